"""HashMatch in a recording: how candidates thin out, and what became of any window of the image.

    recorded = RecordedMatching(reader, lambda obj_id: dataset.model(obj_id, "display"))
    report = recorded.window_at(320, 240)
    print(report.verdict)

Counts, votes and tests are recorded. The points of the tests are, too, for the best detections; for other windows they
are computed again from the recorded image and the model, which gives the same as the run. Pictures of templates are
rendered.
"""

import json
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Integer

from pipeline.exceptions import InputError
from pipeline.hashmatch import pictures
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.pictures import Pictures
from pipeline.hashmatch.points_of_tests import PointsOfTests, points_at_window
from pipeline.hashmatch.reading.maps import RecordedMaps
from pipeline.hashmatch.reading.objects import RecordedObjects
from pipeline.hashmatch.reading.one_template import one_template
from pipeline.hashmatch.reading.report import STAGES_OF_WINDOWS, SizeRange, TemplateVotes, WindowReport
from pipeline.hashmatch.reading.stages import RecordedStages, StageCount
from pipeline.hashmatch.reading.tables import RecordedTables
from pipeline.hashmatch.templates import Templates
from pipeline.hashmatch.window_grid import center_of, corner_at, window_box
from pipeline.kept_settings import settings_of
from pipeline.recording import Heatmap, RecordingReader, Table, Text
from pipeline.scene import Model

__all__ = [
    "Pictures", "PointsOfTests", "RecordedMatching", "SizeRange", "StageCount", "TemplateVotes", "WindowReport",
    "is_recorded",
]  # fmt: skip

_NEEDED = ("hashmatch/settings", "hashmatch/stages", "hashmatch/votes", "hashmatch/edgels", "image/depth")


def is_recorded(reader: RecordingReader) -> bool:
    """Whether a recording has all that `RecordedMatching` reads."""
    return set(_NEEDED) <= set(reader.kinds())


class RecordedMatching:
    """What a recording says about HashMatch; keeps the maps that it makes, so keep one per recording."""

    def __init__(self, reader: RecordingReader, model_of: Callable[[int], Model] | None = None) -> None:
        """Take a recording for which `is_recorded`; raises as `RecordingReader.read` for others.

        Args:
            reader: The recording.
            model_of: Models by object id, with their colours; needed for pictures of templates, and for the points of
                tests that were not recorded.

        """
        settings = json.loads(reader.read("hashmatch/settings", Text).text)
        self.config = settings_of(HashMatchConfig, settings["config"])
        self.edgels_needed: float = settings["edgels_needed"]
        """theta."""
        self.edgel_threshold_m: float = settings["edgel_threshold_m"]
        """tau."""
        self.focal_px: float = settings["focal_px"]
        """Of the templates."""
        self._reader = reader
        self._model_of = model_of
        self._stages = RecordedStages(reader)
        self._maps = RecordedMaps(reader, self.config, self.edgel_threshold_m)
        self.scales: dict[int, float] = self._stages.scales
        """s_w by level."""
        self.levels: tuple[int, ...] = tuple(self.scales)
        """Indices of the levels of the pyramid, smallest first."""
        places = {level: self._maps.place(level) for level in self.levels}
        self._tables = RecordedTables(reader, dict(places), self.config.matches_needed)
        self._objects = RecordedObjects(reader)
        self._templates: dict[tuple[int, int], tuple[Templates, int]] = {}

    def stage_counts(self, level: int | None = None) -> dict[str, StageCount]:
        """What each stage leaves, in the order of the cascade; of one level, or of all together."""
        return self._stages.counts(level)

    def heatmap(self, stage: str, level: int | None = None) -> Heatmap | None:
        """Candidates per pixel after a stage, summed, or at one level; None where none is left at the level."""
        return self._stages.heatmap(stage, level)

    def window_at(self, u: float, v: float, level: int | None = None) -> WindowReport:
        """What became of the window whose centre is nearest to a pixel.

        Args:
            u: Column in the image.
            v: Row in the image.
            level: Of the pyramid; None takes, of the windows about the pixel at all levels, the one that came farthest.

        Raises:
            InputError: the pixel is not in the image.
            UnknownIdError: there is no such level.

        """
        camera = self._maps.camera
        if not (-0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5):
            size = f"{camera.width} x {camera.height}"
            raise InputError(f"pixel ({u:g}, {v:g}) is not in the image of {size} pixels; click into it")
        if level is not None:
            return self._report(level, self._nearest(self._stages.known(level), (u, v)))
        around = [(x, y) for y in (0, -1, 1) for x in (0, -1, 1)]
        reports = [
            self._report(index, self._nearest(index, (u, v), steps)) for index in self.levels for steps in around
        ]
        return max(reports, key=self._progress)

    def window_of(self, detection: int) -> WindowReport:
        """What became of the window of a detection. Raises UnknownIdError if there is no such detection."""
        found = self._tables.detection(detection)
        level = int(found["level"])
        return self._report(level, corner_at(self._maps.place(level), found["pixels"].astype(float)))

    def test_points(self, report: WindowReport, vote: TemplateVotes) -> PointsOfTests:
        """The points of the tests of a template in a window; recorded ones for the best detections.

        Raises InputError if a model that is needed cannot be had.
        """
        path = f"hashmatch/tests/{vote.detection}"
        if vote.detection is not None and path in self._reader.kinds():
            columns = self._reader.read(path, Table).columns
            return PointsOfTests(**{name: columns[name] for name in PointsOfTests._fields})
        own, row = self._template(vote.obj_id, vote.template)
        level = self._maps.level(report.level)
        scale = level.scale * self._maps.base.focal_px / own.focal_px
        return points_at_window(own, level, scale, row, np.array(report.corner), self.config)

    def window_pictures(self, report: WindowReport) -> Pictures:
        """The window in colour, distance, normals and gradients."""
        place = self._maps.place(report.level)
        corner = np.array(report.corner)
        return pictures.window_pictures(self._maps.base, place.scale, place.size, corner, self.config)

    def template_pictures(self, obj_id: int, template: int) -> Pictures:
        """A template in the same; raises InputError if its model cannot be had."""
        rotation = self._objects.rotation(obj_id, template)
        threshold = self.config.template_gradient_threshold
        return pictures.template_pictures(self._model(obj_id), rotation, self.focal_px, threshold)

    def template_pose(self, obj_id: int, template: int) -> Float[np.ndarray, "4 4"]:
        """P_t: camera_from_model of a template before its own camera, metres."""
        return self._objects.pose(obj_id, template)

    def _report(self, level: int, corner: Integer[np.ndarray, "2"]) -> WindowReport:
        place = self._maps.place(level)
        center = center_of(place, corner)
        distances = self._maps.distances(level, corner)
        row = self._tables.row_of_window(level, corner)
        return WindowReport(
            level=level,
            scale=place.scale,
            center=(float(center[0]), float(center[1])),
            box=window_box(center, place.scale),
            corner=(int(corner[0]), int(corner[1])),
            edgels=self._maps.edgels(level, corner),
            edgels_needed=self.edgels_needed,
            distances=tuple(distances.astype(float).round(4).tolist()),
            sizes=self._objects.sizes(level, distances),
            candidates=0 if row is None else int(self._tables.windows["count"][row]),
            votes=() if row is None else self._tables.votes_of(row),
            matches_needed=self.config.matches_needed,
            votes_needed=self.config.votes_needed,
        )

    def _nearest(
        self, level: int, pixel: tuple[float, float], steps: tuple[int, int] = (0, 0)
    ) -> Integer[np.ndarray, "2"]:
        """First pixel of the window nearest to a pixel, or of one so many steps beside it."""
        place = self._maps.place(level)
        corner = place.nearest_corner(corner_at(place, np.array(pixel, float)))
        return place.nearest_corner(corner + np.array(steps) * place.step)

    def _progress(self, report: WindowReport) -> tuple[float, ...]:
        """How far a window came; what came equally far is compared by score, tests, votes and edgels."""
        best = report.farthest
        if best is None:
            return STAGES_OF_WINDOWS.index(report.stage), 0, 0, 0, report.edgels
        score = 0.0 if best.detection is None else float(self._tables.detections["score"][best.detection])
        tests = best.failed_test + sum(best.fractions)
        return STAGES_OF_WINDOWS.index(report.stage), score, tests, best.votes, report.edgels

    def _template(self, obj_id: int, template: int) -> tuple[Templates, int]:
        """A template and its row among those that come with it."""
        if (obj_id, template) not in self._templates:
            rotation, colored = self._objects.rotation(obj_id, template), self._objects.colored(obj_id)
            made = one_template(self._model(obj_id), rotation, self.config, self.focal_px, colored)
            self._templates[obj_id, template] = made
        return self._templates[obj_id, template]

    def _model(self, obj_id: int) -> Model:
        if self._model_of is None:
            raise InputError(f"object {obj_id}: its model is needed to draw a template; open the run with its dataset")
        return self._model_of(obj_id)
