"""Results files that differ by a number, for tests of the leaderboard and for the processes that they start."""

from pipeline.bop.leaderboard.store import Added, Leaderboard

HEADER = "scene_id,im_id,obj_id,score,R,t,time"


def content(number: int, rows: int = 1) -> bytes:
    """A file of its own for every number."""
    lines = [f"1,{number * 10_000 + i},1,0.5,1 0 0 0 1 0 0 0 1,0 0 400,0.25" for i in range(rows)]
    return "\n".join([HEADER, *lines, ""]).encode()


def add(board: Leaderboard, number: int, method: str = "m", rows: int = 1) -> Added:
    """Add it to a leaderboard."""
    return board.add(content(number, rows), method=method, dataset_name="tiny", split="test")
