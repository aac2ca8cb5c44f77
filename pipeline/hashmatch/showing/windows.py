"""The windows that got candidates, and the templates that did best in each of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Integer

from pipeline.hashmatch.detector import Detector, LevelMatches, Matching
from pipeline.hashmatch.showing.fractions import fractions_of
from pipeline.recording import StageRecorder

BEST_VOTED = 4
"""Templates of a window that are recorded, those with the most votes; and the one that came farthest in the tests."""

PASSED = 6
"""Stands for "all tests passed" where tests are compared by how far a candidate came."""


class WindowVotes(NamedTuple):
    """Some candidates of the windows of a level."""

    windows: Integer[np.ndarray, "k"]
    """Rows of the windows that got candidates."""
    counts: Integer[np.ndarray, "k"]
    """How many each got."""
    rows: Integer[np.ndarray, "n"]
    """Of the candidates chosen to be shown, in order."""
    places: Integer[np.ndarray, "n"]
    """Of each one's window in `windows`."""
    ranks: Integer[np.ndarray, "n"]
    """Of each by votes in its window, from 1."""


def show_windows(detector: Detector, matching: Matching, recorder: StageRecorder) -> Integer[np.ndarray, "t"]:
    """Record the windows with candidates and the best of these; returns their templates, numbered through all objects."""
    windows, votes, before = [], [], 0
    for matched in matching.levels:
        chosen = best_of_windows(matched)
        windows.append(_window_columns(matched, chosen))
        votes.append(_vote_columns(detector, matched, chosen, before))
        before += len(chosen.windows)
    recorder.table("hashmatch/candidates/hashing", _stacked(windows))
    columns = _stacked(votes)
    numbers = columns.pop("number")
    recorder.table("hashmatch/votes", columns)
    return np.unique(numbers)


def best_of_windows(matched: LevelMatches) -> WindowVotes:
    """For each window that got candidates, those with the most votes, and the one that came farthest in the tests."""
    found = matched.candidates.windows
    first = np.flatnonzero(np.diff(found, prepend=-1))  # candidates come window after window
    windows, counts = found[first], np.diff(first, append=len(found))
    places = np.repeat(np.arange(len(windows)), counts)
    ranks = np.arange(len(found)) - first[places] + 1 if len(found) else np.zeros(0, np.int64)
    chosen = ranks <= BEST_VOTED
    chosen[_farthest(matched, first, places)] = True
    rows = np.flatnonzero(chosen)
    return WindowVotes(windows, counts, rows, places[rows], ranks[rows])


def _farthest(matched: LevelMatches, first: np.ndarray, places: np.ndarray) -> Integer[np.ndarray, "k"]:
    """Row of the candidate of each window that came farthest in the tests, the best-voted one of several."""
    if not len(first):
        return first
    failed = matched.verified.failed
    reached = np.where(failed == 0, PASSED, failed) + matched.verified.fractions.sum(axis=1) / 8  # counts if all passed
    best = np.flatnonzero(reached == np.maximum.reduceat(reached, first)[places])
    _, first_of_each = np.unique(places[best], return_index=True)
    return best[first_of_each]


def _window_columns(matched: LevelMatches, chosen: WindowVotes) -> dict[str, np.ndarray]:
    return {
        "level": np.full(len(chosen.windows), matched.level.index, np.int8),
        "corner": matched.windows[chosen.windows].astype(np.int16),
        "count": chosen.counts.astype(np.int16),
    }


def _vote_columns(detector: Detector, matched: LevelMatches, chosen: WindowVotes, before: int) -> dict[str, np.ndarray]:
    number = matched.candidates.templates[chosen.rows]
    position = detector.tables.objects[number]
    ids = np.array([own.obj_id for own in detector.objects])
    return {
        "window": (chosen.places + before).astype(np.int32),
        "object": ids[position].astype(np.int16),
        "template": (number - detector.tables.firsts[position]).astype(np.int32),
        "votes": matched.candidates.votes[chosen.rows].astype(np.uint8),
        "rank": chosen.ranks.astype(np.int16),
        "failed": matched.verified.failed[chosen.rows].astype(np.uint8),
        "fractions": fractions_of(detector, matched, chosen.rows).astype(np.float16),
        "number": number,
    }


def _stacked(parts: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
