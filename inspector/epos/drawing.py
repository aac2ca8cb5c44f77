"""What EPOS adds to the picture: a layer, the clicked cell, correspondences, the replayed hypothesis, the model's copy."""

from collections.abc import Callable
from functools import partial

import numpy as np

from inspector.epos import colors
from inspector.epos.drawing_links import add_links
from inspector.epos.drawing_search import add_hypothesis
from inspector.epos.layers import layer_of
from inspector.epos.pieces import cut
from inspector.epos.row import EposRow
from inspector.epos.sketch import WHITE, Sketch, square
from inspector.nodes import ColoredMesh, Drawing, Mesh
from inspector.planes import picture
from inspector.recorded import repeated
from inspector.selection import Selection
from pipeline import geometry

LEVEL = 27
"""Of the layers over the image."""
CELL_PX = 4
"""Side of the frame around a clicked pixel where no cells were recorded."""


def draw(row: EposRow, selection: Selection) -> Drawing:
    """Describe what is added to the picture of a row."""
    sketch = Sketch(row, selection)
    for add in (_add_layer, _add_cell, add_links, add_hypothesis, _add_copy):
        add(sketch)
    return sketch.finished()


def _add_layer(sketch: Sketch) -> None:
    row, opacity = sketch.row, sketch.selection.display.opacity
    layer = layer_of(row, opacity)
    if isinstance(layer, str):
        sketch.warnings.append(layer)
    if layer is None or isinstance(layer, str):
        return
    camera, fineness = row.frame.camera, row.frame.fineness
    size = camera.width * fineness, camera.height * fineness
    token = (row.recording, row.choice.layer, row.fragment, opacity)
    pixels = partial(repeated, layer.pixels, layer.cell_px * fineness, size)
    sketch.nodes["epos/layer"] = picture(row.frame, sketch.selection, "epos/layer", token, pixels, LEVEL)
    sketch.scales += layer.scales
    sketch.notes += layer.notes


def _add_cell(sketch: Sketch) -> None:
    """Frame the clicked cell, and in 3D link it with its candidates on the copy."""
    row = sketch.row
    if not row.choice.has_pixel:
        return
    center, size = (row.choice.pixel, CELL_PX) if row.cell is None else (row.cell.center, row.cell.size)
    sketch.framed("cell", square(np.array(center), size / 2 + 1.0), WHITE, 2.0)
    if sketch.copy is None or row.candidates is None:
        return
    points, weights = row.candidates
    segments = sketch.to_copy(np.broadcast_to(np.array(center), (len(points), 2)), points)
    sketch.lines("candidates", segments, colors.confidence_colors(weights), 2.0)
    sketch.points(
        "candidates_points", segments[:, 1], np.full((len(points), 3), 255, np.uint8), 0.03 * sketch.copy_size
    )


def _add_copy(sketch: Sketch) -> None:
    """The model beside the image, in the colours of its fragments as far as they are lit."""
    row, pose = sketch.row, sketch.copy
    model, centers = row.model, row.recording.centers
    if pose is None or model is None:
        return
    if centers is None or not len(centers):
        vertices: Callable = partial(geometry.transform_points, pose, model.vertices)
        sketch.nodes["epos/model"] = Mesh((model, pose.tobytes()), vertices, model.faces, colors.UNLIT, 1.0)
        return
    pieces = cut(model, centers)
    shown = colors.lit(row.colors, row.weights)
    sketch.nodes["epos/model"] = ColoredMesh(
        (row.recording, pose.tobytes(), shown.tobytes()),
        partial(geometry.transform_points, pose, pieces.vertices),
        pieces.faces,
        lambda: shown[pieces.fragment_of_vertex],
    )
