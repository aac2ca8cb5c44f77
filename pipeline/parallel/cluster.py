"""The workers of a Dask cluster, which read data and program by the paths that these have here."""

import logging
import pickle
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any
from uuid import uuid4

from pipeline.exceptions import InputError
from pipeline.parallel.outcome import Outcome, Success, attempt, packed
from pipeline.parallel.threads import limit_threads
from pipeline.parallel.workers import Function, Item, Result, Shared
from pipeline.program import program

log = logging.getLogger(__name__)

CONNECT_SECONDS = 5.0
"""For the scheduler to answer."""

WORKERS_SECONDS = 15.0
"""For a first worker to come."""

LOOK_SECONDS = 2.0
"""How often it is looked how many workers there are."""

ITEMS_PER_THREAD = 3
"""Items that are with the scheduler for each thread of the workers, so that none has to wait for us."""

MAX_TRIES = 2
"""How often an item is given to the scheduler, which itself gives it to four workers, one after the other."""


@contextmanager
def open_cluster(address: str) -> Iterator["ClusterWorkers"]:
    """Connect to a Dask scheduler until the end of the block; its workers stay.

    Raises InputError if Dask is not installed, no scheduler answers, or there is no worker that has this program.
    """
    client = _connected(address)
    their_log = logging.getLogger("distributed.client")
    level = their_log.level
    their_log.setLevel(logging.CRITICAL)  # it tells of lost workers, which is of no concern to the user
    try:
        _check_workers(client, address)
        yield ClusterWorkers(client, address)
    finally:
        with suppress(Exception):  # the scheduler may be gone
            client.close(timeout=LOOK_SECONDS)
        their_log.setLevel(level)


@dataclass(eq=False)
class _Job:
    index: int
    item: Any
    future: Any = None
    tries: int = 0


class ClusterWorkers:
    """See `Workers`. A worker that is lost is noticed by the scheduler, which gives its items to others."""

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address
        self._threads, self._looked = 1, -LOOK_SECONDS

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
        # A result on which all items depend comes to a worker once, and is made again if those who have it are lost.
        task = self._submit(_load, pickle.dumps((function, shared), pickle.HIGHEST_PROTOCOL))
        new = (_Job(index, item) for index, item in enumerate(items))
        started: set[_Job] = set()
        finished: SimpleQueue[_Job] = SimpleQueue()
        try:
            while True:
                while len(started) < self._room() and (job := next(new, None)):
                    started.add(job)
                    self._start(job, task, finished)
                if not started:
                    return
                job = self._next(finished)
                outcome = self._outcome(job, describe)
                if outcome is None:  # perhaps it was with another item each time that ended the worker
                    self._start(job, task, finished)
                    continue
                started.remove(job)
                if isinstance(outcome, InputError):
                    if on_lost is None:
                        raise outcome
                    outcome = Success(on_lost(job.item, outcome))
                yield job.index, outcome.result()
        finally:
            with suppress(Exception):  # the scheduler may be gone
                self._client.cancel([task, *(job.future for job in started)], force=True)

    def _submit(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return self._client.submit(function, *arguments, key=f"pose-inspector{function.__name__}-{uuid4().hex}")

    def _start(self, job: _Job, task: Any, finished: "SimpleQueue[_Job]") -> None:
        job.future = self._submit(_do, task, pickle.dumps(job.item, pickle.HIGHEST_PROTOCOL))
        job.tries += 1
        job.future.add_done_callback(lambda _: finished.put(job))

    def _room(self) -> int:
        """How many items may be with the scheduler; workers come and go."""
        if time.monotonic() - self._looked > LOOK_SECONDS:
            with suppress(OSError, TimeoutError):
                self._threads = sum(self._client.nthreads().values())
            self._looked = time.monotonic()
        return ITEMS_PER_THREAD * max(self._threads, 1)

    def _next(self, finished: "SimpleQueue[_Job]") -> _Job:
        """Wait for an item."""
        told = False
        while True:
            try:
                return finished.get(timeout=LOOK_SECONDS)
            except Empty:
                self._room()
            if not self._threads and not told:
                log.warning("%s: all Dask workers are gone; waiting for others", self._address)
                told = True

    def _outcome(self, job: _Job, describe: Callable[[Any], str]) -> Outcome | InputError | None:
        """What has become of an item: an error if it was lost for good, None if it is to be tried again."""
        from distributed import KilledWorker

        if job.future.status == "cancelled":
            text = f"{self._address}: the Dask scheduler is gone, or was started anew"
            raise InputError(f"{text}; when it is there, run again to go on")
        try:
            return pickle.loads(job.future.result())
        except KilledWorker:
            if job.tries < MAX_TRIES:
                return None
            text = f"{describe(job.item)}: its Dask workers ended again and again; see their logs"
            return InputError(f"{text}; if memory is short, give them more, or leave it out")


def _connected(address: str) -> Any:
    try:
        from distributed import Client
        from distributed.comm.addressing import parse_address, parse_host_port
    except ImportError as error:
        text = "--scheduler needs Dask, which is not installed here: pip install 'pose-inspector[distributed]'"
        raise InputError(text) from error
    try:
        parse_host_port(parse_address(address)[1])  # a client that is half made would complain at its end
        return Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except ValueError as error:
        raise InputError(f"{address}: is no address of a scheduler ({error}); such is tcp://10.0.0.1:8786") from error
    except OSError as error:
        text = f"no Dask scheduler answers within {CONNECT_SECONDS:.0f} s; start one (dask scheduler) or correct it"
        raise InputError(f"{address}: {text}") from error


def _check_workers(client: Any, address: str) -> None:
    """Wait for a worker, and say so if some have another program than this one."""
    try:
        client.wait_for_workers(1, timeout=WORKERS_SECONDS)
    except TimeoutError as error:
        raise InputError(f"{address}: has no workers; start some (dask worker {address} --nthreads 1)") from error
    try:
        programs = list(client.run(program).values())
    except Exception as error:
        text = f"a Dask worker cannot import this program ({error}); install the same version there"
        raise InputError(f"{address}: {text}") from error
    others = [theirs for theirs in programs if theirs != program()]
    if others:
        text = f"{len(others)} of {len(programs)} Dask workers run another program ({others[0]}; here: {program()})"
        log.warning("%s: %s; the numbers may differ", address, text)


def _load(payload: bytes) -> Outcome:
    """On a worker: what to do, and what all items share."""
    return attempt(lambda: pickle.loads(payload))


def _do(task: Outcome, data: bytes) -> bytes:
    """On a worker: one item, whose outcome is packed."""
    limit_threads(1)

    def call() -> Any:
        function, shared = task.result()
        return function(shared, pickle.loads(data))

    return packed(attempt(call))
