"""Errors of all pairs of an estimate and an annotated instance of one object in one image, as BOP's scripts take them.

Every function takes poses `camera_from_model` in metres, rotations as submitted and as annotated, and returns a row
for each estimate and a column for each instance.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float

from pipeline.bop import errors
from pipeline.bop.vsd import DELTA, TAUS, Variant, vsd
from pipeline.rendering import render_depths
from pipeline.scene import Camera, Model

Poses = Sequence[Float[np.ndarray, "4 4"]]

MSPD_WIDTH_PX = 640
"""Image width that MSPD is scaled to."""


def mssd_of_pairs(model: Model, estimates: Poses, truths: Poses) -> Float[np.ndarray, "e g"]:
    """MSSD in metres; infinite where the bounding spheres are apart."""
    return _table(estimates, truths, lambda e, g: errors.mssd(model, e, g).value, within=model.diameter)


def mspd_of_pairs(model: Model, camera: Camera, estimates: Poses, truths: Poses) -> Float[np.ndarray, "e g"]:
    """MSPD in pixels of an image 640 wide."""
    scale = MSPD_WIDTH_PX / camera.width
    return _table(estimates, truths, lambda e, g: errors.mspd(model, camera.K, e, g).value * scale)


def ad_of_pairs(model: Model, symmetric: bool, estimates: Poses, truths: Poses) -> Float[np.ndarray, "e g"]:
    """ADI if symmetric, else ADD (thesis sec. rel_eval), in metres; infinite where the bounding spheres are apart."""
    average = errors.adi if symmetric else errors.add

    return _table(estimates, truths, lambda e, g: average(model, e, g), within=model.diameter)


def vsd_of_pairs(
    model: Model,
    camera: Camera,
    depth: Float[np.ndarray, "h w"],
    estimates: Poses,
    truths: Poses,
    *,
    taus: Sequence[float] = TAUS,
    delta: float = DELTA,
    variant: Variant = "bop19",
    relative: bool = True,
) -> Float[np.ndarray, "tau e g"]:
    """VSD for each of `taus`, fractions of the diameter or (not `relative`) metres; one call of the ray caster.

    It is 1 where the images of the bounding spheres are apart.
    """
    values = np.ones((len(taus), len(estimates), len(truths)))
    near = _near(model, estimates, truths)
    if not near.any():
        return values
    rows, columns = np.flatnonzero(near.any(axis=1)).tolist(), np.flatnonzero(near.any(axis=0)).tolist()
    drawn = render_depths(model, camera, np.stack([*(estimates[e] for e in rows), *(truths[g] for g in columns)]))
    at_estimate, at_truth = dict(zip(rows, drawn, strict=False)), dict(zip(columns, drawn[len(rows) :], strict=True))
    unit = model.diameter if relative else 1.0
    for e, g in np.argwhere(near).tolist():
        values[:, e, g] = vsd(at_estimate[e], at_truth[g], depth, camera.K, unit, taus, delta, variant).values
    return values


def _near(model: Model, estimates: Poses, truths: Poses) -> Bool[np.ndarray, "e g"]:
    """Whether the images of the bounding spheres meet."""
    near = [errors.sphere_projections_overlap(e, g, model.diameter) for e in estimates for g in truths]
    return np.array(near, dtype=bool).reshape(len(estimates), len(truths))


def _table(
    estimates: Poses,
    truths: Poses,
    error: Callable[[Float[np.ndarray, "4 4"], Float[np.ndarray, "4 4"]], float],
    within: float = np.inf,
) -> Float[np.ndarray, "e g"]:
    """Error of every estimate against every ground-truth pose; infinite for spheres of diameter `within` apart."""
    values = [
        error(estimate, truth) if within == np.inf or errors.spheres_overlap(estimate, truth, within) else np.inf
        for estimate in estimates
        for truth in truths
    ]
    return np.array(values, dtype=float).reshape(len(estimates), len(truths))
