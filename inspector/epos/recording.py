"""What a recording holds of EPOS about one object: anybody's, so that each part may be missing or not fit the others."""

from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from pipeline.recording import Correspondences, Hypotheses, Probabilities, RecordingReader, Table, Text

R = TypeVar("R")

PARTS = {
    "epos/object_probability": "object probabilities",
    "epos/fragments/{obj}": "fragments",
    "epos/fragment_model/{obj}": "fragment centres",
    "epos/correspondences/{obj}": "correspondences",
    "epos/hypotheses/{obj}": "hypotheses",
}
"""What the views are made of, by entity path, in the words of a person."""


class EposRecording:
    """The parts of a recording that are about one object, read when first asked for, and then kept."""

    def __init__(self, reader: RecordingReader, obj_id: int) -> None:
        """Look at an object in a recording; reading a part raises InputError where it is damaged."""
        self.reader = reader
        self.obj_id = obj_id

    @cached_property
    def missing(self) -> tuple[str, ...]:
        """What was not recorded of the object."""
        known = self.reader.kinds()
        return tuple(name for path, name in PARTS.items() if path.format(obj=self.obj_id) not in known)

    @cached_property
    def objects(self) -> Probabilities | None:
        """Probabilities a of all objects."""
        return self._probabilities("epos/object_probability")

    @cached_property
    def fragments(self) -> Probabilities | None:
        """Probabilities b of the object's fragments."""
        return self._probabilities("epos/fragments/{obj}")

    @cached_property
    def correspondences(self) -> Correspondences | None:
        """The correspondences that poses were fitted to."""
        return self._read("epos/correspondences/{obj}", Correspondences)

    @cached_property
    def hypotheses(self) -> Hypotheses | None:
        """The poses that the search looked at; None also where it looked at none."""
        found = self._read("epos/hypotheses/{obj}", Hypotheses)
        return found if found is not None and len(found.quality) else None

    @cached_property
    def decisions(self) -> tuple[str, ...]:
        """What the search took, and why it stopped."""
        path = f"epos/fitting/{self.obj_id}"
        found = self.reader.read_all(path) if path in self.reader.kinds() else []
        return tuple(entry.text for entry in found if isinstance(entry, Text))

    @cached_property
    def object_map(self) -> Float32[np.ndarray, "h w"] | None:
        """Probability a of this object over the grid; None where it was not recorded or is not among the labels."""
        objects = self.objects
        if objects is None or str(self.obj_id) not in objects.labels:
            return None
        return over_grid(objects, objects.values[:, objects.labels.index(str(self.obj_id))])

    @cached_property
    def certainty(self) -> Float32[np.ndarray, "k"] | None:
        """Probability a of this object at the cells of `fragments`, 1 where it was not recorded; None without fragments."""
        if self.fragments is None:
            return None
        cells, known = self.fragments.cells, self.object_map
        if known is None or known.shape != self.fragments.grid:
            return np.ones(len(cells), np.float32)
        return known[cells[:, 1], cells[:, 0]]

    @cached_property
    def likeliest(self) -> Int[np.ndarray, "k"] | None:
        """Most likely fragment at each cell of `fragments`."""
        if self.fragments is None or not self.fragments.values.shape[1]:
            return None
        return self.fragments.values.argmax(axis=1)

    @cached_property
    def _table(self) -> Table | None:
        found = self._read("epos/fragment_model/{obj}", Table)
        if found is None or getattr(found.columns.get("centre_in_model"), "shape", ())[1:] != (3,):
            return None
        return found if self.fragments is None or self._count == len(found) else None

    @cached_property
    def _count(self) -> int:
        return 0 if self.fragments is None else self.fragments.values.shape[1]

    @cached_property
    def centers(self) -> Float64[np.ndarray, "n 3"] | None:
        """g, metres, model frame; where it was not recorded, about the middle of what each fragment predicts."""
        if self._table is not None:
            return np.nan_to_num(self._table.columns["centre_in_model"].astype(np.float64))
        fragments = self.fragments
        if fragments is None or fragments.points_in_model is None or not len(fragments.cells):
            return None
        weights = fragments.values.astype(np.float64)[..., None] + 1e-9
        points = np.nan_to_num(fragments.points_in_model.astype(np.float64))
        return (weights * points).sum(axis=0) / weights.sum(axis=0)

    @cached_property
    def sizes(self) -> Float64[np.ndarray, "n"] | None:
        """h, metres; None where it was not recorded."""
        found = None if self._table is None else self._table.columns.get("size")
        return None if found is None or found.ndim != 1 else np.maximum(found.astype(np.float64), 1e-9)

    def _probabilities(self, path: str) -> Probabilities | None:
        """A record whose cells all lie in its grid and whose values are all numbers."""
        found = self._read(path, Probabilities)
        if found is None:
            return None
        inside = ((found.cells >= 0) & (found.cells < found.grid[::-1])).all(axis=1)
        points = None if found.points_in_model is None else found.points_in_model[inside]
        values = np.nan_to_num(found.values[inside].astype(np.float32), posinf=0.0)
        return Probabilities(values, found.cells[inside], found.grid, found.cell_px, found.labels, points)

    def _read(self, path: str, kind: type[R]) -> R | None:
        name = path.format(obj=self.obj_id)
        known: Any = self.reader.kinds()
        return self.reader.read(name, kind) if name in known else None


def over_grid(record: Probabilities, values: Float[np.ndarray, "k"]) -> Float32[np.ndarray, "h w"]:
    """Values of the cells of a record over its whole grid, 0 elsewhere."""
    grid = np.zeros(record.grid, np.float32)
    grid[record.cells[:, 1], record.cells[:, 0]] = values
    return grid
