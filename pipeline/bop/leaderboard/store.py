"""The leaderboard's store: results files that were handed in, their evaluations, and the table of both.

A folder holds `leaderboard.sqlite` and the files as `files/<sha256>.csv`. Any number of threads and processes may use
it at once, and what a method has returned from is kept whatever happens after.
"""

import contextlib
import json
import os
import sqlite3
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pipeline.bop.evaluation.evaluate import Evaluation
from pipeline.bop.evaluation.summary import time_per_image
from pipeline.bop.leaderboard.database import Database
from pipeline.bop.leaderboard.files import KeptFiles, LockedFile, results_of
from pipeline.bop.leaderboard.records import (
    Added,
    KeptEvaluation,
    Submission,
    about_as_text,
    checked_description,
    checked_method,
    checked_properties,
    evaluation_of,
    now,
    packed,
    submission_of,
    summary_of,
)
from pipeline.bop.leaderboard.table import Board, make_board
from pipeline.bop.results import Results, read_results
from pipeline.exceptions import InputError, UnknownIdError

EVALUATION_VERSION = 1
"""To be raised when the evaluation gives other numbers for the same data; older evaluations do not count then."""

LOCALIZATION = "localization"
"""The task of 6D localization, as in the BOP Challenge since 2019."""

_SUMMARY = (
    "submission_id, fingerprint, task, with_vsd, vsd, mssd, mspd, per_object, targets, why_no_vsd, seconds, added"
)


def default_folder() -> Path:
    """Where the leaderboard lies: in the user's data folder, or in the folder that INSPECTOR_DATA names."""
    given = os.environ.get("INSPECTOR_DATA")
    if given:
        return Path(given).expanduser() / "leaderboard"
    from platformdirs import user_data_path

    return user_data_path("inspector") / "leaderboard"


class Leaderboard:
    """Submissions and evaluations in a folder, which is made when something is first kept.

    Every method may be used from any thread, and raises InputError with one line if the folder cannot be read or
    written, the database is damaged or of a newer version; nothing is changed then.
    """

    def __init__(self, folder: Path) -> None:
        """Open the leaderboard of a folder; one that does not exist yet is empty."""
        self.folder = Path(folder).absolute()
        self._database = Database(self.folder)
        self._files = KeptFiles(self.folder / "files")

    def add(
        self,
        content: bytes | Path,
        *,
        method: str,
        dataset_name: str,
        split: str,
        file_name: str = "",
        description: str = "",
        properties: Mapping[str, str] | None = None,
    ) -> Added:
        """Keep a results file, given as its bytes or its path.

        The same bytes for the same dataset, split and method are kept once: see `Added`. Whether the estimates fit
        the dataset is not looked at here.

        Args:
            content: The file.
            method: Its name on the leaderboard.
            dataset_name: Name of the dataset's folder, such as `lmo`.
            split: Name of the split's folder, `Dataset.split`.
            file_name: What the user calls the file; of a path its own name is taken.
            description: Any text.
            properties: Any names and values, such as `{"GPU": "none"}`.

        Raises:
            FormatError: it is no results file; line and column are named.
            MissingFileError: it cannot be read.
            InputError: a text cannot be kept, or the file cannot.

        """
        values = {
            "method": checked_method(method),
            "dataset_name": dataset_name.lower(),
            "split": split,
            "description": checked_description(description),
            "properties": checked_properties(properties or {}),
            "file_name": _base_name(file_name or (content.name if isinstance(content, Path) else "")),
            "added": now(),
        }
        with self._database.writing():
            staged = self._files.stage()
        try:
            sha256 = self._files.fill(staged, content)
            results = results_of(staged, str(content) if isinstance(content, Path) else values["file_name"])
            counts = {"sha256": sha256, "rows": len(results), "time_per_image": time_per_image(results)}
            return self._add(staged, values | counts)
        finally:
            staged.close()

    def _add(self, staged: LockedFile, values: Mapping[str, Any]) -> Added:
        sql = "SELECT * FROM submissions WHERE sha256 = ? AND dataset_name = ? AND split = ? AND method = ?"
        same = [values[column] for column in ("sha256", "dataset_name", "split", "method")]
        try:
            with self._database.writing() as connection:
                earlier = connection.execute(sql, same).fetchone()
                number = earlier["id"] if earlier is not None else _insert(connection, "submissions", values)
                self._files.keep(staged, values["sha256"])
                return Added(self._submission(_one(connection, number)), is_new=earlier is None)
        except BaseException:
            with contextlib.suppress(InputError):
                self._drop_unused(values["sha256"])
            raise

    def edit(
        self,
        submission_id: int,
        *,
        method: str | None = None,
        description: str | None = None,
        properties: Mapping[str, str] | None = None,
    ) -> Submission:
        """Change what is said of a submission; None leaves a thing as it is, properties are replaced as a whole.

        Raises UnknownIdError if there is no such submission, InputError if a text cannot be kept or the method has
        handed in the same file already.
        """
        changes: dict[str, str] = {}
        if method is not None:
            changes["method"] = checked_method(method)
        if description is not None:
            changes["description"] = checked_description(description)
        if properties is not None:
            changes["properties"] = checked_properties(properties)
        with self._database.writing() as connection:
            _one(connection, submission_id)
            for column, value in changes.items():
                try:
                    connection.execute(f"UPDATE submissions SET {column} = ? WHERE id = ?", (value, submission_id))
                except sqlite3.IntegrityError as error:
                    text = "has the same file for this dataset already; remove one of the two, or give another name"
                    raise InputError(f"method {value}: {text}") from error
            return self._submission(_one(connection, submission_id))

    def remove(self, submission_id: int) -> None:
        """Remove a submission with its evaluations, and its file if no other submission is of it.

        Raises UnknownIdError if there is no such submission.
        """
        with self._database.writing() as connection:
            sha256 = _one(connection, submission_id)["sha256"]
            connection.execute("DELETE FROM submissions WHERE id = ?", (submission_id,))
        self._drop_unused(sha256)  # only now: a file without a submission harms nothing, the other way round it would

    def submissions(self, dataset_name: str | None = None) -> tuple[Submission, ...]:
        """All submissions, or those for a dataset, newest first."""
        with self._database.reading() as connection:
            rows = connection.execute("SELECT * FROM submissions ORDER BY id DESC").fetchall()
            found = tuple(map(self._submission, rows))
        return tuple(s for s in found if dataset_name is None or s.dataset_name == dataset_name.lower())

    def submission(self, submission_id: int) -> Submission:
        """One submission. Raises UnknownIdError if there is none of that id."""
        with self._database.reading() as connection:
            return self._submission(_one(connection, submission_id))

    def results(self, submission_id: int) -> Results:
        """The estimates of a submission under the name of its method.

        Raises UnknownIdError if there is no such submission, MissingFileError if its file is gone, FormatError if it
        is not the file any more that was handed in.
        """
        submission = self.submission(submission_id)
        results = read_results(self._files.check(submission.sha256))
        about = {"method": submission.method, "dataset_name": submission.dataset_name, "split": submission.split}
        return replace(results, **about)

    def keep(
        self,
        submission_id: int,
        evaluation: Evaluation,
        fingerprint: str,
        *,
        task: str = LOCALIZATION,
        with_vsd: bool = True,
    ) -> None:
        """Keep an evaluation of a submission in place of an earlier one of the same kind on the same data.

        Args:
            submission_id: What was evaluated.
            evaluation: What came out.
            fingerprint: Of the dataset, from `evaluation.fingerprint`.
            task: What was asked of the method.
            with_vsd: Whether VSD was asked for.

        Raises:
            UnknownIdError: There is no such submission (any more).

        """
        scores = evaluation.scores
        values = {
            "submission_id": submission_id,
            "fingerprint": fingerprint,
            "task": task,
            "with_vsd": with_vsd,
            "version": EVALUATION_VERSION,
            **scores._asdict(),
            "per_object": json.dumps(evaluation.per_object),
            "targets": len(evaluation.instances),
            "why_no_vsd": evaluation.why_no_vsd,
            "seconds": evaluation.seconds,
            "added": now(),
            "about": about_as_text(evaluation),
            "instances": packed(evaluation.instances),
        }
        with self._database.writing() as connection:
            of = _one(connection, submission_id)["dataset_name"]
            if of != evaluation.dataset.lower():
                raise ValueError(f"an evaluation on {evaluation.dataset} was given for a submission for {of}")
            _insert(connection, "evaluations", values)

    def evaluation(self, submission_id: int, fingerprint: str, *, task: str = LOCALIZATION) -> Evaluation | None:
        """The evaluation of a submission on that very data with all arrays, or None; with VSD rather than without.

        It equals the one that was kept, but for a method that has been renamed since.
        """
        sql = (
            "SELECT e.about, s.method, e.instances FROM evaluations AS e"
            " JOIN submissions AS s ON s.id = e.submission_id"
            " WHERE s.id = ? AND fingerprint = ? AND task = ? AND version = ?"
            " ORDER BY vsd IS NULL, with_vsd DESC LIMIT 1"
        )
        with self._database.reading() as connection:
            row = connection.execute(sql, (submission_id, fingerprint, task, EVALUATION_VERSION)).fetchone()
            return None if row is None else evaluation_of(row)

    def evaluations(self, submission_id: int | None = None, *, task: str | None = None) -> tuple[KeptEvaluation, ...]:
        """The numbers of all evaluations (of one submission, of one task) that count, oldest first; quick."""
        sql = f"SELECT {_SUMMARY} FROM evaluations WHERE version = ? ORDER BY id"
        with self._database.reading() as connection:
            found = [summary_of(row) for row in connection.execute(sql, (EVALUATION_VERSION,))]
        return tuple(e for e in found if submission_id in (None, e.submission_id) and task in (None, e.task))

    def board(self, task: str = LOCALIZATION) -> Board:
        """The table of all methods that have a submission, evaluated or not; quick."""
        return make_board(self.submissions(), self.evaluations(task=task))

    def _submission(self, row: sqlite3.Row) -> Submission:
        return submission_of(row, self._files.path(row["sha256"]))

    def _drop_unused(self, sha256: str) -> None:
        """Remove a file that no submission is of."""
        with self._database.writing() as connection:
            if connection.execute("SELECT 1 FROM submissions WHERE sha256 = ?", (sha256,)).fetchone() is None:
                self._files.discard(sha256)


def _one(connection: sqlite3.Connection, submission_id: int) -> sqlite3.Row:
    row = connection.execute("SELECT * FROM submissions WHERE id = ?", (submission_id,)).fetchone()
    if row is None:
        known = [number for (number,) in connection.execute("SELECT id FROM submissions")]
        raise UnknownIdError("submission", submission_id, "the leaderboard", known)
    return row


def _insert(connection: sqlite3.Connection, table: str, values: Mapping[str, object]) -> int:
    """Insert a row in place of one that is the same in all that must be unique; returns its id."""
    marks = ", ".join("?" * len(values))
    sql = f"INSERT OR REPLACE INTO {table} ({', '.join(values)}) VALUES ({marks})"
    number = connection.execute(sql, tuple(values.values())).lastrowid
    assert number is not None
    return number


def _base_name(file_name: str) -> str:
    """The name of a file without folders, which browsers on Windows may send too, and without what cannot be shown."""
    name = file_name.replace("\\", "/").rpartition("/")[2]
    return "".join(c for c in name if c.isprintable())[:200] or "results.csv"
