"""What an evaluation of any task comes to: its scores under BOP's names, for a JSON file and for tables."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Int

from pipeline.bop.results import Results

Task = Literal["localization", "siso", "detection", "bbox", "segm"]
"""6D localization since 2019; that of 2017; 6D detection; 2D detection by boxes, or by masks."""

Named = Mapping[str, float | None]
"""Scores by name; None where one is not known."""


@dataclass(frozen=True)
class Summary:
    """The scores of one results file on one dataset split."""

    dataset: str
    split: str
    task: Task
    method: str
    scores: Named
    """0..1, but for 2D detection -1 where COCO has nothing to measure."""
    per_object: Mapping[int, Named]
    per_scene: Mapping[int, Named]
    targets: int
    """Number of instances (2017: of pairs of an image and an object) that the method had to find."""
    targets_per_object: Mapping[int, int]
    seconds: float
    """Spent on the evaluation."""
    time_per_image: float | None = None
    """Mean seconds that the method took for an image; None where it does not tell."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Why a score is None, by its name."""
    incomplete: str = ""
    """What is missing of the targets on which methods are compared; empty where all are here."""
    notes: tuple[str, ...] = ()
    """What is to be known beside the numbers, one line each."""

    def as_dict(self) -> dict[str, Any]:
        """What goes into a JSON file."""
        content = {
            "dataset": self.dataset,
            "method": self.method,
            "scores": dict(self.scores),
            "per_object": {str(i): dict(scores) for i, scores in self.per_object.items()},
            "targets": self.targets,
            "seconds": self.seconds,
            "split": self.split,
            "task": self.task,
            "per_scene": {str(i): dict(scores) for i, scores in self.per_scene.items()},
            "targets_per_object": {str(i): count for i, count in self.targets_per_object.items()},
            "average_time_per_image": self.time_per_image,
            "incomplete": self.incomplete,
            "notes": list(self.notes),
        }
        return content | ({"reasons": dict(self.reasons)} if self.reasons else {})


def time_per_image(results: Results) -> float | None:
    """Mean over images of the seconds that a method took, as BOP's scripts take it: that of an image's first row.

    None where there are no rows, or a row says that its time was not measured (-1).
    """
    if not len(results) or (results.time_s < 0).any():
        return None
    first = np.unique(image_numbers(results.scene_id, results.im_id), return_index=True)[1]
    return float(results.time_s[first].mean())


def image_numbers(scene_id: Int[np.ndarray, "n"], im_id: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """One number for each pair of ids below 2^31, in the order of scenes and images."""
    return scene_id.astype(np.int64) << 31 | im_id


def counts(ids: np.ndarray) -> dict[int, int]:
    """How often each id occurs, by id."""
    return dict(zip(*(array.tolist() for array in np.unique(ids, return_counts=True)), strict=True))
