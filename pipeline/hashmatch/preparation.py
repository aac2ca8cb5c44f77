"""What a config says about templates: where they come from, where they are kept; and learning them before a run."""

from collections.abc import Mapping, Sequence

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.coverage import advice
from pipeline.hashmatch.dataset_models import DatasetModels, focal_length
from pipeline.hashmatch.learning import Progress, learned
from pipeline.hashmatch.template_cache import TemplateCache, default_folder
from pipeline.hashmatch.template_source import TemplateSource
from pipeline.hashmatch.templates import Templates
from pipeline.parallel import Workers
from pipeline.scene import Model


def prepare(config: HashMatchConfig, dataset: Dataset, workers: Workers, progress: Progress) -> list[str]:
    """Learn the objects that are not in the cache, once for all workers, and return what the user should know.

    Raises InputError as `learned`, and for an object that the dataset does not have.
    """
    models = DatasetModels(dataset, config.objects)
    source = source_of(models, config, focal_length(dataset))
    templates = learned(source, tuple(models), cache_of(config), workers, progress)
    return [*colorless(templates), *advice(dataset, models, templates, config)]


def source_of(models: Mapping[int, Model], config: HashMatchConfig, focal_px: float) -> TemplateSource:
    """Where the config says that templates come from. Raises InputError if the split of images is not there.

    The focal length is rounded to pixels, so that cameras of one kind share templates.
    """
    focal_px = float(round(focal_px))
    if config.templates is None:
        from pipeline.hashmatch.rendered_templates import RenderedTemplates

        return RenderedTemplates(models, config, focal_px)
    from pipeline.hashmatch.captured_templates import CapturedTemplates

    split = config.templates.absolute()
    return CapturedTemplates(open_dataset(split.parent, split.name), models, config, focal_px)


def cache_of(config: HashMatchConfig) -> TemplateCache:
    """Where the config says that templates are kept."""
    return TemplateCache(config.cache or default_folder())


def colorless(learned: Sequence[Templates]) -> list[str]:
    """A line that names the objects of which the colour test is off, if there are any."""
    ids = [str(own.obj_id) for own in learned if not own.colored]
    if not ids:
        return []
    which = "all models" if len(ids) == len(learned) else f"models {', '.join(ids)}"
    return [f"{which} are without colour: test T5, which compares colours, is off for them"]
