"""The recorded objects: their templates, and the distances at which they fit a level."""

from functools import cached_property

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import UnknownIdError
from pipeline.explaining import recorded_explanations
from pipeline.hashmatch.reading.report import SizeRange
from pipeline.hashmatch.reading.tables import columns_of
from pipeline.recording import RecordingReader


class RecordedObjects:
    """Reads tables when they are asked for first."""

    def __init__(self, reader: RecordingReader) -> None:
        self._reader = reader

    def colored(self, obj_id: int) -> bool:
        """Whether test T5 is made. Raises UnknownIdError for an object that was not learned."""
        return bool(self._objects["colored"][self._row(obj_id)])

    def rotation(self, obj_id: int, template: int) -> Float[np.ndarray, "3 3"]:
        """R_t. Raises UnknownIdError for a template that the recording names nowhere."""
        from scipy.spatial.transform import Rotation

        columns = self._templates
        rows = np.flatnonzero((columns["object"] == obj_id) & (columns["template"] == template))
        found = columns["quaternion_xyzw"][rows[0]] if len(rows) else self._followed.get((obj_id, template))
        if found is None:
            its = columns["template"][columns["object"] == obj_id].tolist()
            raise UnknownIdError(f"template of object {obj_id}", template, str(self._reader.path), its)
        return Rotation.from_quat(np.array(found, float)).as_matrix()

    def pose(self, obj_id: int, template: int) -> Float[np.ndarray, "4 4"]:
        """P_t: camera_from_model with the centroid on the optical axis, metres. Raises as `rotation`."""
        row, pose = self._row(obj_id), np.eye(4)
        pose[:3, :3] = self.rotation(obj_id, template)
        pose[:3, 3] = np.array([0, 0, self._objects["distance"][row]]) - pose[:3, :3] @ self._objects["centroid"][row]
        return pose

    def sizes(self, level: int, distances: Float[np.ndarray, "k"]) -> tuple[SizeRange, ...]:
        """Which objects may be at a level in a window with these distances (metres) at the points of T1."""
        there = distances[distances > 0]
        return tuple(
            one._replace(possible=bool(((there >= one.nearest) & (there <= one.farthest)).any()))
            for one in self._ranges.get(level, [])
        )

    @cached_property
    def _objects(self) -> dict[str, np.ndarray]:
        return columns_of(self._reader, "objects")

    @cached_property
    def _templates(self) -> dict[str, np.ndarray]:
        return columns_of(self._reader, "templates")

    @cached_property
    def _followed(self) -> dict[tuple[int, int], list[float]]:
        """Quaternions of the templates that were followed for annotated instances."""
        return {
            (explanation.obj_id, one["template"]["row"]): one["template"]["quaternion_xyzw"]
            for explanation in recorded_explanations(self._reader).values()
            for one in explanation.details.get("followed", ())
        }

    @cached_property
    def _ranges(self) -> dict[int, list[SizeRange]]:
        names = ("level", "object", "nearest", "farthest")
        columns = columns_of(self._reader, "sizes")
        found: dict[int, list[SizeRange]] = {}
        for level, *values in zip(*(columns[name].tolist() for name in names), strict=True):
            found.setdefault(level, []).append(SizeRange(*values, possible=False))
        return found

    def _row(self, obj_id: int) -> int:
        rows = np.flatnonzero(self._objects["object"] == obj_id)
        if not len(rows):
            raise UnknownIdError("object", obj_id, "the recorded templates", self._objects["object"].tolist())
        return int(rows[0])
