"""A results file as an estimator: what a method submitted, played back with the evidence that evaluation sees.

So any method's run can be looked at stage by stage as far as its results file goes, in the inspector and in rerun.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.bop.assessment import pair
from pipeline.bop.dataset import Dataset
from pipeline.bop.results import Results
from pipeline.bop.vsd import vsd_of_poses
from pipeline.exceptions import InputError
from pipeline.recording import StageRecorder
from pipeline.scene import Image, PoseEstimate, Target

TAU = 0.020
"""Metres; misalignment tolerance of the recorded VSD costs (BOP 2017)."""


class Replay:
    """Gives the estimates of a results file and records the VSD maps of each against its ground truth."""

    def __init__(self, dataset: Dataset, results: Results) -> None:
        self._dataset = dataset
        self._results = results

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        """The submitted poses of the targets, unchanged."""
        found: list[PoseEstimate] = []
        for target in targets:
            found += self._results.estimates(target.image, target.obj_id)[: target.inst_count]
            if recorder.enabled and image.depth is not None:
                try:
                    self._record_vsd(image, target, recorder)
                except InputError as error:  # the poses can be shown even so
                    recorder.text("log", str(error), level="WARN")
        return found

    def _record_vsd(self, image: Image, target: Target, recorder: StageRecorder) -> None:
        assert image.depth is not None
        model, delta = self._dataset.model(target.obj_id), self._dataset.facts.vsd_delta
        for gt, estimate in pair(self._dataset, self._results, target):
            if estimate is None:
                continue
            taus = [TAU / model.diameter]
            vsd = vsd_of_poses(
                model, image.camera, estimate.camera_from_model, gt.camera_from_model, image.depth, taus, delta
            )
            path = f"vsd/{gt.index}"
            recorder.mask(f"{path}/visible_estimate", vsd.expand(vsd.visible_estimate))
            recorder.mask(f"{path}/visible_gt", vsd.expand(vsd.visible_gt))
            difference = vsd.expand(vsd.difference.astype(np.float32), np.nan)
            recorder.heatmap(f"{path}/distance_difference", difference, unit="m")
            recorder.heatmap(f"{path}/cost", vsd.expand(vsd.cost(taus[0]).astype(np.float32), np.nan), unit="cost")
