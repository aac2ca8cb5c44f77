"""Evaluations that are still to be done, kept beside the leaderboard so that they outlive the process."""

import os
import sqlite3
import uuid
from dataclasses import dataclass
from pathlib import Path

from pipeline.bop.leaderboard.database import Database
from pipeline.bop.leaderboard.files import LockedFile, remove_abandoned
from pipeline.exceptions import InputError, UnknownIdError

MOST_ATTEMPTS = 3
"""How often a job is begun by processes that do not live to see its end."""


@dataclass(frozen=True)
class StoredJob:
    """An evaluation that was asked for."""

    id: int
    submission_id: int
    root: Path
    """Folder of the dataset."""
    split: str
    sensor: str | None
    """As given to `open_dataset`."""
    with_vsd: bool
    again: bool
    """Whether to evaluate even what has been evaluated on that very data."""
    failure: str
    """Why it failed; empty as long as it is to be done."""


class JobStore:
    """The jobs of one worker, and those that dead workers have left; any thread may use it.

    A worker holds a locked file as long as its process lives, so others know its jobs from those of a dead one.
    """

    def __init__(self, folder: Path) -> None:
        """Use the database in the leaderboard's folder; raises as `Leaderboard` does, and so do all methods."""
        self._folder = Path(folder).absolute()
        self._database = Database(self._folder)
        self._lock: LockedFile | None = None

    def add(
        self, submission_id: int, root: Path, split: str, sensor: str | None, *, with_vsd: bool, again: bool
    ) -> StoredJob:
        """Keep a job. Raises UnknownIdError if there is no such submission."""
        where = (submission_id, os.fsencode(root.absolute()), split, sensor)
        sql = (
            "INSERT INTO jobs (submission_id, root, split, sensor, with_vsd, again, begun, failure, worker)"
            " VALUES (?, ?, ?, ?, ?, ?, 0, '', ?)"
        )
        with self._database.writing() as connection:
            try:
                number = connection.execute(sql, (*where, with_vsd, again, self._claim())).lastrowid
            except sqlite3.IntegrityError as error:
                known = [number for (number,) in connection.execute("SELECT id FROM submissions")]
                raise UnknownIdError("submission", submission_id, "the leaderboard", known) from error
            return _job(connection.execute("SELECT * FROM jobs WHERE id = ?", (number,)).fetchone())

    def begin(self, job_id: int) -> None:
        """Note that a job is begun, so that one which takes the process down is not begun for ever."""
        self._change("UPDATE jobs SET begun = begun + 1 WHERE id = ?", job_id)

    def put_back(self, job_id: int) -> None:
        """Note that a job was left in good order, to be done later."""
        self._change("UPDATE jobs SET begun = 0 WHERE id = ?", job_id)

    def fail(self, job_id: int, failure: str) -> None:
        """Note why a job failed; it stays until it is removed."""
        self._change("UPDATE jobs SET failure = ? WHERE id = ?", failure, job_id)

    def remove(self, job_id: int) -> None:
        """Forget a job that is done or not wanted any more."""
        self._change("DELETE FROM jobs WHERE id = ?", job_id)

    def adopt(self) -> tuple[StoredJob, ...]:
        """Take over the jobs of workers that are no more, oldest first, failed ones too."""
        with self._database.reading() as connection:
            if connection.execute("SELECT 1 FROM jobs").fetchone() is None:
                return ()
        with self._database.writing() as connection:
            own = self._claim()
            alive = [path.stem for path in self._workers.glob("*.lock")]
            marks = ", ".join("?" * len(alive))
            orphans = connection.execute(f"SELECT * FROM jobs WHERE worker NOT IN ({marks}) ORDER BY id", alive)
            found = [_job(row) for row in orphans.fetchall()]
            connection.executemany("UPDATE jobs SET worker = ? WHERE id = ?", [(own, job.id) for job in found])
        return tuple(found)

    def release(self) -> None:
        """Leave the jobs that are still there to others."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    @property
    def _workers(self) -> Path:
        return self._folder / "workers"

    def _claim(self) -> str:
        """The name of this worker, which lives from now on; whoever calls holds the database's lock."""
        remove_abandoned(self._workers, "*.lock")
        if self._lock is None:
            try:
                self._lock = LockedFile(self._workers / f"{uuid.uuid4().hex}.lock")
            except OSError as error:
                text = f"cannot be written ({error.strerror}); make it writable, or set INSPECTOR_DATA"
                raise InputError(f"{self._workers}: {text}") from error
        return self._lock.path.stem

    def _change(self, sql: str, *values: object) -> None:
        with self._database.writing() as connection:
            connection.execute(sql, values)


def _job(row: sqlite3.Row) -> StoredJob:
    exhausted = f"the program ended {row['begun']} times while it was evaluated; free memory and try again"
    return StoredJob(
        id=row["id"],
        submission_id=row["submission_id"],
        root=Path(os.fsdecode(row["root"])),
        split=row["split"],
        sensor=row["sensor"],
        with_vsd=bool(row["with_vsd"]),
        again=bool(row["again"]),
        failure=row["failure"] or (exhausted if row["begun"] >= MOST_ATTEMPTS else ""),
    )
