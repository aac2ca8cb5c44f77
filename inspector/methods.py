"""The methods that `inspector run` knows.

A method is one entry in `METHODS`: the name of its subcommand, a dataclass with its settings, and a function that makes
the estimator from them. What takes long and is the same for all images is prepared once, before the workers make their
estimators. This module is loaded by every command, so what is slow to import is imported in these functions.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.epos.config import EposSettings
from pipeline.hashmatch.config import HashMatchConfig

if TYPE_CHECKING:
    from pipeline.bop.dataset import Dataset
    from pipeline.estimator import Estimator
    from pipeline.parallel import Workers

Progress = Callable[[str, int, int], None]
"""Called with what is worked at, how much is done and how much there is; what it raises ends the work."""


@dataclass(frozen=True)
class Method:
    """A method of pose estimation."""

    settings: type
    """A frozen dataclass: its fields become options, their docstrings the help, and the run keeps their values.

    `seed` is that of the run; an empty `objects` becomes those of all targets.
    """
    make: "Callable[[Any, Dataset], Estimator]"
    """The estimator with some settings; called in each worker once, so other processes must be able to import it."""
    prepare: "Callable[[Any, Dataset, Workers, Progress], Sequence[str]] | None" = None
    """Makes what estimators read then, from a cache for instance, and returns notes for the user. It goes on where it
    was stopped; a worker that does not see what was made makes it itself."""
    unit: str = "parts"
    """What the progress of the preparation counts."""
    outputs: frozenset[str] = frozenset()
    """Settings that are paths to write to, where nothing needs to be yet."""

    def estimator(self, settings: Any, dataset: "Dataset") -> "Estimator":
        """The estimator, made where it is used."""
        from pipeline.lazy_estimator import LazyEstimator

        return LazyEstimator(partial(self.make, settings, dataset))


@dataclass(frozen=True)
class ReplaySettings:
    """Play back what a method submitted, with the evidence that evaluation sees."""

    results: Path
    """BOP results file (CSV)."""


def make_replay(settings: ReplaySettings, dataset: "Dataset") -> "Estimator":
    """Make the estimator that gives what is in a results file."""
    from pipeline.bop.results import read_results
    from pipeline.replay import Replay

    return Replay(dataset, read_results(settings.results))


def make_epos(settings: EposSettings, dataset: "Dataset") -> "Estimator":
    """Make the estimator of EPOS with its network."""
    from pipeline.epos.estimator import EposEstimator

    return EposEstimator.of_dataset(dataset, settings)


def prepare_epos(settings: EposSettings, dataset: "Dataset", workers: "Workers", progress: Progress) -> Sequence[str]:
    """Compare the network with the dataset, and compile the loops of fitting."""
    from pipeline.epos.preparation import prepare

    return prepare(settings, dataset, progress)


def make_hashmatch(settings: HashMatchConfig, dataset: "Dataset") -> "Estimator":
    """Make the HashMatch estimator; its templates come from the cache."""
    from pipeline.hashmatch.estimator import HashMatchEstimator

    return HashMatchEstimator.of_dataset(dataset, settings)


def prepare_hashmatch(
    settings: HashMatchConfig, dataset: "Dataset", workers: "Workers", progress: Progress
) -> Sequence[str]:
    """Learn the templates that are not in the cache."""
    from pipeline.hashmatch.preparation import prepare

    return prepare(settings, dataset, workers, progress)


METHODS = {
    "replay": Method(ReplaySettings, make_replay),
    "epos": Method(EposSettings, make_epos, prepare_epos),
    "hashmatch": Method(
        HashMatchConfig, make_hashmatch, prepare_hashmatch, unit="templates", outputs=frozenset({"cache"})
    ),
}
