"""The windows in which results are added to the leaderboard, and in which what is said of them is changed."""

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import viser

from inspector import html
from inspector.leaderboard.service import LeaderboardService
from inspector.workspace import Workspace
from pipeline.bop.submission import SubmissionCheck, check_submission
from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from inspector.session import Session

_FINDINGS_SHOWN = 12
_PROPERTIES_HINT = "One a line, such as  image type: RGB"


class AddDialog:
    """Takes a results file from the browser, says what is wrong with it, and has it evaluated."""

    def __init__(self, session: "Session", service: LeaderboardService) -> None:
        self._session = session
        self._service = service
        self._file: viser.UploadedFile | None = None
        self._workspace: Workspace = session.workspace

    def open(self) -> None:
        """Show the window."""
        gui = self._session.client.gui
        self._modal = gui.add_modal("Add results")
        with self._modal:
            dataset = self._workspace.dataset
            gui.add_html(
                html.block(
                    html.paragraph(
                        f"A results file of a method (CSV, BOP format), named METHOD_{dataset.name}-SPLIT.csv. "
                        "It is checked first, then evaluated in the background.",
                        dim=True,
                    )
                )
            )
            upload = gui.add_upload_button("Choose a file…", mime_type=".csv,text/csv", icon=viser.Icon.UPLOAD)
            self._said = gui.add_html("")
            self._name = gui.add_text("Method", "", visible=False)
            self._description = gui.add_text("Description", "", multiline=True, visible=False)
            self._properties = gui.add_text("Properties", "", multiline=True, visible=False, hint=_PROPERTIES_HINT)
            self._submit = gui.add_button("Add and evaluate", visible=False, color="blue")
            cancel = gui.add_button("Close")
        upload.on_upload(lambda _: self._uploaded(upload.value))
        self._submit.on_click(lambda _: self._add())
        cancel.on_click(lambda _: self._modal.close())

    def _uploaded(self, file: viser.UploadedFile) -> None:
        self._said.content = html.block(html.paragraph(f"Checking {file.name} …", dim=True))
        try:
            check = self._check(file)
        except InputError as error:
            self._offer(None)
            self._said.content = html.block(html.finding("error", file.name, "", str(error), ""))
            return
        self._said.content = _findings(file.name, check, self._workspace)
        self._offer(file if check.results is not None and check.unusable is None else None)
        if not self._name.value and check.results is not None:
            self._name.value = check.results.method

    def _check(self, file: viser.UploadedFile) -> SubmissionCheck:
        """Check the file against the dataset that its name says, else against the one that is looked at."""
        self._workspace = self._of_name(file.name)
        with tempfile.TemporaryDirectory(prefix="inspector-") as folder:
            path = Path(folder) / (Path(file.name).name or "results.csv")
            path.write_bytes(file.content)
            return check_submission(self._workspace.dataset, path)

    def _of_name(self, name: str) -> Workspace:
        dataset, _, split = Path(name).stem.rpartition("_")[2].partition("-")
        for workspace in self._session.workspaces:
            if workspace.dataset.name.lower() == dataset.lower():
                return workspace
        try:
            return self._session.workspaces.of(dataset.lower(), split or "test")
        except InputError:
            return self._session.workspace

    def _offer(self, file: viser.UploadedFile | None) -> None:
        self._file = file
        for control in (self._name, self._description, self._properties, self._submit):
            control.visible = file is not None

    def _add(self) -> None:
        file = self._file
        if file is None:
            return
        dataset = self._workspace.dataset
        try:
            added = self._service.store.add(
                file.content,
                method=self._name.value,
                dataset_name=dataset.name,
                split=dataset.split,
                file_name=file.name,
                description=self._description.value,
                properties=properties_of(self._properties.value),
            )
            self._service.evaluate(added.submission, self._workspace)
        except InputError as error:
            self._session.notify("The results were not added", error)
            return
        self._service.changed()
        self._modal.close()


class EditDialog:
    """Changes name, description and properties of a submission, or removes it."""

    def __init__(self, session: "Session", service: LeaderboardService, submission_id: int) -> None:
        self._session = session
        self._service = service
        self._id = submission_id
        self._sure = False

    def open(self) -> None:
        """Show the window."""
        try:
            submission = self._service.store.submission(self._id)
        except InputError as error:
            self._session.notify("The submission cannot be changed", error)
            return
        gui = self._session.client.gui
        self._modal = gui.add_modal(f"{submission.method} on {submission.dataset_name}/{submission.split}")
        with self._modal:
            about = f"{submission.file_name}, {submission.rows:,} estimates, added {submission.added[:16]} UTC"
            gui.add_html(html.block(html.paragraph(about), html.paragraph(f"SHA-256 {submission.sha256}", dim=True)))
            name = gui.add_text("Method", submission.method)
            description = gui.add_text("Description", submission.description, multiline=True)
            lines = "\n".join(f"{key}: {value}" for key, value in submission.properties.items())
            properties = gui.add_text("Properties", lines, multiline=True, hint=_PROPERTIES_HINT)
            save = gui.add_button("Save", color="blue")
            self._remove = gui.add_button("Remove from the leaderboard", color="red")
            close = gui.add_button("Close")
        save.on_click(lambda _: self._save(name.value, description.value, properties.value))
        self._remove.on_click(lambda _: self._removed())
        close.on_click(lambda _: self._modal.close())

    def _save(self, name: str, description: str, properties: str) -> None:
        try:
            self._service.store.edit(
                self._id, method=name, description=description, properties=properties_of(properties)
            )
        except InputError as error:
            self._session.notify("Nothing was changed", error)
            return
        self._service.changed()
        self._modal.close()

    def _removed(self) -> None:
        if not self._sure:  # a second click removes
            self._sure = True
            self._remove.label = "Really remove it, with its scores? Click again"
            return
        try:
            self._service.store.remove(self._id)
        except InputError as error:
            self._session.notify("It was not removed", error)
            return
        self._service.changed()
        self._modal.close()


def properties_of(text: str) -> dict[str, str]:
    """Properties from lines such as `image type: RGB`. Raises InputError for a line without a colon."""
    found: dict[str, str] = {}
    for line in filter(None, map(str.strip, text.splitlines())):
        name, colon, value = line.partition(":")
        if not colon or not name.strip():
            raise InputError(f"property {line!r}: has no name; write it as  name: value")
        found[name.strip()] = value.strip()
    return found


def _findings(name: str, check: SubmissionCheck, workspace: Workspace) -> str:
    """What the check says, the worst first."""
    dataset = f"{workspace.dataset.name}/{workspace.dataset.split}"
    rows = "" if check.results is None else f": {len(check.results):,} estimates for {dataset}"
    parts = [f'<div class="pi-checked"></div>{html.heading(f"{name}{rows}")}']
    found = [*check.errors, *check.warnings]
    if not found:
        parts.append(html.finding("ok", "Fine", "", "columns, ids, targets and times are as they must be", ""))
    for finding in found[:_FINDINGS_SHOWN]:
        parts.append(html.finding(finding.severity, finding.kind, "", finding.text, ""))
    if len(found) > _FINDINGS_SHOWN:
        parts.append(html.paragraph(f"and {len(found) - _FINDINGS_SHOWN} more kinds of faults", dim=True))
    return html.block(*parts)
