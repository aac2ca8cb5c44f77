"""What was recorded of HashMatch for one image, as far as it was: read when it is asked for, and kept."""

from collections.abc import Mapping
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from inspector.hashmatch.choice import FOLLOWED, HashMatchChoice
from inspector.hashmatch.refinement import Refinement, number_of, numbers_of_estimates, read_refinement
from pipeline.bop.dataset import Dataset
from pipeline.explaining import Explanation, recorded_explanations
from pipeline.hashmatch.window_report import (
    Pictures,
    PointsOfTests,
    RecordedMatching,
    TemplateVotes,
    WindowReport,
    is_recorded,
)
from pipeline.recording import ColorImage, RecordingReader, Table
from pipeline.scene import PoseEstimate

SAME_PLACE = 0.01
"""Pixels within which two windows are the same."""
WINDOWS_KEPT = 32
TEMPLATES_KEPT = 128
"""Pictures of templates kept; 200 kB each."""


class ChosenWindow(NamedTuple):
    """A window with its templates."""

    report: WindowReport
    votes: tuple[TemplateVotes, ...]
    """Of the window's templates those that were recorded, and that of the detection."""
    position: int
    """Of the template that is looked at; -1 where the window has none."""
    followed: int = -1
    """Of the template that the trace of the row's instance is about; -1 where that is about another window."""

    @property
    def vote(self) -> TemplateVotes | None:
        """The template that is looked at."""
        return self.votes[self.position] if self.position >= 0 else None


class ImageRecord:
    """The recording of an image, of a run that may be HashMatch's."""

    def __init__(self, reader: RecordingReader, dataset: Dataset) -> None:
        self.reader = reader
        self._dataset = dataset
        self.window_pictures = lru_cache(WINDOWS_KEPT)(self._window_pictures)
        """By a window's level and corner."""
        self.template_pictures = lru_cache(TEMPLATES_KEPT)(self._template_pictures)
        """By object and number."""
        self.points = lru_cache(WINDOWS_KEPT)(self._points)
        """Of the tests of a template in a window."""
        self._refinements: dict[int, Refinement] = {}
        self._window = lru_cache(WINDOWS_KEPT)(self._find_window)

    @cached_property
    def matching(self) -> RecordedMatching | None:
        """The cascade; None where the run did not record it."""
        return RecordedMatching(self.reader, self._model) if is_recorded(self.reader) else None

    @cached_property
    def explanations(self) -> dict[int, Explanation]:
        """Why annotated instances were found or lost, by index; empty where that was not recorded."""
        return recorded_explanations(self.reader)

    def explanation(self, gt_index: int) -> Explanation | None:
        """That of an instance."""
        return self.explanations.get(gt_index)

    @cached_property
    def rgb(self) -> UInt8[np.ndarray, "h w 3"]:
        """The image that the method was given; gray where it had no colour."""
        if "image/rgb" in self.reader.kinds():
            return self.reader.read("image/rgb", ColorImage).rgb
        camera = self.reader.view.camera
        assert camera is not None
        return np.full((camera.height, camera.width, 3), 60, np.uint8)

    @cached_property
    def estimates(self) -> dict[int, PoseEstimate]:
        """Estimates by number."""
        numbers = numbers_of_estimates(self.reader)
        return {number: self.reader.read(f"estimates/{number}", PoseEstimate) for number in numbers}

    def number_of(self, wanted: PoseEstimate | None) -> int | None:
        """Number of a row of the results; None where it is not among the recorded estimates."""
        return number_of(self.estimates, wanted)

    def refinement(self, number: int | None) -> Refinement | None:
        """How an estimate was refined; None where there is no such estimate."""
        if number not in self.estimates:
            return None
        if number not in self._refinements:
            self._refinements[number] = read_refinement(self.reader, number)
        return self._refinements[number]

    def window(self, choice: HashMatchChoice, gt_index: int = -1) -> ChosenWindow | None:
        """The window that is chosen; None for none. InputError where there is no such pixel, level or detection.

        The template that was followed for an annotated instance (`gt_index`) is among its templates.
        """
        if self.matching is None or not choice.has_window or not choice.is_of(self.reader.key):
            return None
        report, votes, usual = self._window(choice.pixel, choice.level, choice.detection)
        votes, followed = self._with_followed(report, votes, gt_index)
        if choice.template is None or (choice.template == FOLLOWED and followed < 0):
            position = usual
        else:
            position = followed if choice.template == FOLLOWED else min(max(choice.template, 0), len(votes) - 1)
        return ChosenWindow(report, votes, position, followed)

    def has_points(self, vote: TemplateVotes) -> bool:
        """Whether the points of the tests were recorded; else they have to be computed again."""
        return f"hashmatch/tests/{vote.detection}" in self.reader.kinds()

    @cached_property
    def detections(self) -> Mapping[str, np.ndarray]:
        """Columns of the candidates that passed all tests, best first."""
        return self.reader.read("hashmatch/candidates/verification", Table).columns

    @cached_property
    def objects(self) -> dict[int, tuple[float, float]]:
        """Diameter, and distance of the templates' centroids (metres), by object id."""
        columns = self.reader.read("hashmatch/objects", Table).columns
        rows = zip(columns["object"], columns["diameter"], columns["distance"], strict=True)
        return {int(obj_id): (float(diameter), float(distance)) for obj_id, diameter, distance in rows}

    def colored(self, obj_id: int) -> bool:
        """Whether T5 is made for an object."""
        columns = self.reader.read("hashmatch/objects", Table).columns
        return bool(columns["colored"][columns["object"] == obj_id].any())

    def pose(self, report: WindowReport, vote: TemplateVotes) -> Float[np.ndarray, "4 4"]:
        """P_{t,w}: camera_from_model of a template at a window (thesis sec. HashMatch, refinement), metres.

        Its distance is that of its scale; that of a detection is what test T4 measured.
        """
        from pipeline.hashmatch.poses import rotation_to_ray

        matching, camera = self.matching, self.reader.view.camera
        assert matching is not None
        assert camera is not None
        diameter, usual = self.objects[vote.obj_id]
        distance = usual * report.scale * camera.K[0, 0] / matching.focal_px
        if vote.detection is not None and np.isfinite(shift := self.detections["shift"][vote.detection]):
            distance = max(usual + float(shift), 0.1 * diameter)
        turn = np.eye(4)
        turn[:3, :3] = rotation_to_ray(camera.K, np.array(report.center))
        pose = turn @ matching.template_pose(vote.obj_id, vote.template)
        pose[:3, 3] += turn[:3, 2] * (distance - usual)
        return pose

    def _with_followed(
        self, report: WindowReport, votes: tuple[TemplateVotes, ...], gt_index: int
    ) -> tuple[tuple[TemplateVotes, ...], int]:
        """Templates of a window with the one that the trace of an instance is about, and its position; -1 elsewhere."""
        explanation = self.explanation(gt_index)
        about = {} if explanation is None else explanation.details
        window, template = about.get("window"), about.get("template")
        if explanation is None or window is None or template is None or window["level"] != report.level:
            return votes, -1
        if not np.allclose((window["u"], window["v"]), report.center, atol=SAME_PLACE):
            return votes, -1
        for position, vote in enumerate(votes):
            if (vote.obj_id, vote.template) == (explanation.obj_id, template["row"]):
                return votes, position
        return (*votes, _followed(explanation.obj_id, about)), len(votes)

    def _find_window(
        self, pixel: tuple[float, float], level: int | None, detection: int | None
    ) -> tuple[WindowReport, tuple[TemplateVotes, ...], int]:
        """A window, its templates, and the position of the one to look at first."""
        matching = self.matching
        assert matching is not None
        if detection is None:
            report = matching.window_at(*pixel, level)
            best = report.farthest
            return report, report.votes, -1 if best is None else report.votes.index(best)
        report = matching.window_of(detection)
        found = [vote.detection for vote in report.votes]
        if detection in found:
            return report, report.votes, found.index(detection)
        return report, (*report.votes, self._vote_of(detection)), len(found)

    def _vote_of(self, detection: int) -> TemplateVotes:
        """A detection as one of the templates of its window; its rank is not recorded and 0."""
        row = {name: column[detection] for name, column in self.detections.items()}
        by = int(row["suppressed_by"])
        first, second, third, fourth = row["fractions"].astype(float).round(3).tolist()
        return TemplateVotes(
            obj_id=int(row["object"]),
            template=int(row["template"]),
            votes=int(row["votes"]),
            rank=0,
            failed_test=0,
            fractions=(first, second, third, fourth),
            missing=None,
            detection=detection,
            suppressed_by=None if by == detection else by,
        )

    def _window_pictures(self, report: WindowReport) -> Pictures:
        assert self.matching is not None
        return self.matching.window_pictures(report)

    def _template_pictures(self, obj_id: int, template: int) -> Pictures:
        assert self.matching is not None
        return self.matching.template_pictures(obj_id, template)

    def _points(self, report: WindowReport, vote: TemplateVotes) -> PointsOfTests:
        assert self.matching is not None
        return self.matching.test_points(report, vote)

    def _model(self, obj_id: int):
        return self._dataset.model(obj_id, "display")


def _followed(obj_id: int, about: Mapping[str, Any]) -> TemplateVotes:
    """A template that was followed for an annotated instance."""
    fractions = [float(test.get("fraction") or 0.0) for test in about["tests"][1:]]
    failed = int(about["failed_test"])
    needed = about["tests"][1]["needed"]
    return TemplateVotes(
        obj_id=obj_id,
        template=int(about["template"]["row"]),
        votes=int(about["votes"]["votes"]),
        rank=int(about["votes"]["rank"]),
        failed_test=failed,
        fractions=(fractions[0], fractions[1], fractions[2], fractions[3]),
        missing=round(needed - fractions[failed - 2], 3) if failed > 1 else None,
        detection=None,
        suppressed_by=None,
    )
