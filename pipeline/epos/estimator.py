"""EPOS as an estimator: image, network, potential correspondences, robust fitting (thesis ch. method_epos)."""

import logging
from collections.abc import Sequence
from time import perf_counter
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from pipeline.bop.dataset import Dataset
from pipeline.epos.checkpoint import TrainedObject, load_network, shipped_checkpoint
from pipeline.epos.config import EposSettings, Precision
from pipeline.epos.correspondences import establish
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.results import FittingTrace
from pipeline.epos.networks.network import chosen_device
from pipeline.epos.prediction import Seen
from pipeline.epos.showing import show_fitting, show_object, show_objects
from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from pipeline.recording import NullRecorder, StageRecorder
from pipeline.scene import Image, PoseEstimate, Target

log = logging.getLogger(__name__)

_RECORDED_FROM = 0.02
"""Cells where an object is at least so likely are recorded, so that lower tau_a can be tried on a recording..."""

_RECORDED_CELLS = 4000
"""... but no more than so many, if they were not used: a network that knows little has them everywhere."""


@runtime_checkable
class Predictor(Protocol):
    """Who looks at images: a trained network, or the ground truth in its place."""

    @property
    def objects(self) -> tuple[TrainedObject, ...]:
        """The objects that are known."""
        ...

    def see(self, image: Image, precision: Precision) -> Seen:
        """Look at an image that has colours. Raises InputError where that fails."""
        ...


class EposEstimator:
    """Finds known objects in RGB images; the same image, targets and settings give the same poses."""

    def __init__(self, predictor: Predictor, settings: EposSettings) -> None:
        """Take a network; it is used where it is."""
        self.predictor = predictor
        self.settings = settings
        self.seconds: dict[str, float] = {}
        """Wall time of the stages of the last image: network, correspondences, fitting."""
        self.counts: dict[str, int] = {}
        """Of the last image: objects looked for, correspondences and sampled triplets of all of them."""

    @classmethod
    def of_dataset(cls, dataset: Dataset, settings: EposSettings) -> "EposEstimator":
        """Load the network and compare its objects with those of a dataset.

        Raises:
            InputError: the checkpoint cannot be read, or was trained on other objects; the device is not there.

        """
        checkpoint = settings.checkpoint or shipped_checkpoint()
        trained = load_network(checkpoint, chosen_device(settings.device))
        if not set(trained.obj_ids) & set(dataset.obj_ids):
            known = ", ".join(map(str, trained.obj_ids))
            raise InputError(
                f"{checkpoint}: was trained on objects {known}, none of which {dataset.name} has; "
                "give the checkpoint of this dataset"
            )
        for obj_id in set(trained.obj_ids) & set(dataset.obj_ids):
            try:
                model = dataset.model(obj_id, "display")
            except (MissingFileError, FormatError):
                continue  # EPOS needs no models at test time
            trained.check_model(model)
        return cls(trained, settings)

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        """See `pipeline.estimator.Estimator`.

        An object that is nowhere likely has no estimates. Neither has one that the network was not trained on, which a
        warning says.

        Raises:
            InputError: the image has no colour, is smaller than the network's stride, or its K is unusable; the network
                knows none of the objects; its output is not finite.

        """
        recorder = recorder or NullRecorder()
        where = f"scene {image.key.scene_id}, image {image.key.im_id}"
        if image.rgb is None:
            raise InputError(f"{where}: has no colour or gray image; EPOS needs one")
        positions = self._positions(targets, recorder)
        self.seconds = dict.fromkeys(("network", "correspondences", "fitting"), 0.0)
        self.counts = {"objects": len(positions), "correspondences": 0, "triplets": 0}
        begun = perf_counter()
        seen = self.predictor.see(image, self.settings.precision)
        self.seconds["network"] += perf_counter() - begun
        if recorder.enabled:
            show_objects(seen, [known.obj_id for known in self.predictor.objects], recorder)
        if seen.damaged_cells:
            recorder.text("log", f"{seen.damaged_cells} cells have output that is not finite; left out", "WARN")
        found: list[PoseEstimate] = []
        for target, position in positions.items():
            found += self._instances(image, seen, target, position, recorder)
        return found

    def _positions(self, targets: Sequence[Target], recorder: StageRecorder) -> dict[Target, int]:
        """Places of the targets' objects in the predictor's list. Raises UnknownIdError if none has one."""
        known = {own.obj_id: position for position, own in enumerate(self.predictor.objects)}
        positions = {target: known[target.obj_id] for target in targets if target.obj_id in known}
        for target in targets:
            if not positions:
                raise UnknownIdError("object", target.obj_id, "the objects that the network was trained on", known)
            if target not in positions:
                text = f"object {target.obj_id}: the network was not trained on it; it is not looked for"
                recorder.text("log", text, "WARN")
                log.warning("scene %d, image %d, %s", *target.image, text)
        return positions

    def _instances(
        self, image: Image, seen: Seen, target: Target, position: int, recorder: StageRecorder
    ) -> list[PoseEstimate]:
        """Poses of one object, and the time they took."""
        settings, fragments = self.settings, self.predictor.objects[position].fragments
        clock = [perf_counter()]
        tau_a = settings.correspondences.min_object_probability
        prediction = seen.about(position, target.obj_id, tau_a)
        clock.append(perf_counter())
        matches = establish(prediction, fragments, settings.correspondences)
        clock.append(perf_counter())
        trace = FittingTrace() if recorder.enabled else None
        count = None if settings.count_instances else target.inst_count
        K = np.asarray(image.camera.K, np.float64)
        fitting = fit_poses(matches, K, settings.fitting, instances=count, seed=settings.seed, trace=trace)
        clock.append(perf_counter())
        for stage, seconds in zip(self.seconds, np.diff(clock), strict=True):
            self.seconds[stage] += float(seconds)
        self.counts["correspondences"] += len(matches)
        self.counts["triplets"] += fitting.iterations
        if trace is not None:
            shown = seen.about(
                position, target.obj_id, _recorded_from(seen.object_probability[..., position + 1], tau_a)
            )
            show_object(shown, fragments, matches, recorder)
            show_fitting(target.obj_id, fitting, trace, recorder)
        return [PoseEstimate(*image.key, target.obj_id, pose.quality, pose.camera_from_model) for pose in fitting.poses]


def _recorded_from(a: Float32[np.ndarray, "h w"], tau_a: float) -> float:
    """The a_o from which cells are recorded."""
    likely = a[a > _RECORDED_FROM]
    if len(likely) <= _RECORDED_CELLS:
        return min(tau_a, _RECORDED_FROM)
    return min(tau_a, float(np.partition(likely, -_RECORDED_CELLS)[-_RECORDED_CELLS]))
