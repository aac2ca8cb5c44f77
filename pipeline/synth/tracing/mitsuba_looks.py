"""Materials as few Mitsuba BSDFs as possible, since each costs time to trace and to compile, for every image anew.

All static surfaces of plain colours share one BSDF that looks its values up in a palette; pictures that do not repeat
share another through an atlas; a texture that repeats has its own, and so has every object. Vertex colours become
pictures too: Mitsuba's vertex attributes would cost it a case per shape in the scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from pipeline.scene import Model
from pipeline.synth.materials import Material, Texture
from pipeline.synth.tracing.mitsuba_variant import mitsuba
from pipeline.synth.tracing.model_shading import Shaded

MIN_ROUGHNESS = 0.04
SPECULAR_STEP = 0.25
"""Mitsuba has one specular per BSDF, so it is rounded to steps of this, or every surface would need its own."""
LARGE = 1024
"""Pixels of the sides of textures that repeat: Mitsuba compiles code anew for each other size."""
CELL, CELLS = 512, 8
"""Pixels of a picture in the atlas, and pictures along its side."""
COLORS = 32
"""Plain materials along the side of the palette."""
NEUTRAL = (0.4, 0.4, 0.4)
"""Linear RGB of what has no colour."""


@dataclass(frozen=True, eq=False)
class Look:
    """A mesh whose texture coordinates are those of its BSDF's pictures."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    uv: Float[np.ndarray, "v 2"]


class Atlas:
    """Pictures that cover their surface once, many in one bitmap, each with a roughness."""

    def __init__(self) -> None:
        self._images: list[UInt8[np.ndarray, "_ _ 3"]] = []
        self._finish: list[tuple[float, float]] = []
        self._slots: dict[tuple[int, float, float], int] = {}

    def slot(self, texture: Texture, material: Material) -> int:
        """Number of the picture's place."""
        key = (id(texture), material.roughness, material.metallic)
        if key not in self._slots:
            import cv2

            image = cv2.resize(texture.image, (CELL, CELL), interpolation=cv2.INTER_AREA)
            self._slots[key] = len(self._images)
            self._images.append(np.asarray(image))
            self._finish.append((material.roughness, material.metallic))
        return self._slots[key]

    @staticmethod
    def sheet(slot: int) -> int:
        """Number of the bitmap that a place is in."""
        return slot // CELLS**2

    @staticmethod
    def uv(slot: int, uv: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, "v 2"]:
        """Texture coordinates in the bitmap of those in the picture (0..1), half a pixel inside its border."""
        row, column = divmod(slot % CELLS**2, CELLS)
        inside = (0.5 + np.clip(uv, 0.0, 1.0) * (CELL - 1)) / CELL
        return (inside + np.array([column, row])) / CELLS

    def bsdf(self, sheet: int, step: float) -> Any:
        """The BSDF of all pictures of one bitmap (its first row is at v = 0, as Mitsuba has it)."""
        chosen = slice(sheet * CELLS**2, (sheet + 1) * CELLS**2)
        canvas = np.zeros((CELLS, CELL, CELLS, CELL, 3), np.uint8)
        for k, image in enumerate(self._images[chosen]):
            canvas[k // CELLS, :, k % CELLS] = image[::-1]
        picture = _bitmap(canvas.reshape(CELLS * CELL, CELLS * CELL, 3), raw=False)
        return _bsdf(picture, *_finish_tables(self._finish[chosen], CELLS), step)


class Palette:
    """Plain materials, each a pixel of three small bitmaps."""

    def __init__(self) -> None:
        self._slots: dict[tuple[float, ...], int] = {}

    def uv(self, material: Material) -> tuple[float, float]:
        """Texture coordinates of the material's pixel."""
        color = material.color or NEUTRAL
        slot = self._slots.setdefault((*color, material.roughness, material.metallic), len(self._slots) % COLORS**2)
        row, column = divmod(slot, COLORS)
        return (column + 0.5) / COLORS, (row + 0.5) / COLORS

    def bsdf(self, step: float) -> Any:
        """The BSDF of all of them."""
        values = np.zeros((COLORS**2, 5), np.float32)
        values[: len(self._slots)] = list(self._slots)[: COLORS**2]
        picture = _bitmap(values[:, :3].reshape(COLORS, COLORS, 3), raw=True, smooth=False)
        return _bsdf(picture, *_finish_tables([(r, m) for r, m in values[:, 3:].tolist()], COLORS), step)


def merged(parts: Sequence[Look]) -> Look:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts[:-1], strict=True)])
    vertices, normals, uv = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("vertices", "normals", "uv")
    )
    return Look(vertices, faces, normals, uv)


def mesh(name: str, look: Look, bsdf: Any) -> Any:
    """A Mitsuba mesh."""
    mi = mitsuba()
    props = mi.Properties()
    props["mesh_bsdf"] = bsdf
    made = mi.Mesh(name, len(look.vertices), len(look.faces), props, True, True)
    params = mi.traverse(made)
    params["vertex_positions"] = _flat(look.vertices)
    params["vertex_normals"] = _flat(look.normals)
    params["vertex_texcoords"] = _flat(look.uv)
    params["faces"] = np.ascontiguousarray(look.faces, np.uint32).ravel()
    params.update()
    return made


def step_of(material: Material) -> float:
    """The material's specular, rounded; 0 only if it is 0 and there is no metal, for then it is plainly diffuse."""
    if material.specular == 0 and material.metallic == 0:
        return 0.0
    return max(SPECULAR_STEP, round(material.specular / SPECULAR_STEP) * SPECULAR_STEP)


def tiled(texture: Texture, material: Material) -> Any:
    """The BSDF of a texture that repeats."""
    relief = texture.relief
    bumps = None
    if relief is not None and texture.relief_depth > 0:
        heights = _large(relief.astype(np.float32) * np.float32(texture.relief_depth))
        bumps = _bitmap(heights[::-1, :, None], raw=True)
    picture = _bitmap(_large(texture.image)[::-1], raw=False)
    return _bsdf(picture, material.roughness, material.metallic, step_of(material), bumps)


def plain(material: Material) -> Any:
    """The BSDF of an object of one colour."""
    color = {"type": "rgb", "value": list(material.color or NEUTRAL)}
    return _bsdf(color, material.roughness, material.metallic, step_of(material))


_images: WeakKeyDictionary[Model, dict[str, Any]] = WeakKeyDictionary()


def pictured(model: Model, material: Material) -> Any:
    """The BSDF of an object with its model's own texture image."""
    if model not in _images:
        assert model.texture is not None
        _images[model] = {"image": _made(_bitmap(model.texture[::-1], raw=False))}
    return _bsdf(_images[model]["image"], material.roughness, material.metallic, step_of(material))


def vertex_colored(model: Model, shaded: Shaded, material: Material) -> tuple[Shaded, Any]:
    """The mesh with separate corners and coordinates in a picture of its vertex colours, and the BSDF.

    Each face has 2 x 2 pixels of its own: its corners' colours and, as the fourth, what continues them linearly, so
    that the bilinear lookup of Mitsuba interpolates linearly over the face.
    """
    assert shaded.colors is not None
    count = len(shaded.faces)
    side = 2 ** ceil(np.log2(max(2 * ceil(sqrt(count)), 16)))  # few sizes: Mitsuba compiles code for each
    if model not in _images:
        a, b, c = linear_from_srgb(shaded.colors[shaded.faces]).transpose(1, 0, 2)
        cells = np.zeros(((side // 2) ** 2, 2, 2, 3), np.float32)
        cells[:count] = np.stack([np.stack([a, b], 1), np.stack([c, b + c - a], 1)], 1)
        grid = cells.reshape(side // 2, side // 2, 2, 2, 3).transpose(0, 2, 1, 3, 4).reshape(side, side, 3)
        _images[model] = {"image": _made(_bitmap(grid, raw=True))}
    row, column = np.divmod(np.arange(count), side // 2)
    first = np.stack([2 * column + 0.5, 2 * row + 0.5], axis=1)
    uv = (first[:, None, :] + np.array([[0, 0], [1, 0], [0, 1]])) / side
    corners = shaded.faces.ravel()
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    normals = None if shaded.normals is None else shaded.normals[corners]
    separate = Shaded(shaded.vertices[corners], faces, normals, uv.reshape(-1, 2))
    return separate, _bsdf(_images[model]["image"], material.roughness, material.metallic, step_of(material))


def _bsdf(base_color: Any, roughness: Any, metallic: Any, step: float, bumps: Any = None) -> Any:
    """Mitsuba's `principled` material, seen from both sides since scanned models are not always closed."""
    surface: dict[str, Any] = {"type": "diffuse", "reflectance": base_color}  # what principled comes to, but faster
    if step > 0:
        surface = {"type": "principled", "base_color": base_color, "specular": step, "metallic": metallic}
        surface["roughness"] = max(roughness, MIN_ROUGHNESS) if isinstance(roughness, float) else roughness
    if bumps is not None:
        surface = {"type": "bumpmap", "heights": bumps, "bsdf": surface}
    return _made({"type": "twosided", "bsdf": surface})


def _finish_tables(finish: Sequence[tuple[float, float]], side: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Bitmaps of roughness and metallic, one pixel per entry."""
    table = np.zeros((side * side, 2), np.float32)
    table[: len(finish)] = finish
    table[:, 0] = np.maximum(table[:, 0], MIN_ROUGHNESS)
    grid = table.reshape(side, side, 2)
    return _bitmap(grid[..., :1], raw=True, smooth=False), _bitmap(grid[..., 1:], raw=True, smooth=False)


def _bitmap(image: np.ndarray, raw: bool, smooth: bool = True) -> dict[str, Any]:
    bitmap = mitsuba().Bitmap(np.ascontiguousarray(image))
    kind = "bilinear" if smooth else "nearest"
    return {"type": "bitmap", "bitmap": bitmap, "raw": raw, "wrap_mode": "repeat", "filter_type": kind}


def _made(description: dict[str, Any]) -> Any:
    return mitsuba().load_dict(description)


def _large(image: np.ndarray) -> np.ndarray:
    import cv2

    return image if image.shape[:2] == (LARGE, LARGE) else np.asarray(cv2.resize(image, (LARGE, LARGE)))


def _flat(values: np.ndarray) -> Float32[np.ndarray, " n"]:
    return np.ascontiguousarray(values, np.float32).ravel()


def linear_from_srgb(srgb: UInt8[np.ndarray, "*n 3"]) -> Float32[np.ndarray, "*n 3"]:
    """Linear RGB in 0..1."""
    values = srgb.astype(np.float32) / 255.0
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(np.float32)
