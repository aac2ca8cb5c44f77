"""2D detections in BOP's COCO form, a JSON list of objects.

Each has `scene_id, image_id, category_id, score, time` and `bbox` (x, y, width, height in pixels), `segmentation`
(a mask as run lengths), or both.
"""

import gzip
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import orjson

from pipeline.bop.json_files import read_bytes
from pipeline.bop.results import name_parts
from pipeline.exceptions import FormatError

Measure = Literal["bbox", "segm"]
"""Compare boxes or masks."""

_GIVEN_BY: dict[Measure, str] = {"bbox": "bbox", "segm": "segmentation"}


@dataclass(frozen=True, eq=False)
class Detections:
    """All detections of a method on a dataset split, in the order of the file."""

    path: Path
    entries: list[dict[str, Any]]
    """As in the file; checked."""
    method: str
    dataset_name: str
    split: str

    def __len__(self) -> int:
        return len(self.entries)

    @property
    def measure(self) -> Measure:
        """Masks if there are any, else boxes."""
        return "segm" if any(entry.get("segmentation") for entry in self.entries) else "bbox"

    def of(self, measure: Measure) -> list[dict[str, Any]]:
        """Detections that have a box (a mask); BOP leaves out the others."""
        return [entry for entry in self.entries if entry.get(_GIVEN_BY[measure])]

    @property
    def time_per_image(self) -> float | None:
        """Mean over images of the seconds for the first detection of each; None where one was not measured (-1)."""
        times: dict[tuple[int, int], float] = {}
        for entry in self.entries:
            if entry.get("time", -1) < 0:
                return None
            times.setdefault((entry["scene_id"], entry["image_id"]), entry["time"])
        return sum(times.values()) / len(times) if times else None


def read_detections(path: Path) -> Detections:
    """Read a file of detections, also a compressed one (`.json.gz`).

    Raises MissingFileError if it cannot be read, FormatError that names the entry, the key and the value of the first
    bad one and says how many more there are.
    """
    content = _content(path)
    if not isinstance(content, list):
        raise FormatError(f"{path}: holds a {type(content).__name__}; expected a list of detections")
    problems = _problems(content)
    if first := next(problems, None):
        more = sum(1 for _ in problems)
        raise FormatError(f"{path}: {first}" + (f" (one of {more + 1} bad detections)" if more else ""))
    return Detections(path, content, *name_parts(path.name.removesuffix(".gz")))


def _content(path: Path) -> Any:
    data = read_bytes(path)
    try:
        return orjson.loads(gzip.decompress(data) if path.suffix == ".gz" else data)
    except orjson.JSONDecodeError as error:
        raise FormatError(f"{path}: is no JSON ({error.msg} at line {error.lineno}); get the file again") from error
    except (OSError, EOFError) as error:  # what gzip raises for damaged data
        raise FormatError(f"{path}: cannot be decompressed; get the file again") from error


def _problems(entries: list[Any]) -> Iterator[str]:
    """What is wrong, one line for each bad entry; they are counted from 1."""
    for number, entry in enumerate(entries, start=1):
        problem = _problem(entry) if isinstance(entry, dict) else f"is {entry!r:.60}; expected an object"
        if problem:
            yield f"detection {number}: {problem}"


def _problem(entry: dict[str, Any]) -> str | None:
    for name in ("scene_id", "image_id", "category_id"):
        if type(entry.get(name)) is not int:
            return f"{name} is {entry.get(name)!r:.60}; expected a whole number"
    for name in ("score", "time"):
        if not _is_number(entry.get(name, -1.0 if name == "time" else None)):
            return f"{name} is {entry.get(name)!r:.60}; expected a finite number"
    box, mask = entry.get("bbox"), entry.get("segmentation")
    if box and not (isinstance(box, list) and len(box) == 4 and all(map(_is_number, box)) and min(box[2:]) >= 0):
        return f"bbox is {box!r:.60}; expected x, y, width and height in pixels"
    return mask_problem(mask) if mask else None


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def mask_problem(mask: Any) -> str | None:
    """What is wrong with a mask as run lengths; pycocotools does not look, and may never end for a damaged one."""
    size = mask.get("size") if isinstance(mask, dict) else None
    if not isinstance(size, list) or len(size) != 2 or not all(type(length) is int and length > 0 for length in size):
        return f"segmentation is {mask!r:.60}; expected run lengths, {{'counts': ..., 'size': [height, width]}}"
    counts = mask.get("counts")
    lengths = _unpacked(counts) if isinstance(counts, str) else counts
    if not isinstance(lengths, list) or not all(type(length) is int and length >= 0 for length in lengths):
        return f"counts of segmentation are {counts!r:.60}; expected numbers of pixels, or COCO's compressed text"
    if sum(lengths) != size[0] * size[1]:
        return f"counts of segmentation are of {sum(lengths)} pixels, its size {size} has {size[0] * size[1]}; correct them"
    return None


def _unpacked(text: str) -> list[int] | None:
    """Run lengths from COCO's compressed text; None if it is damaged.

    Every character holds five bits and whether more follow, the lowest bits first, the last of them signed. From the
    fourth number on they are differences to the one before the last.
    """
    codes = np.frombuffer(text.encode(errors="replace"), np.uint8).astype(np.int64) - 48
    last = np.flatnonzero(codes & 0x20 == 0)
    if not len(codes) or codes.min() < 0 or codes.max() > 63 or not len(last) or last[-1] != len(codes) - 1:
        return None
    first = np.append(0, last[:-1] + 1)
    if (last - first).max() > 9:  # beyond any image
        return None
    place = np.arange(len(codes)) - np.repeat(first, last - first + 1)
    numbers = np.add.reduceat((codes & 0x1F) << 5 * place, first)
    numbers -= np.where(codes[last] & 0x10, 1 << 5 * (last - first + 1), 0)
    numbers[1::2] = numbers[1::2].cumsum()
    numbers[2::2] = numbers[2::2].cumsum()
    return numbers.tolist()
