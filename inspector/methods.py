"""The methods that `inspector run` knows.

A method is one entry in `METHODS`: the name of its subcommand, a dataclass with its settings, and a function that makes
the estimator from them. This module is loaded by every command, so what is slow to import is imported in that function.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pipeline.bop.dataset import Dataset
    from pipeline.estimator import Estimator


@dataclass(frozen=True)
class Method:
    """A method of pose estimation."""

    settings: type
    """A frozen dataclass: its fields become options, their docstrings the help, and the run keeps their values."""
    make: "Callable[[Any, Dataset], Estimator]"
    """The estimator with some settings; called in each worker once, so other processes must be able to import it."""

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


METHODS = {
    "replay": Method(ReplaySettings, make_replay),
}
