"""What a recording leads to with other thresholds: correspondences for other tau_a and tau_b, inliers for another tau_r.

Works on records alone, so also on those of other methods; quick enough to follow a slider.
"""

import numpy as np
from jaxtyping import Float, Float64, Int

from pipeline.epos.config import CorrespondenceConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences, correspondences_of_pixels
from pipeline.exceptions import InputError
from pipeline.geometry import transform_points
from pipeline.recording import Correspondences, Probabilities


def correspondences_from(
    fragments: Probabilities,
    obj_id: int,
    *,
    objects: Probabilities | None = None,
    centers: Float[np.ndarray, "n 3"] | None = None,
    config: CorrespondenceConfig | None = None,
) -> PotentialCorrespondences:
    """Potential correspondences of an object as `establish` finds them (thesis sec. epos_establish_coords).

    Args:
        fragments: b of the object, with the points that its fragments predict.
        obj_id: the object.
        objects: a, of which the class with the object's id as its label counts; where not given, a is 1.
        centers: g, metres, model frame; needed where `config` is without regression.
        config: tau_a, tau_b and whether to use the predicted points. Cells that were not recorded stay away at any tau_a.

    Raises:
        InputError: the record has no points, the object is none of the classes, or the centres are missing.

    """
    config = config or CorrespondenceConfig()
    a, b = object_probabilities(fragments, obj_id, objects), fragments.values.astype(np.float64)
    highest = b.max(axis=1, initial=0.0, keepdims=True)
    linked = (b > config.min_fragment_probability * highest) & (a > config.min_object_probability)[:, None]
    rows, ids = np.nonzero(linked)
    points = _points(fragments, obj_id, centers, config.regression, rows, ids)
    cells = fragments.cells[rows].astype(np.int64)
    pixels = cells * float(fragments.cell_px) + (fragments.cell_px - 1) / 2
    return PotentialCorrespondences(
        obj_id, pixels, points, a[rows] * b[rows, ids], cells[:, 1] * fragments.grid[1] + cells[:, 0], ids
    )


def object_probabilities(
    fragments: Probabilities, obj_id: int, objects: Probabilities | None
) -> Float64[np.ndarray, "k"]:
    """Look a of an object up at the cells of the record of its fragments; 1 where it was not recorded. Raises InputError."""
    if objects is None:
        return np.ones(len(fragments.cells))
    if str(obj_id) not in objects.labels:
        known = ", ".join(objects.labels)
        raise InputError(f"object {obj_id}: is not in the recorded object probabilities; available: {known}")
    if objects.grid != fragments.grid:
        raise InputError(f"object {obj_id}: fragments have a grid of {fragments.grid}, objects of {objects.grid}")
    dense = np.zeros(objects.grid)
    dense[objects.cells[:, 1], objects.cells[:, 0]] = objects.values[:, objects.labels.index(str(obj_id))]
    return dense[fragments.cells[:, 1], fragments.cells[:, 0]]


def potential(recorded: Correspondences) -> PotentialCorrespondences:
    """Recorded correspondences; those at the same coordinates share a pixel."""
    return correspondences_of_pixels(
        recorded.obj_id,
        recorded.pixels.astype(np.float64),
        recorded.points_in_model.astype(np.float64),
        recorded.confidence.astype(np.float64),
        recorded.fragment_ids,
    )


def residuals(
    correspondences: PotentialCorrespondences,
    K: Float[np.ndarray, "3 3"],
    camera_from_model: Float[np.ndarray, "4 4"],
) -> Float64[np.ndarray, "n"]:
    """Re-projection error e of each correspondence, pixels (thesis eq. reproj_error); infinite behind the camera."""
    points = transform_points(camera_from_model, correspondences.points_in_model.astype(np.float64))
    projected = points @ np.asarray(K, np.float64).T
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.linalg.norm(projected[:, :2] / projected[:, 2:] - correspondences.pixels, axis=1)
    return np.where(points[:, 2] > 0, off, np.inf)


def inliers(
    correspondences: PotentialCorrespondences,
    K: Float[np.ndarray, "3 3"],
    camera_from_model: Float[np.ndarray, "4 4"],
    tau_r: float = 4.0,
) -> Int[np.ndarray, "i"]:
    """Rows of the best correspondence of each pixel, where its error is below tau_r pixels; ascending."""
    errors = residuals(correspondences, K, camera_from_model)
    near = np.flatnonzero(errors < tau_r)
    by_pixel = near[np.lexsort((errors[near], correspondences.pixel_ids[near]))]
    return np.sort(by_pixel[np.unique(correspondences.pixel_ids[by_pixel], return_index=True)[1]])


def _points(
    fragments: Probabilities,
    obj_id: int,
    centers: Float[np.ndarray, "n 3"] | None,
    regression: bool,
    rows: Int[np.ndarray, "m"],
    ids: Int[np.ndarray, "m"],
) -> Float64[np.ndarray, "m 3"]:
    """3D points of the linked fragments."""
    if not regression:
        if centers is None:
            raise InputError(f"object {obj_id}: without regression the fragments' centres are needed; give centers")
        return centers[ids].astype(np.float64)
    if fragments.points_in_model is None:
        raise InputError(f"object {obj_id}: no 3D points of the fragments were recorded; record points_in_model")
    return fragments.points_in_model[rows, ids].astype(np.float64)
