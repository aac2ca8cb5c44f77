"""EPOS as an estimator: image, network, potential correspondences, robust fitting (thesis ch. method_epos)."""

from collections.abc import Sequence
from time import perf_counter

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.epos.checkpoint import TrainedNetwork, load_network
from pipeline.epos.config import EposSettings
from pipeline.epos.correspondences import establish
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.results import FittingTrace
from pipeline.epos.networks.network import chosen_device
from pipeline.epos.prediction import SeenImage, predict_object, see
from pipeline.epos.showing import show_fitting, show_object, show_objects
from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.recording import NullRecorder, StageRecorder
from pipeline.scene import Image, PoseEstimate, Target


class EposEstimator:
    """Finds known objects in RGB images; the same image, targets and settings give the same poses."""

    def __init__(self, trained: TrainedNetwork, settings: EposSettings) -> None:
        """Take a network; it is used where it is."""
        self.trained = trained
        self.settings = settings
        self.seconds: dict[str, float] = {}
        """Wall time of the stages of the last image: network, correspondences, fitting."""

    @classmethod
    def of_dataset(cls, dataset: Dataset, settings: EposSettings) -> "EposEstimator":
        """Load the network and compare its objects with those of a dataset.

        Raises:
            InputError: the checkpoint cannot be read, or was trained on other objects; the device is not there.

        """
        trained = load_network(settings.checkpoint, chosen_device(settings.device))
        if not set(trained.obj_ids) & set(dataset.obj_ids):
            known = ", ".join(map(str, trained.obj_ids))
            raise InputError(
                f"{settings.checkpoint}: was trained on objects {known}, none of which {dataset.name} has; "
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
        """See `pipeline.estimator.Estimator`; an object that is nowhere likely has no estimates.

        Raises:
            InputError: the image has no colour, is smaller than the network's stride, or its K is unusable; an object is
                not known to the network; the network's output is not finite.

        """
        recorder = recorder or NullRecorder()
        where = f"scene {image.key.scene_id}, image {image.key.im_id}"
        if image.rgb is None:
            raise InputError(f"{where}: has no colour or gray image; EPOS needs one")
        positions = {target: self.trained.position(target.obj_id) for target in targets}
        self.seconds = dict.fromkeys(("network", "correspondences", "fitting"), 0.0)
        begun = perf_counter()
        seen = see(self.trained.network, image.rgb, self.settings.precision)
        self.seconds["network"] += perf_counter() - begun
        if recorder.enabled:
            show_objects(seen, self.trained.obj_ids, recorder)
        if seen.damaged_cells:
            recorder.text("log", f"{seen.damaged_cells} cells have output that is not finite; left out", "WARN")
        found: list[PoseEstimate] = []
        for target, position in positions.items():
            found += self._instances(image, seen, target, position, recorder)
        return found

    def _instances(
        self, image: Image, seen: SeenImage, target: Target, position: int, recorder: StageRecorder
    ) -> list[PoseEstimate]:
        """Poses of one object, and the time they took."""
        settings, fragments = self.settings, self.trained.objects[position].fragments
        clock = [perf_counter()]
        tau_a = settings.correspondences.min_object_probability
        prediction = predict_object(self.trained.network, seen, position, target.obj_id, tau_a)
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
        if trace is not None:
            show_object(prediction, fragments, matches, recorder)
            show_fitting(target.obj_id, fitting, trace, recorder)
        return [PoseEstimate(*image.key, target.obj_id, pose.quality, pose.camera_from_model) for pose in fitting.poses]


def make_epos(settings: EposSettings, dataset: Dataset) -> EposEstimator:
    """Make the estimator for a dataset; raises as `EposEstimator.of_dataset`."""
    return EposEstimator.of_dataset(dataset, settings)
