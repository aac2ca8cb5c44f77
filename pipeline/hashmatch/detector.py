"""The cascade over the windows of an image: objectness, hashing, verification, non-maxima suppression."""

import os
from collections import defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import thread_time

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.detections import detections_of
from pipeline.hashmatch.hashing import HashTables, build_tables
from pipeline.hashmatch.level import Level
from pipeline.hashmatch.matching import Detections, LevelMatches, Matching
from pipeline.hashmatch.poses import centroid_distance, pose_at_window
from pipeline.hashmatch.pyramid import Base, level_indices, make_level, prepare
from pipeline.hashmatch.template_store import TemplateStore, size_ranges, store
from pipeline.hashmatch.templates import Templates
from pipeline.hashmatch.verification import Verified, objects_of_size, verify
from pipeline.hashmatch.voting import Candidates, vote
from pipeline.scene import Image

__all__ = ["Detections", "Detector", "LevelMatches", "Matching"]

_CHUNK = 2048
"""Windows that a thread takes at once."""


@dataclass(frozen=True, eq=False)
class _Screened:
    """The windows of a level, and those that are hashed; see `LevelMatches`."""

    level: Level
    scale: float
    windows: Integer[np.ndarray, "n 2"]
    edgel_counts: Integer[np.ndarray, "n"]
    foreground: Integer[np.ndarray, "f"]
    hashed: Integer[np.ndarray, "k"]
    allowed: Bool[np.ndarray, "k o"]


class Detector:
    """Finds templates of some objects in images; safe to use from several threads."""

    def __init__(self, objects: Sequence[Templates], config: HashMatchConfig) -> None:
        """Make the hash tables. Takes some seconds for ten thousands of templates."""
        self.objects = tuple(objects)
        self.config = config.for_templates(sum(map(len, self.objects)) / len(self.objects))
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
        begun = thread_time()
        base = prepare(image, self.edgel_threshold, masked)
        chosen = np.ones(len(self.objects), bool) if wanted is None else wanted
        sought = [own for own, yes in zip(self.objects, chosen, strict=True) if yes]
        indices = level_indices(base, sought, self.config)
        spent = [("pyramid", thread_time() - begun)]
        threads = self.config.threads or len(os.sched_getaffinity(0))
        with ThreadPoolExecutor(threads) as pool:
            # largest levels first, so that no thread waits for another at the end
            screened = list(pool.map(lambda index: self._screen(base, index, chosen, spent), indices[::-1]))[::-1]
            evaluated = [
                [
                    pool.submit(self._evaluate, own, slice(i, i + _CHUNK), spent)
                    for i in range(0, len(own.hashed), _CHUNK)
                ]
                for own in screened
            ]
            # with many objects the parts take hundreds of megabytes: each level's go when they are joined
            matched = tuple(_joined(own, [part.result() for part in evaluated.pop(0)]) for own in screened)
        begun = thread_time()
        detections = detections_of(self.objects, matched, self.config)
        spent.append(("nms", thread_time() - begun))
        return Matching(base, matched, detections, self.edgels_needed, _summed(spent))

    def pose(self, matching: Matching, row: int, measured: bool = False) -> Float[np.ndarray, "4 4"]:
        """P_{t,w} of a detection; with `measured` at the distance that the depth image says (T4's med_delta)."""
        found, base = matching.detections, matching.base
        own = self.objects[found.objects[row]]
        distance = centroid_distance(own, float(found.scales[row]), base.focal_px)
        if measured and np.isfinite(found.shifts[row]):
            distance = max(own.distance + float(found.shifts[row]), 0.1 * own.diameter)
        return pose_at_window(own, int(found.templates[row]), base.image.camera.K, found.centers[row], distance)

    def _screen(
        self, base: Base, index: int, wanted: Bool[np.ndarray, "o"], spent: list[tuple[str, float]]
    ) -> _Screened:
        """Make a level and leave out windows without edgels, and those where no wanted object is of the right size."""
        begun = thread_time()
        level = make_level(base, index, self.config)
        made = thread_time()
        scale = level.scale * base.focal_px / self.objects[0].focal_px
        windows = level.windows(self.config.window_step_px)
        counts = level.edgel_counts(windows)
        foreground = np.flatnonzero(counts > self.edgels_needed).astype(np.int32)
        ranges = size_ranges(self.points, scale, self.config.scale_factor)
        allowed = objects_of_size(level, windows[foreground], ranges) & wanted
        some = allowed.any(axis=1)
        spent += ("pyramid", made - begun), ("objectness", thread_time() - made)
        return _Screened(level, scale, windows, counts, foreground, foreground[some], allowed[some])

    def _evaluate(self, own: _Screened, part: slice, spent: list[tuple[str, float]]) -> tuple[Candidates, Verified]:
        """Vote for and verify templates at some of the windows of a level."""
        begun = thread_time()
        level, rows = own.level, own.hashed[part]
        windows = own.windows[rows]
        voted = vote(self.tables, level.distance, level.normal_bins, windows, own.allowed[part], self.config)
        between = thread_time()
        verified = verify(self.points, level, windows, voted, own.scale, self.config)
        spent += ("hashing", between - begun), ("verification", thread_time() - between)
        return voted._replace(windows=rows[voted.windows]), verified


def _joined(own: _Screened, parts: Sequence[tuple[Candidates, Verified]]) -> LevelMatches:
    """The windows of a level with the candidates of all its parts."""
    if not parts:
        candidates = Candidates(*(np.zeros(0, np.int32) for _ in range(3)))
        verified = Verified(np.zeros(0, np.uint8), np.zeros((0, 4), np.float32), *np.zeros((2, 0), np.float32))
        return LevelMatches(**vars(own), candidates=candidates, verified=verified)
    voted, tested = zip(*parts, strict=True)
    failed, shifts, known = (
        np.concatenate([getattr(part, name) for part in tested]) for name in ("failed", "shifts", "known")
    )
    # few pass, so hardly any of this memory is ever touched
    fractions = np.zeros((len(failed), 4), np.float32)
    fractions[failed == 0] = np.concatenate([part.fractions[part.failed == 0] for part in tested])
    candidates = Candidates(*(np.concatenate(columns) for columns in zip(*voted, strict=True)))
    return LevelMatches(**vars(own), candidates=candidates, verified=Verified(failed, fractions, shifts, known))


def _summed(spent: Iterable[tuple[str, float]]) -> dict[str, float]:
    seconds: defaultdict[str, float] = defaultdict(float)
    for stage, time in spent:
        seconds[stage] += time
    return dict(seconds)
