"""`inspector evaluate`: the scores that the BOP Challenge would give."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import Positional, arg

from pipeline.exceptions import FormatError, InputError

if TYPE_CHECKING:
    from pipeline.bop.dataset import Dataset
    from pipeline.bop.evaluation.columns import Execution
    from pipeline.bop.evaluation.files import AnyEvaluation
    from pipeline.bop.evaluation.over_datasets import Mean
    from pipeline.bop.evaluation.summary import Summary
    from pipeline.parallel import Workers


@dataclass(frozen=True)
class EvaluateConfig:
    """Score results files as the BOP Challenge does.

    Tasks: localization (since 2019: average recalls of VSD, MSSD and MSPD), siso (2017: one instance of each object, by
    VSD), detection (2024: average precision; of a JSON file in COCO's form that of 2D boxes or masks).
    """

    dataset: Positional[Path]
    """Folder of a BOP dataset, or one with several of them: then the files' names tell which each is for. Or the folder
    of a run, alone: it knows its dataset and results."""
    results: Positional[tuple[Path, ...]]
    """BOP results files, METHOD_DATASET-SPLIT.csv; for 2D detection .json or .json.gz."""
    task: Literal["localization", "siso", "detection"] = "localization"
    """What the method was asked for."""
    split: str | None = None
    """Folder of the split, such as test_primesense; by default the one named by the file, else the official test split."""
    vsd: bool = True
    """Compute VSD where there is depth (localization); it takes by far the most time."""
    add: bool = False
    """Also the recall by ADD, or ADI where views are ambiguous, at 10 % of the diameter (localization)."""
    measure: Annotated[Literal["bbox", "segm"] | None, arg(name="2d")] = None
    """Compare boxes or masks (2D detection); by default masks if the file has any."""
    modal: bool = False
    """Compare boxes with those of the visible parts instead of the whole objects (2D detection)."""
    json: Path | None = None
    """File to write the scores to: an object for one results file, a list for several; for several datasets an object
    with that list and the means."""
    out: Path | None = None
    """Folder to write scores, curves and a table of instances to, in one of its own for each results file. An
    interrupted evaluation goes on from what is there."""
    workers: int | None = None
    """Processes to compute in; by default one for each core, where it pays."""
    scheduler: str | None = None
    """Address of a Dask scheduler, such as tcp://10.0.0.1:8786, whose workers are to compute instead."""


@dataclass(frozen=True)
class _Job:
    """A results file, what it is evaluated on, and where its files go."""

    file: Path
    dataset: "Dataset"
    folder: Path | None

    @property
    def is_2d(self) -> bool:
        return self.file.name.endswith((".json", ".json.gz"))


def run(config: EvaluateConfig, console: Console | None = None) -> int:
    """Evaluate all files, print and write the scores; 0 if all could be scored. InputError is left to the caller.

    Of several files one that cannot be scored is told, and 2 returned; the others are scored all the same.
    """
    from inspector.commands.evaluation_report import report
    from pipeline.bop.evaluation.files import summary_of, write_json
    from pipeline.bop.evaluation.over_datasets import means_over_datasets
    from pipeline.parallel import open_workers

    console = console or Console()
    jobs = _jobs(_of_run(config))
    evaluations: list[AnyEvaluation] = []
    with open_workers(config.workers, config.scheduler) as workers:
        for job in jobs:
            try:
                evaluations.append(_evaluated(config, job, workers, console))
            except KeyboardInterrupt:
                goes_on = f"the same command goes on from what is in {config.out}" if config.out else "nothing is kept"
                console.print(f"interrupted; {escape(goes_on)}", soft_wrap=True)
                raise
            except InputError as error:
                if len(jobs) == 1:
                    raise
                console.print(f"[bold red]error:[/bold red] {escape(str(error))}", soft_wrap=True)
    summaries = [summary_of(evaluation) for evaluation in evaluations]
    several = len({job.dataset.root for job in jobs}) > 1
    means = means_over_datasets(summaries) if several else []
    report(console, summaries, means)
    if config.json and summaries:
        write_json(config.json, _content(summaries, means, len(jobs)))
    return 0 if len(evaluations) == len(jobs) else 2


def _of_run(config: EvaluateConfig) -> EvaluateConfig:
    """With the dataset and the results of a run where its folder is given in the place of a dataset."""
    from pipeline.run import RESULTS_FILE, RUN_FILE
    from pipeline.run_info import read_info

    if config.results or not (config.dataset / RUN_FILE).is_file():
        return config
    info = read_info(config.dataset)
    split = config.split or info.dataset_split
    return replace(config, dataset=Path(info.dataset_root), results=(config.dataset / RESULTS_FILE,), split=split)


def _content(summaries: "Sequence[Summary]", means: "Sequence[Mean]", files: int) -> Any:
    """What goes into the JSON file."""
    found = [summary.as_dict() for summary in summaries]
    if means:
        return {"evaluations": found, "over_datasets": [mean.as_dict() for mean in means]}
    return found[0] if files == 1 else found


def _jobs(config: EvaluateConfig) -> list[_Job]:
    """What is to be done; raises InputError for whatever would come out only after hours of computing."""
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.evaluation.files import check_writable
    from pipeline.bop.evaluation.over_datasets import check_once_each
    from pipeline.bop.results_home import homes, named_split, parts_of

    if not config.results:
        raise InputError("no results file; name one or more: inspector evaluate DATASET RESULTS.csv")
    roots = homes(config.dataset, config.results)
    if len(set(roots)) > 1:
        pairs = [(parts_of(file).method, root.name) for file, root in zip(config.results, roots, strict=True)]
        check_once_each(pairs)
    datasets: dict[tuple[Path, str | None], Dataset] = {}
    jobs = []
    for file, root, folder in zip(config.results, roots, _folders(config), strict=True):
        split = config.split or named_split(root, file)
        if (root, split) not in datasets:
            datasets[root, split] = open_dataset(root, split)
        jobs.append(_Job(file, datasets[root, split], folder))
        if jobs[-1].is_2d and config.task != "detection":
            raise InputError(f"{file}: a JSON file holds 2D detections; add --task detection, or give poses as CSV")
        if (config.measure or config.modal) and not jobs[-1].is_2d:
            raise InputError(f"{file}: holds poses; leave out --2d and --modal, which are for 2D detections (JSON)")
    if config.modal and config.measure == "segm":
        raise InputError("--modal is about boxes; leave it out, or give --2d bbox")
    for path in (config.json, *(folder / "scores.json" for job in jobs if (folder := job.folder))):
        if path is not None:
            check_writable(path)
    return jobs


def _folders(config: EvaluateConfig) -> list[Path | None]:
    """Folder for the files of each results file. Raises InputError if two would have the same."""
    if config.out is None:
        return [None] * len(config.results)
    folders = [config.out / file.name.removesuffix(".gz").rpartition(".")[0] for file in config.results]
    for folder in folders:
        if folders.count(folder) > 1:
            raise InputError(f"{folder}: two results files have this name; rename one, or evaluate them one by one")
    return list(folders)


def _evaluated(config: EvaluateConfig, job: _Job, workers: "Workers", console: Console) -> "AnyEvaluation":
    from pipeline.bop.evaluation.columns import Execution
    from pipeline.bop.evaluation.files import write_evaluation
    from pipeline.bop.evaluation.journal import forget_pieces

    journal = None if job.folder is None else job.folder / "unfinished"
    execution = Execution(workers, journal)
    evaluation = _detections(config, job) if job.is_2d else _poses(config, job, execution, console)
    if job.folder is not None:
        write_evaluation(job.folder, evaluation)
    if journal is not None:
        forget_pieces(journal)
    return evaluation


def _detections(config: EvaluateConfig, job: _Job) -> "AnyEvaluation":
    from pipeline.bop.coco.detection import evaluate_detections
    from pipeline.bop.coco.results import read_detections
    from pipeline.bop.evaluation.files import with_notes

    detections = read_detections(job.file)
    if not len(detections):
        raise FormatError(f"{job.file}: holds no detections; write one for each object that was found")
    evaluation = evaluate_detections(job.dataset, detections, config.measure, modal=config.modal)
    named, own = detections.dataset_name.lower(), job.dataset.name.lower()
    notes = [f"{job.file} is for {named} by its name, evaluated on {own}; check both"] if named not in ("", own) else []
    return with_notes(evaluation, notes)


def _poses(config: EvaluateConfig, job: _Job, execution: "Execution", console: Console) -> "AnyEvaluation":
    from pipeline.bop.evaluation.evaluate import evaluate
    from pipeline.bop.evaluation.files import with_notes
    from pipeline.bop.evaluation.pose_detection import evaluate_pose_detection
    from pipeline.bop.evaluation.siso import evaluate_siso
    from pipeline.bop.submission import check_submission

    checked = check_submission(job.dataset, job.file, config.task)
    if checked.results is None or checked.unusable is not None:
        raise FormatError(
            f"{job.file}: {checked.unusable.text if checked.unusable else 'cannot be read; get it again'}"
        )
    method = _method_of_run(job.file)
    results = checked.results if method is None else replace(checked.results, method=method)
    with _progress(console, job.file.name) as progress:
        if config.task == "siso":
            evaluation = evaluate_siso(job.dataset, results, progress, execution=execution)
        elif config.task == "detection":
            evaluation = evaluate_pose_detection(job.dataset, results, progress, execution=execution)
        else:
            options = {"with_vsd": config.vsd, "with_ad": config.add}
            evaluation = evaluate(job.dataset, results, progress, **options, execution=execution)
    errors = [found for found in checked.errors if method is None or found.kind != "file name"]
    refused = [f"BOP would refuse the file: {found.text}" for found in errors]
    return with_notes(evaluation, [*refused, *(found.text for found in checked.warnings)])


def _method_of_run(file: Path) -> str | None:
    """Method of the run whose results these are; None for a file of its own."""
    from pipeline.run import RUN_FILE
    from pipeline.run_info import read_info

    return read_info(file.parent).method if (file.parent / RUN_FILE).is_file() else None


@contextmanager
def _progress(console: Console, title: str) -> Iterator[Callable[[float], None]]:
    columns = (TextColumn(escape(title)), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=1.0)
        yield lambda share: bars.update(task, completed=share)
