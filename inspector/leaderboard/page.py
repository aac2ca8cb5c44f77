"""What the page of the leaderboard asks of a session; arguments come from the browser, unchecked."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, get_args

from inspector.leaderboard.dialogs import AddDialog, EditDialog
from inspector.leaderboard.figures import Entry, figures
from inspector.leaderboard.rows import table
from inspector.leaderboard.service import LeaderboardService
from inspector.selection import Filter, Grouping, Score, Selection
from pipeline.bop.evaluation.evaluate import Evaluation
from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from inspector.session import Session

_CHOICES: dict[str, Callable[[Any], bool]] = {
    "open": lambda value: isinstance(value, bool),
    "score": lambda value: value in get_args(Score),
    "by": lambda value: value in get_args(Grouping),
    "first": lambda value: value is None or type(value) is int,
    "second": lambda value: value is None or type(value) is int,
}
"""What the page may change of the leaderboard, and to what."""


class LeaderboardPage:
    """The leaderboard in one browser."""

    def __init__(self, session: "Session", service: LeaderboardService) -> None:
        self._session = session
        self._service = service
        self._stop_listening = service.listen(session.publish)

    def close(self) -> None:
        """Stop following the leaderboard."""
        self._stop_listening()

    def methods(self) -> dict[str, Callable[..., Any]]:
        """The calls by name, as the page knows them."""
        return {
            "board": self.table,
            "board_figures": self.figures,
            "board_show": self.show,
            "board_targets": self.open_targets,
            "board_evaluate": self.evaluate,
            "board_cancel": self.cancel,
            "board_edit": self.edit,
        }

    def state(self) -> dict[str, Any]:
        """What the page shows of the leaderboard."""
        board = self._session.selection.board
        if not board.open:
            return {"open": False}
        with contextlib.suppress(InputError):  # the table says it
            self._service.opened(self._session.workspace)
        first, second = self._marked()
        return {
            "open": True,
            "score": board.score,
            "by": board.by,
            "first": first,
            "second": second,
            "version": self._service.version,
            "figures": self._service.numbers,
        }

    def show(self, changes: dict[str, Any]) -> None:
        """Change what the leaderboard shows."""
        known = {name: value for name, value in dict(changes).items() if name in _CHOICES and _CHOICES[name](value)}
        self._session.change(board=known)

    def table(self) -> dict[str, Any]:
        """All methods with their numbers."""
        try:
            return {"note": "", **table(self._service, self._session.workspace)}
        except InputError as error:
            return {"note": str(error), "here": "", "datasets": [], "rows": [], "average_name": "", "average_title": ""}

    def figures(self, score: str) -> dict[str, Any]:
        """Bars and curves of the marked methods on the dataset that is looked at."""
        board = self._session.selection.board
        board = replace(board, score=score) if score in get_args(Score) else board
        workspace, entries = self._session.workspace, []
        for place, submission_id in zip(("first", "second"), self._marked(), strict=True):
            evaluation = None if submission_id is None else self._evaluation(submission_id)
            if submission_id is not None and evaluation is not None:
                entries.append(Entry(place, submission_id, evaluation))
        name = f"{workspace.dataset.name}/{workspace.dataset.split}"
        return {"dataset": name, **figures(entries, board)}

    def open_targets(self, submission_id: int, dataset: str, wanted: dict[str, Any]) -> None:
        """Look at the targets behind a number, the worst first."""
        session, wanted = self._session, dict(wanted)
        selection = session.selection
        here = f"{session.workspace.dataset.name.lower()}/{session.workspace.dataset.split}"
        criterion = wanted.get("criterion")
        changes: dict[str, Any] = {
            "criterion": criterion if criterion in ("mssd", "mspd", "vsd") else selection.criterion,
            "filter": Filter(obj_id=_whole(wanted.get("obj_id")), scene_id=_whole(wanted.get("scene_id"))),
            "board": replace(selection.board, open=False),
            "sort": "error",
            "descending": True,
        }
        try:
            if dataset == here:
                index = self._service.method_of(int(submission_id), session.workspace)
                compared = None if selection.compare == index else selection.compare
                session.begin_anew(replace(selection, method=index, compare=compared, **changes))
            else:
                self._go_elsewhere(int(submission_id), str(dataset), changes)
        except InputError as error:
            session.notify("The targets cannot be opened", error)

    def evaluate(self, submission_id: int) -> None:
        """Evaluate a submission in the background."""
        try:
            submission = self._service.store.submission(int(submission_id))
            workspace = self._session.workspaces.of(submission.dataset_name, submission.split)
            self._service.evaluate(submission, workspace)
        except InputError as error:
            self._session.notify("It cannot be evaluated", error)

    def cancel(self, job_id: int) -> None:
        """Give up an evaluation."""
        self._service.queue.cancel(int(job_id))

    def edit(self, submission_id: int) -> None:
        """Open the dialog that changes what is said of a submission."""
        EditDialog(self._session, self._service, int(submission_id)).open()

    def add(self) -> None:
        """Open the dialog that takes a results file."""
        AddDialog(self._session, self._service).open()

    def _go_elsewhere(self, submission_id: int, dataset: str, changes: dict[str, Any]) -> None:
        name, _, split = dataset.partition("/")
        workspace = self._session.workspaces.of(name, split)
        index = self._service.method_of(submission_id, workspace)
        first = workspace is self._session.workspaces.first
        usual = Selection(dataset="" if first else dataset, delta_mm=workspace.delta * 1000)
        dark = self._session.selection.dark
        self._session.go_to_dataset(replace(usual, method=index, dark=dark, **changes))

    def _marked(self) -> tuple[int | None, int | None]:
        """The submissions whose bars and curves are shown: those chosen, else the methods that are looked at."""
        session, board = self._session, self._session.selection.board
        first, second = board.first, board.second
        if first is None:
            methods = session.selection.method, session.selection.compare
            own, compared = (self._service.submission_of(method, session.workspace) for method in methods)
            first, second = own, compared if second is None else second
        return first, second if second != first else None

    def _evaluation(self, submission_id: int) -> Evaluation | None:
        try:
            return self._service.evaluation(submission_id, self._session.workspace)
        except (InputError, OverflowError):  # a number from an address may be too large for the store
            return None


def _whole(value: Any) -> int | None:
    return value if type(value) is int else None
