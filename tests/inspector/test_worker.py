"""The background worker of a browser."""

import logging
import threading

import pytest

from inspector.worker import LatestWins

PATIENCE = 10.0
"""Seconds after which something that should have happened did not."""


@pytest.fixture
def worker():
    worker = LatestWins("test")
    yield worker
    worker.stop()


def test_of_the_jobs_that_wait_only_the_latest_runs(worker: LatestWins):
    begun, go_on, ran = threading.Event(), threading.Event(), []

    def first() -> None:
        begun.set()
        assert go_on.wait(PATIENCE)
        ran.append("first")

    worker.submit(first)
    assert begun.wait(PATIENCE)
    for name in ("second", "third", "fourth"):
        worker.submit(lambda name=name: ran.append(name))
    go_on.set()
    assert worker.wait_idle(PATIENCE)
    assert ran == ["first", "fourth"]


def test_jobs_run_in_one_thread_that_is_not_the_callers(worker: LatestWins):
    seen = set()
    for _ in range(3):
        worker.submit(lambda: seen.add(threading.get_ident()))
        assert worker.wait_idle(PATIENCE)
    assert len(seen) == 1
    assert threading.get_ident() not in seen


def test_an_error_is_told_and_does_not_end_the_worker(caplog: pytest.LogCaptureFixture):
    told: list[Exception] = []
    worker = LatestWins("test", told.append)
    ran = threading.Event()
    with caplog.at_level(logging.CRITICAL, "inspector.worker"):
        worker.submit(lambda: 1 / 0)  # type: ignore[arg-type]
        assert worker.wait_idle(PATIENCE)
        worker.submit(ran.set)
        assert ran.wait(PATIENCE)
    worker.stop()
    assert [type(error) for error in told] == [ZeroDivisionError]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_error_in_telling_of_an_error_does_not_end_the_worker():
    def tell(error: Exception) -> None:
        raise RuntimeError("the browser is gone") from error

    worker = LatestWins("test", tell)
    ran = threading.Event()
    worker.submit(lambda: 1 / 0)  # type: ignore[arg-type]
    worker.wait_idle(1.0)
    worker.submit(ran.set)
    assert ran.wait(2.0)
    worker.stop()


def test_a_stopped_worker_takes_no_jobs(worker: LatestWins):
    ran = threading.Event()
    worker.stop()
    worker.submit(ran.set)
    assert not worker.wait_idle(0.2)
    assert not ran.is_set()


def test_waiting_for_a_busy_worker_gives_up(worker: LatestWins):
    go_on = threading.Event()
    worker.submit(lambda: go_on.wait(PATIENCE) and None)
    assert not worker.wait_idle(0.05)
    go_on.set()
    assert worker.wait_idle(PATIENCE)
