"""Evaluations in the background: one after the other, to be cancelled, and taken up again after a restart."""

import json
import logging
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from inspector.announcer import Announcer
from inspector.evaluations import EvaluationQueue
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.evaluation.evaluate import Evaluation, evaluate
from pipeline.bop.evaluation.fingerprint import fingerprint
from pipeline.bop.leaderboard.jobs import MOST_ATTEMPTS, JobStore
from pipeline.bop.leaderboard.records import Submission
from pipeline.bop.leaderboard.store import Leaderboard
from pipeline.bop.results import write_results
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from tests.tiny_dataset import ANNOTATED, FIRST, claim, make_dataset, moved, perfect, results_of

ROOT = Path(__file__).resolve().parents[2]
PATIENCE = 30.0
"""Seconds after which something that should have happened did not."""


@pytest.fixture
def tiny(tmp_path: Path) -> Dataset:
    return open_dataset(make_dataset(tmp_path / "tiny"))


@pytest.fixture
def board(tmp_path: Path) -> Leaderboard:
    return Leaderboard(tmp_path / "leaderboard")


@pytest.fixture
def queues(board: Leaderboard) -> Iterator[Callable[..., EvaluationQueue]]:
    """Makes queues and stops them."""
    made: list[EvaluationQueue] = []

    def make(start: bool = True, **options) -> EvaluationQueue:
        made.append(EvaluationQueue(board, **options))
        if start:
            made[-1].start()
        return made[-1]

    yield make
    for queue in made:
        queue.stop(PATIENCE)


def add(board: Leaderboard, tmp_path: Path, method: str = "m", shift: float = 0.0) -> Submission:
    """Hand in a file with one estimate moved by metres."""
    (_, left), *_ = ANNOTATED[FIRST]
    path = tmp_path / f"{method}_tiny-test.csv"
    write_results(path, results_of(claim(FIRST, 1, moved(left, x=shift))))
    return board.add(path, method=method, dataset_name="tiny", split="test").submission


class Controlled:
    """Stands for `evaluate`: begins when told, and goes on step by step."""

    def __init__(self) -> None:
        self.begun, self.go_on, self.ended = threading.Event(), threading.Event(), threading.Event()
        self.evaluated: list[str] = []
        self.steps = 100_000

    def __call__(self, dataset, results, progress, *, with_vsd: bool) -> Evaluation:
        self.begun.set()
        try:
            for step in range(self.steps):
                progress(step / self.steps)
                if self.go_on.wait(0.005):
                    break
        finally:
            self.ended.set()
        self.evaluated.append(results.method)
        return evaluate(dataset, results, progress, with_vsd=with_vsd)


def state(queue: EvaluationQueue, job_id: int) -> tuple[str, str]:
    job = queue.job(job_id)
    assert job is not None
    return job.state, job.reason


# ---- real evaluations


def test_a_submission_is_evaluated_and_kept(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    submission, queue = add(board, tmp_path, "mine", 0.004), queues()
    job = queue.submit(submission, tiny)
    assert (job.submission_id, job.root, job.split) == (submission.id, tiny.root, "test")
    assert queue.wait_idle(PATIENCE)
    assert queue.job(job.id).progress == 1.0
    assert state(queue, job.id) == ("done", "")
    kept = board.evaluation(submission.id, fingerprint(tiny))
    expected = evaluate(tiny, board.results(submission.id))
    assert kept is not None
    assert kept.as_dict() | {"seconds": 0} == expected.as_dict() | {"seconds": 0}
    assert np.array_equal(kept.instances.mssd, expected.instances.mssd)
    assert 0 < kept.scores.mssd < 1
    assert kept.method == "mine"
    queue.stop(PATIENCE)
    assert JobStore(board.folder).adopt() == ()


def test_a_real_method_is_evaluated_in_the_background(board: Leaderboard, queues, lmo: Path):
    path, dataset, shares = lmo / "results" / "megapose_lmo-test.csv", open_dataset(lmo), []
    submission = board.add(path, method="MegaPose", dataset_name="lmo", split="test").submission
    queue = queues(evaluate=lambda d, r, p, *, with_vsd: evaluate(d, r, lambda s: (shares.append(s), p(s))[1]))
    job = queue.submit(submission, dataset)
    assert queue.wait_idle(PATIENCE)
    assert state(queue, job.id) == ("done", "")
    kept = board.evaluation(submission.id, fingerprint(dataset))
    expected = evaluate(dataset, board.results(submission.id)).scores
    assert kept is not None
    assert kept.scores == expected
    assert len(shares) > 5
    assert shares == sorted(shares)


def test_a_real_evaluation_is_cancelled_within_a_fraction_of_a_second(board: Leaderboard, queues, lmo: Path):
    path, dataset = lmo / "results" / "megapose_lmo-test.csv", open_dataset(lmo)
    submission = board.add(path, method="MegaPose", dataset_name="lmo", split="test").submission
    begun, ended = threading.Event(), threading.Event()

    def watched(dataset, results, progress, *, with_vsd):
        def told(share: float) -> None:
            if share > 0:
                begun.set()
            progress(share)

        try:
            while True:
                evaluate(dataset, results, told, with_vsd=with_vsd)
        finally:
            ended.set()

    queue = queues(evaluate=watched)
    job = queue.submit(submission, dataset)
    assert begun.wait(PATIENCE)
    time_of_cancel = time.monotonic()
    queue.cancel(job.id)
    assert state(queue, job.id) == ("cancelled", "")
    assert ended.wait(PATIENCE)
    assert time.monotonic() - time_of_cancel < 1.0
    assert board.evaluations() == ()


# ---- one after the other


def test_jobs_run_in_the_order_in_which_they_came(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    controlled = Controlled()
    queue = queues(evaluate=controlled)
    jobs = [queue.submit(add(board, tmp_path, method), tiny) for method in ("a", "b", "c")]
    assert controlled.begun.wait(PATIENCE)
    assert [job.state for job in queue.jobs()] == ["running", "waiting", "waiting"]
    controlled.go_on.set()
    assert queue.wait_idle(PATIENCE)
    assert controlled.evaluated == ["a", "b", "c"]
    assert [job.id for job in queue.jobs()] == [job.id for job in jobs]
    assert {job.state for job in queue.jobs()} == {"done"}


def test_the_same_is_not_evaluated_twice(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    controlled, submission = Controlled(), add(board, tmp_path)
    queue = queues(evaluate=controlled)
    first = queue.submit(submission, tiny)
    assert queue.submit(submission, tiny).id == first.id
    without = queue.submit(submission, tiny, with_vsd=False)
    assert without.id != first.id
    controlled.go_on.set()
    assert queue.wait_idle(PATIENCE)
    done_before = queue.submit(submission, tiny)
    assert queue.wait_idle(PATIENCE)
    assert state(queue, done_before.id) == ("done", "")
    assert controlled.evaluated == ["m", "m"]
    queue.submit(submission, tiny, again=True)
    assert queue.wait_idle(PATIENCE)
    assert len(controlled.evaluated) == 3
    assert [e.with_vsd for e in board.evaluations()] == [False, True]


def test_changed_data_are_read_anew(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    submission, queue, before = add(board, tmp_path), queues(), fingerprint(tiny)
    tiny.ground_truth(FIRST)  # as a browser does, which would remember them
    queue.submit(submission, tiny)
    assert queue.wait_idle(PATIENCE)
    change_ground_truth(tiny)
    queue.submit(submission, tiny)
    assert queue.wait_idle(PATIENCE)
    old, new = board.evaluation(submission.id, before), board.evaluation(submission.id, fingerprint(tiny))
    assert old is not None
    assert new is not None
    assert new.scores.mssd < old.scores.mssd
    assert new.scores == evaluate(open_dataset(tiny.root), board.results(submission.id)).scores


def change_ground_truth(dataset: Dataset) -> None:
    path = dataset.root / "test" / "000001" / "scene_gt.json"
    content = json.loads(path.read_text())
    content["0"][0]["cam_t_m2c"][0] += 10
    path.write_text(json.dumps(content))


def test_a_dataset_that_changes_between_two_jobs_is_read_anew(
    board: Leaderboard, queues, tiny: Dataset, tmp_path: Path
):
    def change_after_first(dataset, results, progress, *, with_vsd):
        found = evaluate(dataset, results, progress, with_vsd=with_vsd)
        if results.method == "first":
            change_ground_truth(tiny)
        return found

    queue = queues(start=False, evaluate=change_after_first)
    jobs = [queue.submit(add(board, tmp_path, method), tiny) for method in ("first", "second")]
    queue.start()
    assert queue.wait_idle(PATIENCE)
    assert [state(queue, job.id)[0] for job in jobs] == ["failed", "done"]
    (kept,) = board.evaluations()
    assert kept.scores == evaluate(open_dataset(tiny.root), board.results(jobs[1].submission_id)).scores
    assert kept.fingerprint == fingerprint(tiny)


def test_numbers_of_data_that_change_meanwhile_are_not_kept(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    def change(dataset, results, progress, *, with_vsd):
        found = evaluate(dataset, results, progress, with_vsd=with_vsd)
        (tiny.root / "test" / "000001" / "scene_gt_info.json").write_text("{}")
        return found

    queue = queues(evaluate=change)
    job = queue.submit(add(board, tmp_path), tiny)
    assert queue.wait_idle(PATIENCE)
    assert state(queue, job.id) == ("failed", f"{tiny.root}: was changed while it was evaluated; evaluate it again")
    assert board.evaluations() == ()


def test_a_failure_hinders_no_other_job(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path, caplog):
    faults: list[Exception] = [FormatError("x.json: line 3, wrong; mend it"), ZeroDivisionError("a bug\nin two lines")]

    def fail_first(dataset, results, progress, *, with_vsd):
        if faults:
            raise faults.pop(0)
        return evaluate(dataset, results, progress, with_vsd=with_vsd)

    queue = queues(evaluate=fail_first)
    with caplog.at_level(logging.CRITICAL, "inspector.evaluations"):
        jobs = [queue.submit(add(board, tmp_path, method), tiny) for method in ("a", "b", "c")]
        assert queue.wait_idle(PATIENCE)
    assert [state(queue, job.id) for job in jobs] == [
        ("failed", "x.json: line 3, wrong; mend it"),
        ("failed", "evaluation failed: ZeroDivisionError: a bug"),
        ("done", ""),
    ]


def test_what_cannot_be_evaluated_says_why(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    changed, gone, removed = (add(board, tmp_path, method) for method in ("changed", "gone", "removed"))
    queue = queues(start=False)
    jobs = [queue.submit(submission, tiny) for submission in (changed, gone, removed)]
    changed.path.write_text("1,2,3")
    board.remove(removed.id)
    queue.start()
    assert queue.wait_idle(PATIENCE)
    assert "its content has changed since it was uploaded" in state(queue, jobs[0].id)[1]
    assert state(queue, jobs[2].id) == ("cancelled", "the submission was removed")
    shutil.rmtree(tiny.root)
    later = queue.retry(jobs[1].id)
    assert later is not None
    assert queue.wait_idle(PATIENCE)
    assert state(queue, later.id)[0] == "failed"
    assert f"{tiny.root}: no such folder" in state(queue, later.id)[1]


def test_a_submission_is_evaluated_on_its_own_dataset_only(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    queue, submission = queues(), add(board, tmp_path)
    other = board.add(submission.path, method="m", dataset_name="lmo", split="test").submission
    with pytest.raises(InputError, match="submission 2 is for lmo/test, not for tiny/test; open that dataset"):
        queue.submit(other, tiny)
    board.remove(submission.id)
    with pytest.raises(UnknownIdError, match="submission 1 is not in the leaderboard; available: 2"):
        queue.submit(submission, tiny)
    assert queue.jobs() == ()


# ---- cancelling, progress, news


def test_a_cancelled_job_ends_at_once_and_the_next_begins(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    controlled = Controlled()
    queue = queues(evaluate=controlled)
    running, waiting, last = (queue.submit(add(board, tmp_path, method), tiny) for method in ("a", "b", "c"))
    assert controlled.begun.wait(PATIENCE)
    queue.cancel(waiting.id)
    controlled.begun.clear()
    begun = time.monotonic()
    queue.cancel(running.id)
    assert (state(queue, running.id), state(queue, waiting.id)) == (("cancelled", ""), ("cancelled", ""))
    assert controlled.ended.wait(PATIENCE)
    assert time.monotonic() - begun < 0.5
    assert controlled.begun.wait(PATIENCE)  # the next one
    controlled.go_on.set()
    assert queue.wait_idle(PATIENCE)
    assert controlled.evaluated == ["c"]
    assert [e.submission_id for e in board.evaluations()] == [last.submission_id]
    queue.cancel(last.id)  # too late
    queue.cancel(99)
    assert state(queue, last.id) == ("done", "")
    queue.stop(PATIENCE)
    assert JobStore(board.folder).adopt() == ()


def test_progress_and_the_time_left_are_told(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    at, go_on = [threading.Event(), threading.Event()], [threading.Event(), threading.Event()]

    def stepwise(dataset, results, progress, *, with_vsd):
        for step, share in enumerate((0.0, 0.25)):
            time.sleep(0.05)
            progress(share)
            at[step].set()
            assert go_on[step].wait(PATIENCE)
        return evaluate(dataset, results, progress, with_vsd=with_vsd)

    queue = queues(evaluate=stepwise)
    job = queue.submit(add(board, tmp_path), tiny)
    assert (job.state, job.progress, job.seconds_left) == ("waiting", 0.0, None)
    assert at[0].wait(PATIENCE)
    assert (queue.job(job.id).progress, queue.job(job.id).seconds_left) == (0.0, None)
    go_on[0].set()
    assert at[1].wait(PATIENCE)
    now = queue.job(job.id)
    assert (now.state, now.progress) == ("running", 0.25)
    assert 3 * 0.1 <= now.seconds_left < PATIENCE
    go_on[1].set()
    assert queue.wait_idle(PATIENCE)
    assert (queue.job(job.id).progress, queue.job(job.id).seconds_left) == (1.0, None)


def test_listeners_are_told_of_the_end_and_not_too_often(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    told, done, threads = [], threading.Event(), set()

    def listener() -> None:
        told.append(time.monotonic())
        threads.add(threading.current_thread().name)
        if queue.jobs() and not queue.jobs()[-1].is_open:
            done.set()

    def busy(dataset, results, progress, *, with_vsd):
        for step in range(3000):
            progress(step / 3000)
        return evaluate(dataset, results, progress, with_vsd=with_vsd)

    queue = queues(evaluate=busy, start=False)
    end = queue.listen(listener)
    queue.listen(lambda: 1 / 0)  # hinders nobody
    begun = time.monotonic()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(logging.getLogger("inspector.announcer"), "disabled", True)
        queue.start()
        queue.submit(add(board, tmp_path), tiny)
        assert done.wait(PATIENCE)
    assert len(told) <= (time.monotonic() - begun) / 0.25 + 2
    assert threads == {"evaluation news"}
    end()
    count = len(told)
    queue.dismiss(queue.jobs()[0].id)
    time.sleep(0.3)  # the time in which it would have been told
    assert (len(told), queue.jobs()) == (count, ())


def test_news_come_at_once_then_at_intervals_and_the_last_for_certain():
    announcer, told = Announcer("test", interval=0.2), []
    value, last = [0], threading.Event()

    def listener() -> None:
        told.append((time.monotonic(), value[0]))
        if value[0] == 500:
            last.set()

    announcer.listen(listener)
    for number in range(501):
        value[0] = number
        announcer.changed()
        time.sleep(0.001)
    assert last.wait(PATIENCE)
    announcer.stop()
    times = [at for at, _ in told]
    assert told[0][1] < 150
    assert np.diff(times).min() >= 0.19


# ---- restarts


def test_unfinished_jobs_are_taken_up_after_a_stop(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    controlled = Controlled()
    queue = queues(evaluate=controlled)
    jobs = [queue.submit(add(board, tmp_path, method), tiny) for method in ("a", "b")]
    cancelled = queue.submit(add(board, tmp_path, "c"), tiny)
    queue.cancel(cancelled.id)
    assert controlled.begun.wait(PATIENCE)
    begun = time.monotonic()
    queue.stop(PATIENCE)
    assert time.monotonic() - begun < PATIENCE / 2
    with pytest.raises(InputError, match="no evaluation is taken on any more, the program is ending"):
        queue.submit(add(board, tmp_path, "d"), tiny)
    assert controlled.evaluated == []
    later = queues()
    assert [job.id for job in later.jobs()] == [job.id for job in jobs]
    assert later.wait_idle(PATIENCE)
    assert {job.state for job in later.jobs()} == {"done"}
    assert len(board.evaluations()) == 2


def test_a_job_may_be_stopped_in_good_order_any_number_of_times(
    board: Leaderboard, queues, tiny: Dataset, tmp_path: Path
):
    submission = add(board, tmp_path)
    for attempt in range(MOST_ATTEMPTS + 1):
        controlled = Controlled()
        queue = queues(evaluate=controlled)
        if attempt == 0:
            queue.submit(submission, tiny)
        assert controlled.begun.wait(PATIENCE)
        queue.stop(PATIENCE)
    later = queues()
    assert later.wait_idle(PATIENCE)
    assert [job.state for job in later.jobs()] == ["done"]


def test_failed_jobs_are_shown_again_until_dismissed(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    def fail(dataset, results, progress, *, with_vsd):
        raise FormatError("x.json: wrong; mend it")

    queue = queues(evaluate=fail)
    failed = queue.submit(add(board, tmp_path), tiny)
    assert queue.wait_idle(PATIENCE)
    queue.stop(PATIENCE)
    later = queues()
    assert state(later, failed.id) == ("failed", "x.json: wrong; mend it")
    again = later.retry(failed.id)
    assert later.job(failed.id) is None
    assert later.wait_idle(PATIENCE)
    assert state(later, again.id) == ("done", "")
    later.stop(PATIENCE)
    assert queues().jobs() == ()


def test_another_living_process_keeps_its_jobs(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    controlled = Controlled()
    queue = queues(evaluate=controlled)
    queue.submit(add(board, tmp_path), tiny)
    assert controlled.begun.wait(PATIENCE)
    assert queues().jobs() == ()
    controlled.go_on.set()
    assert queue.wait_idle(PATIENCE)


def test_a_folder_that_cannot_be_written_does_not_hinder_the_start(
    board: Leaderboard, queues, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    def refuse(self):
        raise InputError("board: cannot be written")

    monkeypatch.setattr(JobStore, "adopt", refuse)
    assert queues().jobs() == ()
    assert "unfinished evaluations are left alone: board: cannot be written" in caplog.text


def test_a_dataset_is_not_kept_in_memory_when_there_is_nothing_to_do(
    board: Leaderboard, queues, tiny: Dataset, tmp_path: Path
):
    opened = []

    def counted(root: Path, split: str | None = None, sensor: str | None = None) -> Dataset:
        opened.append(root)
        return open_dataset(root, split, sensor)

    queue = queues(start=False, open_dataset=counted)
    for method in ("a", "b", "c"):
        queue.submit(add(board, tmp_path, method), tiny)
    queue.start()
    assert queue.wait_idle(PATIENCE)
    assert opened == [tiny.root]
    queue.submit(add(board, tmp_path, "d"), tiny)
    assert queue.wait_idle(PATIENCE)
    assert len(opened) == 2


SERVER = """
import sys, time
from pathlib import Path
from inspector.evaluations import EvaluationQueue
from pipeline.bop.dataset import open_dataset
from pipeline.bop.leaderboard.store import Leaderboard

def stuck(dataset, results, progress, *, with_vsd):
    progress(0.5)
    print("running", flush=True)
    time.sleep(60)  # without a word: as native code does

board = Leaderboard(Path(sys.argv[1]))
queue = EvaluationQueue(board, evaluate=stuck)
queue.start()
if not queue.jobs():
    for submission in board.submissions()[::-1]:
        queue.submit(submission, open_dataset(Path(sys.argv[2])))
sys.stdin.readline()
"""


def serve(board: Leaderboard, tiny: Dataset) -> subprocess.Popen[str]:
    """A process that is stuck in an evaluation when this returns."""
    command = [sys.executable, "-c", SERVER, str(board.folder), str(tiny.root)]
    process = subprocess.Popen(command, cwd=ROOT, stdin=-1, stdout=-1, stderr=-1, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "running\n"
    return process


def test_the_end_of_the_program_does_not_wait_for_an_evaluation(
    board: Leaderboard, queues, tiny: Dataset, tmp_path: Path
):
    submission = add(board, tmp_path)
    process, begun = serve(board, tiny), time.monotonic()
    _, err = process.communicate("\n", timeout=PATIENCE)
    assert (process.returncode, err) == (0, "")
    assert time.monotonic() - begun < 20.0  # of the 60 that it would take
    queue = queues()
    assert [job.submission_id for job in queue.jobs()] == [submission.id]
    assert queue.wait_idle(PATIENCE)
    assert len(board.evaluations()) == 1


def test_jobs_of_a_killed_process_are_taken_up_but_not_for_ever(
    board: Leaderboard, queues, tiny: Dataset, tmp_path: Path
):
    for method in ("deadly", "other"):
        add(board, tmp_path, method)
    for _ in range(MOST_ATTEMPTS):
        process = serve(board, tiny)
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=PATIENCE)
    queue = queues()
    deadly, other = queue.jobs()
    assert state(queue, deadly.id) == (
        "failed",
        f"the program ended {MOST_ATTEMPTS} times while it was evaluated; free memory and try again",
    )
    assert queue.wait_idle(PATIENCE)
    assert state(queue, other.id) == ("done", "")
    queue.retry(deadly.id)
    assert queue.wait_idle(PATIENCE)
    assert len(board.evaluations()) == 2
    assert len(list((board.folder / "workers").iterdir())) == 1  # those of the killed ones are gone


def test_results_are_those_of_perfect_estimates(board: Leaderboard, queues, tiny: Dataset, tmp_path: Path):
    write_results(tmp_path / "p.csv", perfect())
    submission = board.add(tmp_path / "p.csv", method="perfect", dataset_name="tiny", split="test").submission
    queue = queues()
    queue.submit(submission, tiny)
    assert queue.wait_idle(PATIENCE)
    (row,) = board.board().rows
    assert (row.average.value, row.average.name) == (1.0, "mean of 1 dataset")
