"""HashMatch as an estimator (thesis ch. HashMatch): templates, the cascade over windows, refinement."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.exceptions import UnknownIdError
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.dataset_models import DatasetModels, focal_length
from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.learning import Progress, learned
from pipeline.hashmatch.preparation import cache_of, source_of
from pipeline.hashmatch.proposals import Instance
from pipeline.hashmatch.pyramid import check_image
from pipeline.hashmatch.selection import estimate_instances
from pipeline.hashmatch.showing import show_matching, show_refinement, show_tests
from pipeline.parallel.threads import thread_limit
from pipeline.recording import NullRecorder, StageRecorder
from pipeline.scene import Image, Model, PoseEstimate, Target


@dataclass(frozen=True, eq=False)
class Found:
    """Everything that HashMatch found in an image."""

    matching: Matching
    proposed: list[Instance]
    """Refined poses, before instances were chosen."""
    chosen: list[Instance]
    """The instances, best first."""
    seconds: dict[str, float]
    """Wall time: "matching", "refinement"; processor time of the stages of matching is in `matching.seconds`."""


class HashMatchEstimator:
    """Finds known objects in RGB-D images; the same image, targets and config always give the same poses."""

    def __init__(
        self, models: Mapping[int, Model], config: HashMatchConfig, focal_px: float,
        progress: Progress = lambda *_: None,
    ) -> None:  # fmt: skip
        """Learn the objects, or take their templates from the cache.

        Args:
            models: By object id, with colour, diameter and symmetries.
            config: All parameters.
            focal_px: Focal length of the templates, rounded to pixels; that of the images, best.
            progress: See `learned`.

        Raises:
            InputError: a model cannot be rendered, or the cache cannot be used.

        """
        self.models = models
        self.config = config
        templates = learned(source_of(models, config, focal_px), tuple(models), cache_of(config), progress=progress)
        self.detector = Detector(templates, _for_matching(config))

    @classmethod
    def of_dataset(
        cls, dataset: Dataset, config: HashMatchConfig, obj_ids: Sequence[int] = (),
        progress: Progress = lambda *_: None,
    ) -> "HashMatchEstimator":  # fmt: skip
        """Learn objects of a dataset (by default those of the config, else all) for its cameras.

        Raises InputError if they or the cameras cannot be used.
        """
        models = DatasetModels(dataset, obj_ids or config.objects)
        return cls(models, config, focal_length(dataset), progress)

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        """See `pipeline.estimator.Estimator`. For detection the counts of the targets are ignored.

        Raises:
            InputError: the image has no depth or no usable K, or an object was not learned.

        """
        return self.found(image, targets, recorder)[0]

    def found(
        self, image: Image, targets: Sequence[Target], recorder: StageRecorder | None = None
    ) -> tuple[list[PoseEstimate], Found]:
        """Estimates with all that led to them. Raises as `estimate` does."""
        recorder = recorder or NullRecorder()
        check_image(image)
        counts = self._counts(targets)
        begun = perf_counter()
        wanted = np.isin(np.arange(len(self.detector.objects)), list(counts))
        matching = self.detector.match(image, wanted)
        matched = perf_counter()
        models = [self.models[own.obj_id] for own in self.detector.objects]
        proposed, chosen = estimate_instances(self.detector, matching, models, counts, recorder.enabled)
        refined = perf_counter()
        estimates = [self._estimate(image, instance) for instance in chosen]
        if recorder.enabled:
            show_matching(self.detector, matching, recorder)
            show_tests(self.detector, matching, chosen, recorder)
            show_refinement(self.detector, proposed, chosen, estimates, recorder)
        seconds = {"matching": matched - begun, "refinement": refined - matched}
        return estimates, Found(matching, proposed, chosen, seconds)

    def _counts(self, targets: Sequence[Target]) -> dict[int, int]:
        """Instances sought, by position in the detector's list of objects."""
        positions = {own.obj_id: i for i, own in enumerate(self.detector.objects)}
        for target in targets:
            if target.obj_id not in positions:
                raise UnknownIdError("object", target.obj_id, "the templates that were learned", positions)
        siso = self.config.task == "siso"
        return {positions[target.obj_id]: 1 if siso else target.inst_count for target in targets}

    def _estimate(self, image: Image, instance: Instance) -> PoseEstimate:
        obj_id = self.detector.objects[instance.position].obj_id
        return PoseEstimate(*image.key, obj_id, instance.score, instance.pose)


def _for_matching(config: HashMatchConfig) -> HashMatchConfig:
    """What the stages go by: SiSo is localization of one instance; processes side by side share the cores."""
    threads = config.threads or thread_limit() or len(os.sched_getaffinity(0))
    return replace(config, task="localization" if config.task == "siso" else config.task, threads=threads)
