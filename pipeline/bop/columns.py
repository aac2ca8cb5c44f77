"""What a score needs to know of every target, computed piece by piece as columns of numbers.

A piece is the targets of some images; no other piece is needed to compute it. So pieces can be computed in any order
and place, and their columns, put one after the other, are the same to the last bit.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.bop.results import Results
from pipeline.scene import Target

Columns = dict[str, np.ndarray]
"""Arrays whose first axis has the same length: a row for whatever is scored, such as an annotated instance."""

Compute = Callable[[Dataset, Results, Sequence[Target]], Columns]
"""Columns of some targets; a function that other processes can import, or a `functools.partial` of one."""

Progress = Callable[[float], None]
"""Called with the finished share, 0..1; what it raises ends the computation."""

TARGETS_PER_PIECE = 32
"""A piece has at least as many targets, and all of each of its images, but for the last."""


@dataclass(frozen=True)
class Execution:
    """How columns are computed: here, one piece after the other."""

    def columns(
        self, compute: Compute, dataset: Dataset, results: Results, targets: Sequence[Target], progress: Progress
    ) -> Columns:
        """Columns of all targets, in their order."""
        parts = []
        for done, piece in enumerate(found := list(pieces(targets)), start=1):
            parts.append(compute(dataset, results, piece))
            progress(done / len(found))
        return joined(parts)


HERE = Execution()


def pieces(targets: Sequence[Target]) -> Iterator[list[Target]]:
    """Targets in pieces, in their order; targets of an image that follow each other stay together."""
    piece: list[Target] = []
    for _, of_image in groupby(targets, attrgetter("image")):
        piece += of_image
        if len(piece) >= TARGETS_PER_PIECE:
            yield piece
            piece = []
    if piece:
        yield piece


def joined(parts: Sequence[Columns]) -> Columns:
    """Columns of pieces one after the other; there must be at least one piece."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
