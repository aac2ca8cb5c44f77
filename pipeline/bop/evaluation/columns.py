"""What a score needs to know of every target, computed piece by piece as columns of numbers.

A piece is the targets of some images; no other piece is needed to compute it. So pieces can be computed in any order
and place, and their columns, put one after the other, are the same to the last bit.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.journal import NoJournal, PieceJournal
from pipeline.bop.evaluation.name import evaluation_of
from pipeline.bop.results import Results
from pipeline.parallel import HERE as IN_THIS_PROCESS
from pipeline.parallel import Workers
from pipeline.scene import Target

Columns = dict[str, np.ndarray]
"""Arrays whose first axis has the same length: a row for whatever is scored, such as an annotated instance.

One named `row` holds rows of the results, -1 for none.
"""

Compute = Callable[[Dataset, Results, Sequence[Target]], Columns]
"""Columns of some targets; a function that other processes can import, or a `functools.partial` of one.

It is given the results for the images of these targets only.
"""

Progress = Callable[[float], None]
"""Called with the finished share, 0..1; what it raises ends the computation."""

TARGETS_PER_PIECE = 32
"""A piece has at least as many targets, and all of each of its images, but for the last."""


@dataclass(frozen=True)
class Execution:
    """How columns are computed: by whom, and whether what is finished outlives an interruption."""

    workers: Workers | None = None
    """Who computes the pieces; None for this process."""
    journal: Path | None = None
    """Folder where finished pieces are kept until `forget_pieces`; the same evaluation begun again goes on from them.
    """

    def columns(
        self, compute: Compute, dataset: Dataset, results: Results, targets: Sequence[Target], progress: Progress
    ) -> Columns:
        """Columns of all targets, in their order.

        Raises InputError if the journal cannot be written or another process writes to it, or the workers are gone.
        """
        found = list(pieces(targets))
        with self._opened_journal(compute, dataset, results, targets) as journal:
            parts = dict(journal.kept)
            waiting = [index for index in range(len(found)) if index not in parts]
            if parts:
                progress(len(parts) / len(found))
            work = (Piece.of(found[index], results) for index in waiting)
            workers = self.workers or IN_THIS_PROCESS
            with closing(
                workers.map_unordered(
                    columns_of_piece, work, (compute, dataset), total=len(waiting), describe=Piece.__str__
                )
            ) as computed:
                for position, columns in computed:
                    parts[waiting[position]] = columns
                    journal.add(waiting[position], columns)
                    progress(len(parts) / len(found))
        return joined([parts[index] for index in range(len(found))])

    def _opened_journal(
        self, compute: Compute, dataset: Dataset, results: Results, targets: Sequence[Target]
    ) -> PieceJournal | NoJournal:
        if self.journal is None:
            return NoJournal()
        return PieceJournal(self.journal, evaluation_of(compute, dataset, results, targets, TARGETS_PER_PIECE))


HERE = Execution()


class Piece(NamedTuple):
    """What it takes to compute a piece, whatever the size of the results file."""

    targets: list[Target]
    results: Results
    """Those for the images of the targets."""
    rows: Int[np.ndarray, "n"]
    """Rows of the whole results that these are."""

    @staticmethod
    def of(targets: list[Target], results: Results) -> "Piece":
        """Take what belongs to some targets; the order of the file is kept, on which equal scores depend."""
        images = dict.fromkeys(target.image for target in targets)
        rows = np.sort(np.concatenate([results.rows(image) for image in images]))
        arrays = {
            f.name: value[rows] for f in fields(results) if isinstance(value := getattr(results, f.name), np.ndarray)
        }
        return Piece(targets, replace(results, **arrays), rows)

    def __str__(self) -> str:
        first, last = self.targets[0], self.targets[-1]
        end = "" if first.image == last.image else f" to scene {last.scene_id}, image {last.im_id}"
        return f"scene {first.scene_id}, image {first.im_id}{end}"


def columns_of_piece(shared: tuple[Compute, Dataset], piece: Piece) -> Columns:
    """Columns of one piece; rows of the results are those of the whole results."""
    compute, dataset = shared
    columns = compute(dataset, piece.results, piece.targets)
    if "row" in columns:
        columns["row"] = np.where(columns["row"] < 0, -1, np.append(piece.rows, -1)[columns["row"]])
    return columns


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
