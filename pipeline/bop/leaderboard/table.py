"""The table of the leaderboard: a row a method, a column a dataset, as in the benchmark's (thesis tab. bop_2020_results)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from pipeline.bop.evaluation.scores import Scores
from pipeline.bop.facts import dataset_facts
from pipeline.bop.leaderboard.records import KeptEvaluation, Submission

CORE_DATASETS = ("lmo", "tless", "tudl", "icbin", "itodd", "hb", "ycbv")
"""The core datasets in the order of the benchmark's table (thesis sec. bop20)."""

AR_CORE = "AR_Core"


class Column(NamedTuple):
    """What a method is evaluated on."""

    dataset_name: str
    split: str

    @property
    def title(self) -> str:
        """Name for people, such as `LM-O`; with the split if it is not the one on which methods are compared."""
        facts = dataset_facts(self.dataset_name)
        name = facts.title.partition(" (")[0]
        return name if self.split == facts.test_split else f"{name} {self.split}"


@dataclass(frozen=True)
class Cell:
    """How well a method did on a dataset."""

    submission_id: int
    """The method's newest submission for the dataset that has been evaluated."""
    newer_submission_id: int | None
    """A newer one that has not been evaluated yet."""
    fingerprint: str
    """Of the data that it was evaluated on; with the submission it names the evaluation."""
    scores: Scores
    why_no_vsd: str
    """Empty where there is VSD, and so AR."""
    targets: int
    """Number of instances asked for."""
    benchmark_targets: int | None
    """Number of instances that the benchmark asks for on this split; None where it is not known."""
    seconds_per_image: float | None
    """None where not reported."""

    @property
    def is_full(self) -> bool:
        """Whether it is the benchmark's own number of instances."""
        return self.targets == self.benchmark_targets

    @property
    def is_subset(self) -> bool:
        """Whether there are fewer instances than in the benchmark, so that the numbers are not its numbers."""
        return self.benchmark_targets is not None and self.targets < self.benchmark_targets


@dataclass(frozen=True)
class Mean:
    """A mean over the datasets of a method, each of the same weight."""

    value: float | None
    name: str
    """`AR_Core` if all core datasets are there as the benchmark has them, otherwise such as `mean of 2 datasets`."""
    reason: str
    """Why there is none; empty where there is one."""

    @property
    def is_core(self) -> bool:
        """Whether it is the benchmark's AR_Core (thesis sec. bop_accuracy_score)."""
        return self.name == AR_CORE


@dataclass(frozen=True)
class Row:
    """A method."""

    method: str
    cells: dict[Column, Cell]
    """Only of what it has been evaluated on."""
    average: Mean
    """Of AR; none where a dataset has no VSD, as a mean with fewer errors would be another measure."""
    seconds_per_image: Mean
    """Mean over the same datasets of the mean time per image; none where a dataset has no time."""
    submissions: tuple[Submission, ...]
    """All of them, newest first, whether they count or not."""


@dataclass(frozen=True)
class Board:
    """The table: AR_Core first, then other means, best first; rows without one come last, by MSSD and MSPD."""

    columns: tuple[Column, ...]
    """All of which there is a submission; core datasets first, in the benchmark's order."""
    rows: tuple[Row, ...]


def make_board(submissions: Iterable[Submission], evaluations: Sequence[KeptEvaluation]) -> Board:
    """The table of submissions, newest first, and of their evaluations, oldest first.

    Of several evaluations of a submission that of all the benchmark's instances counts before one of other data,
    then that of the newest evaluated data, then that with VSD.
    """
    by_method: dict[str, list[Submission]] = {}
    for submission in submissions:
        by_method.setdefault(submission.method, []).append(submission)
    of_submission: dict[int, list[KeptEvaluation]] = {}
    for evaluation in evaluations:
        of_submission.setdefault(evaluation.submission_id, []).append(evaluation)
    rows = [_row(method, found, of_submission) for method, found in by_method.items()]
    columns = {_column(submission) for row in rows for submission in row.submissions}
    return Board(tuple(sorted(columns, key=_place)), tuple(sorted(rows, key=_rank)))


def _row(method: str, submissions: Sequence[Submission], of_submission: dict[int, list[KeptEvaluation]]) -> Row:
    cells: dict[Column, Cell] = {}
    newer: dict[Column, int] = {}
    for submission in submissions:
        column = _column(submission)
        if submission.id not in of_submission:
            newer.setdefault(column, submission.id)
        elif column not in cells:
            cells[column] = _cell(submission, of_submission[submission.id], newer.get(column))
    cells = {column: cells[column] for column in sorted(cells, key=_place)}
    return Row(method, cells, _average(cells), _mean_time(cells), tuple(submissions))


def _column(submission: Submission) -> Column:
    return Column(submission.dataset_name, submission.split)


def _cell(submission: Submission, evaluations: Sequence[KeptEvaluation], newer: int | None) -> Cell:
    facts = dataset_facts(submission.dataset_name)
    expected = facts.test_instances if submission.split == facts.test_split else None
    newest = [e for e in evaluations if e.targets == expected] or list(evaluations)
    same_data = [e for e in newest if e.fingerprint == newest[-1].fingerprint]
    counts = max(same_data, key=lambda e: e.scores.vsd is not None)
    return Cell(
        submission_id=submission.id,
        newer_submission_id=newer,
        fingerprint=counts.fingerprint,
        scores=counts.scores,
        why_no_vsd=counts.why_no_vsd,
        targets=counts.targets,
        benchmark_targets=expected,
        seconds_per_image=submission.time_per_image,
    )


def _average(cells: dict[Column, Cell]) -> Mean:
    counted, name = _counted(cells)
    without = [f"{column.title}: {cell.why_no_vsd}" for column, cell in counted.items() if cell.scores.average is None]
    return _mean([cell.scores.average for cell in counted.values()], name, "no VSD, so no AR", without)


def _mean_time(cells: dict[Column, Cell]) -> Mean:
    counted, name = _counted(cells)
    without = [column.title for column, cell in counted.items() if cell.seconds_per_image is None]
    return _mean([cell.seconds_per_image for cell in counted.values()], name, "no time reported", without)


def _counted(cells: dict[Column, Cell]) -> tuple[dict[Column, Cell], str]:
    """The cells that go into the means, and what such a mean is called."""
    core = {column: cell for column, cell in cells.items() if column.dataset_name in CORE_DATASETS and cell.is_full}
    if len(core) == len(CORE_DATASETS):
        return core, AR_CORE
    unit = "dataset" if len({column.dataset_name for column in cells}) == len(cells) else "split"
    return cells, f"mean of {len(cells)} {unit}{'' if len(cells) == 1 else 's'}"


def _mean(values: Sequence[float | None], name: str, lack: str, without: Sequence[str]) -> Mean:
    known = [value for value in values if value is not None]
    if not values:
        return Mean(None, name, "not evaluated yet")
    if without:
        return Mean(None, name, f"{lack} ({'; '.join(without)})")
    return Mean(sum(known) / len(known), name, "")


def _place(column: Column) -> tuple[int, Column]:
    core = CORE_DATASETS.index(column.dataset_name) if column.dataset_name in CORE_DATASETS else len(CORE_DATASETS)
    return core, column


def _rank(row: Row) -> tuple[bool, bool, float, str]:
    value = row.average.value
    if value is None:
        known = [(cell.scores.mssd + cell.scores.mspd) / 2 for cell in row.cells.values()]
        return True, not known, -sum(known) / max(len(known), 1), row.method
    return False, not row.average.is_core, -value, row.method
