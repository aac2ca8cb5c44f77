"""What the network believed, per cell, as layers over the image."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from inspector.epos import colors
from inspector.epos.row import EposRow
from inspector.layers import ColorScale, Rgba, blank, label_colors
from pipeline.recording import Probabilities

FAINTEST = 0.12
"""Least opacity of a cell that is shown at all."""
MOST_NOTES = 12
"""Objects named in the legend."""

Note = tuple[str, tuple[int, int, int] | None]


class GridLayer(NamedTuple):
    """A layer with a pixel per cell, and what its colours mean."""

    pixels: Rgba
    cell_px: int
    scales: tuple[ColorScale, ...] = ()
    notes: tuple[Note, ...] = ()


def layer_of(row: EposRow, opacity: float) -> GridLayer | str | None:
    """The layer that is chosen; None for none, or in one line what of it was not recorded."""
    if row.fragment is not None:
        return _of_fragment(row, row.fragment, opacity)
    makers = {
        "object": _of_object,
        "objects": _of_objects,
        "fragments": _of_fragments,
        "coordinates": _of_coordinates,
        "points": _of_points,
        "confidence": _of_confidence,
    }
    make = makers.get(row.choice.layer)
    return None if make is None else make(row, opacity)


def _of_object(row: EposRow, opacity: float) -> GridLayer | str:
    objects, probability = row.recording.objects, row.recording.object_map
    if objects is None or probability is None:
        return "object probabilities were not recorded, or not of this object"
    pixels = _painted(colors.confidence_colors(probability.ravel()), probability.ravel(), opacity)
    pixels = pixels.reshape(*probability.shape, 4)
    return GridLayer(pixels, objects.cell_px, (colors.confidence_scale(f"probability of object {_id(row)}"),))


def _of_objects(row: EposRow, opacity: float) -> GridLayer | str:
    objects = row.recording.objects
    if objects is None or not objects.values.shape[1]:
        return "object probabilities were not recorded"
    likeliest = objects.values.argmax(axis=1)
    names = objects.labels or tuple(map(str, range(objects.values.shape[1])))
    background = np.array([name == "background" for name in names])[likeliest]
    palette = np.array(label_colors(len(names)), np.uint8)
    shown = np.where(background, 0.0, objects.values.max(axis=1))
    seen, counts = np.unique(likeliest[~background], return_counts=True)
    most = seen[np.argsort(-counts)][:MOST_NOTES]
    notes = tuple((f"object {names[i]}", _rgb(palette[i])) for i in np.sort(most))
    return _cells(objects, palette[likeliest], shown, opacity, (), notes)


def _of_fragments(row: EposRow, opacity: float) -> GridLayer | str:
    fragments, likeliest, certainty = _known(row)
    if fragments is None or likeliest is None or certainty is None:
        return _not_recorded(row)
    scales = () if row.extent is None or row.recording.centers is None else row.extent.scales("fragment's centre")
    return _cells(fragments, row.colors[likeliest], certainty, opacity, scales)


def _of_coordinates(row: EposRow, opacity: float) -> GridLayer | str:
    fragments, likeliest, certainty = _known(row)
    centers, sizes = row.recording.centers, row.recording.sizes
    if fragments is None or likeliest is None or certainty is None:
        return _not_recorded(row)
    if fragments.points_in_model is None or centers is None or sizes is None:
        return f"3D fragment coordinates of object {_id(row)} were not recorded (predicted points, centres and sizes)"
    points = _predicted(fragments, likeliest)
    coordinates = (points - centers[likeliest]) / sizes[likeliest, None]
    return _cells(fragments, colors.coordinate_colors(coordinates), certainty, opacity, colors.COORDINATE_SCALES)


def _of_points(row: EposRow, opacity: float) -> GridLayer | str:
    fragments, likeliest, certainty = _known(row)
    if fragments is None or likeliest is None or certainty is None:
        return _not_recorded(row)
    if fragments.points_in_model is None or row.extent is None:
        return f"predicted 3D points of object {_id(row)} were not recorded"
    points = _predicted(fragments, likeliest)
    return _cells(fragments, row.extent.colors(points), certainty, opacity, row.extent.scales("predicted point's"))


def _of_confidence(row: EposRow, opacity: float) -> GridLayer | str:
    fragments, likeliest, certainty = _known(row)
    if fragments is None or likeliest is None or certainty is None:
        return _not_recorded(row)
    confidence = certainty * fragments.values.max(axis=1)
    highest = float(confidence.max(initial=0.0)) or 1.0
    scale = colors.confidence_scale("confidence a·b of the likeliest fragment", highest)
    return _cells(fragments, colors.confidence_colors(confidence / highest), certainty, opacity, (scale,))


def _of_fragment(row: EposRow, fragment: int, opacity: float) -> GridLayer | str:
    """Where in the image the chosen fragment is believed to be."""
    fragments, certainty = row.recording.fragments, row.recording.certainty
    if fragments is None or certainty is None:
        return _not_recorded(row)
    belief = certainty * fragments.values[:, fragment]
    highest = float(belief.max(initial=0.0)) or 1.0
    scale = colors.confidence_scale(f"probability of fragment {fragment} here", highest)
    shown = np.where(belief > 0.01 * highest, 0.15 + 0.85 * belief / highest, 0.0)
    notes = ((f"fragment {fragment}", _rgb(row.colors[fragment])),)
    return _cells(fragments, colors.confidence_colors(belief / highest), shown, opacity, (scale,), notes)


def _known(row: EposRow) -> tuple[Probabilities | None, Int[np.ndarray, "k"] | None, Float[np.ndarray, "k"] | None]:
    return row.recording.fragments, row.recording.likeliest, row.recording.certainty


def _predicted(fragments: Probabilities, likeliest: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k 3"]:
    assert fragments.points_in_model is not None
    return fragments.points_in_model[np.arange(len(likeliest)), likeliest].astype(np.float64)


def _not_recorded(row: EposRow) -> str:
    return f"fragments of object {_id(row)} were not recorded"


def _cells(
    record: Probabilities,
    shown: UInt8[np.ndarray, "k 3"],
    probability: Float[np.ndarray, "k"],
    opacity: float,
    scales: tuple[ColorScale, ...],
    notes: tuple[Note, ...] = (),
) -> GridLayer:
    layer = blank(*record.grid)
    x, y = record.cells.T
    layer[y, x] = _painted(shown, probability, opacity)
    return GridLayer(layer, record.cell_px, scales, notes)


def _painted(
    shown: UInt8[np.ndarray, "k 3"], probability: Float[np.ndarray, "k"], opacity: float
) -> UInt8[np.ndarray, "k 4"]:
    """Colours with an opacity that grows with the probability; nothing below one in a hundred."""
    share = np.clip(probability, 0, 1)
    alpha = np.where(share > 0.01, FAINTEST + (1 - FAINTEST) * share, 0.0) * opacity * 255
    return np.concatenate([shown, alpha[:, None].astype(np.uint8)], axis=1)


def _id(row: EposRow) -> int:
    return row.recording.obj_id


def _rgb(color: np.ndarray) -> tuple[int, int, int]:
    return int(color[0]), int(color[1]), int(color[2])
