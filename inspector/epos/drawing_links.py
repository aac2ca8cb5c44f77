"""Correspondences in the picture: dots over the image, and in 3D lines to the model's copy; inliers apart from outliers."""

import numpy as np
from jaxtyping import Int, UInt8

from inspector.epos import colors
from inspector.epos.matches import Matches
from inspector.epos.sketch import WHITE, Sketch
from pipeline import geometry

MOST_LINES = {"inliers": 100, "outliers": 50}
"""Correspondences drawn as lines in 3D; more are thinned out. Most outliers are the other choices of explained pixels."""
INLIER_PX, OUTLIER_PX = 1.5, 1.2
"""Radius of the dots in pixels of the image."""


def add_links(sketch: Sketch) -> None:
    """Add the correspondences that are asked for."""
    choice, matches = sketch.row.choice, sketch.row.matches
    if choice.links == "off":
        return
    if matches is None:
        sketch.warnings.append(f"correspondences of object {sketch.row.recording.obj_id} were not recorded")
        return
    if choice.links != "inliers":
        _add_dots(sketch, matches, "outliers", matches.unexplained, OUTLIER_PX)
        sketch.notes.append(("pixels that the pose does not explain", colors.OUTLIER))
    if choice.links != "outliers":
        _add_dots(sketch, matches, "inliers", matches.inliers, INLIER_PX)
        _add_errors(sketch, matches)
        residual = choice.color == "residual"
        sketch.scales.append(
            colors.residual_scale(matches.tau_r) if residual else colors.confidence_scale("confidence s = a·b")
        )
    if sketch.copy is not None and sketch.row.cell is None:  # else only the lines of the clicked cell are of interest
        _add_lines(sketch, matches)


def _colors_of(sketch: Sketch, matches: Matches, rows: Int[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    if sketch.row.choice.color == "residual":
        return colors.residual_colors(matches.residuals[rows], matches.tau_r)
    return colors.confidence_colors(matches.links.confidence[rows])


def _add_dots(sketch: Sketch, matches: Matches, name: str, rows: Int[np.ndarray, "n"], radius_px: float) -> None:
    points = sketch.at(matches.links.pixels[rows])
    size = radius_px * float(points[0, 2]) / matches.K[0, 0] if len(points) else 0.0
    plain = np.tile(np.array(colors.OUTLIER, np.uint8), (len(rows), 1))
    sketch.points(name, points, plain if name == "outliers" else _colors_of(sketch, matches, rows), size)


def _add_errors(sketch: Sketch, matches: Matches) -> None:
    """From each explained pixel to where the pose projects its 3D point; in the image view only."""
    rows = matches.inliers
    if sketch.in_3d or matches.camera_from_model is None or not len(rows):
        return
    points = geometry.transform_points(matches.camera_from_model, matches.links.points_in_model[rows])
    ends = np.stack([matches.links.pixels[rows], geometry.project(matches.K, points)], axis=1)
    sketch.lines("errors", sketch.at(ends), WHITE, 1.5)


def _add_lines(sketch: Sketch, matches: Matches) -> None:
    """Lines between pixels and points of the copy."""
    groups = {"outliers": np.flatnonzero(~matches.is_inlier), "inliers": matches.inliers}
    for name, rows in groups.items():
        if sketch.row.choice.links not in (name, "all") or not len(rows):
            continue
        kept = _thinned(rows, MOST_LINES[name])
        sketch.notes.append((f"lines: {len(kept)} of {len(rows)} {name}", None))
        segments = sketch.to_copy(matches.links.pixels[kept], matches.links.points_in_model[kept])
        shown = _colors_of(sketch, matches, kept) if name == "inliers" else colors.OUTLIER
        sketch.lines(f"links/{name}", segments, shown, 1.5 if name == "inliers" else 1.0)


def _thinned(rows: Int[np.ndarray, "n"], most: int) -> Int[np.ndarray, "m"]:
    """At most so many rows, chosen at random but always the same."""
    if len(rows) <= most:
        return rows
    return np.sort(np.random.default_rng(0).choice(rows, most, replace=False))
