"""Least squares of the reprojection errors of markers that lie on one plane: cameras and places together."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

SQUARE = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
"""Corners of a marker of side 1 in its own frame, in OpenCV's order."""
LOSS_PX = 0.5
"""Reprojection errors beyond grow in weight only linearly."""
MOST_EVALUATIONS = 100


@dataclass(frozen=True, eq=False)
class Sightings:
    """Markers seen in images; the unknowns are the poses of the cameras and the places of all markers but the first."""

    images: Int[np.ndarray, "n"]
    """Number of the image of each sighting."""
    markers: Int[np.ndarray, "n"]
    """Number of its marker."""
    pixels: Float[np.ndarray, "n 4 2"]
    K: Float[np.ndarray, "i 3 3"]
    """Camera matrix of each image."""
    first: Float[np.ndarray, "3"]
    """Place of the first marker: x, y, turn; the frame of all others."""

    def chosen(self, rows: Bool[np.ndarray, "n"]) -> "Sightings":
        """Of some sightings."""
        return replace(self, images=self.images[rows], markers=self.markers[rows], pixels=self.pixels[rows])

    def unpacked(self, vector: Float[np.ndarray, "v"]) -> tuple[Float[np.ndarray, "i 4 4"], Float[np.ndarray, "m 3"]]:
        """Poses of the cameras, and x, y, turn of all markers."""
        from scipy.spatial.transform import Rotation

        rows = vector[: 6 * len(self.K)].reshape(-1, 6)
        poses = np.tile(np.eye(4), (len(rows), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = Rotation.from_rotvec(rows[:, :3]).as_matrix(), rows[:, 3:]
        return poses, np.vstack([self.first, vector[6 * len(self.K) :].reshape(-1, 3)])

    def errors(self, vector: Float[np.ndarray, "v"]) -> Float[np.ndarray, "e"]:
        """Projected minus seen corners, pixels, all in a row."""
        poses, placed = self.unpacked(vector)
        x, y, turn = placed[self.markers].T
        across = np.exp(1j * turn)[:, None] * (SQUARE[:, 0] + 1j * SQUARE[:, 1]) + (x + 1j * y)[:, None]
        on_board = np.stack([across.real, across.imag, np.zeros(across.shape), np.ones(across.shape)], axis=-1)
        projection = self.K @ poses[:, :3]
        homogeneous = np.einsum("nij,nkj->nki", projection[self.images], on_board)
        return (homogeneous[..., :2] / homogeneous[..., 2:] - self.pixels).ravel()

    def distances(self, vector: Float[np.ndarray, "v"]) -> Float[np.ndarray, "n 4"]:
        """Pixels between each corner and its projection."""
        return np.linalg.norm(self.errors(vector).reshape(-1, 4, 2), axis=-1)

    def solved(self, start: Float[np.ndarray, "v"]) -> Float[np.ndarray, "v"]:
        """The unknowns with the least errors, large ones with less weight."""
        from scipy.optimize import least_squares
        from scipy.sparse import lil_matrix

        touched = lil_matrix((8 * len(self.images), len(start)), dtype=np.int8)
        for row, (image, marker) in enumerate(zip(self.images.tolist(), self.markers.tolist(), strict=True)):
            touched[8 * row : 8 * row + 8, 6 * image : 6 * image + 6] = 1
            if marker > 0:
                column = 6 * len(self.K) + 3 * (marker - 1)
                touched[8 * row : 8 * row + 8, column : column + 3] = 1
        found = least_squares(
            self.errors,
            start,
            loss="soft_l1",
            f_scale=LOSS_PX,
            x_scale="jac",
            jac_sparsity=touched,
            max_nfev=MOST_EVALUATIONS,
        )
        return found.x
