"""Worker processes on this machine, each with one item at a time, so it is known what a process that dies was at."""

import logging
import os
import pickle
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import wait
from typing import Any

from pipeline.exceptions import InputError
from pipeline.parallel.outcome import Outcome, Success
from pipeline.parallel.process import WorkerProcess
from pipeline.parallel.workers import Function, Item, Result, Shared

log = logging.getLogger(__name__)

MAX_LOSSES = 3
"""An item that has ended so many processes is not tried again, nor are processes that end as they start."""


@dataclass(eq=False)
class _Job:
    index: int
    item: Any
    losses: int = 0


class _Jobs:
    """What is to be done, taken from the items only when needed."""

    def __init__(self, items: Iterable[Any]) -> None:
        self._new = (_Job(index, item) for index, item in enumerate(items))
        self._again: deque[_Job] = deque()

    def next(self) -> _Job | None:
        """What to do next; None if there is nothing, for now."""
        return self._again.popleft() if self._again else next(self._new, None)

    def put_back(self, job: _Job) -> None:
        """Have a job done again."""
        self._again.append(job)


class LocalWorkers:
    """Up to `count` processes, started when there is something to do and kept until `close`; see `Workers`."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._threads = max(1, len(os.sched_getaffinity(0)) // count)
        self._idle: list[WorkerProcess] = []
        self._busy: dict[WorkerProcess, _Job] = {}
        self._failed_starts = 0

    def map_unordered(
        self,
        function: Function[Shared, Item, Result],
        items: Iterable[Item],
        shared: Shared,
        *,
        total: int | None = None,
        describe: Callable[[Item], str] = str,
        on_lost: Callable[[Item, InputError], Result] | None = None,
    ) -> Generator[tuple[int, Result], None, None]:
        """See `Workers`."""
        task = pickle.dumps((function, shared), pickle.HIGHEST_PROTOCOL)
        jobs = _Jobs(items)
        self._end_busy()  # with what an earlier caller left without a word
        try:
            self._hand_out(jobs, task)
            while self._busy:
                news = list(self._news(jobs, describe))
                self._hand_out(jobs, task)  # nobody waits while the caller looks at what came
                for job, outcome in news:
                    if isinstance(outcome, InputError):  # lost for good
                        if on_lost is None:
                            raise outcome
                        outcome = Success(on_lost(job.item, outcome))
                    yield job.index, outcome.result()
        finally:
            self._end_busy()

    def close(self) -> None:
        """End all processes."""
        self._end_busy()
        _end(self._idle)
        self._idle.clear()

    def _end_busy(self) -> None:
        """End processes that are at something."""
        _end(self._busy)
        self._busy.clear()

    def _hand_out(self, jobs: "_Jobs", task: bytes) -> None:
        """Give every process something to do, as long as there is anything."""
        while len(self._busy) < self._count and (job := jobs.next()):
            process = self._idle.pop() if self._idle else WorkerProcess(self._threads)
            self._busy[process] = job
            process.give(task, pickle.dumps(job.item, pickle.HIGHEST_PROTOCOL))

    def _news(self, jobs: "_Jobs", describe: Callable[[Any], str]) -> Iterator[tuple[_Job, Outcome | InputError]]:
        """Wait for answers and losses; a job that is lost is put back, unless it was so too often."""
        by_connection = {process.connection: process for process in self._busy}
        for connection in wait(list(by_connection)):
            process = by_connection[connection]  # type: ignore[index]: a connection that was given
            try:
                outcome = process.take()
            except OSError:
                job = self._busy.pop(process)
                if (error := self._lost(process, job, describe)) is None:
                    jobs.put_back(job)
                else:
                    yield job, error
                continue
            if outcome is not None:
                self._idle.append(process)
                yield self._busy.pop(process), outcome

    def _lost(self, process: WorkerProcess, job: _Job, describe: Callable[[Any], str]) -> InputError | None:
        """Clear up after a process that is gone; the error to report if its job is to be given up."""
        how = process.end()
        if not process.ready:
            self._failed_starts += 1
            if self._failed_starts < MAX_LOSSES:
                return None
            raise InputError(f"worker processes end as they start ({how}); see what {sys.executable} says of it")
        job.losses += 1
        text = f"{describe(job.item)}: its worker process ended ({how})"
        if job.losses < MAX_LOSSES:
            log.warning("%s; it is done again", text)
            return None
        return InputError(f"{text}, {job.losses} times; if memory is short, take fewer workers, or leave it out")


def _end(processes: Iterable[WorkerProcess]) -> None:
    """End processes, all at the same time."""
    processes = list(processes)
    for process in processes:
        process.stop()
    for process in processes:
        process.end()
