"""From the paths of a command line to a workspace."""

from pathlib import Path

from inspector.workspace import Method, Workspace
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import read_results
from pipeline.exceptions import InputError, MissingFileError
from pipeline.run import RUN_FILE, Run


def open_workspace(path: Path, results: tuple[Path, ...] = (), split: str | None = None) -> Workspace:
    """Open a dataset, or a run with the dataset that it was made on, and results files to inspect beside it.

    Raises:
        InputError: the folder, the run or a results file is absent or damaged.

    """
    if (path / RUN_FILE).exists():
        run = Run.open(path)
        own = Method(run.info.method, read_results(run.results_path), run.results_path)
        return Workspace(_dataset_of(run), (own, *map(_method, results)), run)
    return Workspace(open_dataset(path, split), tuple(map(_method, results)))


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
