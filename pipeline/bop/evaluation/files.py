"""The folder that an evaluation is written to: `scores.json`, `curves.json`, and tables of what is behind the scores.

`instances.csv` has a row for each annotated instance (2017: each target), `estimates.csv`, for 6D detection, one for
each estimate that counts. Recalls of an instance are the shares of the thresholds at which it is found.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from pipeline.bop.evaluation.columns import Columns
from pipeline.bop.evaluation.curves import SISO_THETAS, VISIBILITY, curves, curves_by, siso_curves
from pipeline.bop.evaluation.detection_outcomes import LEFT_OUT, RIGHT, THRESHOLDS, Outcomes
from pipeline.bop.evaluation.evaluate import Evaluation
from pipeline.bop.evaluation.pose_detection import PoseDetectionEvaluation, Precisions
from pipeline.bop.evaluation.scores import MSPD_THETAS_PX, THETAS, FoundInstances
from pipeline.bop.evaluation.siso import TAUS as SISO_TAUS
from pipeline.bop.evaluation.siso import SisoEvaluation, SisoTargets
from pipeline.bop.evaluation.summary import Summary, counts
from pipeline.bop.json_files import write_atomically
from pipeline.bop.vsd import TAUS
from pipeline.exceptions import InputError

AnyEvaluation = Evaluation | SisoEvaluation | PoseDetectionEvaluation | Summary
"""Of 6D localization since 2019, of 2017, of 6D detection, of 2D detection."""


def summary_of(evaluation: AnyEvaluation) -> Summary:
    """The scores of an evaluation of any task."""
    return evaluation if isinstance(evaluation, Summary) else evaluation.summary


def with_notes(evaluation: AnyEvaluation, notes: Sequence[str]) -> AnyEvaluation:
    """The evaluation with more to be known beside the numbers."""
    if isinstance(evaluation, Evaluation | Summary):
        return replace(evaluation, notes=(*evaluation.notes, *notes))
    summary = replace(evaluation.summary, notes=(*evaluation.summary.notes, *notes))
    return replace(evaluation, summary=summary)


def write_evaluation(folder: Path, evaluation: AnyEvaluation) -> None:
    """Write all files of an evaluation, over those that are there. Raises InputError if one cannot be written."""
    write_json(folder / "scores.json", summary_of(evaluation).as_dict())
    match evaluation:
        case Evaluation():
            write_csv(folder / "instances.csv", _instances(evaluation.instances))
            write_json(folder / "curves.json", _curves(evaluation.instances))
        case SisoEvaluation(targets=targets) if targets is not None:
            write_csv(folder / "instances.csv", _siso_targets(targets))
            write_json(folder / "curves.json", _siso_curves(targets))
        case PoseDetectionEvaluation():
            is_instance = evaluation.outcomes.gt_index >= 0
            write_csv(folder / "instances.csv", _detected_instances(evaluation.outcomes.of(is_instance)))
            write_csv(folder / "estimates.csv", _detections(evaluation.outcomes.of(~is_instance)))
            write_json(folder / "curves.json", _precisions(evaluation.precisions))
        case _:
            pass


def check_writable(path: Path) -> None:
    """Raise InputError if a file could not be written, before it has cost anything; its folder is made if absent."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    probe = path.with_name(f".{path.name}.{os.getpid()}.probe")
    try:
        write_atomically(probe, b"")
        probe.unlink(missing_ok=True)
    except InputError as error:
        raise InputError(str(error).replace(str(probe), str(path))) from error


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file for people and programs, NaN as null."""
    write_atomically(path, orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))


def write_csv(path: Path, columns: Columns) -> None:
    """Write columns of numbers with their names; NaN is left empty."""
    texts = [["" if value != value else str(value) for value in column.tolist()] for column in columns.values()]
    lines = [",".join(columns), *map(",".join, zip(*texts, strict=True)), ""]
    write_atomically(path, "\n".join(lines).encode())


def _ids(rows: FoundInstances | SisoTargets | Outcomes) -> Columns:
    names = ("scene_id", "im_id", "obj_id", "gt_index", "visible_fraction")
    return {name: getattr(rows, name) for name in names}


def _instances(instances: FoundInstances) -> Columns:
    average = {name: getattr(instances, name) for name in ("vsd", "mssd", "mspd")}
    parts = {
        f"average_recall_{name}": f.reshape(len(f), -1).mean(axis=1) for name, f in average.items() if f is not None
    }
    columns = _ids(instances)
    if len(parts) == len(average):
        columns["average_recall"] = np.mean(list(parts.values()), axis=0)
    ad = {} if instances.ad is None else {"ad_found": instances.ad.astype(int)}
    return columns | parts | ad


def _siso_targets(targets: SisoTargets) -> Columns:
    errors = {f"vsd_{tau * 1000:.0f}mm": targets.vsd[:, i] for i, tau in enumerate(SISO_TAUS)}
    return _ids(targets) | errors | {"found": targets.found.astype(int)}


def _detected_instances(instances: Outcomes) -> Columns:
    found = {f"recall_{error}": (getattr(instances, error) == RIGHT).mean(axis=1) for error in THRESHOLDS}
    return _ids(instances) | {"demanded": instances.demanded.astype(int)} | found


def _detections(estimates: Outcomes) -> Columns:
    columns = {name: getattr(estimates, name) for name in ("scene_id", "im_id", "obj_id", "row", "score")}
    for error in THRESHOLDS:
        outcomes = getattr(estimates, error)
        columns[f"right_{error}"] = (outcomes == RIGHT).mean(axis=1)
        columns[f"left_out_{error}"] = (outcomes == LEFT_OUT).mean(axis=1)
    return columns


def _curves(instances: FoundInstances) -> dict[str, Any]:
    return {
        "thetas": THETAS.tolist(),
        "mspd_thetas_px": MSPD_THETAS_PX.tolist(),
        "taus": list(TAUS),
        "visibility": VISIBILITY.tolist(),
        "all": curves(instances).as_dict(),
        "per_object": {str(i): found.as_dict() for i, found in curves_by(instances, instances.obj_id).items()},
    }


def _siso_curves(targets: SisoTargets) -> dict[str, Any]:
    return {
        "thetas": SISO_THETAS.tolist(),
        "taus_m": list(SISO_TAUS),
        "visibility": VISIBILITY.tolist(),
        "all": siso_curves(targets).as_dict(),
        "per_object": {str(i): siso_curves(targets, targets.obj_id == i).as_dict() for i in counts(targets.obj_id)},
    }


def _precisions(precisions: Mapping[int, Precisions]) -> dict[str, Any]:
    """Average precision at each threshold."""
    means = {error: np.mean([of_object[error] for of_object in precisions.values()], axis=0) for error in THRESHOLDS}
    return {
        "thresholds": {error: thresholds.tolist() for error, thresholds in THRESHOLDS.items()},
        "all": {error: mean.tolist() for error, mean in means.items()},
        "per_object": {str(i): {e: at.tolist() for e, at in of.items()} for i, of in precisions.items()},
    }
