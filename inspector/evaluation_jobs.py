"""The jobs of an evaluation queue: how each stands, and how it may change."""

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from pipeline.bop.leaderboard.jobs import StoredJob

State = Literal["waiting", "running", "done", "failed", "cancelled"]


@dataclass(frozen=True)
class Job:
    """How an evaluation stands; a new one is made with every change."""

    id: int
    """Unique among all jobs of the leaderboard, ever."""
    submission_id: int
    root: Path
    """Folder of the dataset."""
    split: str
    sensor: str | None
    with_vsd: bool
    again: bool
    """Whether to evaluate even what has been evaluated on that very data."""
    state: State
    progress: float = 0.0
    """The finished share, 0..1."""
    seconds_left: float | None = None
    """An estimate; None as long as it cannot be told."""
    reason: str = ""
    """One line why it failed or was cancelled; else empty."""

    @property
    def is_open(self) -> bool:
        """Whether it is still to come to an end."""
        return self.state in ("waiting", "running")


class EndedError(Exception):
    """Ends an evaluation that is not wanted any more."""


def job_of(stored: StoredJob) -> Job:
    """A job as it was written down: failed or still to be done."""
    return Job(
        id=stored.id,
        submission_id=stored.submission_id,
        root=stored.root,
        split=stored.split,
        sensor=stored.sensor,
        with_vsd=stored.with_vsd,
        again=stored.again,
        state="failed" if stored.failure else "waiting",
        reason=stored.failure,
    )


class JobList:
    """Jobs by id, for any number of threads and one worker."""

    def __init__(self, announce: Callable[[], None]) -> None:
        """Call `announce`, which must return at once, after every change."""
        self._jobs: dict[int, Job] = {}
        self._begun: dict[int, float] = {}
        self._condition = threading.Condition()
        self._announce = announce
        self.is_stopped = False

    def add(self, jobs: Iterable[Job]) -> None:
        """Add jobs."""
        with self._condition:
            self._jobs.update((job.id, job) for job in jobs)
            self._changed()

    def all(self) -> tuple[Job, ...]:
        """All jobs, oldest first."""
        with self._condition:
            return tuple(self._jobs[number] for number in sorted(self._jobs))

    def get(self, job_id: int) -> Job | None:
        """One job; None if there is none (any more)."""
        with self._condition:
            return self._jobs.get(job_id)

    def take(self) -> Job | None:
        """Wait for the oldest job that waits, which runs from then on; None when the list is stopped."""
        with self._condition:
            self._condition.wait_for(lambda: self.is_stopped or self._waiting())
            if self.is_stopped:
                return None
            job = self._waiting()[0]
            self._begun[job.id] = time.monotonic()
            self._jobs[job.id] = replace(job, state="running")
            self._changed()
            return self._jobs[job.id]

    def progress(self, job_id: int, share: float) -> None:
        """Note the finished share of a running job. Raises EndedError if it is not wanted any more."""
        with self._condition:
            job = self._jobs.get(job_id)
            if self.is_stopped or job is None or not job.is_open:
                raise EndedError
            spent = time.monotonic() - self._begun[job_id]
            left = spent * (1 - share) / share if share > 0 else None
            self._jobs[job_id] = replace(job, progress=share, seconds_left=left)
            self._changed()

    def end(self, job_id: int, state: State, reason: str = "") -> bool:
        """Bring an open job to its end; False if there is none."""
        with self._condition:
            job = self._jobs.get(job_id)
            if job is None or not job.is_open:
                return False
            share = 1.0 if state == "done" else job.progress
            self._begun.pop(job_id, None)
            self._jobs[job_id] = replace(job, state=state, progress=share, seconds_left=None, reason=reason)
            self._changed()
            return True

    def drop(self, job_id: int) -> bool:
        """Forget a job that has come to its end; False if there is none."""
        with self._condition:
            job = self._jobs.get(job_id)
            if job is None or job.is_open:
                return False
            del self._jobs[job_id]
            self._changed()
            return True

    def stop(self) -> None:
        """Let no job begin any more, and the running one end where it is; all stay as they are."""
        with self._condition:
            self.is_stopped = True
            self._condition.notify_all()

    @property
    def is_idle(self) -> bool:
        """Whether no job waits or runs."""
        with self._condition:
            return not any(job.is_open for job in self._jobs.values())

    def wait_idle(self, timeout: float) -> bool:
        """Wait until no job waits or runs; False if that takes longer than `timeout` seconds."""
        with self._condition:
            return self._condition.wait_for(lambda: self.is_idle, timeout)

    def _waiting(self) -> list[Job]:
        return sorted((job for job in self._jobs.values() if job.state == "waiting"), key=lambda job: job.id)

    def _changed(self) -> None:
        self._condition.notify_all()
        self._announce()
