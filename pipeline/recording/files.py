"""Recording files on disk: whole or absent, and checked.

A recording `X.rrd` has its SHA-256 in `X.rrd.sha256`, in the format of `sha256sum`. Both are written under temporary
names; the checksum is renamed first, so a recording that can be seen always has its checksum beside it.
"""

import hashlib
import logging
import os
import re
import secrets
from pathlib import Path

from pipeline.exceptions import InputError, MissingFileError
from pipeline.scene import ImageKey

APPLICATION_ID = "pose-inspector"
"""Rerun's name for recordings and layouts that belong together."""

_MAGIC = b"RRF2"
_FOOTER = b"RRF2FOOT"
_FOOTER_WITHIN = 32  # bytes from the end
_NAME = re.compile(r"(\d{6,})_(\d{6,})\.rrd")
_log = logging.getLogger(__name__)


class RecordingError(InputError):
    """A recording cannot be read or written."""


class EmptyRecordingError(RecordingError):
    """The file has no bytes."""


class NotARecordingError(RecordingError):
    """The file is something else than a rerun recording of a known version."""


class TruncatedRecordingError(RecordingError):
    """The end of the file is missing."""


class UnfinishedRecordingError(RecordingError):
    """The file was never finished: no footer and no checksum."""


class DamagedRecordingError(RecordingError):
    """The content is not what was written."""


def recording_name(key: ImageKey) -> str:
    """File name of an image's recording, such as `000002_000003.rrd`."""
    return f"{key.scene_id:06d}_{key.im_id:06d}.rrd"


def recorded_image(name: str) -> ImageKey | None:
    """The image that a file name stands for; None for files that are no image's recording."""
    match = _NAME.fullmatch(name)
    return ImageKey(int(match[1]), int(match[2])) if match else None


def checksum_path(path: Path) -> Path:
    """Where the checksum of a recording lies."""
    return path.with_name(path.name + ".sha256")


def write_checked(path: Path, content: bytes) -> None:
    """Write a file and its checksum so that a reader finds both or no file.

    Raises:
        RecordingError: the file cannot be written (no space, no permission); nothing is left behind.

    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}")
    temporary_sum = checksum_path(temporary)
    line = f"{hashlib.sha256(content).hexdigest()}  {path.name}\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(content)
        temporary_sum.write_text(line)
        path.unlink(missing_ok=True)  # an older recording must not be seen with the newer checksum
        temporary_sum.replace(checksum_path(path))
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or error
        raise RecordingError(
            f"{path}: cannot write the recording: {reason}; free space or choose another folder"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
        temporary_sum.unlink(missing_ok=True)


def check_file(path: Path) -> bool:
    """Look for damage; True if the checksum vouches for the file, False (and a warning) if there is none.

    Raises:
        MissingFileError: there is no such file.
        RecordingError: the subclass names the damage.

    """
    if not path.is_file():
        raise MissingFileError(f"{path}: no such recording; run the method on this image with recording on")
    content = path.read_bytes()
    expected = _read_checksum(path)
    if not content:
        raise EmptyRecordingError(f"{path}: the recording is empty (0 bytes); run the image again")
    if not content.startswith(_MAGIC):
        raise NotARecordingError(
            f"{path}: starts with {content[:4]!r}, not {_MAGIC!r}: no rerun recording of this version; run the image again"
        )
    if _FOOTER not in content[-_FOOTER_WITHIN:]:
        if expected is None:
            raise UnfinishedRecordingError(
                f"{path}: no footer and no checksum: its writer was stopped; run the image again"
            )
        raise TruncatedRecordingError(
            f"{path}: cut off after {len(content)} bytes; copy it again or run the image again"
        )
    if expected is None:
        _log.warning("%s: no checksum beside it (%s); damage would go unseen", path, checksum_path(path).name)
        return False
    found = hashlib.sha256(content).hexdigest()
    if found != expected:
        text = f"SHA-256 is {found[:12]}..., not {expected[:12]}... as written"
        raise DamagedRecordingError(f"{path}: {text}; copy it again or run the image again")
    return True


def _read_checksum(path: Path) -> str | None:
    try:
        return checksum_path(path).read_text(errors="replace").split(maxsplit=1)[0]
    except (OSError, IndexError):
        return None
