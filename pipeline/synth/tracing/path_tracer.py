"""Photorealistic images of objects in a world by path tracing with Mitsuba 3 (thesis sec. synth_pbr).

    tracer = PathTracer(world, [(model, material, world_from_model), ...])
    rgb = tracer.render(camera, camera_from_world, "bop20", seed=0)
    ids = tracer.object_ids(camera, camera_from_world)

A scene is built once per arrangement and serves any number of cameras. Pixel (column, row) has its centre at
(column, row), as everywhere: its silhouettes are those of `pipeline.rendering.render(..., pixel_center=0.0)`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int32, UInt8

from pipeline.exceptions import UnknownIdError
from pipeline.scene import Camera
from pipeline.synth.tracing import mitsuba_scene
from pipeline.synth.tracing.denoising import denoise
from pipeline.synth.tracing.mitsuba_scene import Object
from pipeline.synth.tracing.mitsuba_variant import is_scalar, mitsuba
from pipeline.synth.tracing.tone_mapping import PhotoConfig, photograph
from pipeline.synth.worlds.world import World

ROULETTE = 2
"""Paths that carry little light may end from this reflection on."""
MAX_SAMPLES_AT_ONCE = 36
"""Samples per pixel of one pass, which bounds the memory."""


@dataclass(frozen=True)
class Preset:
    """How well an image is rendered (thesis table tab:synth_arnoldsampling)."""

    samples_per_pixel: int
    """Paths per pixel."""
    max_reflections: int
    """Of one path in total, the first hit not counted: what the table calls D depth."""
    denoised: bool = True
    guide_samples: int = 4
    """Samples per pixel of the albedo and normals that guide the denoiser."""


PRESETS = {
    "low": Preset(4, 1),
    "medium": Preset(36, 3),
    "high": Preset(225, 4),
    "bop20": Preset(16, 3),
}
"""By name. The table gives rays per pixel (AA) and indirect rays per first hit (D): low 1 x 1, medium 9 x 4, high
25 x 9, BlenderProc4BOP 50 x 1. Here every path is a ray through the pixel of its own, so medium and high take the
product, low takes 4 for the sake of edges, and bop20 takes 16: guided by albedo and normals, the denoiser makes of 16
samples a picture 1.4 to 1.6 dB short of the one that it makes of 50 (`benchmarks/path_tracer.py --quality`; without
it, 50 are 9 to 14 dB short). Depths are the table's D depths, but high's, which is its Max depth.
"""


def preset_of(preset: str | Preset) -> Preset:
    """A preset by its name; a preset is passed on. Raises `UnknownIdError`, which lists the names."""
    if isinstance(preset, Preset):
        return preset
    if preset not in PRESETS:
        raise UnknownIdError("quality", preset, "the presets", PRESETS)
    return PRESETS[preset]


class PathTracer:
    """A world with objects in it, ready to be seen by many cameras."""

    def __init__(self, world: World, objects: Sequence[Object]) -> None:
        self._world = world
        self._scene, self._numbers = mitsuba_scene.load(world, objects)

    def render(
        self,
        camera: Camera,
        camera_from_world: Float[np.ndarray, "4 4"],
        preset: str | Preset = "bop20",
        seed: int = 0,
        photo: PhotoConfig | None = None,
    ) -> UInt8[np.ndarray, "h w 3"]:
        """The photograph: sRGB. The same seed gives the same image on the same machine, up to a level by rounding."""
        radiance = self.radiance(camera, camera_from_world, preset, seed)
        return photograph(radiance, photo, self._world.white, np.random.default_rng([seed, 77]))

    def radiance(
        self, camera: Camera, camera_from_world: Float[np.ndarray, "4 4"], preset: str | Preset = "bop20", seed: int = 0
    ) -> Float32[np.ndarray, "h w 3"]:
        """Linear RGB radiance, without noise if the preset says so."""
        preset = preset_of(preset)
        integrator = {"type": "path", "max_depth": preset.max_reflections + 2, "rr_depth": ROULETTE}
        passes = _passes(preset.samples_per_pixel)
        samples = preset.samples_per_pixel // passes
        total = np.zeros((camera.height, camera.width, 3), np.float32)
        for k in range(passes):
            total += self._trace(integrator, camera, camera_from_world, samples, (seed * 1009 + k) % 2**31)
        radiance = np.nan_to_num(total / passes, nan=0.0, posinf=0.0, neginf=0.0)
        if not preset.denoised:
            return radiance
        return denoise(radiance, *self.guides(camera, camera_from_world, preset.guide_samples, seed))

    def guides(
        self, camera: Camera, camera_from_world: Float[np.ndarray, "4 4"], samples: int = 4, seed: int = 0
    ) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w 3"]]:
        """Albedo and world-frame normals of what each pixel shows, averaged over the pixel."""
        if is_scalar():
            samples = 1  # this takes longer there than the image itself
        integrator = {"type": "aov", "aovs": "albedo:albedo,normals:sh_normal"}
        both = np.nan_to_num(self._trace(integrator, camera, camera_from_world, samples, (seed + 5) % 2**31))
        return np.clip(both[..., :3], 0, 1), both[..., 3:6]

    def object_ids(self, camera: Camera, camera_from_world: Float[np.ndarray, "4 4"]) -> Int32[np.ndarray, "h w"]:
        """Position in the list of objects of what the centre of each pixel shows, -1 for the world."""
        mi = mitsuba()
        sensor = mitsuba_scene.sensor(camera, camera_from_world, "stratified", 1, jitter=False)
        integrator = mi.load_dict({"type": "aov", "aovs": "shape:shape_index"})
        shapes = np.rint(np.array(integrator.render(self._scene, sensor, seed=0, spp=1))[..., 0]).astype(np.int64)
        position = np.full(max(int(shapes.max()), int(self._numbers.max(initial=0))) + 1, -1, np.int32)
        position[self._numbers] = np.arange(len(self._numbers))
        return position[shapes]

    def _trace(
        self, integrator: dict[str, Any], camera: Camera, camera_from_world: np.ndarray, samples: int, seed: int
    ) -> np.ndarray:
        mi = mitsuba()
        sampler = "multijitter" if samples > 1 else "independent"
        sensor = mitsuba_scene.sensor(camera, camera_from_world, sampler, samples, jitter=True)
        return np.array(mi.load_dict(integrator).render(self._scene, sensor, seed=seed, spp=samples))


def render(
    world: World,
    objects: Sequence[Object],
    camera: Camera,
    camera_from_world: Float[np.ndarray, "4 4"],
    preset: str | Preset = "bop20",
    seed: int = 0,
) -> UInt8[np.ndarray, "h w 3"]:
    """One image; for several of the same arrangement make a `PathTracer`."""
    return PathTracer(world, objects).render(camera, camera_from_world, preset, seed)


def _passes(samples: int) -> int:
    """The least number of equal passes none of which is too large."""
    return next(k for k in range(ceil(samples / MAX_SAMPLES_AT_ONCE), samples + 1) if samples % k == 0)
