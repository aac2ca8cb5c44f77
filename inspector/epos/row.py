"""One row of the table under one choice: the pose, the correspondences, the clicked cell, the hypothesis."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from inspector.epos.choice import EposChoice
from inspector.epos.colors import Extent, extent_of, fragment_colors
from inspector.epos.matches import Matches, established
from inspector.epos.recording import EposRecording
from inspector.epos.search import Hypothesis, Search
from inspector.epos.thresholds import Thresholds
from inspector.frame import Frame, Role
from pipeline.exceptions import InputError
from pipeline.scene import Model

POSE_NAMES: dict[Role, str] = {"estimate": "the estimate", "ground_truth": "the ground truth"}


class Cell(NamedTuple):
    """What was predicted at the clicked pixel."""

    row: int
    """Of the recorded fragments."""
    center: tuple[float, float]
    """Pixel (u, v) in the middle of the cell."""
    size: int
    """Side of the cell, pixels."""
    certainty: float
    """a of the object."""
    probabilities: Float32[np.ndarray, "n"]
    """b of its fragments."""


class ChosenPose(NamedTuple):
    """The pose that correspondences are held against."""

    camera_from_model: Float[np.ndarray, "4 4"]
    name: str
    """For people: whose it is."""


@dataclass(frozen=True, eq=False)
class EposRow:
    """What is seen of EPOS: computed when first asked for, and then kept."""

    frame: Frame
    recording: EposRecording
    choice: EposChoice
    of_run: Thresholds

    @cached_property
    def thresholds(self) -> Thresholds:
        """Those in force."""
        return self.of_run.moved(self.choice)

    @cached_property
    def model(self) -> Model | None:
        """The object's model; None where it cannot be read."""
        try:
            return self.frame.model
        except InputError:
            return None

    @cached_property
    def count(self) -> int:
        """Number of fragments, as far as known."""
        centers, fragments = self.recording.centers, self.recording.fragments
        if fragments is not None:
            return fragments.values.shape[1]
        return 0 if centers is None else len(centers)

    @cached_property
    def colors(self) -> UInt8[np.ndarray, "n 3"]:
        """Colour of each fragment."""
        return fragment_colors(self.model, self.recording.centers, self.count)

    @cached_property
    def extent(self) -> Extent | None:
        """The box in which places on the model are told by colour; None where nothing tells it."""
        if self.model is not None:
            return extent_of(self.model.vertices)
        return None if self.recording.centers is None else extent_of(self.recording.centers)

    @cached_property
    def search(self) -> Search | None:
        """The recorded search for poses."""
        links = self.recording.correspondences
        found = self.recording.hypotheses
        return None if found is None else Search(found, 0 if links is None else len(links.pixels))

    @cached_property
    def hypothesis(self) -> Hypothesis | None:
        """The hypothesis that is shown; None where none is chosen or recorded."""
        if self.search is None or self.choice.hypothesis is None:
            return None
        return self.search.at(self.choice.hypothesis)

    @cached_property
    def pose(self) -> ChosenPose | None:
        """The hypothesis that is shown, else the estimate of the row, else its ground truth."""
        if self.hypothesis is not None:
            return ChosenPose(self.hypothesis.camera_from_model, f"hypothesis {self.hypothesis.position + 1}")
        for role, name in POSE_NAMES.items():
            pose = self.frame.pose(role)
            if pose is not None and np.isfinite(pose).all():
                return ChosenPose(pose, name)
        return None

    @cached_property
    def matches(self) -> Matches | None:
        """The correspondences at the thresholds in force; None where nothing was recorded that tells them."""
        found = established(self.recording, self.thresholds, self.of_run)
        if found is None:
            return None
        pose = None if self.pose is None else self.pose.camera_from_model
        return Matches(*found, self.frame.camera.K, pose, self.thresholds.tau_r)

    @cached_property
    def cell(self) -> Cell | None:
        """The recorded cell at the clicked pixel; None where none was clicked, or the object is not likely there."""
        fragments, certainty = self.recording.fragments, self.recording.certainty
        if not self.choice.has_pixel or fragments is None or certainty is None:
            return None
        at = np.floor((np.array(self.choice.pixel) + 0.5) / fragments.cell_px)
        rows = np.flatnonzero((fragments.cells == at).all(axis=1))
        if not len(rows):
            return None
        middle = at * fragments.cell_px + (fragments.cell_px - 1) / 2
        row = int(rows[0])
        center = float(middle[0]), float(middle[1])
        return Cell(row, center, fragments.cell_px, float(certainty[row]), fragments.values[row])

    @cached_property
    def fragment(self) -> int | None:
        """The chosen fragment, if the object has it."""
        chosen = self.choice.fragment
        return chosen if chosen is not None and 0 <= chosen < self.count else None

    @cached_property
    def weights(self) -> Float64[np.ndarray, "n"] | None:
        """How strongly each fragment is lit, 0..1: the chosen one, or by the clicked pixel; None for all."""
        if self.fragment is not None:
            return np.eye(1, self.count, self.fragment)[0]
        if self.cell is not None and len(self.cell.probabilities):
            b = self.cell.probabilities.astype(np.float64)
            return b / max(float(b.max()), 1e-9)
        return None

    @cached_property
    def candidates(self) -> tuple[Float64[np.ndarray, "k 3"], Float64[np.ndarray, "k"]] | None:
        """3D points of the clicked cell on its likely fragments (above tau_b), and their b relative to the highest."""
        fragments = self.recording.fragments
        if self.cell is None or self.weights is None or fragments is None or fragments.points_in_model is None:
            return None
        b = self.cell.probabilities.astype(np.float64)
        share = b / max(float(b.max()), 1e-9)
        kept = np.flatnonzero(share > self.thresholds.tau_b)
        points = fragments.points_in_model[self.cell.row, kept].astype(np.float64)
        good = np.isfinite(points).all(axis=1)
        return points[good], share[kept][good]
