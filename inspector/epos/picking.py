"""What of EPOS a click into the picture points at: a pixel of the image, or a fragment on the model's copy."""

from typing import Any

import numpy as np

from inspector.epos.choice import NO_PIXEL
from inspector.epos.placing import copy_from
from inspector.epos.row import EposRow
from inspector.planes import image_depth
from inspector.selection import Selection
from inspector.views import Click
from pipeline import geometry
from pipeline.epos.fragments import nearest_center
from pipeline.ray_casting import first_hit


def picked(row: EposRow, selection: Selection, click: Click) -> dict[str, Any] | None:
    """Fields of the choice that a click changes; None where it is about something else."""
    if click.pixel is not None:
        return _pixel(row, click.pixel)
    pose, centers = copy_from(row, selection), row.recording.centers
    on_copy = None if pose is None or row.model is None else first_hit(row.model, pose, click.origin, click.direction)
    on_image = _image_hit(row, selection, click)
    if pose is not None and on_copy is not None and (on_image is None or on_copy < on_image):
        if centers is None or not len(centers):
            return None
        point = geometry.transform_points(geometry.inverse(pose), click.origin + on_copy * click.direction)
        fragment = int(nearest_center(centers, point[None])[0])
        return {"fragment": None if fragment == row.fragment else fragment}
    if on_image is None:
        return None
    point = click.origin + on_image * click.direction
    u, v = geometry.project(row.frame.camera.K, point)
    return _pixel(row, (float(u), float(v)))


def _image_hit(row: EposRow, selection: Selection, click: Click) -> float | None:
    """Where the ray meets the image's plane, as a factor of its direction; None where it does not, or beside the image."""
    along = click.direction[2]
    if abs(along) < 1e-9:
        return None
    factor = (image_depth(row.frame, selection) - click.origin[2]) / along
    camera, point = row.frame.camera, click.origin + factor * click.direction
    u, v = geometry.project(camera.K, point)
    inside = -0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5
    return float(factor) if factor > 0 and inside else None


def _pixel(row: EposRow, pixel: tuple[float, float]) -> dict[str, Any] | None:
    """The clicked pixel, or none again where its cell is the one that was clicked before; None beside the image."""
    camera, fragments = row.frame.camera, row.recording.fragments
    if not (-0.5 <= pixel[0] < camera.width - 0.5 and -0.5 <= pixel[1] < camera.height - 0.5):
        return None
    whole = (float(np.round(pixel[0])), float(np.round(pixel[1])))
    cell_px = 4 if fragments is None else fragments.cell_px
    again = row.choice.has_pixel and _cell(whole, cell_px) == _cell(row.choice.pixel, cell_px)
    return {"pixel": NO_PIXEL if again else whole, "fragment": None}


def _cell(pixel: tuple[float, float], cell_px: int) -> tuple[int, int]:
    return int((pixel[0] + 0.5) // cell_px), int((pixel[1] + 0.5) // cell_px)
