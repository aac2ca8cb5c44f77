"""What makes two evaluations the same: all that decides the numbers."""

import hashlib
import json
import pickle
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.fingerprint import fingerprint
from pipeline.bop.results import Results
from pipeline.program import program
from pipeline.scene import Target


class EvaluationName(NamedTuple):
    """Which evaluation it is, and what decides its numbers."""

    title: str
    """Dataset, split and method."""
    what: str
    """Digest of the title, what is computed, and its options: the evaluation that the user means."""
    decisive: Mapping[str, str]
    """Digests by name of all else that the numbers depend on."""

    @property
    def file_name(self) -> str:
        """To keep what belongs to it under."""
        readable = re.sub(r"[^A-Za-z0-9.-]+", "_", self.title)[:80]
        return f"{readable}-{self.what}-{_digest(json.dumps(self.decisive).encode())}"


def evaluation_of(
    compute: Any, dataset: Dataset, results: Results, targets: Sequence[Target], per_piece: int
) -> EvaluationName:
    """Name an evaluation; `compute` and its options are told apart by their pickle."""
    title = f"{dataset.name}-{dataset.split}-{results.method}"
    arrays = (results.scene_id, results.im_id, results.obj_id, results.score, results.rotation, results.translation_mm)
    decisive = {
        "dataset": fingerprint(dataset),
        "results": _digest(*(np.ascontiguousarray(array) for array in (*arrays, results.time_s))),
        "targets": _digest(np.array(targets, dtype=np.int64), str(per_piece).encode()),
        "program": program(),
    }
    return EvaluationName(title, _digest(title.encode(), pickle.dumps(compute, 4)), decisive)


def _digest(*parts: Any) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()[:16]
