"""Ray-cast colour pictures: the surface colour of each pixel, lit by fixed lights at the camera."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.rendering import Surface, render
from pipeline.scene import Camera, Model

GRAY = 0.72
"""sRGB value of a model without colour."""

AMBIENT = 0.3
"""Share of the surface colour that shows without any light, linear."""

LIGHTS = (((-0.4, -0.6, -1.0), 0.75), ((0.8, 0.1, -0.6), 0.2))
"""Where light comes from (camera frame: above left behind the camera, and right of it), and its share, linear."""


class ColorRendering(NamedTuple):
    """A model drawn in colour."""

    rgb: UInt8[np.ndarray, "h w 3"]
    """Black outside the object."""
    mask: Bool[np.ndarray, "h w"]
    """Silhouette."""


def srgb_from_linear(linear: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n"]:
    """Encode linear light, cut to 0..1, as 8-bit sRGB (gamma 2.2)."""
    return np.rint(np.clip(linear, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)


def linear_from_srgb(srgb: UInt8[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Decode 8-bit sRGB to linear light 0..1 (gamma 2.2)."""
    return (srgb / 255.0) ** 2.2


def shade(model: Model, camera: Camera, camera_from_model: np.ndarray, pixel_center: float) -> ColorRendering:
    """Draw a model as a matt surface; arguments as for `render_color`."""
    rendering = render(model, camera, camera_from_model, pixel_center, with_surface=True)
    mask = rendering.mask_crop
    rgb = np.zeros((*mask.shape, 3), np.uint8)
    if mask.any():
        assert rendering.surface is not None
        weights, corners = _corners(model, rendering.surface, mask)
        normals = _normals(model, rendering.surface.normals[mask], weights, corners)
        light = _light(normals @ np.linalg.inv(camera_from_model[:3, :3]))
        rgb[mask] = srgb_from_linear(_base_color(model, weights, corners) * light[:, None])
    return ColorRendering(rendering.expand(rgb), rendering.mask)


def _light(normals_in_camera: np.ndarray) -> np.ndarray:
    """Light that reaches each surface point, on either side: meshes have faces that are turned inside out."""
    normals = normals_in_camera / np.maximum(np.linalg.norm(normals_in_camera, axis=1, keepdims=True), 1e-12)
    light = np.full(len(normals), AMBIENT)
    for direction, share in LIGHTS:
        light += share * np.abs(normals @ (np.array(direction) / np.linalg.norm(direction)))
    return light


def _corners(model: Model, surface: Surface, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each pixel of the mask the weights (n, 3) and vertex ids (n, 3) of its face's corners."""
    b, c = surface.barycentric[mask].T
    return np.stack([1 - b - c, b, c], axis=1), model.faces[surface.face_ids[mask]]


def _normals(model: Model, face_normals: np.ndarray, weights: np.ndarray, corners: np.ndarray) -> np.ndarray:
    if model.normals is None:
        return face_normals.astype(np.float64)
    return np.einsum("nk,nkc->nc", weights, model.normals[corners])


def _base_color(model: Model, weights: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Linear surface colour (n, 3)."""
    if model.colors is not None:
        return np.einsum("nk,nkc->nc", weights, linear_from_srgb(model.colors[corners]))
    if model.texture is not None and model.texture_uv is not None:
        height, width = model.texture.shape[:2]
        u, v = np.einsum("nk,nkc->cn", weights, model.texture_uv[corners]) % 1.0
        rows = np.minimum(((1 - v) * height).astype(int), height - 1)
        return linear_from_srgb(model.texture[rows, np.minimum((u * width).astype(int), width - 1)])
    return np.full((len(weights), 3), GRAY**2.2)
