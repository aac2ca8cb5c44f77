"""From what the network predicts to potential 2D-3D correspondences (thesis sec. epos_establish_coords)."""

import numpy as np

from pipeline.epos.config import CorrespondenceConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fragments import Fragments
from pipeline.epos.grid import cell_pixels
from pipeline.epos.prediction import ObjectPrediction
from pipeline.exceptions import InputError


def establish(
    prediction: ObjectPrediction, fragments: Fragments, config: CorrespondenceConfig | None = None
) -> PotentialCorrespondences:
    """Link each cell with a point on all fragments that are likely enough: many to many, cell by cell.

    A fragment counts where a_o > tau_a and b_of / max_i b_oi > tau_b; the point is h r + g, the confidence s = a b.

    Raises:
        InputError: the prediction is about another number of fragments.

    """
    config = config or CorrespondenceConfig()
    found = prediction.fragment_probability.shape[1]
    if found != len(fragments):
        raise InputError(
            f"object {prediction.obj_id}: the network predicts {found} fragments, the object has {len(fragments)}; "
            "use the fragments that it was trained with"
        )
    a, b = prediction.object_probability, prediction.fragment_probability
    highest = b.max(axis=1, initial=0.0, keepdims=True)
    linked = (b > config.min_fragment_probability * highest) & (a > config.min_object_probability)[:, None]
    rows, ids = np.nonzero(linked)
    coordinates = prediction.coordinates[rows, ids].astype(np.float64)
    if not config.regression:
        coordinates = np.zeros_like(coordinates)
    cells = prediction.cells[rows]
    return PotentialCorrespondences(
        prediction.obj_id,
        cell_pixels(cells),
        fragments.points(ids, coordinates),
        a[rows].astype(np.float64) * b[rows, ids],
        cells[:, 1] * prediction.grid[1] + cells[:, 0],
        ids,
    )
