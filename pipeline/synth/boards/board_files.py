"""Boards on disk: a description (JSON) that calibration reads, and pictures to print at their true size (PNG).

    {"unit": "m", "dictionary": "DICT_4X4_100", "size": [0.5125, 0.5125], "free": [...], "height": 0.075,
     "markers": [{"id": 0, "corners": [[x, y, z], [x, y, z], [x, y, z], [x, y, z]]}, ...]}

Corners are those of the black square, in the board frame, clockwise from the upper left. `unit` is `m` or `mm`;
`size`, `free` and `height` may be missing from a description of a board that is only to be detected.
"""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.bop.json_files import read_json_object, write_atomically
from pipeline.exceptions import FormatError, InputError
from pipeline.synth.boards.marker_board import TOP, MarkerBoard

UNITS = {"m": 1.0, "mm": 0.001}
METRES_PER_INCH = 0.0254
HEADER = 33
"""Bytes of a PNG before its second chunk."""


def write_board(path: Path, board: MarkerBoard) -> None:
    """Write the description, in metres, one marker a line. Raises `InputError` if it cannot be written."""
    head = {"unit": "m", "dictionary": board.dictionary, "size": _rounded(board.size), "free": _rounded(board.free)}
    lines = [f'  "{name}": {json.dumps(value)},' for name, value in (head | {"height": round(board.height, 9)}).items()]
    markers = [{"id": k, "corners": _rounded(board.corners(k))} for k in board.ids]
    rows = ",\n".join(f"    {json.dumps(marker)}" for marker in markers)
    text = "\n".join(["{", *lines, '  "markers": [', rows, "  ]", "}", ""])
    write_atomically(path, text.encode())


def _rounded(values: Any) -> list:
    return (np.round(np.asarray(values, float), 9) + 0.0).tolist()


def read_board(path: Path) -> MarkerBoard:
    """Read a description.

    Raises `MissingFileError` or `FormatError`, one line that names the file, the entry and the fix.
    """
    content = read_json_object(path)
    unit = content.get("unit")
    if not isinstance(unit, str) or unit not in UNITS:
        raise FormatError(f'{path}: "unit" is {json.dumps(unit)}; write "m" or "mm"')
    markers = content.get("markers")
    if not isinstance(markers, list) or not markers:
        raise FormatError(f'{path}: "markers" is missing or empty; list each marker with "id" and "corners"')
    ids, corners = zip(*(_marker(path, k, entry) for k, entry in enumerate(markers)), strict=True)
    points = np.stack(corners) * UNITS[unit]
    extent = 2 * np.abs(points[..., :2]).max(axis=(0, 1))
    size, free = (_pair(path, content, name, UNITS[unit]) for name in ("size", "free"))
    height = _numbers(path, "height", content.get("height", 0.0), ()) * UNITS[unit]
    try:
        return MarkerBoard(
            str(content.get("dictionary")),
            ids,
            points,
            size or (extent[0], extent[1]),
            free or (0.0, 0.0),
            float(height),
        )
    except InputError as error:
        raise FormatError(f"{path}: {error}") from None


def _marker(path: Path, position: int, entry: Any) -> tuple[int, np.ndarray]:
    if not isinstance(entry, dict) or type(entry.get("id")) is not int:  # True is an int, but no id
        raise FormatError(f'{path}: marker {position} of the list has no whole number as "id"; give it one')
    return entry["id"], _numbers(path, f"corners of marker {entry['id']}", entry.get("corners"), (4, 3))


def _pair(path: Path, content: dict[str, Any], name: str, scale: float) -> tuple[float, float] | None:
    if name not in content:
        return None
    width, depth = (_numbers(path, name, content[name], (2,)) * scale).tolist()
    return width, depth


def _numbers(path: Path, name: str, value: Any, shape: tuple[int, ...]) -> np.ndarray:
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != shape or not np.isfinite(numbers).all():
        wanted = " x ".join(map(str, shape)) if shape else "one"
        raise FormatError(
            f"{path}: {name}: expected {wanted} finite number{'s' if shape else ''}; got {str(value)[:60]}"
        )
    return numbers


def write_picture(path: Path, board: MarkerBoard, dpi: float = 600.0, face: str = TOP) -> None:
    """Write the print of a face as a PNG that knows its resolution: printed at 100 % it has its true size.

    The pixels are square and the file states whole pixels per metre, so the scale is exact. Raises `InputError`.
    """
    px_per_metre = round(dpi / METRES_PER_INCH)
    _, encoded = cv2.imencode(".png", board.picture(px_per_metre, face))
    png = encoded.tobytes()
    content = b"pHYs" + struct.pack(">IIB", px_per_metre, px_per_metre, 1)  # PNG 1.2, 11.3.5.3: pixels per metre
    chunk = struct.pack(">I", len(content) - 4) + content + struct.pack(">I", zlib.crc32(content))
    write_atomically(path, png[:HEADER] + chunk + png[HEADER:])
