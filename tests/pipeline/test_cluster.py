"""Workers of a real Dask scheduler in other processes: the same results, also when one of them is killed."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_dataset import ANNOTATED, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of
from worker_functions import fail, process_of, slow_columns, square, threads

from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.columns import Execution
from pipeline.bop.evaluation.evaluate import evaluate
from pipeline.bop.results import read_results
from pipeline.exceptions import InputError, UnknownIdError
from pipeline.parallel import Workers, cluster, open_workers
from pipeline.parallel.cluster import ClusterWorkers
from pipeline.recording import RecordingReader
from pipeline.replay import Replay
from pipeline.run import Run
from pipeline.running import run_estimator

pytest.importorskip("distributed", reason="the extra `distributed` is not installed")
REPOSITORY = Path(__file__).resolve().parents[2]
DEMO = REPOSITORY / "assets" / "demo"


class Cluster:
    """A scheduler and its workers, each a process of its own."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._processes = folder, []
        self.workers: list[subprocess.Popen] = []
        file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--port", "0", "--scheduler-file", str(file))
        until(lambda: file.exists() and file.read_text().endswith("}"))
        self.address: str = json.loads(file.read_text())["address"]

    def add_worker(self) -> None:
        """Start a worker without a nanny, which nobody starts again."""
        options = ("--nthreads", "1", "--no-nanny", "--local-directory", str(self._folder))
        self.workers.append(self._start("worker", self.address, *options))

    def kill_worker(self) -> None:
        """Kill a worker as the system does when memory is short."""
        self.workers.pop().send_signal(signal.SIGKILL)

    def end(self) -> None:
        for process in self._processes:
            process.kill()
            process.wait()

    def _start(self, kind: str, *arguments: str) -> subprocess.Popen:
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", "--host", "127.0.0.1", "--no-dashboard"]
        environment = os.environ | {"PYTHONPATH": f"{REPOSITORY}:{REPOSITORY / 'tests'}"}
        with (self._folder / f"{kind}.log").open("ab") as log:
            process = subprocess.Popen([*command, *arguments], env=environment, stdout=log, stderr=log)
        self._processes.append(process)
        return process


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler, at first without workers."""
    made = Cluster(tmp_path_factory.mktemp("dask"))
    yield made
    made.end()


@pytest.fixture
def two(started: Cluster) -> Iterator[Workers]:
    """Two Dask workers; those that were killed are started again."""
    while len(started.workers) < 2:
        started.add_worker()
    with open_workers(scheduler=started.address) as workers:
        workers._client.wait_for_workers(2, timeout=60)  # type: ignore[attr-defined]
        yield workers


# ---- connecting


def test_a_scheduler_without_workers_is_told(started: Cluster, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cluster, "WORKERS_SECONDS", 0.2)
    with pytest.raises(InputError, match=f"^{started.address}: has no workers; start some"), _at(started.address):
        pass


def test_a_scheduler_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 1.0)
    with pytest.raises(InputError, match=r"^tcp://127.0.0.1:9: no Dask scheduler answers within 1 s; start one"):
        _at("tcp://127.0.0.1:9").__enter__()
    with pytest.raises(InputError, match=r"^next door: is no address of a scheduler .*; such is tcp://10.0.0.1:8786$"):
        _at("next door").__enter__()


def test_where_dask_is_absent_it_is_told_how_to_get_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"^--scheduler needs Dask, .*pip install 'pose-inspector\[distributed\]'$"):
        _at("tcp://127.0.0.1:9").__enter__()


def _at(address: str) -> Any:
    return open_workers(scheduler=address)


def test_workers_with_another_program_are_told(
    two: Workers, started: Cluster, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    monkeypatch.setattr(cluster, "program", os.getpid)  # another one everywhere
    with _at(started.address):
        told = [record.message for record in caplog.records]
    assert len(told) == 1
    assert f"2 of 2 Dask workers run another program ({started.workers[0].pid}" in told[0].replace(
        str(started.workers[1].pid), str(started.workers[0].pid)
    )
    assert told[0].endswith(f"here: {os.getpid()}); the numbers may differ")


def test_workers_without_the_program_are_told():
    class Bare:
        def wait_for_workers(self, count: int, timeout: float) -> None: ...

        def run(self, function: Callable) -> None:
            raise ModuleNotFoundError("No module named 'pipeline'")

    with pytest.raises(InputError, match=r"a Dask worker cannot import this program \(No module named 'pipeline'\)"):
        cluster._check_workers(Bare(), "tcp://127.0.0.1:1")


# ---- working


def test_results_are_those_of_this_process(two: Workers):
    assert dict(two.map_unordered(square, range(50), 3)) == {item: 3 + item * item for item in range(50)}
    processes: set[int] = set()
    for _ in range(20):  # on a busy machine one worker may have done all before the other one wakes up
        processes |= {process for _, process in two.map_unordered(process_of, [0.1] * 10, None)}
        if len(processes) == 2:
            break
    assert len(processes) == 2
    assert os.getpid() not in processes


def test_errors_arrive_as_they_are(two: Workers):
    with pytest.raises(UnknownIdError, match=r"^object 31 is not in lmo; available: 1, 5$"):
        list(two.map_unordered(fail, range(10), "unknown"))
    with pytest.raises(RuntimeError, match=r"^ForeignError: it is foreign$"):
        list(two.map_unordered(fail, range(10), "foreign"))


def test_open3d_uses_one_thread(two: Workers):
    ((_, (after_one, allowed)),) = two.map_unordered(threads, [0], None)
    assert allowed == len(os.sched_getaffinity(0))
    assert after_one < 4 + allowed  # the worker's own


def test_evaluation_is_the_same_to_the_last_bit_with_a_worker_killed(two: Workers, started: Cluster, tmp_path: Path):
    dataset = open_dataset(DEMO)
    results = read_results(DEMO / "results" / "perturbed-1_demo-test.csv")
    shares: list[float] = []

    def progress(share: float) -> None:
        shares.append(share)
        if len(shares) == 2:
            started.kill_worker()

    compute = partial(slow_columns, seconds=0.2, folder=tmp_path)
    targets = dataset.targets()
    expected = Execution().columns(compute, dataset, results, targets, lambda _: None)
    found = Execution(two).columns(compute, dataset, results, targets, progress)
    assert len(shares) >= 5
    assert len(started.workers) == 1
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


def test_scores_with_vsd_are_the_same_to_the_last_digit(two: Workers, tmp_path: Path):
    dataset = open_dataset(make_dataset(tmp_path / "tiny"))
    found = [
        claim(FIRST, 1, moved(ANNOTATED[FIRST][0][1], z=0.004)),
        claim(SECOND, 1, moved(ANNOTATED[SECOND][0][1], x=0.004)),
    ]
    here = evaluate(dataset, results_of(*found))
    there = evaluate(dataset, results_of(*found), execution=Execution(two))
    assert there.scores == here.scores
    assert here.scores.vsd not in (0.0, 1.0, None)


def test_an_estimator_is_run_by_the_cluster(two: Workers, tmp_path: Path):
    dataset = open_dataset(make_dataset(tmp_path / "tiny"))
    submitted = perfect()
    with Run.create(tmp_path / "run", dataset=dataset, method="replay") as run:
        assert run_estimator(Replay(dataset, submitted), dataset, run, workers=two) == 0
        assert set(run.finished_images()) == {FIRST, SECOND}
    read = read_results(run.results_path)
    for key in (FIRST, SECOND):
        np.testing.assert_array_equal(read.rotation[read.rows(key)], submitted.rotation[submitted.rows(key)])
        assert RecordingReader.open(run.recording_path(key)).verified


# ---- what goes wrong


class Killing:
    """A client of a scheduler that gives every task up, as its workers end again and again."""

    def submit(self, function: Callable, *arguments: Any, key: str) -> "Killing":
        self.status = "error"
        return self

    def add_done_callback(self, tell: Callable[[Any], None]) -> None:
        tell(self)

    def result(self) -> Any:
        from distributed import KilledWorker

        raise KilledWorker("item", None, 3)

    def nthreads(self) -> dict[str, int]:
        return {"tcp://127.0.0.1:1": 1}

    def cancel(self, futures: list, force: bool) -> None:
        assert force


def test_an_item_that_always_kills_its_worker_is_named():
    workers = ClusterWorkers(Killing(), "tcp://127.0.0.1:1")
    with pytest.raises(InputError, match=r"^item 7: its Dask workers ended again and again; see their logs"):
        list(workers.map_unordered(square, [7], 0, describe=lambda item: f"item {item}"))
    assert list(workers.map_unordered(square, [7], 0, on_lost=lambda item, error: -item)) == [(0, -7)]


def test_a_scheduler_that_goes_away_is_told(two: Workers, started: Cluster):
    results = two.map_unordered(process_of, [0.05] * 100, None)
    next(results)
    started.scheduler.kill()
    with pytest.raises(InputError, match=f"^{started.address}: the Dask scheduler is gone"):
        list(results)
