"""What is under the mouse: the pixel, its depth, its point in the camera's and the model's frame, and the object hit."""

import numpy as np
from jaxtyping import Float

from inspector.frame import Frame
from inspector.navigation import Navigation
from inspector.views import Click
from pipeline import geometry
from pipeline.ray_casting import first_hit


def readout(frame: Frame, navigation: Navigation, x: float, y: float) -> str:
    """Describe the point of the window (shares 0..1) in one line."""
    origin, direction = navigation.ray(x, y)
    if navigation.viewport is not None:
        return _at_pixel(frame, *navigation.viewport.pixel_at(x, y))
    depths = _model_depths(frame, origin, direction)
    if not depths:
        return ""
    role, depth = min(depths.items(), key=lambda item: item[1])
    point = origin + depth * direction
    return f"{role}: camera {_point(point)}{_in_model(frame, point)}"


def click_at(navigation: Navigation, x: float, y: float, shift: bool) -> Click:
    """What a click at a point of the window (shares 0..1) points at."""
    viewport = navigation.viewport
    pixel = None if viewport is None else viewport.pixel_at(x, y)
    return Click(pixel, *navigation.ray(x, y), shift)


def hit(frame: Frame, navigation: Navigation, x: float, y: float) -> int | None:
    """Index of the annotated instance seen first at a point of the window; None where there is none."""
    origin, direction = navigation.ray(x, y)
    nearest: tuple[float, int] | None = None
    for truth in frame.annotations:
        if not frame.has_model(truth.obj_id):
            continue
        model = frame.workspace.dataset.model(truth.obj_id)
        depth = first_hit(model, truth.camera_from_model, origin, direction)
        if depth is not None and (nearest is None or depth < nearest[0]):
            nearest = (depth, truth.index)
    return None if nearest is None else nearest[1]


def _at_pixel(frame: Frame, u: float, v: float) -> str:
    camera = frame.camera
    if not (-0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5):
        return ""
    text = f"u {u:7.1f}  v {v:7.1f}"
    depth = frame.image.depth
    measured = 0.0 if depth is None else float(depth[round(v), round(u)])
    if depth is None:
        text += "   no depth in this image"
    elif measured == 0:
        text += "   depth not measured here"
    else:
        point = geometry.unproject(camera.K, np.array([u, v]), np.array(measured))
        return f"{text}   depth {measured * 1000:.1f} mm   camera {_point(point)}{_in_model(frame, point)}"
    ray = np.linalg.solve(camera.K, (u, v, 1.0))
    depths = _model_depths(frame, np.zeros(3), ray)
    if depths:
        role, nearest = min(depths.items(), key=lambda item: item[1])
        text += f"   on the {role}: camera {_point(nearest * ray)}{_in_model(frame, nearest * ray)}"
    return text


def _model_depths(frame: Frame, origin: np.ndarray, direction: np.ndarray) -> dict[str, float]:
    """Where a ray meets the model at the ground truth and at the estimate, in units of `direction`."""
    found = {}
    for role, name in (("ground_truth", "ground truth"), ("estimate", "estimate")):
        pose = frame.pose(role)  # type: ignore[arg-type]
        depth = None if pose is None else first_hit(frame.model, pose, origin, direction)
        if depth is not None:
            found[name] = depth
    return found


def _in_model(frame: Frame, point: Float[np.ndarray, "3"]) -> str:
    pose = frame.pose("ground_truth")
    name = "ground truth"
    if pose is None:
        pose, name = frame.pose("estimate"), "estimate"
    if pose is None or not np.isfinite(pose).all() or abs(np.linalg.det(pose[:3, :3])) < 1e-9:
        return ""
    return f"   model {_point(geometry.transform_points(geometry.inverse(pose), point))} ({name})"


def _point(point: Float[np.ndarray, "3"]) -> str:
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*(point * 1000))
