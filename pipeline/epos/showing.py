"""What the recorder is handed of an image: probabilities, correspondences, the search for poses.

Called only when something is recorded; paths are those of `pipeline.recording.entities`.
"""

from collections.abc import Sequence

import numpy as np

from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fitting.results import Fitting, FittingTrace
from pipeline.epos.fragments import Fragments
from pipeline.epos.grid import CELL_PX, cell_pixels
from pipeline.epos.prediction import ObjectPrediction, Seen
from pipeline.epos.targets import KnownObject, Targets
from pipeline.recording import StageRecorder

BEST = ", best so far"
"""Ends the label of a hypothesis that was the best when the search looked at it."""


def show_objects(seen: Seen, obj_ids: Sequence[int], recorder: StageRecorder) -> None:
    """Record a, for all cells."""
    rows, columns, classes = seen.object_probability.shape
    cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    recorder.probabilities(
        "epos/object_probability",
        seen.object_probability.reshape(-1, classes).astype(np.float16),
        cells=cells.astype(np.int16),
        grid=(rows, columns),
        cell_px=CELL_PX,
        labels=["background", *map(str, obj_ids)],
    )


def show_object(
    prediction: ObjectPrediction, fragments: Fragments, matches: PotentialCorrespondences, recorder: StageRecorder
) -> None:
    """Record b with the points of all fragments, the fragments themselves, and the correspondences."""
    obj_id, ids = prediction.obj_id, np.arange(len(fragments))
    points = fragments.sizes[:, None] * prediction.coordinates + fragments.centers
    recorder.table(
        f"epos/fragment_model/{obj_id}", {"centre_in_model": fragments.centers.copy(), "size": fragments.sizes.copy()}
    )
    recorder.probabilities(
        f"epos/fragments/{obj_id}",
        prediction.fragment_probability.astype(np.float16),
        cells=prediction.cells.astype(np.int16),
        grid=prediction.grid,
        cell_px=CELL_PX,
        labels=list(map(str, ids)),
        points_in_model=points.astype(np.float16),  # metres: to 0.03 mm at 6 cm
    )
    recorder.correspondences(
        f"epos/correspondences/{obj_id}",
        obj_id,
        matches.pixels,
        matches.points_in_model,
        matches.confidence,
        fragment_ids=matches.fragment_ids,
    )


def show_fitting(obj_id: int, fitting: Fitting, trace: FittingTrace, recorder: StageRecorder) -> None:
    """Record every pose that was looked at, the decisions, and why the search ended."""
    looked_at = trace.all_hypotheses()
    recorder.hypotheses(
        f"epos/hypotheses/{obj_id}",
        obj_id,
        looked_at.camera_from_model,
        looked_at.quality,
        steps=np.arange(len(looked_at.quality)),
        instances=looked_at.proposals,
        samples=looked_at.triplets,
        labels=[
            f"{stage}{BEST}" if best else stage for stage, best in zip(looked_at.stage, looked_at.best, strict=True)
        ],
    )
    for event in trace.events:
        recorder.text(f"epos/fitting/{obj_id}", f"{event.kind}: {event.text}")
    counted = f"{len(fitting.poses)} poses from {fitting.pixels} pixels, {fitting.iterations} triplets"
    recorder.text(f"epos/fitting/{obj_id}", f"{counted}; {fitting.stopped}")


def show_targets(targets: Targets, objects: Sequence[KnownObject], recorder: StageRecorder) -> None:
    """Record what the network should say of an image."""
    obj_ids = np.array([0, *(known.model.obj_id for known in objects)])
    recorder.heatmap("epos/targets/object", obj_ids[targets.objects], unit="object", cell_px=CELL_PX)
    for label in np.unique(targets.objects[targets.objects > 0]):
        rows, columns = np.nonzero(targets.objects == label)
        ids, coordinates = targets.fragments[rows, columns], targets.coordinates[rows, columns]
        cells = np.stack([columns, rows], axis=1)
        recorder.table(
            f"epos/targets/fragments/{obj_ids[label]}",
            {
                "cells": cells,
                "pixels": cell_pixels(cells),
                "instance": targets.instances[rows, columns],
                "fragment": ids,
                "coordinates": coordinates,
                "points_in_model": objects[label - 1].fragments.points(ids, coordinates),
            },
        )
