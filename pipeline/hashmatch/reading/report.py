"""What became of one window: its edgels, distances, votes and tests, and one sentence about them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from pipeline.hashmatch.verification import TESTS

WindowStage = Literal["objectness", "size", "hashing", "verification", "suppression", "kept"]

STAGES_OF_WINDOWS: tuple[WindowStage, ...] = (
    "objectness", "size", "hashing", "verification", "suppression", "kept",
)  # fmt: skip
"""Where a window may end, in order; "kept" is not an end."""


class SizeRange(NamedTuple):
    """Whether an object could be in a window, as test T1 asks."""

    obj_id: int
    nearest: float
    """Metres; measured distances at which some template of the object passes T1."""
    farthest: float
    possible: bool


class TemplateVotes(NamedTuple):
    """A template in a window."""

    obj_id: int
    template: int
    votes: int
    rank: int
    """By votes among the templates of the window, from 1."""
    failed_test: int
    """The first of T1 to T5 that failed; 0 where all are passed."""
    fractions: tuple[float, float, float, float]
    """Shares of matching points in T2 to T5; 0 in tests that were not made."""
    missing: float | None
    """v minus the share in the test that failed; None where none or T1 failed, which is passed or not."""
    detection: int | None
    """Row among the detections."""
    suppressed_by: int | None
    """Row of the detection that suppressed this one; None where it was kept, or is no detection."""

    @property
    def kept(self) -> bool:
        """Whether non-maxima suppression kept it."""
        return self.detection is not None and self.suppressed_by is None


@dataclass(frozen=True)
class WindowReport:
    """What became of a window."""

    level: int
    scale: float
    center: tuple[float, float]
    """(u_w, v_w), pixels of the image."""
    box: tuple[float, float, float, float]
    """x0, y0, x1, y1 in the image, pixels."""
    corner: tuple[int, int]
    """(x, y) of its first pixel in the padded maps of its level."""
    edgels: int
    edgels_needed: float
    """theta: more are needed."""
    distances: tuple[float, ...]
    """Metres, at the five points of T1; 0 where not measured."""
    sizes: tuple[SizeRange, ...]
    """Of all objects."""
    candidates: int
    """Templates that voting passed on."""
    votes: tuple[TemplateVotes, ...]
    """The recorded ones, most votes first: the best-voted templates and the one that came farthest in the tests."""
    matches_needed: float
    """v, as a share."""
    votes_needed: int
    """m."""

    @property
    def objectness(self) -> bool:
        """Whether there are edgels enough."""
        return self.edgels > self.edgels_needed

    @property
    def farthest(self) -> TemplateVotes | None:
        """The template that came farthest."""
        return max(self.votes, key=_progress, default=None)

    @property
    def stage(self) -> WindowStage:
        """Where it ended."""
        best = self.farthest
        if best is not None:
            if best.failed_test:
                return "verification"
            return "kept" if best.kept else "suppression"
        if not self.objectness:
            return "objectness"
        return "hashing" if any(size.possible for size in self.sizes) else "size"

    @property
    def verdict(self) -> str:
        """One sentence."""
        best = self.farthest
        if best is not None:
            return _verdict_on(best, self)
        if not self.objectness:
            return f"It holds {self.edgels} depth edgels; more than {self.edgels_needed:.0f} are needed."
        if self.stage == "size":
            return f"No object fits: {_measured(self.distances)}, {_sought(self.sizes)}."
        return f"No template got {self.votes_needed} votes."


def _progress(one: TemplateVotes) -> tuple[float, ...]:
    reached = 6 if one.failed_test == 0 else one.failed_test
    return reached, one.kept, one.detection is not None, sum(one.fractions), -one.rank


def _verdict_on(best: TemplateVotes, report: WindowReport) -> str:
    voted = f"{report.candidates} templates were voted for" if report.candidates > 1 else "One template was voted for"
    name = f"template {best.template} of object {best.obj_id} ({best.votes} votes, rank {best.rank})"
    if best.failed_test == 1:
        return f"{voted}; {name} came farthest and failed {TESTS[0]}."
    if best.failed_test:
        share = f"{best.fractions[best.failed_test - 2]:.2f} of {report.matches_needed:.2f} needed"
        return f"{voted}; {name} came farthest and failed {TESTS[best.failed_test - 1]}: {share}."
    if best.kept:
        return f"{voted}; {name} passed all tests and was kept as detection {best.detection}."
    if best.detection is None:
        return f"{voted}; {name} passed all tests, but too many others of its object had better scores."
    return f"{voted}; {name} passed all tests, and detection {best.suppressed_by} suppressed it."


def _measured(distances: Sequence[float]) -> str:
    there = [distance for distance in distances if distance > 0]
    if not there:
        return "nothing is measured at its five points"
    return f"{min(there):.2f} to {max(there):.2f} m is measured"


def _sought(sizes: Sequence[SizeRange]) -> str:
    nearest, farthest = min(size.nearest for size in sizes), max(size.farthest for size in sizes)
    return f"objects of its size are {nearest:.2f} to {farthest:.2f} m away"
