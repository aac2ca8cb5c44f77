"""Downloading a BOP dataset: choose its parts, fetch, verify and unpack them, skip what is already there."""

import errno
import fcntl
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from pipeline.bop.archives import no_space, unpack
from pipeline.bop.facts import dataset_facts
from pipeline.bop.hub import DEFAULT_HUB, Hub, ProgressCallback, RemoteFile, Step, fetch, list_archives
from pipeline.exceptions import InputError, UnknownIdError

_TEST_PREFERENCE = (r"test.*_bop19", r"test.*_bop24", r"test_all", r"test.*", r"val.*")
_WORK_FOLDER = ".download"

Archives = dict[str, tuple[RemoteFile, ...]]


def default_parts(name: str, archives: Archives) -> tuple[str, ...]:
    """Choose what one needs to evaluate on a dataset: base, models, and the test images of the BOP challenges.

    As the table of datasets says; for a dataset that is not in it, the most usual test archive of the listing.
    """
    facts = dataset_facts(name)
    listed = {file.name: part for part, files in archives.items() for file in files}
    known = [listed.get(archive) for archive in (*facts.base_archives, *facts.models_archives, *facts.test_archives)]
    usual = (part for pattern in _TEST_PREFERENCE for part in archives if re.fullmatch(pattern, part))
    tests = [] if facts.test_archives else [next(usual, None)]
    return tuple(dict.fromkeys(part for part in known + tests if part))


def download_dataset(
    name: str,
    to: Path,
    parts: Sequence[str] | None = None,
    *,
    hub: Hub = DEFAULT_HUB,
    overwrite: bool = False,
    progress: ProgressCallback = lambda step: None,
) -> Path:
    """Fetch, verify and unpack parts of a dataset into `to/name` and return that folder.

    parts: as `list_archives` names them; None: `default_parts`. Parts that are complete are skipped (unless
    `overwrite`); an interrupted download continues where it stopped. Raises InputError (one line) for an unknown name
    or part, no connection, a wrong checksum, a full disk, or a differing file in the way.
    """
    archives = list_archives(name, hub)
    wanted = tuple(parts) if parts else default_parts(name, archives)
    if not wanted:
        raise InputError(f"{name}: no usual test archive on the hub; choose with --parts from: {', '.join(archives)}")
    for part in wanted:
        if part not in archives:
            raise UnknownIdError("part", part, f"{name} on the hub", archives)
    root = to / name
    with _work_folder(root) as work:
        missing = {part: archives[part] for part in wanted if overwrite or not is_complete(root, part, archives[part])}
        _check_space(missing, work)
        for part, files in missing.items():
            _download_part(part, files, root, work, hub, overwrite, progress)
    return root


def _download_part(
    part: str,
    files: tuple[RemoteFile, ...],
    root: Path,
    work: Path,
    hub: Hub,
    overwrite: bool,
    progress: ProgressCallback,
) -> None:
    with _full_disk_is_one_line(work, sum(file.size for file in files)):
        paths = [fetch(file, work, hub, progress) for file in files]
        unpack(
            paths,
            root,
            scratch=work / f"{part}.unpacking",
            outer_folder=files[0].repository.rpartition("/")[2],
            overwrite=overwrite,
            on_bytes=lambda done, total: progress(Step("unpack", files[-1].name, done, total)),
        )
        (work / f"{part}.done").write_text(_identity(files))
        for path in paths:
            path.unlink()


@contextmanager
def _work_folder(root: Path) -> Iterator[Path]:
    """Make the folder for what is under way, locked against a second download of the same dataset."""
    work = root / _WORK_FOLDER
    try:
        work.mkdir(parents=True, exist_ok=True)
        lock = (work / "lock").open("w")
    except OSError as error:
        raise InputError(f"{work}: cannot be written ({error.strerror}); choose another folder with --to") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{root}: another download into this folder is running; wait for it") from error
        yield work


@contextmanager
def _full_disk_is_one_line(work: Path, needed: int) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise no_space(work, needed, shutil.disk_usage(work).free) from error


def _check_space(missing: Archives, work: Path) -> None:
    """Refuse a disk that is too small for all unpacked parts and the largest archive (they are removed one by one)."""
    sizes = [sum(file.size for file in files) for files in missing.values()]
    have = sum(path.stat().st_size for path in work.iterdir() if path.is_file())
    needed = sum(sizes) + max(sizes, default=0) - have  # images hardly shrink in a zip
    free = shutil.disk_usage(work).free
    if needed > free:
        raise no_space(work, needed, free)


def is_complete(root: Path, part: str, files: tuple[RemoteFile, ...]) -> bool:
    """Whether this very version of a part was unpacked into the dataset folder `root`."""
    done = root / _WORK_FOLDER / f"{part}.done"
    return done.is_file() and done.read_text() == _identity(files)


def _identity(files: tuple[RemoteFile, ...]) -> str:
    return "".join(f"{file.digest}  {file.name}\n" for file in files)
