"""Backgrounds: photographs of a folder (the thesis took those of NYU Depth V2), or made-up ones."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Literal, Protocol

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.bop.images import image_size, read_rgb
from pipeline.bop.json_files import read_bytes
from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.synth.render_and_paste.scenery import made_up_scenery

SUFFIXES = frozenset((".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".ppm"))
_REDUCED = {2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4, 8: cv2.IMREAD_REDUCED_COLOR_8}


class Backgrounds(Protocol):
    """Where backgrounds come from."""

    def image(self, rng: np.random.Generator, width: int, height: int) -> UInt8[np.ndarray, "h w 3"]:
        """A background of that size, RGB; the same generator state gives the same one."""
        ...


class MadeUpBackgrounds:
    """Backgrounds painted by `made_up_scenery`."""

    def image(self, rng: np.random.Generator, width: int, height: int) -> UInt8[np.ndarray, "h w 3"]:
        """A background of that size."""
        return made_up_scenery(rng, width, height)


class PhotoFolder:
    """Photographs of a folder and its subfolders; those that cannot be read are skipped with one warning for all."""

    def __init__(self, folder: Path, crop: Literal["random", "center"] = "random") -> None:
        """List the photographs. Raises MissingFileError for a folder that is absent or has none."""
        self._folder, self._crop = Path(folder), crop
        if not self._folder.is_dir():
            raise MissingFileError(f"{folder}: is no folder of background photographs; give one, or none at all")
        paths = (path for path in self._folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
        self._paths = sorted(paths)
        self._bad: set[Path] = set()
        if not self._paths:
            known = " ".join(sorted(SUFFIXES))
            raise MissingFileError(f"{folder}: has no background photographs ({known}); give a folder that has some")

    def image(self, rng: np.random.Generator, width: int, height: int) -> UInt8[np.ndarray, "h w 3"]:
        """Part of a random photograph, scaled to cover the image. Raises FormatError if none can be read."""
        while len(self._bad) < len(self._paths):
            path = self._paths[int(rng.integers(len(self._paths)))]
            corner = rng.random(2) if self._crop == "random" else np.array([0.5, 0.5])
            photo = self._read(path, width, height)
            if photo is not None:
                return covering(photo, width, height, corner)
        raise FormatError(f"{self._folder}: none of its {len(self._paths)} photographs can be read; replace them")

    def _read(self, path: Path, width: int, height: int) -> UInt8[np.ndarray, "h w 3"] | None:
        if path in self._bad:
            return None
        try:
            return _photo(path, width, height)
        except InputError as error:
            if not self._bad:
                logging.getLogger(__name__).warning("%s; it is skipped, as are others that cannot be read", error)
            self._bad.add(path)
            return None


def covering(
    photo: UInt8[np.ndarray, "h w 3"], width: int, height: int, corner: np.ndarray
) -> UInt8[np.ndarray, "height width 3"]:
    """Scale a photograph so that it just covers the size, and cut it; `corner` 0..1 in x and y says where."""
    rows, columns = photo.shape[:2]
    scale = max(width / columns, height / rows)
    cut = min(columns, max(1, round(width / scale))), min(rows, max(1, round(height / scale)))
    x, y = (int(corner[0] * (columns - cut[0] + 1)), int(corner[1] * (rows - cut[1] + 1)))
    part = photo[y : y + cut[1], x : x + cut[0]]
    return cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)


def _photo(path: Path, width: int, height: int) -> UInt8[np.ndarray, "h w 3"]:
    """Read a photograph; one that is far larger than needed is decoded at a part of its size, which takes less time."""
    columns, rows = image_size(path)
    if not columns or not rows:
        raise FormatError(f"{path}: has no pixels; get the file again")
    factor = max((f for f in _REDUCED if f <= min(columns / width, rows / height)), default=1)
    if factor == 1:
        return read_rgb(path)
    data = read_bytes(path)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), _REDUCED[factor] | cv2.IMREAD_IGNORE_ORIENTATION)
    cut_off = data.startswith(b"\xff\xd8") and b"\xff\xd9" not in data[-64:]  # OpenCV fills the rest with gray
    if image is None or cut_off:
        raise FormatError(f"{path}: is no image or is cut off; get the file again")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
