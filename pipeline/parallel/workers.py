"""What workers are, and how many of them it takes."""

import os
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from contextlib import closing, contextmanager
from typing import Any, Protocol, TypeVar, cast, runtime_checkable

from pipeline.exceptions import InputError

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Result = TypeVar("Result")

START_SECONDS = 0.5
"""What it takes until a new process is ready to work."""

Function = Callable[[Shared, Item], Result]
"""What is done with an item; other processes must be able to import it, so no lambda and nothing of `__main__`."""


@runtime_checkable
class Workers(Protocol):
    """Those who do the work; for one thread at a time."""

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
        """Positions and results of all items, as they come; close it, or leave the workers' block, to stop early.

        Args:
            function: Called with `shared` and an item.
            items: As many as you like; only a few are taken before they are needed.
            shared: What all calls need. It is sent to a worker once, which may keep in it what it finds out.
            total: Number of items, where it is known.
            describe: Names an item in messages.
            on_lost: Gives the result of an item that ended its worker process again and again; without it, the
                error is raised.

        Raises:
            InputError: an item ended its worker again and again, or there are no workers.
            Exception: whatever the function raises, as it is; items that wait then are not done.

        """
        ...


class Here:
    """In this process, one item after the other."""

    def map_unordered(
        self, function: Function[Shared, Item, Result], items: Iterable[Item], shared: Shared, **_: Any
    ) -> Generator[tuple[int, Result], None, None]:
        """See `Workers`; here, items come in their order."""
        for index, item in enumerate(items):
            yield index, function(shared, item)


HERE = Here()


class AsItPays:
    """In this process until it is clear that others would be done sooner, starting them included."""

    def __init__(self, others: Workers) -> None:
        """Hold the others, which start nothing before they have something to do."""
        self._others = others
        self._earlier = 0.0
        self._pays = False

    def map_unordered(
        self,
        function: Function[Shared, Item, Result],
        items: Iterable[Item],
        shared: Shared,
        *,
        total: int | None = None,
        **options: Any,
    ) -> Generator[tuple[int, Result], None, None]:
        """See `Workers`."""
        rest, done = iter(items), 0
        for result in self._here(function, rest, shared, len(items) if isinstance(items, Sized) else total):
            yield done, result
            done += 1
        if self._pays:
            with closing(self._others.map_unordered(function, rest, shared, **options)) as results:
                for index, result in results:
                    yield done + index, result

    def _here(
        self, function: Function[Shared, Item, Result], items: Iterator[Item], shared: Shared, total: int | None
    ) -> Iterator[Result]:
        """Results of items that are done here: all, or until it pays not to."""
        spent: list[float] = []
        while not self._pays:
            item = next(items, _NOTHING)
            if item is _NOTHING:
                break
            begun = time.perf_counter()
            result = function(shared, cast(Item, item))
            spent.append(time.perf_counter() - begun)
            yield result
            self._pays = pays(spent, total, self._earlier)
        self._earlier += sum(spent)


_NOTHING = object()


def pays(spent: list[float], total: int | None, earlier: float = 0.0) -> bool:
    """Whether other processes would save more time than it takes to start them.

    Args:
        spent: Seconds by item so far. The first has loaded libraries and files, as every process would have to.
        total: Number of items; where it is unknown, as much is taken to be left as is done.
        earlier: Seconds spent on earlier tasks: as much again is taken to come.

    """
    if len(spent) < 2:
        return False
    first, later = spent[0], spent[1:]
    usual = sum(later) / len(later)
    left = usual * ((2 * len(spent) if total is None else total) - len(spent))
    return (left + earlier) / 2 > START_SECONDS + max(first - usual, 0.0)


@contextmanager
def open_workers(count: int | None = None, scheduler: str | None = None) -> Iterator[Workers]:
    """Workers until the end of the block.

    Args:
        count: Processes on this machine: 1 is this one; None as many as there are cores, once it pays.
        scheduler: Address of a Dask scheduler, such as tcp://10.0.0.1:8786, whose workers are taken instead. They
            need this program and the same files at the same paths.

    Raises:
        InputError: the count is no count, or there is no scheduler with workers at the address.

    """
    if count is not None and count < 1:
        raise InputError(f"{count} workers; give 1 or more")
    if scheduler is not None:
        from pipeline.parallel.cluster import open_cluster

        with open_cluster(scheduler) as cluster:
            yield cluster
        return
    cores = len(os.sched_getaffinity(0))
    if 1 in (count, cores if count is None else 0):
        yield HERE
        return
    from pipeline.parallel.local import LocalWorkers

    with closing(LocalWorkers(count or cores)) as local:
        yield AsItPays(local) if count is None else local
