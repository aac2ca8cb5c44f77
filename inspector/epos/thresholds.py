"""tau_a, tau_b and tau_r: as the run had them, and as a person has moved them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from inspector.epos.choice import EposChoice
from inspector.workspace import Workspace
from pipeline.epos.config import CorrespondenceConfig
from pipeline.epos.fitting.config import FittingConfig


class Thresholds(NamedTuple):
    """Which correspondences are established, and which of them are inliers (thesis sec. epos_experiments)."""

    tau_a: float
    tau_b: float
    tau_r: float
    """Pixels."""

    def moved(self, choice: EposChoice) -> "Thresholds":
        """With what was chosen in place of what the run had."""
        chosen = {name: value for name in self._fields if (value := getattr(choice, name)) is not None}
        return self._replace(**chosen)


def thresholds_of(workspace: Workspace) -> Thresholds:
    """The thresholds that a run's settings name, wherever they stand in them; else those of the thesis."""
    config = {} if workspace.run is None else workspace.run.info.config
    usual, fitting = CorrespondenceConfig(), FittingConfig()
    return Thresholds(
        _find(config, "min_object_probability", usual.min_object_probability),
        _find(config, "min_fragment_probability", usual.min_fragment_probability),
        _find(config, "inlier_threshold_px", fitting.inlier_threshold_px),
    )


def _find(config: Any, name: str, usual: float) -> float:
    """A number by its name at any depth of nested settings."""
    if not isinstance(config, Mapping):
        return usual
    found = config.get(name)
    if isinstance(found, int | float):
        return float(found)
    return next((value for part in config.values() if (value := _find(part, name, usual)) != usual), usual)
