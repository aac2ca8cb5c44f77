"""Reading a recording back: any entity of one image, on its own and in a few milliseconds."""

from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar, overload

from pipeline.exceptions import UnknownIdError
from pipeline.recording.files import DamagedRecordingError, check_file
from pipeline.recording.records import KINDS, RECORD_TYPES, View
from pipeline.scene import GroundTruth, ImageKey, PoseEstimate

R = TypeVar("R")
_ROW_ID = "rerun.controls.RowId"


class RecordingReader:
    """A checked recording of one image; may be read from several threads.

    `verified` is False where the recording has no checksum.
    """

    def __init__(self, path: Path, store: Any, verified: bool) -> None:
        from pipeline.recording.codec import PREFIX

        self.path = path
        self.verified = verified
        self._store = store
        self._kinds: dict[str, str] = {}
        for column in store.schema().component_columns():
            if column.archetype and column.archetype.startswith(PREFIX):
                self._kinds[column.entity_path.removeprefix("/")] = column.archetype.removeprefix(PREFIX)

    @classmethod
    def open(cls, path: Path) -> "RecordingReader":
        """Verify a recording and read its index.

        Raises:
            MissingFileError: there is no such file.
            RecordingError: it is empty, cut off, damaged, unfinished or no recording.

        """
        verified = check_file(path)
        from rerun.chunk import RrdReader

        try:
            return cls(path, RrdReader(path).store(), verified)
        except (RuntimeError, ValueError) as error:  # only where no checksum vouches for the content
            raise _damaged(path, error) from error

    @property
    def key(self) -> ImageKey:
        """The image that was recorded."""
        return self.view.key

    @property
    def view(self) -> View:
        """The image's key and camera."""
        return self.read("image", View)

    def kinds(self) -> dict[str, str]:
        """Kind of every entity by its path, sorted by path; costs nothing."""
        return dict(sorted(self._kinds.items()))

    def paths(self, pattern: str) -> list[str]:
        """Paths that match a pattern such as `epos/fragments/*`, sorted with numbers in order."""
        found = [path for path in self._kinds if fnmatchcase(path, pattern)]
        return sorted(found, key=lambda path: [(len(part), part) for part in path.split("/")])

    @overload
    def read(self, path: str) -> Any: ...
    @overload
    def read(self, path: str, record_type: type[R]) -> R: ...
    def read(self, path: str, record_type: type[Any] | None = None) -> Any:
        """The record at a path, the last one if there are several.

        Raises:
            UnknownIdError: the recording has nothing at this path.
            DamagedRecordingError: it cannot be decoded, or is not of the wanted type.

        """
        record = self.read_all(path)[-1]
        if record_type is not None and not isinstance(record, record_type):
            raise DamagedRecordingError(
                f"{self.path}: {path} is of kind {KINDS[type(record)]}, not {KINDS[record_type]}"
            )
        return record

    def read_all(self, path: str) -> list[Any]:
        """All records at a path, in the order in which they were logged; raises as `read`."""
        kind = self._kinds.get(path)
        if kind is None:
            raise UnknownIdError("entity", path, str(self.path), self._kinds)
        from pipeline.recording.codec import decode

        if kind not in RECORD_TYPES:
            raise UnknownIdError(f"{path}: kind", kind, "this version", RECORD_TYPES)
        try:
            rows = sorted(self._rows(path), key=lambda row: row[0])
            return [decode(kind, columns) for _, columns in rows]
        except (RuntimeError, ValueError, KeyError, TypeError) as error:
            raise _damaged(self.path, error) from error

    def estimates(self) -> tuple[PoseEstimate, ...]:
        """The poses that the method submitted for the image."""
        return tuple(self.read(path, PoseEstimate) for path in self.paths("estimates/*"))

    def ground_truth(self) -> tuple[GroundTruth, ...]:
        """The annotated poses that were recorded with the image."""
        return tuple(self.read(path, GroundTruth) for path in self.paths("ground_truth/*"))

    def _rows(self, path: str) -> Iterator[tuple[bytes, dict[str, Any]]]:
        """Row id and components of every row that holds a record."""
        for chunk in self._store.stream().filter(content=f"/{path}"):
            batch = chunk.to_record_batch()
            layouts = [name for name in batch.schema.names if name.endswith(":layout")]
            for row in range(batch.num_rows if layouts else 0):
                values = {name: batch.column(name)[row] for name in batch.schema.names}
                columns = {name: value.values for name, value in values.items() if hasattr(value, "values")}
                if columns.get(layouts[0]) is not None:
                    yield values[_ROW_ID].as_py(), columns


def _damaged(path: Path, error: Exception) -> DamagedRecordingError:
    reason = (str(error).splitlines() or [type(error).__name__])[0]
    return DamagedRecordingError(f"{path}: cannot be decoded ({reason}); run the image again")
