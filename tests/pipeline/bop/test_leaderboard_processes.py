"""The leaderboard with several threads and processes at once, killed ones, and disks that cannot be written."""

import hashlib
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from pipeline.bop.leaderboard.store import Leaderboard
from pipeline.exceptions import InputError
from tests.leaderboard_uploads import add

ROOT = Path(__file__).resolve().parents[3]
PATIENCE = 60.0
"""Seconds after which something that should have happened did not."""

PRELUDE = """
import sys
from pathlib import Path
from pipeline.bop.leaderboard.store import Leaderboard
from pipeline.exceptions import InputError
from tests.leaderboard_uploads import add

board = Leaderboard(Path(sys.argv[1]))
"""


def started(folder: Path, code: str, *, before: tuple[str, ...] = ()) -> subprocess.Popen[str]:
    """A process that runs the code with the leaderboard of the folder as `board`."""
    command, pipe = [*before, sys.executable, "-c", PRELUDE + code, str(folder)], subprocess.PIPE
    return subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, stderr=pipe, text=True)


def finished(process: subprocess.Popen[str], said: str = "") -> str:
    out, err = process.communicate(said, timeout=PATIENCE)
    assert process.returncode == 0, err
    return out


def assert_whole(board: Leaderboard) -> None:
    """Every submission has its file, the database is sound, and nothing is half there after the next upload."""
    for submission in board.submissions():
        assert hashlib.sha256(submission.path.read_bytes()).hexdigest() == submission.sha256
    with sqlite3.connect(board.folder / "leaderboard.sqlite") as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone()[0] == "ok"
    connection.close()
    add(board, 99_999, "after")
    assert not list((board.folder / "files").glob("*.partial"))


def test_threads_may_add_edit_remove_and_look_at_once(tmp_path: Path):
    board = Leaderboard(tmp_path / "board")

    def work(number: int) -> None:
        mine = [add(board, number * 10 + i, f"method {number}").submission for i in range(4)]
        shared = add(board, 7, "shared").submission
        board.edit(mine[0].id, description="edited")
        board.remove(mine[1].id)
        assert shared in board.submissions()
        board.board()

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(work, range(8)))
    kept = board.submissions()
    assert len(kept) == 8 * 3 + 1
    assert sum(submission.description == "edited" for submission in kept) == 8
    assert len({submission.id for submission in kept}) == len(kept)
    assert len(list((board.folder / "files").iterdir())) == len({submission.sha256 for submission in kept})
    assert_whole(board)


def test_processes_may_add_at_once_even_to_a_folder_that_does_not_exist_yet(tmp_path: Path):
    code = """
number = int(sys.stdin.readline())
new = sum(add(board, i, "shared").is_new for i in range(15))
for i in range(15):
    add(board, 100 * number + i, f"process {number}")
print(new)
"""
    folder = tmp_path / "board"
    processes = [started(folder, code) for _ in range(3)]
    for number, process in enumerate(processes):  # they wait for their number, so that all begin together
        assert process.stdin is not None
        process.stdin.write(f"{number + 1}\n")
        process.stdin.flush()
    outputs = [int(finished(process)) for process in processes]
    assert sum(outputs) == 15  # each of the shared files was new for exactly one of them
    board = Leaderboard(folder)
    assert len(board.submissions()) == 15 + 3 * 15
    assert_whole(board)


def test_a_process_killed_while_it_adds_leaves_nothing_half_there(tmp_path: Path):
    code = """
for number in range(10**6):
    add(board, number, rows=200)
    print(number, flush=True)
"""
    folder, rng = tmp_path / "board", np.random.default_rng(0)
    told = 0
    for _ in range(6):
        process = started(folder, code)
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(rng.uniform(0, 0.05))  # at any moment of the loop
        process.send_signal(signal.SIGKILL)
        told = max(told, 1 + len(process.stdout.read().split()))
        process.communicate(timeout=PATIENCE)
        board = Leaderboard(folder)
        assert len(board.submissions()) >= told  # what was told to be kept is kept
        assert_whole(board)
        board.remove(board.submissions()[0].id)


def test_a_process_killed_before_the_database_says_so_leaves_only_what_the_next_one_removes(tmp_path: Path):
    folder = tmp_path / "board"
    code = """
from pipeline.bop.leaderboard.files import KeptFiles
import os, signal
KeptFiles.keep = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
add(board, 1)
"""
    process = started(folder, code)
    process.communicate(timeout=PATIENCE)
    assert process.returncode == -signal.SIGKILL
    assert [path.suffix for path in (folder / "files").iterdir()] == [".partial"]
    board = Leaderboard(folder)
    assert board.submissions() == ()
    assert_whole(board)


def test_a_file_that_is_being_added_elsewhere_is_not_taken_for_abandoned(tmp_path: Path):
    folder = tmp_path / "board"
    code = """
from pipeline.bop.leaderboard import store as leaderboard
read = leaderboard.results_of
def wait(*given):
    print("staged", flush=True)
    sys.stdin.readline()
    return read(*given)
leaderboard.results_of = wait
print(add(board, 1).submission.rows)
"""
    process = started(folder, code)
    assert process.stdout is not None
    assert process.stdout.readline() == "staged\n"
    add(Leaderboard(folder), 2)  # removes what is abandoned
    assert finished(process, "\n") == "1\n"
    assert len(Leaderboard(folder).submissions()) == 2


def test_reading_goes_on_while_another_process_writes(tmp_path: Path):
    board = Leaderboard(tmp_path / "board")
    process = started(board.folder, "for i in range(60): add(board, i)")
    seen = []
    while process.poll() is None:
        seen.append(len(board.submissions()))
    finished(process)
    assert seen == sorted(seen)
    assert len(board.submissions()) == 60


# ---- disks that cannot be written


def limited() -> tuple[str, ...]:
    """What starts a process to which permissions apply, though these tests may run as root."""
    if os.geteuid() != 0:
        return ()
    if shutil.which("setpriv") is None:
        pytest.skip("root may write everywhere, and there is no setpriv to give that up")
    return ("setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner")


def test_a_folder_that_may_only_be_read_can_be_looked_at(tmp_path: Path):
    board = Leaderboard(tmp_path / "board")
    add(board, 1)
    for path in (board.folder / "files", board.folder):
        path.chmod(0o555)
    code = """
print(len(board.board().rows), len(board.results(1)))
for use in (lambda: add(board, 2), lambda: board.edit(1, method="x"), lambda: board.remove(1)):
    try:
        use()
    except InputError as error:
        print(error)
from pipeline.bop.leaderboard.jobs import JobStore
print(JobStore(board.folder).adopt())
"""
    try:
        out = finished(started(board.folder, code, before=limited())).splitlines()
    finally:
        for path in (board.folder, board.folder / "files"):
            path.chmod(0o755)
    assert out[0] == "1 1"
    assert "files: cannot be written (Permission denied), nothing was added" in out[1]
    for line in out[2:4]:
        assert "leaderboard.sqlite: cannot be written or opened" in line
        assert line.endswith("or set INSPECTOR_DATA to a folder that you may write to")
    assert out[4:] == ["()"]
    assert len(board.submissions()) == 1
    assert_whole(board)


def test_a_folder_that_may_not_be_read_or_made_is_one_line(tmp_path: Path):
    (tmp_path / "closed").mkdir()
    (tmp_path / "closed").chmod(0o000)
    code = """
for use in (lambda: Leaderboard(board.folder / "closed" / "board"), lambda: add(Leaderboard(board.folder / "new"), 1)):
    try:
        use()
    except InputError as error:
        print(error)
"""
    tmp_path.chmod(0o555)
    try:
        out = finished(started(tmp_path, code, before=limited())).splitlines()
    finally:
        tmp_path.chmod(0o755)
        (tmp_path / "closed").chmod(0o755)
    assert len(out) == 2
    assert "closed/board/leaderboard.sqlite: cannot be opened (Permission denied); make it writable" in out[0]
    assert "new: cannot be made (Permission denied); make it writable, or set INSPECTOR_DATA" in out[1]


def test_a_full_disk_changes_nothing_and_is_one_line(tmp_path: Path):
    """A limit on the size of files stands for the disk: the upload, then the database, comes to it."""
    board = Leaderboard(tmp_path / "board")
    for number in range(3):
        add(board, number)
    size = (board.folder / "leaderboard.sqlite").stat().st_size
    code = f"""
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))
def attempt(use):
    try:
        return print("done", use())
    except InputError as error:
        print(error)
attempt(lambda: add(board, 10, rows=2000))
attempt(lambda: board.edit(1, description="x" * 9999) and board.edit(2, description="y" * 9999))
for number in range(100, 400):
    try:
        add(board, number)
    except InputError as error:
        print(error)
        break
"""
    out = finished(started(board.folder, code)).splitlines()
    assert "files: cannot be written (File too large), nothing was added; free space" in out[0]
    assert out[1].startswith("done") or "leaderboard.sqlite: " in out[1]
    assert "leaderboard.sqlite: " in out[2]
    assert len(out) == 3
    kept = board.submissions()
    assert len(kept) >= 3
    files = {path.name for path in (board.folder / "files").iterdir()}
    assert files == {submission.path.name for submission in kept}
    assert_whole(board)


def test_a_database_that_sqlite_calls_full_is_told_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    board = Leaderboard(tmp_path / "board")
    add(board, 1)
    connect = sqlite3.connect

    def small(*given, **options) -> sqlite3.Connection:
        connection = connect(*given, **options)
        connection.execute("PRAGMA max_page_count = 1")  # at least what there is
        return connection

    monkeypatch.setattr(sqlite3, "connect", small)
    with pytest.raises(InputError, match=r"leaderboard\.sqlite: the disk is full, nothing was changed; free space"):
        board.edit(1, description="x" * 10_000)

    def add_many() -> None:
        for number in range(2, 100):
            add(board, number)

    with pytest.raises(InputError, match="the disk is full"):
        add_many()
    monkeypatch.undo()
    kept = board.submissions()
    assert kept[-1].description == ""
    assert len(list((board.folder / "files").iterdir())) == len(kept)
    assert_whole(board)


def test_threads_that_wait_for_each_other_do_not_wait_for_ever(tmp_path: Path):
    """Two that read and then write, which a database that takes its lock late would refuse."""
    board = Leaderboard(tmp_path / "board")
    ids = [add(board, number).submission.id for number in range(2)]
    barrier, faults = threading.Barrier(2), []

    def edit(number: int) -> None:
        try:
            for turn in range(25):
                barrier.wait(PATIENCE)
                board.edit(number, description=f"{turn}")
        except Exception as error:
            faults.append(error)
            barrier.abort()

    threads = [threading.Thread(target=edit, args=(number,)) for number in ids]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert faults == []
    assert {submission.description for submission in board.submissions()} == {"24"}
