"""Columns piece by piece: the same to the last bit wherever they are computed, and however often it was interrupted."""

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tiny_dataset import make_dataset, perfect
from worker_functions import rows_of_results, slow_columns

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.evaluation.columns import HERE, Columns, Execution, Piece, pieces
from pipeline.bop.evaluation.evaluate import evaluate, localization_columns
from pipeline.bop.evaluation.journal import SUFFIX
from pipeline.bop.results import Results, read_results
from pipeline.exceptions import InputError
from pipeline.parallel import Workers, open_workers
from pipeline.scene import Target

REPOSITORY = Path(__file__).resolve().parents[3]
DEMO = REPOSITORY / "assets" / "demo"
DEMO_RESULTS = DEMO / "results" / "perturbed-1_demo-test.csv"


@pytest.fixture(scope="module")
def two() -> Iterator[Workers]:
    """Two other processes."""
    with open_workers(2) as workers:
        yield workers


@pytest.fixture(scope="module")
def demo() -> Dataset:
    """The demo, whose targets are in five pieces."""
    return open_dataset(DEMO)


@pytest.fixture(scope="module")
def results() -> Results:
    """Results for it."""
    return read_results(DEMO_RESULTS)


class Computing:
    """Columns of targets, and which pieces were computed."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.firsts: list[Target] = []
        self._stop_after = stop_after

    def __call__(self, dataset: Dataset, results: Results, targets: Sequence[Target]) -> Columns:
        if len(self.firsts) == self._stop_after:
            raise KeyboardInterrupt
        self.firsts.append(targets[0])
        return localization_columns(dataset, results, targets, with_vsd=False)

    def __reduce__(self) -> tuple:
        return Computing, ()


def computed(
    execution: Execution, compute, dataset: Dataset, results: Results, shares: list[float] | None = None
) -> Columns:
    progress = (lambda _: None) if shares is None else shares.append
    return execution.columns(compute, dataset, results, dataset.targets(), progress)


def assert_same(found: Columns, expected: Columns) -> None:
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values)


# ---- in several processes


def test_scores_of_several_processes_are_the_same_to_the_last_digit(two: Workers, demo: Dataset, results: Results):
    here, there = evaluate(demo, results), evaluate(demo, results, execution=Execution(two))
    assert there.scores == here.scores
    assert 0.0 < (here.scores.vsd or 0.0) < 1.0
    for name, values in vars(here.instances).items():
        np.testing.assert_array_equal(getattr(there.instances, name), values)


def test_lmo_in_several_processes_is_the_same_to_the_last_digit(two: Workers, lmo: Path):
    dataset, megapose = open_dataset(lmo), read_results(lmo / "results" / "megapose_lmo-test.csv")
    assert evaluate(dataset, megapose, execution=Execution(two)).scores == evaluate(dataset, megapose).scores


def test_a_piece_has_the_results_of_its_images_only(demo: Dataset, results: Results):
    for targets in pieces(demo.targets()):
        piece = Piece.of(targets, results)
        images = {target.image for target in targets}
        assert 0 < len(piece.results) < len(results) / 2
        assert set(piece.results.images()) <= images
        for image in images:
            np.testing.assert_array_equal(piece.rows[piece.results.rows(image)], results.rows(image))


@pytest.mark.parametrize("parallel", [False, True])
def test_row_numbers_are_those_of_the_whole_results(two: Workers, demo: Dataset, results: Results, parallel: bool):
    found = computed(Execution(two if parallel else None), rows_of_results, demo, results)
    expected = [row for target in demo.targets() for row in [*results.rows(target.image, target.obj_id), -1]]
    assert found["row"].tolist() == expected


def test_a_dataset_is_sent_without_what_it_has_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    make_dataset(tmp_path / "tiny")
    monkeypatch.chdir(tmp_path)
    dataset = open_dataset(Path("tiny"))
    unread = pickle.dumps(dataset)
    dataset.model(1), dataset.targets(), dataset.problems()
    data = pickle.dumps(dataset)
    assert data == unread
    monkeypatch.chdir("/")
    opened = pickle.loads(data)
    assert (opened.root, opened.name, opened.split) == (tmp_path / "tiny", "tiny", "test")
    assert opened.targets() == dataset.targets()
    np.testing.assert_array_equal(opened.model(1).vertices, dataset.model(1).vertices)


def test_errors_name_what_is_wrong_wherever_it_happens(two: Workers, tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    (root / "test" / "000001" / "depth" / "000000.png").write_bytes(b"no image")
    messages = []
    for execution in (HERE, Execution(two)):
        with pytest.raises(InputError) as caught:
            evaluate(open_dataset(root), perfect(), execution=execution)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]
    assert "000000.png" in messages[0]


def test_progress_tells_the_finished_share_and_can_stop(two: Workers, demo: Dataset, results: Results):
    shares: list[float] = []
    computed(Execution(two), slow_columns, demo, results, shares)
    assert shares == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])

    def stop(share: float) -> None:
        raise InterruptedError(f"at {share}")

    begun = time.monotonic()
    with pytest.raises(InterruptedError, match=r"^at 0\.2$"):
        Execution(two).columns(partial(slow_columns, seconds=0.5), demo, results, demo.targets(), stop)
    assert time.monotonic() - begun < 10


# ---- interrupted


def test_what_is_finished_is_not_computed_again(demo: Dataset, results: Results, tmp_path: Path):
    expected = computed(HERE, Computing(), demo, results)
    execution, begun = Execution(journal=tmp_path / "journal"), Computing(stop_after=2)
    with pytest.raises(KeyboardInterrupt):
        computed(execution, begun, demo, results)
    again, shares = Computing(), []
    assert_same(computed(execution, again, demo, results, shares), expected)
    assert len(begun.firsts) == 2
    assert len(again.firsts) == 3
    assert shares == pytest.approx([0.4, 0.6, 0.8, 1.0])
    once_more, shares = Computing(), []
    assert_same(computed(execution, once_more, demo, results, shares), expected)
    assert once_more.firsts == []
    assert shares == [1.0]


SCRIPT = """
import sys
from functools import partial
from pathlib import Path
from pipeline.bop.evaluation.columns import Execution
from pipeline.bop.dataset import open_dataset
from pipeline.bop.results import read_results
from pipeline.parallel import open_workers
from worker_functions import slow_columns
dataset, results = open_dataset(Path(sys.argv[1])), read_results(Path(sys.argv[2]))
with open_workers(2) as workers:
    compute = partial(slow_columns, seconds=float(sys.argv[5]), folder=Path(sys.argv[4]))
    Execution(workers, Path(sys.argv[3])).columns(compute, dataset, results, dataset.targets(), lambda _: None)
"""


def test_an_evaluation_that_is_killed_goes_on_where_it_stopped(demo: Dataset, results: Results, tmp_path: Path):
    journal, marks = tmp_path / "journal", tmp_path / "marks"
    marks.mkdir()
    environment = os.environ | {"PYTHONPATH": f"{REPOSITORY}:{REPOSITORY / 'tests'}"}
    seconds = 0.7
    command = [sys.executable, "-c", SCRIPT, *map(str, (DEMO, DEMO_RESULTS, journal, marks, seconds))]
    with subprocess.Popen(command, env=environment) as process:
        end = time.monotonic() + 60
        while not (kept := _sizes(journal)) or kept[0] < 6_000:  # two pieces, of five
            assert time.monotonic() < end
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
    finished = {path.name.rpartition("-")[0] for path in marks.iterdir()}
    shares: list[float] = []
    compute = partial(slow_columns, seconds=seconds, folder=marks)
    found = computed(Execution(journal=journal), compute, demo, results, shares)
    assert_same(found, computed(HERE, partial(slow_columns, seconds=0.0), demo, results))
    assert shares[0] >= 0.4
    names = [path.name.rpartition("-")[0] for path in marks.iterdir()]
    assert len(finished) >= 2
    assert len(names) - len(set(names)) <= 2, "done again is at most what the two processes were at"


def _sizes(folder: Path) -> list[int]:
    return [path.stat().st_size for path in folder.glob(f"*{SUFFIX}")]


# ---- memory


MEMORY_SCRIPT = """
import sys, tracemalloc
from pathlib import Path
from benchmarks import scaling
from pipeline.bop.evaluation.columns import Execution
from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.evaluate import evaluate
from pipeline.bop.results import read_results

scaling.IMAGES_PER_SCENE = 10  # a scene's files are parsed as a whole
folder = Path(sys.argv[1])
for targets in (100, 500, 2000):
    results = read_results(scaling.make_dataset(folder / f"of{targets}", targets, depth=False))
    if targets > 100:  # the libraries are loaded then
        tracemalloc.start()
    dataset, execution = open_dataset(folder / f"of{targets}"), Execution(journal=folder / f"journal{targets}")
    assert len(evaluate(dataset, results, with_vsd=False, execution=execution).instances) == targets
    if targets > 100:
        print(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
"""


def test_memory_grows_by_the_numbers_kept_of_a_target_only(tmp_path: Path):
    # In a process of its own, as the checks of types and shapes in tests need memory of their own.
    command = [sys.executable, "-c", MEMORY_SCRIPT, str(tmp_path)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True)
    small, large = map(int, done.stdout.split())
    assert (large - small) / 1500 < 1200, "bytes per target"
