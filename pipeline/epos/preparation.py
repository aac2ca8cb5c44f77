"""What EPOS needs before the first image: a network that fits the dataset, and compiled loops of fitting."""

from collections.abc import Callable, Sequence

from pipeline.bop.dataset import Dataset
from pipeline.epos.config import EposSettings
from pipeline.epos.estimator import EposEstimator
from pipeline.epos.fitting.warm_up import is_warm, warm_up


def prepare(settings: EposSettings, dataset: Dataset, progress: Callable[[str, int, int], None]) -> Sequence[str]:
    """Look whether the network fits, and compile the loops once, so that not every worker does.

    Args:
        settings: of EPOS; its `objects` are those that are looked for.
        dataset: with the objects.
        progress: called with what is worked at, how much is done and how much there is.

    Returns:
        Notes for the user.

    Raises:
        InputError: as `EposEstimator.of_dataset`.

    """
    known = {own.obj_id for own in EposEstimator.of_dataset(dataset, settings).predictor.objects}
    if not is_warm(settings.fitting.scheme):
        progress("compiling the loops of fitting, this once", 0, 1)
        warm_up(settings.fitting.scheme)
        progress("compiling the loops of fitting, this once", 1, 1)
    unknown = ", ".join(str(obj_id) for obj_id in sorted(set(settings.objects) - known))
    return [f"the network was not trained on objects {unknown}; they are not looked for"] if unknown else []
