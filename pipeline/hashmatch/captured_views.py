"""Views of an object in images of it, as the camera of the templates would have seen them."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from pipeline.geometry import project, transform_points
from pipeline.hashmatch import channels
from pipeline.hashmatch.config import TEMPLATE_SIZE
from pipeline.hashmatch.poses import rotation_to_ray
from pipeline.hashmatch.views import View, centroid_of, fitting_distance, template_camera
from pipeline.scene import Image, Model

_AGREES = 0.1
"""Diameters by which measured and rendered depth may differ in a mask that is rendered."""


def captured_view(
    image: Image,
    camera_from_model: Float[np.ndarray, "4 4"],
    mask: Bool[np.ndarray, "h w"],
    model: Model,
    focal_px: float,
) -> View:
    """What a template camera sees of an object in an image: turned to its centroid, at the distance of the templates.

    Turning a camera is exact. Bringing the object to another distance is taken for scaling, as in matching.

    Args:
        image: With colour and depth.
        camera_from_model: Of the object, metres.
        mask: Visible silhouette.
        model: For its size.
        focal_px: Of the template camera.

    """
    assert image.rgb is not None
    assert image.depth is not None
    K, distance = image.camera.K, fitting_distance(model, focal_px)
    centroid = transform_points(camera_from_model, centroid_of(model)[None])[0]
    away = float(np.linalg.norm(centroid))
    R_a = rotation_to_ray(K, project(K, centroid))
    template_K = template_camera(focal_px).K
    zoomed_K = template_camera(focal_px * away / distance).K
    depth = np.where(mask, image.depth, 0).astype(np.float32)

    def seen(values: np.ndarray) -> np.ndarray:
        warp = zoomed_K @ R_a.T @ np.linalg.inv(K)
        return cv2.warpPerspective(values, warp, (TEMPLATE_SIZE, TEMPLATE_SIZE), flags=cv2.INTER_NEAREST)

    inside = seen(mask.astype(np.uint8)) > 0
    distances = seen(channels.distances(depth, K))
    distances = np.where(inside & (distances > 0), distances + np.float32(distance - away), np.float32(0))
    rays = channels.distances(np.ones_like(distances), template_K)
    rgb = _seen_colors(image.rgb, K, zoomed_K @ R_a.T)
    return View(
        rotation=R_a.T @ camera_from_model[:3, :3],
        mask=inside,
        depth=distances / rays,
        distance=distances,
        normals=seen(channels.normals(depth, K)) * inside[..., None],
        rgb=rgb * inside[..., None],
    )


def _seen_colors(rgb: np.ndarray, K: np.ndarray, pixels_from_rays: np.ndarray) -> np.ndarray:
    """Colours at the pixels of a template; the image is made smaller first where it shows more than these do."""
    shrink = min(1.0, pixels_from_rays[0, 0] / K[0, 0])
    size = (max(1, round(rgb.shape[1] * shrink)), max(1, round(rgb.shape[0] * shrink)))
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    sx, sy = size[0] / rgb.shape[1], size[1] / rgb.shape[0]
    small_from_large = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1]])
    warp = pixels_from_rays @ np.linalg.inv(small_from_large @ K)
    return cv2.warpPerspective(small, warp, (TEMPLATE_SIZE, TEMPLATE_SIZE), flags=cv2.INTER_LINEAR)


def rendered_mask(model: Model, image: Image, camera_from_model: Float[np.ndarray, "4 4"]) -> Bool[np.ndarray, "h w"]:
    """Silhouette of a model where the depth image does not show something else; for images without masks."""
    from pipeline.rendering import render

    assert image.depth is not None
    rendered = render(model, image.camera, camera_from_model, pixel_center=0.0).depth
    agrees = np.abs(image.depth - rendered) < _AGREES * model.diameter
    return (rendered > 0) & (agrees | (image.depth <= 0))
