"""Measured against expected depth at many places of some images: what depth corrections are fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.scene import ImageKey


@dataclass(frozen=True, eq=False)
class DepthSamples:
    """Places at which depth was measured and is known from elsewhere."""

    measured: Float[np.ndarray, "n"]
    """Metres, as in the depth image."""
    expected: Float[np.ndarray, "n"]
    """Metres, from a board's pose or an annotated one."""
    pixels: Float[np.ndarray, "n 2"]
    """x, y in the image; the centre of pixel (0, 0) is at (0, 0)."""
    images: Int[np.ndarray, "n"]
    """Row of `keys`: places in one image share the error of its pose."""
    keys: tuple[ImageKey, ...]
    image_size: tuple[int, int]
    """Width and height in pixels."""

    def __len__(self) -> int:
        return len(self.measured)

    @property
    def differences(self) -> Float[np.ndarray, "n"]:
        """Measured minus expected depth, metres."""
        return self.measured - self.expected

    def chosen(self, rows: Bool[np.ndarray, "n"]) -> "DepthSamples":
        """Some of the samples; the list of images stays."""
        return DepthSamples(
            self.measured[rows], self.expected[rows], self.pixels[rows], self.images[rows], self.keys, self.image_size
        )

    def within(self, near: float, far: float) -> "DepthSamples":
        """Those whose expected depth is in a range, metres: what is measured would choose by its own noise."""
        return self.chosen((self.expected >= near) & (self.expected <= far))


def gathered(parts: Sequence[tuple[ImageKey, DepthSamples]]) -> DepthSamples:
    """The samples of single images as those of all; there must be one part at least."""
    samples = [part for _, part in parts]
    return DepthSamples(
        np.concatenate([part.measured for part in samples]),
        np.concatenate([part.expected for part in samples]),
        np.concatenate([part.pixels for part in samples]),
        np.repeat(np.arange(len(samples)), [len(part) for part in samples]),
        tuple(key for key, _ in parts),
        samples[0].image_size,
    )
