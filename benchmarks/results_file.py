"""Rows per second of reading a results file, against readers that one would write at first, and the memory it takes.

The file is made in a temporary folder: random estimates with all their digits. The other readers are a loop over lines
and `float` in the manner of the benchmark's scripts, the csv module, and two ways through NumPy. All give the same
numbers to the last bit. Usage: python benchmarks/results_file.py [--rows 100000] [--repeats 5]
"""

import argparse
import csv
import multiprocessing
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.bop.results import Results, read_results, write_results

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "rotation", "translation_mm", "time_s")
MIB = 2**20
COPIES = 10
"""How many times longer the file is whose memory is measured."""


def main() -> None:
    """Make the file, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "method_bench-test.csv"
        make_file(path, arguments.rows)
        compare(path, arguments.rows, arguments.repeats)
        lengthen(path)
        print_memory(path)


def make_file(path: Path, rows: int) -> None:
    """Write random estimates."""
    rng = np.random.default_rng(0)
    results = Results(
        scene_id=rng.integers(1, 21, rows),
        im_id=rng.integers(0, 500, rows),
        obj_id=rng.integers(1, 31, rows),
        score=rng.random(rows),
        rotation=Rotation.random(rows, rng=rng).as_matrix(),
        translation_mm=rng.normal([0, 0, 800], 100, (rows, 3)),
        time_s=rng.random(rows),
    )
    write_results(path, results)


def lengthen(path: Path) -> None:
    """Repeat all rows."""
    body = path.read_bytes().partition(b"\n")[2]
    with path.open("ab") as file:
        for _ in range(COPIES - 1):
            file.write(body)


def compare(path: Path, rows: int, repeats: int) -> None:
    """Time all readers in turn, so that whatever else runs here hits them alike; print the shortest times."""
    readers = {
        "ours": read_results,
        "loop over lines": read_in_a_loop,
        "csv module": read_with_csv,
        "numpy.fromstring": read_with_fromstring,
        "numpy.loadtxt": read_with_loadtxt,
    }
    times: dict[str, list[float]] = {name: [] for name in readers}
    expected = table(read_results(path))
    for _ in range(repeats):
        for name, reader in readers.items():
            begin = time.perf_counter()
            found = reader(path)
            times[name].append(time.perf_counter() - begin)
            assert table(found).tobytes() == expected.tobytes(), name
    ours = min(times["ours"])
    for name, seconds in times.items():
        best = min(seconds)
        print(f"{name:18s} {best:6.3f} s, {rows / best / 1e3:7.0f} thousand rows/s, {best / ours:5.1f} times as long")


def table(found: Any) -> np.ndarray:
    """All numbers that a reader gave, 17 a row."""
    if isinstance(found, Results):
        return np.column_stack([getattr(found, column).reshape(len(found), -1) for column in COLUMNS]).astype(float)
    if isinstance(found, list):
        return np.array([[*r["ids"], r["score"], *r["R"].flat, *r["t"].flat, r["time"]] for r in found], float)
    return found


def read_in_a_loop(path: Path) -> list[dict[str, Any]]:
    """A dictionary a row, with an array for R and one for t."""
    rows = []
    with path.open() as file:
        next(file)
        for line in file:
            fields = line.split(",")
            rows.append(
                {
                    "ids": [int(field) for field in fields[:3]],
                    "score": float(fields[3]),
                    "R": np.array(list(map(float, fields[4].split())), float).reshape(3, 3),
                    "t": np.array(list(map(float, fields[5].split())), float).reshape(3, 1),
                    "time": float(fields[6]),
                }
            )
    return rows


def read_with_csv(path: Path) -> np.ndarray:
    """The csv module, and Python's floats."""
    with path.open(newline="") as file:
        rows = csv.reader(file)
        next(rows)
        return np.array([[float(x) for field in row for x in field.split()] for row in rows])


def read_with_fromstring(path: Path) -> np.ndarray:
    """NumPy's reader of text, which does not see where rows end."""
    body = path.read_bytes().partition(b"\n")[2]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return np.fromstring(body.replace(b",", b" ").decode(), sep=" ").reshape(-1, 17)


def read_with_loadtxt(path: Path) -> np.ndarray:
    """NumPy's reader of tables."""
    with path.open() as file:
        return np.loadtxt((line.replace(",", " ") for line in file), skiprows=1)


def print_memory(path: Path) -> None:
    """Time and peak memory of a process that reads the long file, over the memory of the arrays that it gets."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        rows, seconds, peak, arrays = pool.apply(memory_of_reading, (path,))
    print(
        f"{rows} rows ({path.stat().st_size / MIB:.0f} MiB): {seconds:.2f} s, peak memory {peak / MIB:.0f} MiB above that "
        f"of the process before, for arrays of {arrays / MIB:.0f} MiB: {peak / arrays:.2f} times"
    )


def memory_of_reading(path: Path) -> tuple[int, float, float, int]:
    """Rows, seconds, growth of the process's peak memory while it reads, and size of the arrays, in bytes."""
    import pyarrow.csv  # noqa: F401  (its code is not the memory of reading)

    Path("/proc/self/clear_refs").write_text("5")  # the peak so far is forgotten
    before, begin = memory("VmRSS"), time.perf_counter()
    results = read_results(path)
    seconds = time.perf_counter() - begin
    size = sum(getattr(results, column).nbytes for column in COLUMNS)
    return len(results), seconds, memory("VmHWM") - before, size


def memory(name: str) -> float:
    """An entry of this process's status, in bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * next(float(line.split()[1]) for line in lines if line.startswith(f"{name}:"))


if __name__ == "__main__":
    main()
