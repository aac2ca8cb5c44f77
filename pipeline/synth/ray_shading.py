"""Pictures of meshes by ray casting: area lights with soft shadows, one diffuse bounce, glossy plastic, antialiasing.

Colour samples spread over the square about an integer pixel coordinate, which is the pixel's centre (OpenCV, BOP).
The result is linear radiance; `pipeline.synth.sensor` turns it into an 8-bit image.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.scene import Camera
from pipeline.synth.ray_world import Hits, World

SURFACE_OFFSET = 2e-4
"""Secondary rays start this far (metres) off the surface, beyond float32 noise."""


@dataclass(frozen=True)
class AreaLight:
    """A rectangle that shines to one side: its corner, its two edges (metres, world) and its linear RGB radiance."""

    corner: tuple[float, float, float]
    edge_u: tuple[float, float, float]
    edge_v: tuple[float, float, float]
    radiance: tuple[float, float, float]


@dataclass(frozen=True)
class Lighting:
    """Area lights, and a sky that fills the rest."""

    lights: tuple[AreaLight, ...]
    zenith: tuple[float, float, float] = (0.80, 0.84, 0.90)
    horizon: tuple[float, float, float] = (0.50, 0.48, 0.45)

    def sky(self, directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Radiance from directions that meet no surface."""
        up = np.clip(0.5 + 0.5 * directions[:, 2:3], 0, 1)
        return (np.array(self.horizon) * (1 - up) + np.array(self.zenith) * up).astype(np.float32)


@dataclass(frozen=True)
class ShadingConfig:
    """How much work goes into a picture."""

    pixel_grid: int = 3
    """Colour samples per pixel are the square of this."""
    light_samples: int = 3
    """Shadow rays per light and colour sample."""
    bounce_samples: int = 3
    """Diffuse rays per colour sample."""
    smoothing_passes: int = 2
    """Passes of the edge-stopping filter that smooths the illumination (not the texture)."""


def shade(
    world: World, lighting: Lighting, camera: Camera, config: ShadingConfig | None = None, seed: int = 0
) -> Float[np.ndarray, "h w 3"]:
    """Linear radiance of every pixel; `camera.world_from_camera` must be set."""
    config = config or ShadingConfig()
    rng = np.random.default_rng(seed)
    pixels = camera.height * camera.width
    rotation = rng.random((pixels, 6), dtype=np.float32)
    color, light, albedo, normal, depth = (np.zeros((pixels, n), np.float32) for n in (3, 3, 3, 3, 1))
    count = config.pixel_grid**2
    for index in range(count):
        cell = np.array(divmod(index, config.pixel_grid))
        offset = (cell + rng.random((pixels, 2), dtype=np.float32)) / config.pixel_grid - 0.5
        origins, directions = _camera_rays(camera, offset)
        hits = world.first_hits(origins, directions)
        sky = np.ones(pixels, bool)
        sky[hits.ray] = False
        color[sky] += lighting.sky(directions[sky])
        view = -directions[hits.ray]
        diffuse, gloss = _illuminate(world, lighting, hits, view, rotation[hits.ray], index, config)
        color[hits.ray] += hits.albedo * diffuse + gloss
        light[hits.ray] += diffuse
        albedo[hits.ray] += hits.albedo
        normal[hits.ray] += hits.normals
        depth[hits.ray, 0] += np.linalg.norm(hits.points - origins[hits.ray], axis=1)
    shape = (camera.height, camera.width, -1)
    color, light, albedo, normal, depth = ((x / count).reshape(shape) for x in (color, light, albedo, normal, depth))
    # The filter sees the illumination only, and what it removes is taken off the picture: textures stay sharp.
    return color + albedo * (_smooth(light, normal, depth, config.smoothing_passes) - light)


def _camera_rays(camera: Camera, offset: Float[np.ndarray, "n 2"]) -> tuple[np.ndarray, np.ndarray]:
    assert camera.world_from_camera is not None
    v, u = np.indices((camera.height, camera.width)).reshape(2, -1)
    at = np.stack([u + offset[:, 0], v + offset[:, 1], np.ones(len(u))], axis=1)
    directions = at @ np.linalg.inv(camera.K).T @ camera.world_from_camera[:3, :3].T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.broadcast_to(camera.world_from_camera[:3, 3], directions.shape)
    return origins.astype(np.float32), directions.astype(np.float32)


def _illuminate(
    world: World,
    lighting: Lighting,
    hits: Hits,
    view: Float[np.ndarray, "n 3"],
    rotation: Float[np.ndarray, "n 6"],
    index: int,
    config: ShadingConfig,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Diffuse illumination (to be multiplied by the albedo) and glossy reflection towards the viewer."""
    start = hits.points + SURFACE_OFFSET * hits.normals
    cos_view = np.clip(np.einsum("ij,ij->i", hits.normals, view), 0.02, 1.0)[:, None]
    grazing = (1 - cos_view) ** 5 * (hits.specular > 0) * (1 - hits.roughness) ** 2
    fresnel = hits.specular + (1 - hits.specular) * grazing
    diffuse = np.zeros_like(hits.points)
    gloss = np.zeros_like(hits.points)
    for lamp in lighting.lights:
        for k in range(config.light_samples):
            uv = _sequence(index * config.light_samples + k, rotation[:, :2])
            to_light, strength = _towards(lamp, start, uv)
            unit = to_light / np.linalg.norm(to_light, axis=1, keepdims=True)
            cosine = np.einsum("ij,ij->i", hits.normals, unit)[:, None]
            strength *= np.clip(cosine, 0, None) * world.is_lit(start, to_light)[:, None] / config.light_samples
            diffuse += strength / np.pi
            gloss += strength * _highlight(hits, view, unit)
    for k in range(config.bounce_samples):
        uv = _sequence(index * config.bounce_samples + k, rotation[:, 2:4])
        directions = _around(hits.normals, np.sqrt(uv[:, :1]), uv[:, 1:])
        diffuse += _seen(world, lighting, start, directions) / config.bounce_samples
    mirror = 2 * cos_view * hits.normals - view
    uv = _sequence(index, rotation[:, 4:6])
    directions = _around(mirror, np.sqrt(uv[:, :1]) * hits.roughness**1.5, uv[:, 1:])
    gloss += fresnel * _seen(world, lighting, start, directions)
    return diffuse * (1 - fresnel), gloss


def _seen(
    world: World, lighting: Lighting, start: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """What a secondary ray sees: the sky, or a surface under a rough estimate of its light (no further rays)."""
    radiance = lighting.sky(directions)
    hits = world.first_hits(start, directions, textured=False)
    open_sky = lighting.sky(hits.normals)
    for lamp in lighting.lights:
        to_light, strength = _towards(lamp, hits.points, np.full((1, 2), 0.5, np.float32))
        cosine = np.einsum("ij,ij->i", hits.normals, to_light / np.linalg.norm(to_light, axis=1, keepdims=True))
        open_sky = open_sky + 0.6 * strength * np.clip(cosine, 0, None)[:, None] / np.pi
    radiance[hits.ray] = 0.6 * hits.albedo * open_sky
    return radiance


def _towards(lamp: AreaLight, points: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors to points of the lamp, and radiance x solid angle of the whole lamp as seen along them."""
    edge_u, edge_v = np.array(lamp.edge_u, np.float32), np.array(lamp.edge_v, np.float32)
    to_light = np.array(lamp.corner, np.float32) + uv[:, :1] * edge_u + uv[:, 1:] * edge_v - points
    across = np.cross(edge_u, edge_v)
    squared = np.einsum("ij,ij->i", to_light, to_light)
    solid_angle = np.abs(to_light @ across) / squared**1.5
    return to_light, solid_angle[:, None] * np.array(lamp.radiance, np.float32)


def _highlight(hits: Hits, view: np.ndarray, unit: np.ndarray) -> Float[np.ndarray, "n 1"]:
    """Normalized Blinn-Phong lobe with Schlick's Fresnel term."""
    half = view + unit
    half /= np.linalg.norm(half, axis=1, keepdims=True) + 1e-9
    power = 2.0 / np.clip(hits.roughness, 0.06, 1.0) ** 3
    lobe = np.clip(np.einsum("ij,ij->i", hits.normals, half), 0, 1)[:, None] ** power * (power + 8) / (8 * np.pi)
    grazing = np.clip(1 - np.einsum("ij,ij->i", view, half), 0, 1)[:, None] ** 5
    return lobe * (hits.specular + (1 - hits.specular) * grazing * (hits.specular > 0))


def _sequence(index: int, rotation: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Point `index` of the R2 low-discrepancy sequence, shifted per pixel."""
    return (rotation + np.float32(index) * np.array([0.7548776662, 0.5698402910], np.float32)) % np.float32(1.0)


def _around(axes: np.ndarray, radius: np.ndarray, turn: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """Unit vectors off the axes: a point at the given radius of the unit disc, lifted to the sphere (cosine lobe)."""
    sign = np.where(axes[:, 2:] >= 0, 1.0, -1.0).astype(np.float32)
    x, y, z = axes[:, :1], axes[:, 1:2], axes[:, 2:]
    a = -1.0 / (sign + z)
    b = x * y * a
    tangent = np.concatenate([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    bitangent = np.concatenate([b, sign + y * y * a, -y], axis=1)
    angle = np.float32(2 * np.pi) * turn
    return (
        tangent * (radius * np.cos(angle))
        + bitangent * (radius * np.sin(angle))
        + axes * np.sqrt(np.clip(1 - radius**2, 0, 1))
    )


def _smooth(light: np.ndarray, normal: np.ndarray, depth: np.ndarray, passes: int) -> np.ndarray:
    """Edge-stopping a-trous filter: averages illumination among pixels of like normal, depth and illumination."""
    kernel = np.array([1, 4, 6, 4, 1], np.float32) / 16
    normal = normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-6)
    for level in range(passes):
        step = 2**level
        pad = 2 * step
        padded = [np.pad(x, ((pad, pad), (pad, pad), (0, 0)), mode="edge") for x in (light, normal, depth)]
        total, weights = np.zeros_like(light), np.zeros_like(depth)
        for i, j in np.ndindex(5, 5):
            window = (slice(i * step, i * step + light.shape[0]), slice(j * step, j * step + light.shape[1]))
            other_light, other_normal, other_depth = (x[window] for x in padded)
            like = np.sum(normal * other_normal, axis=2, keepdims=True).clip(0, 1) ** 32
            like = like * np.exp(-(np.abs(depth - other_depth) / (0.01 * step)))
            like = like * np.exp(-((np.sum(light - other_light, axis=2, keepdims=True) / 0.5) ** 2))
            weight = kernel[i] * kernel[j] * like
            total += weight * other_light
            weights += weight
        light = np.where(weights > 1e-3, total / np.maximum(weights, 1e-3), light)
    return light
