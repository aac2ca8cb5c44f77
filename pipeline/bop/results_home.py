"""Which dataset a results file is for, where several datasets lie in one folder, as BOP keeps them."""

from collections.abc import Sequence
from pathlib import Path

from pipeline.bop import layout
from pipeline.bop.results import NameParts, name_parts
from pipeline.exceptions import FormatError, UnknownIdError


def homes(folder: Path, files: Sequence[Path]) -> list[Path]:
    """Folder of the dataset of each results file: `folder` itself, or the one in it that the file's name tells.

    Raises MissingFileError if `folder` is absent, FormatError or UnknownIdError if a name does not tell one of its
    datasets.
    """
    datasets = _datasets(folder)
    return [_home(folder, datasets, file) for file in files] if datasets else [folder] * len(files)


def named_split(root: Path, file: Path) -> str | None:
    """The split that a results file's name tells, if the dataset has it and it is not just its test split."""
    named = parts_of(file).split
    if named in ("", "test"):  # which of several test splits is the dataset's own matter
        return None
    return named if named in layout.splits(root) else None


def parts_of(file: Path) -> NameParts:
    """Method, dataset and split of a results file's name; also of one that ends in `.json.gz`."""
    return name_parts(file.name.removesuffix(".gz"))


def _datasets(folder: Path) -> dict[str, Path]:
    """Datasets in a folder by their names in lower case; none if it is a dataset itself."""
    if layout.splits(folder) or layout.scene_ids(folder):
        return {}
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    return {path.name.lower(): path for path in inside if layout.splits(path)}


def _home(folder: Path, datasets: dict[str, Path], file: Path) -> Path:
    name = parts_of(file).dataset.lower()
    if not name:
        raise FormatError(
            f"{file}: its name does not tell which dataset in {folder} it is for; call it METHOD_DATASET-SPLIT.csv"
        )
    if name not in datasets:
        raise UnknownIdError("dataset", name, str(folder), datasets)
    return datasets[name]
