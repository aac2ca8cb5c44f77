"""The uploaded files, kept once each under the hash of their bytes."""

import contextlib
import fcntl
import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from pipeline.bop.results import Results, read_results
from pipeline.exceptions import FormatError, InputError, MissingFileError

_PARTIAL = ".partial"


class LockedFile:
    """A new file that is locked as long as this process lives and does not close it.

    Make it while holding the database's lock for writing: `remove_abandoned` may not see it before it is locked.
    """

    def __init__(self, path: Path) -> None:
        """Make the file; its folder is made too. Raises OSError."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self.file: BinaryIO = path.open("xb")
        fcntl.flock(self.file, fcntl.LOCK_EX)

    def close(self) -> None:
        """Remove the file, if it still has its name, and unlock it."""
        with contextlib.suppress(OSError):
            self.path.unlink()
        with contextlib.suppress(OSError):  # what is still to be written when the disk is full
            self.file.close()


def remove_abandoned(folder: Path, pattern: str) -> None:
    """Remove the files of that pattern that no living process has locked; whoever calls holds the database's lock."""
    for path in folder.glob(pattern):
        with contextlib.suppress(OSError), path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()


class KeptFiles:
    """Files of a folder, each `<sha256>.csv`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()

    def path(self, sha256: str) -> Path:
        """Where the file of that hash lies, or would lie."""
        return self.folder / f"{sha256}.csv"

    def stage(self) -> LockedFile:
        """A new file under a temporary name; those of processes that were killed are removed.

        Whoever calls holds the database's lock. Raises InputError if it cannot be made.
        """
        remove_abandoned(self.folder, f"*{_PARTIAL}")
        with self._told():
            return LockedFile(self.folder / f"{uuid.uuid4().hex}{_PARTIAL}")

    def fill(self, staged: LockedFile, content: bytes | Path) -> str:
        """Write bytes, or those of another file, to the disk and give their hash.

        Raises MissingFileError if the other file cannot be read, InputError if they cannot be written.
        """
        with _source(content) as source, self._told():
            if source is None:
                staged.file.write(content if isinstance(content, bytes) else b"")
            else:
                shutil.copyfileobj(source, staged.file, 1 << 20)
            staged.file.flush()
            os.fsync(staged.file.fileno())  # before the database names it
        return _hash(staged.path)

    def keep(self, staged: LockedFile, sha256: str) -> None:
        """Give a file its name, unless it is there unchanged. Whoever calls holds the database's lock.

        Raises InputError if that cannot be done.
        """
        path = self.path(sha256)
        with self._told():
            if path.is_file() and _hash(path) == sha256:
                return
            staged.path.replace(path)
            folder = os.open(self.folder, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)

    def check(self, sha256: str) -> Path:
        """The path of a file. Raises MissingFileError if it is gone and FormatError if its bytes have changed."""
        path = self.path(sha256)
        try:
            found = _hash(path)
        except OSError as error:
            text = f"cannot be read ({error.strerror}); upload the original again"
            raise MissingFileError(f"{path}: {text}") from error
        if found != sha256:
            raise FormatError(f"{path}: its content has changed since it was uploaded; upload the original again")
        return path

    def discard(self, sha256: str) -> None:
        """Remove a file; one that cannot be removed stays, which harms nothing."""
        with contextlib.suppress(OSError):
            self.path(sha256).unlink()

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(
                f"{self.folder}: cannot be written ({error.strerror}), nothing was added; free space, "
                "or set INSPECTOR_DATA to a folder that you may write to"
            ) from error


def results_of(staged: LockedFile, shown: str) -> Results:
    """The estimates in a staged file; what is wrong with it is told under the name that the user knows."""
    try:
        return read_results(staged.path)
    except InputError as error:
        error.args = (str(error).replace(str(staged.path), shown),)
        raise


@contextlib.contextmanager
def _source(content: bytes | Path) -> Iterator[BinaryIO | None]:
    """The opened file of a path; None for bytes."""
    if isinstance(content, bytes):
        yield None
        return
    try:
        file = content.open("rb")
    except OSError as error:
        raise MissingFileError(f"{content}: cannot be read ({error.strerror}); give a results file (CSV)") from error
    with file:
        yield file


def _hash(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
