"""From the paths of a command line to a workspace."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from inspector.workspace import Method, Workspace
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import Results, read_results
from pipeline.exceptions import InputError, MissingFileError
from pipeline.run import RECORDINGS_FOLDER, RUN_FILE, Run


def open_workspace(path: Path, results: tuple[Path, ...] = (), split: str | None = None) -> Workspace:
    """Open a dataset, or a run with the dataset that it was made on, and results files to inspect beside it.

    Raises:
        InputError: the folder, the run or a results file is absent or damaged.

    """
    if (path / RUN_FILE).exists():
        run = Run.open(path)
        if not run.results_path.is_file():
            raise MissingFileError(f"{run.results_path}: no such file; restore it, or make the run again")
        own = Method(run.info.method, read_results(run.results_path), run.results_path)
        dataset, methods = _dataset_of(run), (own, *map(_method, results))
        return Workspace(dataset, methods, run, notes_on(dataset, methods))
    if (path / RECORDINGS_FOLDER).is_dir():
        raise MissingFileError(f"{path / RUN_FILE}: no such file; restore it, or make the run again")
    dataset, methods = open_dataset(path, split), tuple(map(_method, results))
    return Workspace(dataset, methods, notes=notes_on(dataset, methods))


def notes_on(dataset: Dataset, methods: Iterable[Method]) -> tuple[str, ...]:
    """Say which results files seem to be for other data, one line each."""
    notes = []
    for method in methods:
        results = method.results
        if results.dataset_name and results.dataset_name != dataset.name:
            notes.append(
                f"{method.path}: by its name for {results.dataset_name}, opened with {dataset.name}; check both"
            )
        foreign = _rows_elsewhere(dataset, results)
        if foreign:
            notes.append(
                f"{method.path}: {foreign} of {len(results)} rows are for images that are not in "
                f"{dataset.name}/{dataset.split}; they are left out"
            )
    return tuple(notes)


def _rows_elsewhere(dataset: Dataset, results: Results) -> int:
    images, rows = np.unique(np.stack([results.scene_id, results.im_id], axis=1), axis=0, return_counts=True)
    scenes = {int(scene) for scene in images[:, 0]} & set(dataset.scene_ids)
    here = {(scene, image) for scene in scenes for image in dataset.image_ids(scene)}
    return int(sum(count for image, count in zip(images.tolist(), rows, strict=True) if tuple(image) not in here))


def _method(path: Path) -> Method:
    results = read_results(path)
    return Method(results.method or path.stem, results, path)


def _dataset_of(run: Run) -> Dataset:
    root = Path(run.info.dataset_root)
    if not root.is_dir():
        raise MissingFileError(
            f"{run.root / RUN_FILE}: its dataset {root} is not there; put it back or correct dataset_root in that file"
        )
    try:
        return open_dataset(root, run.info.dataset_split)
    except InputError as error:
        raise InputError(f"{run.root / RUN_FILE}: its dataset cannot be opened: {error}") from error
