"""Which images of a run are finished: `images.jsonl`, one line each, read while it grows."""

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.exceptions import FormatError
from pipeline.scene import ImageKey


@dataclass(frozen=True)
class FinishedImage:
    """A line of `images.jsonl`."""

    scene_id: int
    im_id: int
    estimates: int
    results_bytes: int
    """Length of `results.csv` with this image's rows."""
    timings: Mapping[str, float]
    """Seconds by stage."""
    failure: str | None = None
    """Why the method failed on this image; None where it did not."""

    @property
    def key(self) -> ImageKey:
        """The image."""
        return ImageKey(self.scene_id, self.im_id)


class ImageList:
    """`images.jsonl`, read as far as it is whole; safe from several threads."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.images: list[FinishedImage] = []
        self.keys: set[ImageKey] = set()
        self.offset = 0
        self._lock = threading.Lock()

    def poll(self) -> tuple[FinishedImage, ...]:
        """Read what was added since the last call; FormatError for a line that is no finished image."""
        with self._lock:
            if not self.path.exists() or self.path.stat().st_size <= self.offset:
                return ()
            with self.path.open("rb") as file:
                file.seek(self.offset)
                whole = file.read().rpartition(b"\n")[0]
            new = tuple(self._parse(line) for line in whole.splitlines())
            self.offset += len(whole) + bool(whole)
            self.images += new
            self.keys.update(image.key for image in new)
            return new

    def _parse(self, line: bytes) -> FinishedImage:
        try:
            image = FinishedImage(**json.loads(line))
            if not all(type(value) is int for value in (*image.key, image.estimates, image.results_bytes)):
                raise TypeError
            return replace(image, timings={stage: float(seconds) for stage, seconds in image.timings.items()})
        except (ValueError, TypeError, AttributeError) as error:
            text = f"line {line[:60]!r} is no finished image; delete this line and the later ones"
            raise FormatError(f"{self.path}: {text}") from error


class RunWatch:
    """Tells which images were finished since it was asked last; costs one `stat` when nothing happened."""

    def __init__(self, path: Path) -> None:
        self._images = ImageList(path)

    def poll(self) -> tuple[FinishedImage, ...]:
        """Images that were finished since the last call."""
        return self._images.poll()
