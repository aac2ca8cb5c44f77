"""Recall by the average distance AD: ADD, or ADI where views are ambiguous, below 10 % of the diameter.

It is the criterion of the tables for Linemod and T-LESS before BOP (thesis secs. rel_eval, iros15_localization and
tless_6d_loc_eval). The thesis writes both e <= 0.1 d and "below 10 % of the diameter"; BOP's scripts compare with <,
and so does this.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from pipeline.bop.dataset import Dataset

THETA = 0.1
"""Threshold of correctness, as a fraction of the diameter."""


@dataclass(frozen=True)
class AdRecalls:
    """Shares of the instances that are found by AD, 0..1."""

    recall: float
    """Of all instances, each of the same weight."""
    mean_over_objects: float
    """Mean of the recalls of the objects, as the tables give it."""
    per_object: dict[int, float]
    """By object id."""


def is_symmetric(dataset: Dataset, obj_id: int) -> bool:
    """Whether ADI is to be used for an object: its views are ambiguous.

    Which objects of BOP's datasets are (Linemod: 3, 7, 10, 11; T-LESS: all) stands in `datasets.toml`. Any other
    object is if its model has symmetries.
    """
    if obj_id in dataset.facts.obj_ids:
        return obj_id in dataset.facts.symmetric_obj_ids
    return len(dataset.model(obj_id).symmetries) > 1


def ad_recalls(found: Bool[np.ndarray, "n"], obj_id: Int[np.ndarray, "n"]) -> AdRecalls:
    """Recalls of instances of which it is known whether they are found, and of which object they are."""
    per_object = {int(i): float(found[obj_id == i].mean()) for i in np.unique(obj_id)}
    return AdRecalls(float(found.mean()), float(np.mean(list(per_object.values()))), per_object)
