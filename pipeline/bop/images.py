"""Reading the image files of BOP datasets: colour or gray, depth, masks; png, jpg or tif."""

import struct
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.bop.json_files import read_bytes
from pipeline.exceptions import FormatError

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read_rgb(path: Path) -> UInt8[np.ndarray, "h w 3"]:
    """A colour image as RGB; a gray one is repeated in the three channels, 16 bits become 8."""
    image = _decode(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def read_depth(path: Path, depth_scale_mm: float) -> Float[np.ndarray, "h w"]:
    """A depth image as float32 metres, 0 where not measured; `depth_scale_mm` is the millimetres of one unit."""
    raw = _decode(path, cv2.IMREAD_UNCHANGED)
    if raw.ndim != 2:
        raise FormatError(f"{path}: has {raw.shape[2]} channels; a depth image has one, of 16 bits")
    if raw.dtype == np.uint8:
        raise FormatError(f"{path}: has 8 bits, which is a picture of depth; export the depth as 16-bit PNG")
    depth = raw.astype(np.float32) * np.float32(depth_scale_mm / 1000.0)
    return np.nan_to_num(depth, copy=False, nan=0.0, posinf=0.0, neginf=0.0)


def read_mask(path: Path) -> Bool[np.ndarray, "h w"]:
    """A mask, True where the image is not black."""
    return _decode(path, cv2.IMREAD_GRAYSCALE) > 0


def image_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels; of png and jpg from their first bytes only."""
    head = read_bytes(path, 1 << 16)
    size = _png_size(head) or _jpeg_size(head)
    if size is None:
        height, width = _decode(path, cv2.IMREAD_UNCHANGED).shape[:2]
        size = width, height
    return size


def _decode(path: Path, flags: int) -> np.ndarray:
    data = np.frombuffer(read_bytes(path), dtype=np.uint8)
    image = cv2.imdecode(data, flags) if len(data) and not _is_cut_off(data) else None
    if image is None:
        state = "is no image or is cut off" if len(data) else "is empty"
        raise FormatError(f"{path}: {state} ({len(data)} bytes); get the file again")
    return image


def _is_cut_off(data: UInt8[np.ndarray, "n"]) -> bool:
    """Whether a PNG or JPEG lacks its end mark; OpenCV fills what is missing of a JPEG with gray and says nothing."""
    head, tail = data[:8].tobytes(), data[-64:].tobytes()
    return (head == _PNG_SIGNATURE and b"IEND" not in tail) or (head[:2] == b"\xff\xd8" and b"\xff\xd9" not in tail)


def _png_size(head: bytes) -> tuple[int, int] | None:
    if not head.startswith(_PNG_SIGNATURE) or len(head) < 24:
        return None
    return struct.unpack(">II", head[16:24])


def _jpeg_size(head: bytes) -> tuple[int, int] | None:
    """Walk the segments of a JPEG to its frame header (SOF0-15 without DHT, JPG and DAC)."""
    if not head.startswith(b"\xff\xd8"):
        return None
    at = 2
    while at + 9 <= len(head) and head[at] == 0xFF:
        marker, length = head[at + 1], int.from_bytes(head[at + 2 : at + 4], "big")
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", head[at + 5 : at + 9])
            return width, height
        at += 2 + length
    return None
