"""The cells at which EPOS predicts: centres of 4x4 px regions of the image (thesis sec. epos_experiments)."""

import numpy as np
from jaxtyping import Float, Int

from pipeline.scene import Camera

CELL_PX = 4
"""Side of a cell in pixels."""

CENTER_PX = (CELL_PX - 1) / 2
"""Where the centre of cell (0, 0) lies in the image: pixels 0..3 have their centres at 0..3."""


def grid_shape(height: int, width: int) -> tuple[int, int]:
    """Rows and columns of the whole cells of an image."""
    return height // CELL_PX, width // CELL_PX


def cell_pixels(cells: Int[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2"]:
    """Pixel coordinates (u, v) of the centres of cells (column, row)."""
    return cells * float(CELL_PX) + CENTER_PX


def grid_camera(camera: Camera) -> Camera:
    """The camera that sees with one pixel, centre at integers, what `camera` sees at the centre of one cell."""
    image_from_grid = np.array([[CELL_PX, 0, CENTER_PX], [0, CELL_PX, CENTER_PX], [0, 0, 1.0]])
    height, width = grid_shape(camera.height, camera.width)
    return Camera(np.linalg.inv(image_from_grid) @ camera.K, width, height, camera.world_from_camera)
