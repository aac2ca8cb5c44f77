"""COCO's average precisions and recalls, by pycocotools, with what BOP marks as to be ignored left out.

COCO's own code overwrites that mark, the variant of it that BOP's scripts use does not. What pycocotools prints is
swallowed.
"""

import io
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from copy import copy
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

from pipeline.bop.coco.ground_truth import CocoTruth, Entry
from pipeline.bop.coco.results import Measure

P = ParamSpec("P")
T = TypeVar("T")

SCORES = (
    *("AP", "AP50", "AP75", "AP_small", "AP_medium", "AP_large"),
    *("AR1", "AR10", "AR100", "AR_small", "AR_medium", "AR_large"),
)
"""Names of BOP's scripts for what COCO's `summarize` gives, in its order."""

_NOTHING = -1.0
"""What COCO gives for a score that no annotation decides."""

Scores = dict[str, float | None]


def _quietly(function: Callable[P, T]) -> Callable[P, T]:
    @wraps(function)
    def quiet(*args: P.args, **kwargs: P.kwargs) -> T:
        with redirect_stdout(io.StringIO()):
            return function(*args, **kwargs)

    return quiet


@_quietly
def compared(truth: CocoTruth, found: list[Entry], measure: Measure) -> Any:
    """COCO's evaluator, with detections (in COCO's form, by the numbers of `truth`) compared in all images."""
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    base: Any = COCOeval

    class BopEvaluator(base):
        def _prepare(self) -> None:
            super()._prepare()
            for annotations in self._gts.values():
                for annotation in annotations:
                    annotation["ignore"] = annotation["ignored"]

    def indexed(annotations: list[Entry]) -> Any:
        api: Any = COCO()
        api.dataset = {"images": truth.images, "annotations": annotations, "categories": truth.categories}
        api.createIndex()
        return api

    evaluator: Any = BopEvaluator(indexed(truth.annotations), indexed(found), measure)
    evaluator.evaluate()
    evaluator.accumulate()
    return evaluator


@_quietly
def scores(evaluator: Any) -> Scores:
    """All of COCO's scores; None for one that no annotation decides."""
    evaluator.summarize()
    values = zip(SCORES, map(float, evaluator.stats), strict=True)
    return {name: None if value == _NOTHING else value for name, value in values}


def scores_of_objects(evaluator: Any) -> dict[int, Scores]:
    """AP, AP50, AP75 and AR100 of each object, by id."""
    precision = evaluator.eval["precision"][:, :, :, 0, 2]  # threshold, recall, object; all sizes, 100 detections
    recall = evaluator.eval["recall"][:, :, 0, 2]
    thresholds = evaluator.params.iouThrs
    at = {"AP": thresholds > 0, "AP50": np.isclose(thresholds, 0.5), "AP75": np.isclose(thresholds, 0.75)}
    return {
        int(obj_id): {name: _mean(precision[rows][:, :, k]) for name, rows in at.items()}
        | {"AR100": _mean(recall[:, k])}
        for k, obj_id in enumerate(evaluator.params.catIds)
    }


@_quietly
def scores_of_images(evaluator: Any, numbers: Sequence[int]) -> Scores:
    """All of COCO's scores over some of the images, which are not compared again."""
    part, params = copy(evaluator), copy(evaluator.params)
    shape = (len(params.catIds), len(params.areaRng), len(params.imgIds))
    rows = np.flatnonzero(np.isin(params.imgIds, numbers))
    of_all = np.empty(len(evaluator.evalImgs), dtype=object)
    of_all[:] = evaluator.evalImgs
    params.imgIds = [params.imgIds[row] for row in rows]
    part.params = part._paramsEval = params
    part.evalImgs = of_all.reshape(shape)[:, :, rows].ravel().tolist()
    part.accumulate()
    return scores(part)


def _mean(values: np.ndarray) -> float | None:
    known = values[values > _NOTHING]
    return float(known.mean()) if known.size else None
