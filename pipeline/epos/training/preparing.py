"""What is needed before the first step: objects with fragments, and where images come from."""

from dataclasses import dataclass
from pathlib import Path

from pipeline.bop.dataset import Dataset, open_dataset, splits
from pipeline.epos.checkpoint import TrainedObject
from pipeline.epos.fragments import fragments_of
from pipeline.epos.targets import KnownObject
from pipeline.epos.training.config import TrainConfig
from pipeline.epos.training.images import DatasetImages, ImageSource, PastedImages
from pipeline.epos.training.samples import SampleSet
from pipeline.exceptions import InputError, UnknownIdError
from pipeline.scene import Camera
from pipeline.synth.augmentation import Augmentation


@dataclass(frozen=True, eq=False)
class Prepared:
    """What training works on."""

    dataset: Dataset
    """Where models, camera and sample images are from."""
    objects: tuple[KnownObject, ...]
    samples: SampleSet

    @property
    def trained_objects(self) -> tuple[TrainedObject, ...]:
        """The objects as they are kept with the network."""
        return tuple(TrainedObject.of(known.model, known.fragments) for known in self.objects)


def prepare(config: TrainConfig) -> Prepared:
    """Open everything. Raises InputError for what is missing or does not fit."""
    dataset = open_dataset(config.dataset)
    objects = known_objects(dataset, config)
    sources: list[ImageSource] = []
    shares: list[float] = []
    if config.pasted_share > 0:
        sources.append(PastedImages([known.model for known in objects], _camera(dataset), config.pasted))
        shares.append(config.pasted_share)
    if config.pasted_share < 1:
        sources.append(DatasetImages.of(open_dataset(config.dataset, _training_split(config))))
        shares.append(1.0 - config.pasted_share)
    changes = Augmentation() if config.augment else None
    samples = SampleSet(tuple(sources), tuple(shares), objects, config.crop, changes, config.seed, config.windows)
    return Prepared(dataset, objects, samples)


def known_objects(dataset: Dataset, config: TrainConfig) -> tuple[KnownObject, ...]:
    """The objects to learn. Raises UnknownIdError for one that the dataset does not have, InputError for a bad model."""
    wanted = config.objects or dataset.obj_ids
    if not wanted:
        raise InputError(f"{dataset.root}: has no models of objects to learn; give a dataset with a folder of models")
    for obj_id in (*wanted, *config.fragments_of):
        if obj_id not in dataset.obj_ids:
            raise UnknownIdError("object", obj_id, dataset.name, dataset.obj_ids)
    if len(set(wanted)) < len(wanted):
        raise InputError(f"objects {', '.join(map(str, wanted))}: one is named twice; name each once")
    models = [dataset.model(obj_id, "display") for obj_id in wanted]
    return tuple(
        KnownObject(model, fragments_of(model, config.fragments_of.get(model.obj_id, config.fragments)))
        for model in models
    )


def _training_split(config: TrainConfig) -> str:
    """The split with training images. Raises InputError where there is none and none is named."""
    if config.split is not None:
        return config.split
    found = [name for name in splits(Path(config.dataset)) if name.startswith("train")]
    if not found:
        raise InputError(
            f"{config.dataset}: has no training split; name a split, or make all images on the fly (pasted_share 1)"
        )
    return found[0]


def _camera(dataset: Dataset) -> Camera:
    """Camera of the dataset's first image; the images that are made look as if taken by it."""
    key = next(dataset.images(), None)
    if key is None:
        raise InputError(f"{dataset.root / dataset.split}: has no image to take the camera from; give another split")
    return dataset.camera(key)
