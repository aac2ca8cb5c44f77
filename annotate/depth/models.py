"""Models of a sensor's systematic depth error, each linear in what is fitted (thesis sec. tless_depth_correction)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

Kind = Literal["linear", "offset", "quadratic", "regions"]
KINDS: tuple[Kind, ...] = ("linear", "offset", "quadratic", "regions")
TEXTS: dict[Kind, str] = {
    "linear": "d_c = a d + b",
    "offset": "d_c = d + b",
    "quadratic": "d_c = c d^2 + a d + b",
    "regions": "d_c = a d + b(x, y), b of second degree over the image",
}
REFERENCE = 0.7
"""Metres at which the quadratic term is 0 and has no slope, so that its fit is well conditioned."""


@dataclass(frozen=True, eq=False)
class Correction:
    """A fitted model: what turns measured into correct depth."""

    kind: Kind
    coefficients: Float[np.ndarray, "k"]
    """a and b (offset: b alone), then those of the further terms, in the order of `design`; metres."""
    image_size: tuple[int, int]
    """Width and height in pixels, which positions in the image refer to."""

    @property
    def a(self) -> float:
        """Factor of the measured depth; 1 for an offset alone."""
        return 1.0 if self.kind == "offset" else float(self.coefficients[0])

    @property
    def b(self) -> float:
        """Metres."""
        return float(self.coefficients[0 if self.kind == "offset" else 1])

    def __call__(self, depth: Float[np.ndarray, "n"], pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
        """Corrected depth, metres, of measurements at positions x, y of the image."""
        corrected = design(self.kind, depth, pixels, self.image_size) @ self.coefficients
        return corrected + depth if self.kind == "offset" else corrected


def design(
    kind: Kind, depth: Float[np.ndarray, "n"], pixels: Float[np.ndarray, "n 2"], image_size: tuple[int, int]
) -> Float[np.ndarray, "n k"]:
    """The factors of a model's coefficients."""
    ones = np.ones_like(depth)
    if kind == "offset":
        return ones[:, None]
    columns = [depth, ones]
    if kind == "quadratic":
        columns.append((depth - REFERENCE) ** 2)
    if kind == "regions":
        x, y = (2 * pixels / np.array(image_size) - 1).T
        columns += [x, y, x * x, x * y, y * y]
    return np.column_stack(columns)
