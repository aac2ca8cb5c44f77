"""Workers: the same results wherever they come from, nothing lost with a process, nothing left behind."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import count
from pathlib import Path

import pytest
from worker_functions import (
    die,
    die_once,
    fail,
    process_of,
    remember,
    square,
    threads,
    unfit_to_send,
    wait_for_ever,
)

from pipeline.exceptions import InputError, UnknownIdError
from pipeline.parallel import HERE, Workers, open_workers
from pipeline.parallel.outcome import RemoteTracebackError
from pipeline.parallel.workers import AsItPays, pays

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def two() -> Iterator[Workers]:
    """Two processes; those that a test ends are started again."""
    with open_workers(2) as workers:
        yield workers


def until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


def children() -> set[int]:
    """Processes that this one has started and that are not gone yet."""
    tasks = Path(f"/proc/{os.getpid()}/task").iterdir()
    return {int(child) for task in tasks for child in (task / "children").read_text().split()}


# ---- results


def test_results_come_with_the_position_of_their_item(two: Workers):
    expected = {item: 3 + item * item for item in range(500)}
    assert dict(two.map_unordered(square, range(500), 3)) == expected
    assert dict(HERE.map_unordered(square, range(500), 3)) == expected
    assert list(two.map_unordered(square, [], 3)) == []


def test_items_are_taken_when_they_are_needed(two: Workers):
    taken: list[int] = []
    items = (taken.append(i) or i for i in count())
    with closing(two.map_unordered(square, items, 0)) as results:
        for seen, _ in enumerate(results, start=1):
            assert len(taken) <= seen + 4
            if seen == 100:
                break


def test_what_is_shared_is_sent_to_a_worker_once(two: Workers):
    by_process: dict[int, list[int]] = {}
    for _, (process, seen) in two.map_unordered(remember, range(40), []):
        by_process.setdefault(process, []).append(seen)
    assert os.getpid() not in by_process
    assert all(seen == list(range(1, len(seen) + 1)) for seen in by_process.values())
    assert sum(map(len, by_process.values())) == 40


# ---- errors


def test_errors_arrive_as_they_are(two: Workers):
    with pytest.raises(UnknownIdError, match=r"^object 31 is not in lmo; available: 1, 5$") as caught:
        list(two.map_unordered(fail, range(10), "unknown"))
    assert isinstance(caught.value.__cause__, RemoteTracebackError)
    assert "worker_functions.py" in str(caught.value.__cause__)
    with pytest.raises(FileNotFoundError) as missing:
        list(two.map_unordered(fail, range(10), "system"))
    assert (missing.value.errno, missing.value.filename) == (2, "depth.png")
    assert dict(two.map_unordered(square, range(3), 0)) == {0: 0, 1: 1, 2: 4}


def test_errors_and_results_that_cannot_be_sent_are_told(two: Workers):
    with pytest.raises(RuntimeError, match=r"^ForeignError: it is foreign$"):
        list(two.map_unordered(fail, range(10), "foreign"))
    with pytest.raises(Exception, match="pickle"):
        list(two.map_unordered(unfit_to_send, [1], None))


def test_impossible_counts_are_refused():
    with pytest.raises(InputError, match=r"^0 workers; give 1 or more$"), open_workers(0):
        pass


# ---- processes that end


def test_items_of_a_killed_process_are_done_again(two: Workers, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    assert dict(two.map_unordered(die_once, range(12), tmp_path)) == {item: item for item in range(12)}
    told = [record.message for record in caplog.records]
    assert sorted(text.split(":")[0] for text in told) == ["0", "10", "5"]
    assert all("its worker process ended (signal 9, Killed); it is done again" in text for text in told)


def test_an_item_that_always_kills_its_process_is_named(two: Workers):
    with pytest.raises(InputError, match=r"^item 3: its worker process ended \(signal 9, Killed\), 3 times; if memory"):
        list(two.map_unordered(die, range(6), None, describe=lambda item: f"item {item}"))


def test_the_others_are_done_where_lost_items_have_a_result(two: Workers):
    found = dict(two.map_unordered(die, range(6), None, on_lost=lambda item, error: -item))
    assert found == {0: 0, 1: 1, 2: 2, 3: -3, 4: 4, 5: 5}


def test_processes_that_cannot_start_are_told(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with open_workers(2) as workers, pytest.raises(InputError, match=r"end as they start \(exit code 1\)"):
        list(workers.map_unordered(square, range(3), 0))


# ---- an early end


@contextmanager
def interrupted_when(condition: Callable[[], bool]) -> Iterator[None]:
    """Raise KeyboardInterrupt in the block, as Ctrl-C does, once something is so."""

    def interrupt() -> None:
        until(condition)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        yield
    thread.join()


def test_stopping_early_ends_what_is_being_done(tmp_path: Path):
    before = children()
    with open_workers(2) as workers:
        with (
            interrupted_when(lambda: len(list(tmp_path.iterdir())) == 2),
            closing(workers.map_unordered(wait_for_ever, [1, 2, 3], tmp_path)) as results,
        ):
            next(results)
        assert not list(tmp_path.iterdir()), "they clear up after themselves"
        assert children() == before
        assert dict(workers.map_unordered(square, range(3), 0)) == {0: 0, 1: 1, 2: 4}
    assert children() == before


SCRIPT = """
import sys
from pathlib import Path
from pipeline.parallel import open_workers
from worker_functions import wait_for_ever
with open_workers(2) as workers:
    list(workers.map_unordered(wait_for_ever, [1, 2, 3], Path(sys.argv[1])))
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_process_survives_the_one_that_started_it(how: signal.Signals, tmp_path: Path):
    environment = os.environ | {"PYTHONPATH": f"{REPOSITORY}:{REPOSITORY / 'tests'}"}
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, start_new_session=True) as started:
        until(lambda: len(list(tmp_path.iterdir())) == 2)
        workers = [Path("/proc") / path.name for path in tmp_path.iterdir()]
        os.killpg(started.pid, how)  # as Ctrl-C in a terminal does
    until(lambda: not any(worker.exists() for worker in workers))
    assert not list(tmp_path.iterdir()), "they clear up after themselves"


# ---- how many


def test_little_work_is_done_in_this_process():
    with open_workers() as workers:
        assert {process for _, process in workers.map_unordered(process_of, [0.0] * 20, None)} == {os.getpid()}
    with open_workers(1) as workers:
        assert {process for _, process in workers.map_unordered(process_of, [0.0] * 20, None)} == {os.getpid()}


def test_much_work_moves_to_other_processes(two: Workers):
    found = dict(AsItPays(two).map_unordered(process_of, [0.05] * 60, None))
    assert sorted(found) == list(range(60))
    here = [index for index, process in found.items() if process == os.getpid()]
    assert sorted(here) == [0, 1]
    assert len(set(found.values())) == 3


def test_when_other_processes_pay():
    assert not pays([], 1000)
    assert not pays([9.0], 1000), "nobody knows yet what the later ones take"
    assert pays([9.0, 1.0], 1000)
    assert not pays([9.0, 1.0], 18), "each process would need the 9 s, too"
    assert not pays([0.1, 0.001], 500)
    assert pays([0.1, 0.001], 500, earlier=5.0)
    assert not pays([0.1] * 8, None)
    assert pays([0.1] * 30, None)


def test_libraries_in_workers_use_few_threads(two: Workers):
    cores = len(os.sched_getaffinity(0))
    usual = 2 + max(1, cores // 2)  # the worker, the one that looks after its parent, and those of the libraries
    for _, (number, allowed) in two.map_unordered(threads, range(4), None):
        assert number <= usual
        assert allowed == cores
