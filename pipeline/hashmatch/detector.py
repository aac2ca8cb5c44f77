"""The cascade over the windows of an image: objectness, hashing, verification, non-maxima suppression."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.config import TEMPLATE_SIZE, HashMatchConfig
from pipeline.hashmatch.hashing import HashTables, build_tables
from pipeline.hashmatch.nms import ranking_scores, suppress
from pipeline.hashmatch.poses import centroid_distance, pose_at_window
from pipeline.hashmatch.pyramid import Base, Level, level_indices, make_level, prepare
from pipeline.hashmatch.template_store import TemplateStore, size_ranges, store
from pipeline.hashmatch.templates import Templates
from pipeline.hashmatch.verification import Verified, objects_of_size, verify
from pipeline.hashmatch.voting import Candidates, vote
from pipeline.scene import Image

_CHUNK = 4096
"""Windows that a thread takes at once."""

_MOST_DETECTIONS = 20_000
"""Verified candidates of an object that non-maxima suppression looks at; the best ones."""


@dataclass(frozen=True, eq=False)
class LevelMatches:
    """What the stages made of the windows of one level."""

    level: Level
    scale: float
    """s_w times the focal length of the templates by that of the image."""
    windows: Integer[np.ndarray, "n 2"]
    """All windows: first pixel (x, y) in the maps of the level."""
    edgel_counts: Integer[np.ndarray, "n"]
    foreground: Integer[np.ndarray, "f"]
    """Rows of the windows that pass objectness."""
    hashed: Integer[np.ndarray, "k"]
    """Rows of those that were hashed: some object is of the right size there (T1, which depends on no template)."""
    allowed: Bool[np.ndarray, "k o"]
    """Which objects are, in each of these."""
    candidates: Candidates
    """`windows` are rows of `self.windows`."""
    verified: Verified


@dataclass(frozen=True, eq=False)
class Detections:
    """Verified candidates of all levels, best first."""

    objects: Integer[np.ndarray, "n"]
    """Position in the detector's list of objects."""
    templates: Integer[np.ndarray, "n"]
    """Row in the object's templates."""
    levels: Integer[np.ndarray, "n"]
    """Index of the level of the pyramid."""
    scales: Float[np.ndarray, "n"]
    """s_w."""
    centers: Float[np.ndarray, "n 2"]
    """(u_w, v_w): pixels of the image."""
    boxes: Float[np.ndarray, "n 4"]
    """x0, y0, x1, y1 of the silhouette in the image, pixels."""
    votes: Integer[np.ndarray, "n"]
    fractions: Float[np.ndarray, "n 4"]
    """c_2 to c_5."""
    shifts: Float[np.ndarray, "n"]
    """Metres; median of measured minus template distance."""
    ranking: Float[np.ndarray, "n"]
    """r = c (a / s)."""
    suppressed_by: Integer[np.ndarray, "n"]
    """Row of the detection that suppressed it; its own where it is kept."""

    def __len__(self) -> int:
        return len(self.objects)

    @property
    def kept(self) -> Integer[np.ndarray, "k"]:
        """Rows that non-maxima suppression keeps, best first."""
        return np.flatnonzero(self.suppressed_by == np.arange(len(self)))


@dataclass(frozen=True, eq=False)
class Matching:
    """All that the cascade found in an image."""

    base: Base
    levels: tuple[LevelMatches, ...]
    detections: Detections
    edgels_needed: float
    """theta."""
    seconds: dict[str, float] = field(default_factory=dict)
    """By stage, of all threads together."""


class Detector:
    """Finds templates of some objects in images; safe to use from several threads."""

    def __init__(self, objects: Sequence[Templates], config: HashMatchConfig) -> None:
        """Make the hash tables. Takes some seconds for ten thousands of templates."""
        self.objects = tuple(objects)
        self.config = config
        self.tables: HashTables = build_tables(self.objects, config)
        self.points: TemplateStore = store(self.objects, config)
        self.edgel_threshold = config.edgel_threshold * min(own.diameter for own in self.objects)
        """tau, metres."""
        self.edgels_needed = config.edgel_share * min(own.edgels for own in self.objects)
        """theta."""

    def nbytes(self) -> int:
        """Memory that the templates and tables take."""
        shared = sum(value.nbytes for value in vars(self.points).values())
        return self.tables.nbytes() + shared + sum(own.nbytes() for own in self.objects)

    def match(
        self, image: Image, wanted: Bool[np.ndarray, "o"] | None = None, masked: Bool[np.ndarray, "h w"] | None = None
    ) -> Matching:
        """Run the cascade for the wanted objects (all, by default). Raises InputError for images that do not do.

        Args:
            image: With depth.
            wanted: Which objects, by position.
            masked: Pixels to leave out, as they show what is known already.

        """
        seconds: dict[str, float] = {}
        begun = perf_counter()
        base = prepare(image, self.edgel_threshold, masked)
        chosen = np.ones(len(self.objects), bool) if wanted is None else wanted
        sought = [own for own, yes in zip(self.objects, chosen, strict=True) if yes]
        indices = level_indices(base, sought, self.config)
        threads = self.config.threads or len(os.sched_getaffinity(0))
        with ThreadPoolExecutor(threads) as pool:
            levels = list(pool.map(lambda index: make_level(base, index, self.config), indices))
            seconds["pyramid"] = perf_counter() - begun
            matched = tuple(self._match_level(base, level, chosen, pool, seconds) for level in levels)
        begun = perf_counter()
        detections = self._detections(base, matched)
        seconds["nms"] = perf_counter() - begun
        return Matching(base, matched, detections, self.edgels_needed, seconds)

    def pose(self, matching: Matching, row: int, measured: bool = False) -> Float[np.ndarray, "4 4"]:
        """P_{t,w} of a detection; with `measured` at the distance that the depth image says (T4's med_delta)."""
        found, base = matching.detections, matching.base
        own = self.objects[found.objects[row]]
        distance = centroid_distance(own, float(found.scales[row]), base.focal_px)
        if measured and np.isfinite(found.shifts[row]):
            distance = max(own.distance + float(found.shifts[row]), 0.1 * own.diameter)
        return pose_at_window(own, int(found.templates[row]), base.image.camera.K, found.centers[row], distance)

    def _match_level(
        self, base: Base, level: Level, wanted: np.ndarray, pool: ThreadPoolExecutor, seconds: dict[str, float]
    ) -> LevelMatches:
        begun = perf_counter()
        scale = level.scale * base.focal_px / self.objects[0].focal_px
        windows = level.windows(self.config.window_step_px)
        counts = level.edgel_counts(windows)
        foreground = np.flatnonzero(counts > self.edgels_needed)
        ranges = size_ranges(self.points, scale, self.config.scale_factor)
        allowed = objects_of_size(level, windows[foreground], ranges) & wanted
        hashed = foreground[allowed.any(axis=1)]
        allowed = allowed[allowed.any(axis=1)]
        _add(seconds, "objectness", begun)
        parts = [slice(i, i + _CHUNK) for i in range(0, len(hashed), _CHUNK)]

        def evaluate(part: slice) -> tuple[Candidates, Verified, float, float]:
            begun = perf_counter()
            own = windows[hashed[part]]
            votes = vote(self.tables, level.distance, level.normal_bins, own, allowed[part], self.config)
            between = perf_counter()
            verified = verify(self.points, level, own, votes, scale, self.config)
            candidates = votes._replace(windows=hashed[part][votes.windows])
            return candidates, verified, between - begun, perf_counter() - between

        candidates, verified, voting, testing = zip(*pool.map(evaluate, parts), strict=True) if parts else ((),) * 4
        seconds["hashing"] = seconds.get("hashing", 0.0) + sum(voting)
        seconds["verification"] = seconds.get("verification", 0.0) + sum(testing)
        return LevelMatches(
            level, scale, windows, counts, foreground, hashed, allowed,
            _joined_candidates(candidates), _joined_verified(verified),
        )  # fmt: skip

    def _detections(self, base: Base, matched: Sequence[LevelMatches]) -> Detections:
        parts = [self._of_level(own) for own in matched]
        columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}
        best_first = np.argsort(-columns["ranking"], kind="stable")
        rows_of = [np.flatnonzero(columns["objects"][best_first] == o) for o in range(len(self.objects))]
        best_first = best_first[np.sort(np.concatenate([rows[:_MOST_DETECTIONS] for rows in rows_of]))]
        columns = {name: values[best_first] for name, values in columns.items()}
        together = not self.config.refine and self.config.task == "detection"
        groups = np.zeros_like(columns["objects"]) if together else columns["objects"]
        found = suppress(columns["ranking"], columns["boxes"], groups, self.config.overlap)
        return Detections(**columns, suppressed_by=found.by)

    def _of_level(self, own: LevelMatches) -> dict[str, np.ndarray]:
        """Columns of the verified candidates of a level."""
        rows = np.flatnonzero(own.verified.failed == 0)
        templates = own.candidates.templates[rows]
        windows = own.windows[own.candidates.windows[rows]]
        objects = self.tables.objects[templates]
        local = templates - self.tables.firsts[objects]
        areas, boxes = np.zeros(len(rows), np.int64), np.zeros((len(rows), 4))
        for position in np.unique(objects):
            its = objects == position
            areas[its] = self.objects[position].areas[local[its]]
            boxes[its] = self.objects[position].boxes[local[its]]
        offset = np.tile(windows - own.level.overhang, 2)
        scales = np.full(len(rows), own.level.scale)
        return {
            "objects": objects,
            "templates": local,
            "levels": np.full(len(rows), own.level.index),
            "scales": scales,
            "centers": own.level.centers(windows),
            "boxes": (boxes + offset) / own.level.scale,
            "votes": own.candidates.votes[rows],
            "fractions": own.verified.fractions[rows],
            "shifts": own.verified.shifts[rows],
            "ranking": ranking_scores(
                own.verified.scores[rows].astype(float), areas * own.verified.known[rows], scales
            ),
        }


def window_box(center: Float[np.ndarray, "2"], scale: float) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of a window in the image, pixels."""
    half = TEMPLATE_SIZE / 2 / scale
    return center[0] - half, center[1] - half, center[0] + half, center[1] + half


def _add(seconds: dict[str, float], stage: str, begun: float) -> None:
    seconds[stage] = seconds.get(stage, 0.0) + perf_counter() - begun


def _joined_candidates(parts: Sequence[Candidates]) -> Candidates:
    if not parts:
        return Candidates(*(np.zeros(0, np.int32) for _ in range(3)))
    return Candidates(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _joined_verified(parts: Sequence[Verified]) -> Verified:
    if not parts:
        return Verified(np.zeros(0, np.uint8), np.zeros((0, 4), np.float32), *np.zeros((2, 0), np.float32))
    return Verified(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
