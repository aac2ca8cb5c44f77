"""From exact depth to what a depth camera would measure: noise, holes, steps, and a linear error."""

from dataclasses import dataclass, replace
from math import inf, isfinite, pi

import numpy as np
from jaxtyping import Bool, Float, Float32

from pipeline.exceptions import InputError
from pipeline.synth.sensors.noise import chance, grain, grown, jittered, mixed
from pipeline.synth.sensors.surface import incidence, shadow, steps

STEEPEST = np.radians(85.0)
"""Noise grows with the angle of view up to here."""


@dataclass(frozen=True)
class DepthSensor:
    """How depth is measured; the defaults measure it exactly. Raises InputError for values that make no sense.

    An exact depth d_c is measured as d = (d_c - b) / a, so that a d + b corrects it (thesis sec.
    tless_depth_correction); noise comes before, steps of the measurement after it.
    """

    a: float = 1.0
    """Factor of the correction d_c = a d + b."""
    b: float = 0.0
    """Metres; offset of the correction."""
    noise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """(c0, c1, c2): standard deviation c0 + c1 d + c2 d^2 in metres at a depth of d metres, seen face-on."""
    slanted_noise: tuple[float, float] = (0.0, 0.0)
    """(c, p): c d^p (t / (pi/2 - t))^2 is added to the standard deviation at an angle of view t."""
    grain_px: float = 0.0
    """Standard deviation of the Gaussian window over which the noise of neighbours is alike."""
    jitter_px: float = 0.0
    """Lateral noise: standard deviation by which outlines are displaced, neighbours alike."""
    step: float = 0.01
    """Relative difference of depth that makes an edge."""
    edge_missing: float = 0.0
    """Share of the pixels within one pixel of an edge that are not measured."""
    edge_mixed: float = 0.0
    """Share of the pixels at an edge that are measured somewhere between its two sides."""
    grazing_deg: tuple[float, float] = (90.0, 90.0)
    """Angles of view from which on some pixels, and all pixels, are not measured."""
    eyes: tuple[float, ...] = ()
    """Metres along x from the camera to the parts of the sensor that must see a point too, else it is not measured: its
    projector and, where depth is registered to the colour camera, its infrared camera."""
    inverse_depth_step: float = 0.0
    """1 / metres: step of 1 / d, for sensors that measure disparity; 0 for none."""
    depth_step: float = 0.0
    """Metres: step of d, after the other one; 0 for none."""
    sensing_range: tuple[float, float] = (0.0, inf)
    """Metres: only measurements within are returned."""

    def __post_init__(self) -> None:
        """Check the values."""
        if not (self.a > 0 and isfinite(self.a)):
            raise InputError(f"depth sensor: a = {self.a:g}; give a factor above 0, near 1")
        if not all(map(isfinite, (self.b, *self.noise, *self.slanted_noise, *self.eyes))):
            raise InputError("depth sensor: b, noise, slanted_noise or eyes is not finite; give numbers")
        for name in ("edge_missing", "edge_mixed"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"depth sensor: {name} = {getattr(self, name):g}; give a share of 0 to 1")
        for name in ("grain_px", "jitter_px", "step", "inverse_depth_step", "depth_step"):
            if not getattr(self, name) >= 0:
                raise InputError(f"depth sensor: {name} = {getattr(self, name):g}; give 0 or more")
        for name in ("grazing_deg", "sensing_range"):
            low, high = getattr(self, name)
            if not 0 <= low <= high:
                raise InputError(f"depth sensor: {name} = {low:g} to {high:g}; give 0 <= low <= high")

    @property
    def corrected(self) -> "DepthSensor":
        """The sensor with its linear error corrected (a = 1, b = 0), as in the published images of T-LESS."""
        return replace(self, a=1.0, b=0.0)

    def noise_std(
        self, depth: Float[np.ndarray, "*n"], angle: Float[np.ndarray, "*n"] | float = 0.0
    ) -> Float[np.ndarray, "*n"]:
        """Standard deviation of the noise in metres, at a depth in metres and an angle of view in radians."""
        c0, c1, c2 = self.noise
        std = c0 + c1 * depth + c2 * depth**2
        factor, power = self.slanted_noise
        if factor > 0:
            steep = np.minimum(angle, STEEPEST)
            positive = np.where(depth > 0, depth, 1.0)
            std = std + factor * positive**power * (steep / (pi / 2 - steep)) ** 2
        return np.maximum(std, 0.0)

    def measure(
        self, depth: Float[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"], rng: np.random.Generator
    ) -> Float32[np.ndarray, "h w"]:
        """Measure exact depth (metres along z, 0 where there is nothing): a new image, 0 where nothing is measured.

        The same state of `rng` gives the same image.
        """
        angle = incidence(depth, K)
        seen = depth.astype(np.float32)
        if self.jitter_px:
            seen = jittered(seen, steps(seen, self.step), self.jitter_px, self.grain_px, rng)
        edges = steps(seen, self.step) if self.edge_missing or self.edge_mixed else np.zeros(seen.shape, bool)
        missing = self._missing(seen, angle, edges, K, rng)
        if self.edge_mixed:
            seen = mixed(seen, edges, self.edge_mixed, rng)
        measured = self._in_steps((self._noisy(seen, angle, rng) - np.float32(self.b)) / np.float32(self.a))
        low, high = self.sensing_range
        kept = (seen > 0) & ~missing & (measured > 0) & np.isfinite(measured) & (measured >= low) & (measured <= high)
        return np.where(kept, measured, np.float32(0))

    def _missing(
        self,
        depth: Float32[np.ndarray, "h w"],
        angle: Float32[np.ndarray, "h w"],
        edges: Bool[np.ndarray, "h w"],
        K: Float[np.ndarray, "3 3"],
        rng: np.random.Generator,
    ) -> Bool[np.ndarray, "h w"]:
        """Where the sensor gets no answer: in shadows, at edges, at grazing angles."""
        missing = np.zeros(depth.shape, bool)
        for eye in self.eyes:
            missing |= shadow(depth, K, eye)
        low, high = np.radians(self.grazing_deg)
        if self.edge_missing == 0 and low >= pi / 2:
            return missing
        share = np.clip((angle - low) / max(high - low, 1e-6), 0.0, 1.0)
        share = np.maximum(share, self.edge_missing * grown(edges, 1))
        return missing | (chance(depth.shape, self.grain_px, rng) < share)

    def _noisy(
        self, depth: Float32[np.ndarray, "h w"], angle: Float32[np.ndarray, "h w"], rng: np.random.Generator
    ) -> Float32[np.ndarray, "h w"]:
        if not (any(self.noise) or self.slanted_noise[0]):
            return depth
        return depth + self.noise_std(depth, angle).astype(np.float32) * grain(depth.shape, self.grain_px, rng)

    def _in_steps(self, depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
        if self.inverse_depth_step:
            inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
            count = np.rint(inverse / np.float32(self.inverse_depth_step))
            quantized = np.full_like(depth, np.inf)
            depth = np.divide(np.float32(1 / self.inverse_depth_step), count, out=quantized, where=count > 0)
        if self.depth_step:
            depth = np.rint(depth / np.float32(self.depth_step)) * np.float32(self.depth_step)
        return depth
