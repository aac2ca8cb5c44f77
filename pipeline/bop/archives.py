"""Unpacking dataset archives: zip files, also split ones (.z01, .z02, ..., .zip), safely and all or nothing.

`zipfile` cannot read a split archive: each entry's offset counts from the start of its own part. Here the parts
are read as if they were one file, with a directory rewritten to offsets in that file, and nothing is copied.
"""

import errno
import io
import os
import shutil
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

from pipeline.exceptions import FormatError, InputError

_ENTRY = struct.Struct("<4s6H3L5H2L")  # central directory entry
_END = struct.Struct("<4s4H2LH")  # end of central directory
_END64 = struct.Struct("<4sQ2H2L4Q")
_LOCATOR64 = struct.Struct("<4sLQL")
_IN_ZIP64 = 0xFFFFFFFF
_CHUNK = 1 << 20


def unpack(
    parts: Sequence[Path],
    root: Path,
    *,
    scratch: Path,
    outer_folder: str = "",
    overwrite: bool = False,
    on_bytes: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Unpack an archive into `root` and return the number of its files.

    Everything is unpacked and checked (CRC) in `scratch`, a folder on the same disk, before the first file moves,
    so a broken archive changes nothing in `root`. A folder `outer_folder` around everything is left out.
    Raises FormatError for a broken or unsafe archive and InputError where a different file is in the way.
    """
    try:
        with open_archive(parts) as archive:
            members = _members(archive, parts[-1], outer_folder)
            _check_space(sum(info.file_size for info in members.values()), scratch.parent)
            _extract(archive, members, scratch, on_bytes)
            if not overwrite:
                _refuse_conflicts(members, root)
        _move(members, scratch, root)
        return len(members)
    except (zipfile.BadZipFile, zlib.error, EOFError, struct.error, RuntimeError) as error:
        raise FormatError(
            f"{parts[-1].name}: not a usable zip archive ({error}); delete it and download again"
        ) from error
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def open_archive(parts: Sequence[Path]) -> zipfile.ZipFile:
    """Open a zip archive; the parts of a split one stand in order, the .zip last."""
    if len(parts) == 1:
        return zipfile.ZipFile(parts[0])
    starts = [0]
    for part in parts:
        starts.append(starts[-1] + part.stat().st_size)
    with _buffered(_Joined(parts, starts[-1], b"")) as whole:
        begin, size, count = _find_directory(whole, starts)
        whole.seek(begin)
        entries = _rebase(whole.read(size), starts, count)
    joined = _Joined(parts, begin, entries + _ending(begin, len(entries), count))
    return zipfile.ZipFile(_buffered(joined))


class _Joined(io.RawIOBase):
    """The first `length` bytes of several files in a row, then `tail`, as one readable file."""

    def __init__(self, parts: Sequence[Path], length: int, tail: bytes) -> None:
        self._files = [part.open("rb") for part in parts]
        self._starts = [0]
        for part in parts:
            self._starts.append(self._starts[-1] + part.stat().st_size)
        self._length, self._tail, self._position = length, tail, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._length + len(self._tail)}[whence]
        self._position = base + offset
        return self._position

    def readinto(self, buffer) -> int:
        data = self._read_once(len(buffer))
        buffer[: len(data)] = data
        self._position += len(data)
        return len(data)

    def _read_once(self, size: int) -> bytes:
        if self._position >= self._length:
            at = self._position - self._length
            return self._tail[at : at + size]
        index = next(i for i, end in enumerate(self._starts[1:]) if self._position < end)
        self._files[index].seek(self._position - self._starts[index])
        return self._files[index].read(min(size, self._length - self._position))

    def close(self) -> None:
        for file in self._files:
            file.close()
        super().close()


def _buffered(joined: _Joined) -> io.BufferedReader:
    return io.BufferedReader(joined, _CHUNK)


def _find_directory(whole: io.BufferedReader, starts: list[int]) -> tuple[int, int, int]:
    """Begin in the joined file, size in bytes and number of entries of the central directory."""
    tail_begin = max(0, starts[-1] - _END.size - _LOCATOR64.size - 0xFFFF)
    whole.seek(tail_begin)
    tail = whole.read()
    at = tail.rfind(b"PK\x05\x06")
    if at < 0:
        raise zipfile.BadZipFile("no end record in the last part")
    _, _, disk, _, count, size, offset, _ = _END.unpack_from(tail, at)
    if at >= _LOCATOR64.size and tail[at - _LOCATOR64.size :].startswith(b"PK\x06\x07"):
        _, disk64, offset64, _ = _LOCATOR64.unpack_from(tail, at - _LOCATOR64.size)
        whole.seek(_position(starts, disk64, offset64))
        _, _, _, _, _, disk, _, count, size, offset = _END64.unpack(whole.read(_END64.size))
    return _position(starts, disk, offset), size, count


def _position(starts: list[int], disk: int, offset: int) -> int:
    if disk >= len(starts) - 1 or starts[disk] + offset > starts[-1]:
        raise zipfile.BadZipFile(f"it points into part {disk + 1} of {len(starts) - 1}: a part is missing")
    return starts[disk] + offset


def _rebase(directory: bytes, starts: list[int], count: int) -> bytes:
    """Rewrite the central directory to offsets in the joined file, all of them in 64 bits."""
    entries, at = [], 0
    for _ in range(count):
        fields = list(_ENTRY.unpack_from(directory, at))
        name_end = at + _ENTRY.size + fields[10]
        name = directory[at + _ENTRY.size : name_end]
        packed, unpacked, disk, offset, others = _sizes(fields, directory[name_end : name_end + fields[11]])
        extra = others + struct.pack("<2H3Q", 1, 24, unpacked, packed, _position(starts, disk, offset))
        at = name_end + fields[11] + fields[12]
        fields[2] = max(fields[2], 45)  # the zip version that knows 64 bits
        fields[8] = fields[9] = fields[16] = _IN_ZIP64
        fields[11], fields[12], fields[13] = len(extra), 0, 0
        entries.append(_ENTRY.pack(*fields) + name + extra)
    return b"".join(entries)


def _sizes(fields: list, extra: bytes) -> tuple[int, int, int, int, bytes]:
    """Packed size, unpacked size, part and offset of an entry, and its extra fields without the 64-bit one."""
    packed, unpacked, disk, offset, others = fields[8], fields[9], fields[13], fields[16], b""
    while len(extra) >= 4:
        kind, length = struct.unpack_from("<2H", extra)
        body, whole, extra = extra[4 : 4 + length], extra[: 4 + length], extra[4 + length :]
        if kind != 1:
            others += whole
            continue
        values = iter(struct.unpack(f"<{length // 8}Q", body[: length // 8 * 8]))
        unpacked = next(values) if unpacked == _IN_ZIP64 else unpacked
        packed = next(values) if packed == _IN_ZIP64 else packed
        offset = next(values) if offset == _IN_ZIP64 else offset
        disk = struct.unpack("<L", body[-4:])[0] if disk == 0xFFFF else disk
    return packed, unpacked, disk, offset, others


def _ending(begin: int, size: int, count: int) -> bytes:
    end64 = _END64.pack(b"PK\x06\x06", _END64.size - 12, 45, 45, 0, 0, count, count, size, begin)
    locator = _LOCATOR64.pack(b"PK\x06\x07", 0, begin + size, 1)
    return end64 + locator + _END.pack(b"PK\x05\x06", 0, 0, 0xFFFF, 0xFFFF, _IN_ZIP64, _IN_ZIP64, 0)


def _members(archive: zipfile.ZipFile, source: Path, folder: str) -> dict[PurePosixPath, zipfile.ZipInfo]:
    """List the files of an archive by their place below the dataset's folder."""
    files = {_safe_path(info, source): info for info in archive.infolist() if not info.is_dir()}
    if files and all(path.parts[0] == folder and len(path.parts) > 1 for path in files):
        return {path.relative_to(folder): info for path, info in files.items()}
    return files


def _safe_path(info: zipfile.ZipInfo, source: Path) -> PurePosixPath:
    path = PurePosixPath(info.filename)
    is_link = stat.S_ISLNK(info.external_attr >> 16)
    if path.is_absolute() or ".." in path.parts or "\\" in info.filename or ":" in path.parts[0] or is_link:
        kind = "a link" if is_link else "a path outside the dataset"
        raise FormatError(f"{source.name}: entry {info.filename!r} is {kind}; refused, nothing was unpacked")
    return path


def _check_space(needed: int, folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise no_space(folder, needed, free)


def no_space(folder: Path, needed: int, free: int) -> InputError:
    """Make the error for a disk that is too small, sizes in bytes."""
    return InputError(
        f"{folder}: {needed / 1e9:.2f} GB needed, {free / 1e9:.2f} GB free; "
        "free some space or choose another folder (--to)"
    )


def _extract(
    archive: zipfile.ZipFile,
    members: dict[PurePosixPath, zipfile.ZipInfo],
    scratch: Path,
    on_bytes: Callable[[int, int], None],
) -> None:
    done, total = 0, sum(info.file_size for info in members.values())
    for path, info in members.items():
        target = scratch / path
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(info) as source, target.open("wb") as sink:  # reading to the end checks the CRC
            while chunk := source.read(_CHUNK):
                sink.write(chunk)
                done += len(chunk)
                on_bytes(done, total)


def _refuse_conflicts(members: dict[PurePosixPath, zipfile.ZipInfo], root: Path) -> None:
    """Somebody may have mended the ground truth that is already there: never write over a file that differs."""
    differing = [
        root / path for path, info in members.items() if (root / path).exists() and not _same(root / path, info)
    ]
    if differing:
        raise InputError(
            f"{differing[0]}: exists and differs from the archive ({len(differing)} such files); "
            "move it away, or pass --overwrite"
        )


def _same(path: Path, info: zipfile.ZipInfo) -> bool:
    if not path.is_file() or path.stat().st_size != info.file_size:
        return False
    crc = 0
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            crc = zlib.crc32(chunk, crc)
    return crc == info.CRC


def _move(members: dict[PurePosixPath, zipfile.ZipInfo], scratch: Path, root: Path) -> None:
    for path in members:
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        try:
            (scratch / path).replace(root / path)
        except OSError as error:
            reason = "a folder is in the way" if error.errno in (errno.EISDIR, errno.ENOTDIR) else error.strerror
            raise InputError(f"{root / path}: cannot be written ({reason}); move it away") from error
