"""What decides the scores on a dataset, as one short text."""

import hashlib
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pipeline.bop import layout
from pipeline.bop.dataset import Dataset
from pipeline.bop.json_files import read_bytes
from pipeline.exceptions import MissingFileError

_VERSION = "1"


def fingerprint(dataset: Dataset) -> str:
    """Hash of all that decides the scores on a dataset as it lies on the disk now.

    The annotations (targets, ground truth with its information, cameras, `models_info.json`) count by their bytes:
    these are the files that are corrected by hand and by tools, where a changed digit keeps the size and a copied file
    its time. Images and meshes, too many bytes to read in a tenth of a second, count by name, size and time of change
    to the nanosecond, as they do for make and rsync; the images because depth decides VSD and the width MSPD. The
    name of the dataset and the sensor count too, from which the tolerance of VSD and the choice of files follow. A
    copy that does not keep the times has another fingerprint: then an evaluation is done again, never taken wrongly.

    Raises InputError if a file cannot be read.
    """
    scenes = layout.scene_folders(dataset.root / dataset.split)
    with ThreadPoolExecutor(2) as pool:  # most of the time is the system's
        of_scenes = pool.map(lambda scene_id: _digest(_scene(dataset, scene_id, scenes[scene_id])), sorted(scenes))
        return _digest((*_whole(dataset), *of_scenes)).hex()[:32]


def _whole(dataset: Dataset) -> Iterator[bytes]:
    """What all scenes share, read anew: what the dataset itself remembers may be older than the files."""
    facts, root = dataset.facts, dataset.root
    yield repr((_VERSION, dataset.name.lower(), dataset.split, facts.vsd_delta, facts.eval_models)).encode()
    for path in (*layout.target_files(root, dataset.split), root / "camera.json"):
        yield from _content(path)
    for folder in layout.model_folders(root, (facts.eval_models,)):
        yield from _content(folder / "models_info.json")
        yield _listing(folder)


def _scene(dataset: Dataset, scene_id: int, folder: Path) -> Iterator[bytes]:
    sensor = layout.choose_sensor(folder, dataset._sensor, dataset.facts.sensors)
    scene = layout.SceneLayout(folder, sensor)
    yield repr((scene_id, sensor)).encode()
    for stem in ("scene_camera", "scene_gt", "scene_gt_info"):
        yield from _content(scene.json(stem))
    for images in (scene.image_folder(), scene.depth_folder()):
        yield b"" if images is None else _listing(images)


def _digest(parts: Iterable[bytes]) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))  # else two parts could be taken for one
        digest.update(part)
    return digest.digest()


def _content(path: Path) -> tuple[bytes, ...]:
    """Name and bytes of a file, the name alone of one that is absent."""
    name = os.fsencode(path.name)
    return (name, b"holds", read_bytes(path)) if path.is_file() else (name,)


def _listing(folder: Path) -> bytes:
    """Name, size and time of change of every file in a folder."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)  # names relative to it are found quicker than whole paths
        try:
            with os.scandir(descriptor) as entries:
                names = sorted(entry.name for entry in entries)
            found = [(name, os.stat(name, dir_fd=descriptor)) for name in names]
        finally:
            os.close(descriptor)
    except OSError as error:
        raise MissingFileError(f"{folder}: cannot be read ({error.strerror}); check its permissions") from error
    rows = [(name, status.st_size, status.st_mtime_ns) for name, status in found]
    return repr((folder.name, rows)).encode("utf-8", "surrogateescape")
