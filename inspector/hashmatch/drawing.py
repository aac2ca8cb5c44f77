"""What HashMatch adds to the picture: heatmaps, a window with its template, and a swarm with both poses."""

from functools import partial

import cv2
import numpy as np
from jaxtyping import Float

from inspector import layers, planes
from inspector.drawing import COLORS
from inspector.frame import Frame
from inspector.hashmatch import pieces
from inspector.hashmatch.funnel import NAMES
from inspector.hashmatch.heat import colors_of, counted, heat_pixels, scale_of
from inspector.hashmatch.image_record import ChosenWindow, ImageRecord
from inspector.hashmatch.modalities import MATCHED, UNMATCHED, colors_of_points
from inspector.hashmatch.refinement import Refinement
from inspector.hashmatch.window import shown_test
from inspector.layers import ColorScale, Rgba
from inspector.nodes import NOTHING, Cloud, Drawing, Lines, Mesh, Node
from inspector.selection import Selection
from pipeline import geometry
from pipeline.exceptions import InputError
from pipeline.rendering import render, render_depths
from pipeline.scene import Model

WINDOW = (255, 255, 255)
TEMPLATE = (255, 90, 220)
ROUGH = (255, 205, 50)
"""Colours: of the chosen window, of its template at its pose, of a pose before refinement."""
AXIS = 0.75
"""Length of the axes drawn at a particle, diameters: long enough to stand out of the object."""
DOT = 1.1
"""Half the size of a test's point, pixels of the image."""


def heat(frame: Frame, selection: Selection, record: ImageRecord) -> Drawing:
    """Candidates per pixel after the chosen stage."""
    choice, matching = selection.hashmatch, record.matching
    if matching is None or choice.stage == "off":
        return NOTHING
    if choice.level is not None and choice.level not in matching.scales:
        levels = ", ".join(map(str, matching.levels))
        return Drawing({}, warnings=(f"there is no level {choice.level}; levels of this image: {levels}",))
    count = matching.stage_counts(choice.level)[choice.stage]
    where = "" if choice.level is None else f", level {choice.level}"
    name = f"{NAMES[choice.stage]}{where}"
    said = f"{name}: {counted(count.candidates, markup=False)} candidates in {counted(count.windows, markup=False)} windows"
    heatmap = matching.heatmap(choice.stage, choice.level)
    if heatmap is None:
        return Drawing({}, notes=((said, None),))
    size = (frame.camera.width, frame.camera.height)
    pixels = partial(heat_pixels, heatmap, size, 1)
    node = planes.picture(
        frame,
        selection,
        "hashmatch/heat",
        (choice.stage, choice.level),
        pixels,
        26,
        about=(id(record.reader), frame.key),
    )
    return Drawing({"hashmatch/heat": node}, (scale_of(heatmap),), notes=((said, None),))


def window(frame: Frame, selection: Selection, record: ImageRecord, chosen: ChosenWindow) -> Drawing:
    """The box of a window, the outline of its template, and the points of a test."""
    report, vote = chosen.report, chosen.vote
    left, top, right, bottom = report.box
    corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    box = planes.marks(frame, selection, np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    drawn = Drawing({"hashmatch/window": Lines((report.box, selection.view, frame.key), box, WINDOW, 2.5)})
    drawn = drawn.with_more(Drawing({}, notes=((f"window at level {report.level}", WINDOW),)))
    if vote is None:
        return drawn
    name = f"template {vote.template} of object {vote.obj_id}"
    more = Drawing({}, notes=((name, TEMPLATE),))
    if frame.has_model(vote.obj_id):
        model, pose = frame.workspace.dataset.model(vote.obj_id), record.pose(report, vote)
        more = Drawing({"hashmatch/template": _template(frame, selection, model, pose)}, notes=more.notes)
    drawn = drawn.with_more(more)
    if selection.hashmatch.part != "window":
        return drawn
    return drawn.with_more(_points(frame, selection, record, chosen))


def _template(frame: Frame, selection: Selection, model: Model, pose: Float[np.ndarray, "4 4"]):
    if selection.view == "scene":
        vertices = partial(geometry.transform_points, pose, model.vertices)
        return Mesh((model.obj_id, pose.tobytes()), vertices, model.faces, TEMPLATE, 0.55)

    def outline() -> Rgba:
        layer = layers.blank(frame.fine_camera.height, frame.fine_camera.width)
        _draw_outline(layer, frame, model, pose, TEMPLATE, 2 * frame.fineness)
        return layer

    return planes.picture(frame, selection, "hashmatch/template", (model.obj_id, pose.tobytes()), outline, 28)


def _points(frame: Frame, selection: Selection, record: ImageRecord, chosen: ChosenWindow) -> Drawing:
    """The points of the test that is shown in the tab, over the image."""
    assert chosen.vote is not None
    test = shown_test(chosen.vote, selection.hashmatch.test)
    try:
        found = record.points(chosen.report, chosen.vote)
    except InputError:  # the tab says it
        return NOTHING
    rows = found.test == test
    if not rows.any():
        return NOTHING
    at, size = found.pixels[rows].astype(float), DOT if test > 1 else 2.5 * DOT
    cross = np.array([[[-1, 0], [1, 0]], [[0, -1], [0, 1]]]) * size
    ends = planes.marks(frame, selection, (at[:, None, None] + cross).reshape(-1, 2, 2))
    colors = colors_of_points(found.matched[rows], found.masked[rows]).repeat(2, axis=0)
    node = Lines((ends.tobytes(), colors.tobytes()), ends, colors, 2.0)
    matched = int(found.matched[rows].sum())
    notes = (
        (f"{pieces.name_of_test(test)}: {matched} match", MATCHED),
        (f"{int(rows.sum()) - matched} do not", UNMATCHED),
    )
    return Drawing({"hashmatch/points": node}, notes=notes)


def swarm(frame: Frame, selection: Selection, found: Refinement) -> Drawing:
    """The particles of an iteration, and the poses before and after: outlines over the image, or in 3D."""
    obj_id = found.estimate.obj_id
    if not frame.has_model(obj_id):
        return Drawing({}, warnings=(f"the dataset has no model of object {obj_id}",))
    model, iteration = frame.workspace.dataset.model(obj_id), found.iteration(selection.hashmatch.iteration)
    notes: list[tuple[str, tuple[int, int, int] | None]] = [("rough pose", ROUGH)] if found.rough is not None else []
    notes.append(("refined pose", layers.ESTIMATE))
    scales: tuple[ColorScale, ...] = ()
    if found.swarm is not None:
        low, high = found.scores
        stops = tuple((int(r), int(g), int(b)) for r, g, b in layers.turbo(np.linspace(0, 1, 9)))
        scales = (ColorScale(f"particles of iteration {iteration}: score", f"{low:.2f}", f"{high:.2f}", stops),)
    nodes: dict[str, Node] = {"hashmatch/swarm": _outlines(frame, selection, found, model, iteration)}
    if selection.view == "scene":
        nodes = _seen_through(frame, selection) | _in_3d(found, model, iteration)
        if "models/estimate" in nodes and found.is_pose(frame.pose("estimate")):
            del nodes["hashmatch/refined"]
    return Drawing(nodes, scales, notes=tuple(notes))


def _outlines(frame: Frame, selection: Selection, found: Refinement, model: Model, iteration: int):
    def pixels() -> Rgba:
        layer = layers.blank(frame.fine_camera.height, frame.fine_camera.width)
        if found.swarm is not None:
            rows = np.flatnonzero(found.particles(iteration))
            rows = rows[np.argsort(found.swarm.quality[rows])]  # the best on top
            colors = colors_of(found.swarm.quality[rows], *found.scores)
            poses = found.swarm.camera_from_model[rows]
            for rendering, color in zip(render_depths(model, frame.fine_camera, poses, 0.0), colors, strict=True):
                contour = layers.contour_of(rendering.mask_crop, 1)
                layers.paint(layer[rendering.box.slices], contour, (int(color[0]), int(color[1]), int(color[2])), 0.75)
        if found.rough is not None:
            _draw_outline(layer, frame, model, found.rough, ROUGH, frame.fineness)
        _draw_outline(layer, frame, model, found.estimate.camera_from_model, layers.ESTIMATE, frame.fineness)
        return layer

    token = (found.number, iteration, found.estimate.camera_from_model.tobytes())
    return planes.picture(frame, selection, "hashmatch/swarm", token, pixels, 29)


def _seen_through(frame: Frame, selection: Selection) -> dict[str, Node]:
    """The row's own poses, in place of those drawn anyway: through them the particles can be seen."""
    nodes: dict[str, Node] = {}
    for role, color in COLORS.items():
        pose = frame.pose(role)
        if getattr(selection.display, role) and pose is not None and np.isfinite(pose).all():
            vertices = partial(geometry.transform_points, pose, frame.model.vertices)
            token = (frame.row.obj_id, pose.tobytes())
            nodes[f"models/{role}"] = Mesh(token, vertices, frame.model.faces, color, 0.25)
    return nodes


def _in_3d(found: Refinement, model: Model, iteration: int) -> dict[str, Node]:
    """Both poses as see-through meshes, and each particle as three axes with dots at their ends, coloured by its score."""
    nodes: dict[str, Node] = {}
    after = found.estimate.camera_from_model
    for name, pose, color in (("rough", found.rough, ROUGH), ("refined", after, layers.ESTIMATE)):
        if pose is not None:
            vertices = partial(geometry.transform_points, pose, model.vertices)
            token = (model.obj_id, pose.tobytes())
            nodes[f"hashmatch/{name}"] = Mesh(token, vertices, model.faces, color, 0.35)
    if found.swarm is None:
        return nodes
    rows = found.particles(iteration)
    poses, colors = found.swarm.camera_from_model[rows], colors_of(found.swarm.quality[rows], *found.scores)
    token = (found.number, iteration, poses.tobytes())
    centers, axes = poses[:, None, :3, 3], poses[:, :3, :3].transpose(0, 2, 1) * (AXIS * model.diameter)
    tips = centers + axes
    segments = np.stack([np.broadcast_to(centers, tips.shape), tips], axis=2).reshape(-1, 2, 3)
    dots, thrice = np.concatenate([centers, tips], axis=1).reshape(-1, 3), colors.repeat(3, axis=0)
    nodes["hashmatch/axes"] = Lines(token, segments, thrice, 1.5)
    nodes["hashmatch/particles"] = Cloud(token, lambda: (dots, colors.repeat(4, axis=0)), 0.03 * model.diameter)
    return nodes


def _draw_outline(
    layer: Rgba, frame: Frame, model: Model, pose: np.ndarray, color: tuple[int, int, int], width: int
) -> None:
    """Draw the outline of a model, with a dark rim that sets it off from bright and busy images, in place."""
    rendering = render(model, frame.fine_camera, pose, pixel_center=0.0)
    if not rendering.box.area:
        return
    mask = rendering.mask
    outer = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    layers.paint(layer, outer & ~mask, (0, 0, 0), 0.5)
    layers.paint(layer, layers.contour_of(mask, width), color, 1.0)
