"""Where things lie in a BOP dataset: splits, scenes, the folders of one sensor, models, target lists.

Names vary: `test`, `test_primesense`, `rgb` or `gray`, and with several sensors `scene_gt_cam1.json` with
`rgb_cam1/` and `mask_cam1/` (IPD, XYZ-IBD, ITODD-MV) or `scene_gt_gray1.json` with `gray1/` (HOT3D).
"""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pipeline.bop.facts import DatasetFacts
from pipeline.exceptions import MissingFileError, UnknownIdError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
MODEL_SUFFIXES = (".ply", ".glb")


def splits(root: Path) -> tuple[str, ...]:
    """Names of the folders of a dataset that hold scenes: test splits first, then validation, training, others.

    Raises MissingFileError if the folder of the dataset is absent.
    """
    folders = [path.name for path in root.iterdir() if path.is_dir()] if _is_folder(root) else []
    return tuple(sorted(filter(lambda name: scene_ids(root / name), folders), key=_split_order))


def choose_split(root: Path, split: str | None, facts: DatasetFacts) -> str:
    """The split that is asked for, or of all the most interesting: the official test split, else test, val, train.

    Raises MissingFileError if there is none, UnknownIdError if there is no such split.
    """
    available = splits(root)
    if not available and scene_ids(root):
        raise MissingFileError(f"{root}: is a split itself; open its parent {root.parent} with split {root.name}")
    if not available:
        raise MissingFileError(
            f"{root}: no split holds a scene; expected folders such as test/000001/scene_camera.json"
        )
    if split is not None and split not in available:
        raise UnknownIdError("split", split, str(root), available)
    if split is None:
        return facts.test_split if facts.test_split in available else available[0]
    return split


def scene_ids(split_folder: Path) -> tuple[int, ...]:
    """Ids of the scene folders in a split, in order."""
    return tuple(sorted(scene_folders(split_folder)))


def scene_folders(split_folder: Path) -> dict[int, Path]:
    """Scene folders of a split by id: the folders whose name is a number."""
    try:
        with os.scandir(split_folder) as entries:
            return {
                int(e.name): Path(e.path) for e in entries if e.name.isdecimal() and e.name.isascii() and e.is_dir()
            }
    except OSError as error:
        raise MissingFileError(f"{split_folder}: cannot be read ({error.strerror}); check its permissions") from error


@dataclass(frozen=True)
class SceneLayout:
    """Paths of one scene as seen by one sensor."""

    folder: Path
    sensor: str
    """Suffix of the sensor's files and folders; empty for the classic layout with one unnamed sensor."""

    def json(self, stem: str) -> Path:
        """Path of `scene_camera`, `scene_gt` or `scene_gt_info`, whether it exists or not."""
        return self.folder / f"{self._suffixed(stem)}.json"

    def image_folder(self) -> Path | None:
        """Folder of the colour or gray images, None where there is none."""
        names = [f"rgb_{self.sensor}", f"gray_{self.sensor}", self.sensor] if self.sensor else ["rgb", "gray"]
        return _first_folder(self.folder, names)

    def depth_folder(self) -> Path | None:
        """Folder of the depth images, None where there is none."""
        return _first_folder(self.folder, [self._suffixed("depth")])

    def mask(self, im_id: int, gt_index: int, visible: bool) -> Path | None:
        """Path of a mask, None where there is none."""
        folder = self.folder / self._suffixed("mask_visib" if visible else "mask")
        candidates = [folder / f"{im_id:06d}_{gt_index:06d}{suffix}" for suffix in IMAGE_SUFFIXES]
        return next((path for path in candidates if path.is_file()), None)

    def _suffixed(self, stem: str) -> str:
        return f"{stem}_{self.sensor}" if self.sensor else stem


def sensors(scene_folder: Path) -> tuple[str, ...]:
    """Suffixes of the sensors of a scene, in order of the alphabet; the unnamed one is an empty string."""
    prefix = "scene_camera"
    stems = [path.stem.removeprefix(prefix) for path in scene_folder.glob(f"{prefix}*.json")]
    return tuple(sorted(stem.removeprefix("_") for stem in stems if not stem or stem.startswith("_")))


def choose_sensor(scene_folder: Path, wanted: str | None, preferred: Iterable[str]) -> str:
    """The wanted sensor if the scene has it, else the most preferred one that it has, else its first, else the unnamed."""
    available = sensors(scene_folder)
    order = (*([] if wanted is None else [wanted]), *preferred, *available)
    return next((name for name in order if name in available), "")


def numbered_files(folder: Path | None, suffixes: Iterable[str] = IMAGE_SUFFIXES) -> dict[int, Path]:
    """Files whose name is a number, by that number, such as `000012.png`; empty where the folder is None."""
    return {} if folder is None else {i: folder / name for i, name in numbered_names(folder, suffixes).items()}


def numbered_names(folder: Path, suffixes: Iterable[str] = IMAGE_SUFFIXES) -> dict[int, str]:
    """Names of the files whose name is a number, by that number, in order."""
    found: dict[int, str] = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            stem, dot, suffix = entry.name.rpartition(".")
            if stem.isdecimal() and stem.isascii() and (dot + suffix).lower() in suffixes:
                found[int(stem)] = entry.name
    return dict(sorted(found.items()))


def model_folders(root: Path, first: Iterable[str]) -> tuple[Path, ...]:
    """All folders of models that exist, those named first in front."""
    usual = (
        "models",
        "models_reconst",
        "models_fine",
        "models_cad",
        "models_eval",
        "object_models",
        "object_models_eval",
    )
    others = sorted(path.name for path in root.glob("models*") if path.is_dir())
    names = dict.fromkeys([*first, *usual, *others])
    return tuple(root / name for name in names if (root / name).is_dir())


def model_files(folder: Path) -> dict[int, Path]:
    """Model files of a folder by object id, such as `obj_000012.ply`."""
    found = {}
    for path in sorted(folder.glob("obj_*")):
        number = path.stem.removeprefix("obj_")
        if number.isdecimal() and path.suffix.lower() in MODEL_SUFFIXES:
            found[int(number)] = path
    return found


def target_files(root: Path, split: str) -> tuple[Path, ...]:
    """Lists of targets that belong to a split, the one of BOP Challenge 2019 first."""
    kind = split.partition("_")[0]
    order = [f"{kind}_targets_{year}.json" for year in ("bop19", "bop24", "bop18")] + [f"{kind}_targets.json"]
    others = sorted(path.name for path in root.glob(f"{kind}_targets*.json"))
    return tuple(root / name for name in dict.fromkeys([*order, *others]) if (root / name).is_file())


def _is_folder(root: Path) -> bool:
    if root.is_dir():
        return True
    problem = "is not a folder" if root.exists() else "no such folder"
    raise MissingFileError(f"{root}: {problem}; give the folder of a BOP dataset, the one that holds test/ and models/")


def _first_folder(parent: Path, names: Iterable[str]) -> Path | None:
    return next((parent / name for name in names if (parent / name).is_dir()), None)


def _split_order(name: str) -> tuple[int, str]:
    kinds = ("test", "val", "train")
    return next((i for i, kind in enumerate(kinds) if name.startswith(kind)), len(kinds)), name
