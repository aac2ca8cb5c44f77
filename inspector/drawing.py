"""What the picture of a row consists of: the image with its overlays, or the scene in 3D."""

from collections.abc import Callable, Hashable
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, UInt8

from inspector import layers
from inspector.frame import ROLES, Frame, Role
from inspector.layers import ColorScale, Rgba
from inspector.nodes import Cloud, Drawing, Lines, Mesh, Node, Viewpoint
from inspector.planes import FRUSTUM, brought_to_front, depths_of, picture
from inspector.recorded import layer_of
from inspector.selection import Display, Selection
from pipeline import geometry
from pipeline.exceptions import InputError
from pipeline.scene import ImageKey, Model

COLORS: dict[Role, tuple[int, int, int]] = {
    "ground_truth": layers.GROUND_TRUTH,
    "estimate": layers.ESTIMATE,
    "compared": layers.COMPARED,
}
LEVELS: dict[Role, int] = {"compared": 0, "estimate": 1, "ground_truth": 2}
"""Order of the outlines, far to near; those on top are thinner, so that equal poses show all their colours."""
WITNESS_COLORS = ((255, 60, 60), (255, 200, 0))
"""Of the lines between the vertices that decide MSSD and MSPD."""
CLOUD_POINTS = 200_000
"""More points than this are thinned out."""
DIFFERENCE_LIMIT = 0.02
"""Metres at which the colours of depth differences saturate."""


def draw(frame: Frame, selection: Selection) -> Drawing:
    """Describe the picture of a row in the view that is chosen."""
    return _Draughtsman(frame, selection).draw()


class _Draughtsman:
    """Collects the nodes of one picture."""

    def __init__(self, frame: Frame, selection: Selection) -> None:
        self.frame = frame
        self.selection = selection
        self.display: Display = selection.display
        self.image_view = selection.view == "image"
        self.close_up = selection.close_up
        self.nodes: dict[str, Node] = {}
        self.scales: list[ColorScale] = []
        self.warnings: list[str] = [*frame.problems, *_unknown(frame)]
        self.nearest, _ = depths_of(frame)

    def draw(self) -> Drawing:
        layers_of_view = [self._image, self._depth, self._masks, self._recorded, self._models, self._witness]
        for add in layers_of_view if self.image_view else [*layers_of_view, self._points, self._cameras]:
            try:
                add()
            except InputError as error:  # what is damaged is missing, the rest is shown
                self.warnings.append(str(error))
        return Drawing(self.nodes, tuple(self.scales), tuple(dict.fromkeys(self.warnings)))

    def _picture(
        self,
        name: str,
        token: Hashable,
        pixels: Callable[[], UInt8[np.ndarray, "h w c"]],
        level: int,
        edges: tuple[float, float, float, float] | None = None,
    ) -> None:
        about = self.frame.key if name == "image" else ()  # the image is the same for all its rows
        self.nodes[name] = picture(self.frame, self.selection, name, token, pixels, level, edges, about)

    def _image(self) -> None:
        rgb = self.frame.image.rgb
        if rgb is None and not self.frame.problems:
            self.warnings.append("this image has no colour or gray channel")
        if self.display.image and rgb is not None:
            self._picture("image", (), lambda: rgb, 0)
        elif self.image_view:
            size = (self.frame.camera.height, self.frame.camera.width, 3)
            self._picture("image", "black", lambda: np.zeros(size, np.uint8), 0)

    def _depth(self) -> None:
        if self.display.depth == "off":
            return
        depth = self.frame.image.depth
        if depth is None:
            self.warnings.append(f"no depth in this image: the layer '{self.display.depth}' is empty")
            return
        layer, scale = _depth_overlay(self.frame, self.display)
        token = (self.display.depth, self.display.opacity)
        self._picture("depth", token, partial(layers.upsampled, layer, self.frame.fineness), 10)
        self.scales.append(scale)

    def _masks(self) -> None:
        if not self.display.masks:
            return
        masks = [m for gt in self.frame.annotations if (m := self.frame.visible_mask(gt.index)) is not None]
        if not masks:
            self.warnings.append("the dataset has no masks for this image (inspector doctor says more)")
            return
        self._picture("masks", (), lambda: _mask_overlay(masks, self.frame.fineness), 20)

    def _recorded(self) -> None:
        path = self.display.recorded
        if not path:
            return
        recordings = self.frame.workspace.recordings
        reader = None if recordings is None else recordings.reader(self.frame.key)
        if reader is None or path not in reader.kinds():
            self.warnings.append(f"not recorded for this image: {path}")
            return
        size = (self.frame.camera.width, self.frame.camera.height)
        layer, scale = layer_of(reader.read(path), size, self.display.opacity)
        token = (path, self.display.opacity)
        self._picture("recorded", token, partial(layers.upsampled, layer, self.frame.fineness), 25)
        if scale is not None:
            self.scales.append(scale)

    def _models(self) -> None:
        display, frame = self.display, self.frame
        roles: list[Role] = [role for role in ROLES if getattr(display, role) and frame.pose(role) is not None]
        if display.others:
            self._others()
        if display.style in ("wireframe", "shaded") or not self.image_view:
            wireframe = display.style == "wireframe"
            for role in roles:
                self._mesh(role, frame.model, frame.pose(role), COLORS[role], display.opacity, wireframe)
        if not self.image_view or display.style in ("wireframe", "shaded"):
            return
        token = (display.style, display.opacity, self.close_up)
        if display.wipe and {"ground_truth", "estimate"} <= set(roles):
            self._picture("estimate", (*token, display.wipe_position), self._wiped, 40)
            roles = [role for role in roles if role not in ("ground_truth", "estimate")]
        for role in roles:
            shown = self.frame.silhouette(role)
            if shown is not None and shown.box.area:
                edges = self.frame.edges(shown.box)
                self._picture(role, token, partial(self._silhouette, role, shown.mask_crop), 1 + LEVELS[role], edges)

    def _others(self) -> None:
        if self.image_view and self.frame.others:
            self._picture("others", self.display.style, self._other_contours, 30)
        for position, other in enumerate(self.frame.others if not self.image_view else ()):
            self._mesh(f"others/{position}", other.model, other.camera_from_model, layers.OTHERS, 0.6, False)

    def _mesh(
        self, name: str, model: Model, pose: Float[np.ndarray, "4 4"] | None, color, opacity: float, wireframe: bool
    ) -> None:
        if pose is None or not np.isfinite(pose).all():
            return
        # Vertices are moved here: a quaternion could not carry rotations that are not orthonormal.
        vertices = partial(geometry.transform_points, pose, model.vertices)
        token = (model.obj_id, pose.tobytes())
        self.nodes[f"models/{name}"] = Mesh(token, vertices, model.faces, color, opacity, wireframe)

    def _silhouette(self, role: Role, mask: Bool[np.ndarray, "h w"]) -> Rgba:
        fill = 0.45 * self.display.opacity if self.display.style == "fill" else 0.0
        thin, step = (2, 1) if self.close_up else (3, 2)
        thickness = thin + step * (2 - LEVELS[role])  # fine pixels, towards the inside
        return layers.silhouette(mask, COLORS[role], fill=fill, opacity=self.display.opacity, thickness=thickness)

    def _wiped(self) -> Rgba:
        found, truth = self.frame.silhouette("estimate"), self.frame.silhouette("ground_truth")
        assert found is not None
        assert truth is not None
        left, right = self._silhouette("estimate", found.mask), self._silhouette("ground_truth", truth.mask)
        return layers.wiped(left, right, self.display.wipe_position)

    def _other_contours(self) -> Rgba:
        layer = layers.blank(self.frame.fine_camera.height, self.frame.fine_camera.width)
        for shown in self.frame.other_silhouettes:
            contour = layers.contour_of(shown.mask_crop, self.frame.fineness)
            layers.paint(layer[shown.box.slices], contour, layers.OTHERS, 0.8)
        return layer

    def _witness(self) -> None:
        """Draw the vertices that decide MSSD and MSPD, from the ground truth to the estimate."""
        if not self.display.witness:
            return
        found, truth, witnesses = (
            self.frame.pose("estimate"),
            self.frame.pose("ground_truth"),
            self.frame.witnesses("estimate"),
        )
        if found is None or truth is None or witnesses is None:
            return
        model = self.frame.model
        for name, witness, color in zip(("mssd", "mspd"), witnesses, WITNESS_COLORS, strict=True):
            if witness.vertex < 0:
                continue
            vertex = model.vertices[witness.vertex]
            at_truth = geometry.transform_points(truth @ model.symmetries[witness.symmetry], vertex)
            ends = np.stack([at_truth, geometry.transform_points(found, vertex)])
            if self.image_view and (ends[:, 2] > 0).all():
                ends = brought_to_front(ends)
            self.nodes[f"witness/{name}"] = Lines((name, ends.tobytes()), ends[None], color, width=3.0)

    def _points(self) -> None:
        if not self.display.points:
            return
        if self.frame.image.depth is None:
            self.warnings.append("no depth in this image: no point cloud")
            return
        size = 0.9 * self.nearest / self.frame.camera.K[0, 0]
        self.nodes["points"] = Cloud((self.frame.key, "points"), partial(_cloud, self.frame), size=size)

    def _cameras(self) -> None:
        """Draw this image's camera, and those of the scene's other images where their poses are known."""
        corners = _corners(self.frame, FRUSTUM * self.nearest)
        self.nodes["frustum"] = Lines(corners.tobytes(), corners, (150, 150, 150), width=1.5)
        for im_id, camera_from_other in self.frame.neighbours:
            image = ImageKey(self.frame.key.scene_id, im_id)
            token = (self.frame.key, image)
            scale = 0.4 * FRUSTUM * self.nearest
            self.nodes[f"cameras/{im_id}"] = Viewpoint(token, image, self.frame.camera, camera_from_other, scale)


def _unknown(frame: Frame) -> list[str]:
    """What an address may ask for that the data do not have."""
    row = frame.row
    if row.gt_index >= 0 and frame.ground_truth is None:
        return [f"image {row.im_id} of scene {row.scene_id} has no annotation {row.gt_index} of object {row.obj_id}"]
    if row.gt_index < 0 and row.estimate >= 0 and frame.estimate is None:
        return [f"the results have no row {row.estimate}"]
    return []


def _depth_overlay(frame: Frame, display: Display) -> tuple[Rgba, ColorScale]:
    depth = frame.image.depth
    assert depth is not None
    if display.depth == "depth":
        return layers.depth_layer(depth, display.opacity)
    role: Role = "ground_truth" if display.depth.endswith("truth") else "estimate"
    rendering = frame.rendered(role)
    rendered = rendering.depth if rendering is not None else np.zeros_like(depth)
    valid = (depth > 0) & (rendered > 0)
    return layers.difference_layer(depth - rendered, valid, DIFFERENCE_LIMIT, display.opacity)


def _mask_overlay(masks: list, fineness: int) -> Rgba:
    layer = layers.blank(*masks[0].shape)
    for mask, color in zip(masks, layers.label_colors(len(masks)), strict=True):
        layers.paint(layer, mask, color, 0.45)
        layers.paint(layer, layers.contour_of(mask), color, 1.0)
    return layers.upsampled(layer, fineness)


def _cloud(frame: Frame) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    depth, rgb = frame.image.depth, frame.image.rgb
    assert depth is not None
    points, measured = geometry.points_from_depth(frame.camera.K, depth)
    colors = rgb[measured] if rgb is not None else np.full((len(points), 3), 170, np.uint8)
    if len(points) > CLOUD_POINTS:  # at random: every n-th point would leave stripes
        kept = np.random.default_rng(0).choice(len(points), CLOUD_POINTS, replace=False)
        points, colors = points[kept], colors[kept]
    return points, colors


def _corners(frame: Frame, z: float) -> Float[np.ndarray, "8 2 3"]:
    """Edges of the camera's frustum up to depth z."""
    w, h = frame.camera.width, frame.camera.height
    pixels = np.array([[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]])
    corners = geometry.unproject(frame.camera.K, pixels, np.full(4, z))
    edges = [(np.zeros(3), corner) for corner in corners]
    edges += [(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    return np.array(edges)
