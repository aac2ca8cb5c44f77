"""Worlds and objects as a Mitsuba 3 scene: meshes, lights, cameras. Needs `mitsuba` (extra `synth`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Int

from pipeline.exceptions import InputError
from pipeline.geometry import inverse
from pipeline.scene import Camera, Model
from pipeline.synth.materials import Material
from pipeline.synth.tracing import mitsuba_looks as looks
from pipeline.synth.tracing.mitsuba_looks import Atlas, Look, Palette
from pipeline.synth.tracing.mitsuba_variant import is_scalar, mitsuba
from pipeline.synth.tracing.model_shading import Shaded, crease_normals, shaded
from pipeline.synth.worlds.world import Beam, Light, Piece, PointLight, Sky, World

Object = tuple[Model, Material, Float[np.ndarray, "4 4"]]
"""What is rendered besides the world: model, material, world_from_model."""


class Loaded(NamedTuple):
    """A scene of Mitsuba's, its acceleration structure built."""

    scene: Any
    object_numbers: Int[np.ndarray, " n"]
    """What Mitsuba's AOV `shape_index` says of each object."""


def load(world: World, objects: Sequence[Object]) -> Loaded:
    """Make the scene."""
    mi = mitsuba()
    parts = {f"static_{i:04d}": item for i, item in enumerate(_static(world))}
    meshes = [_object_mesh(item) for item in objects]
    parts |= {f"zobject_{i:04d}": item for i, item in enumerate(meshes)}  # sorted last
    scene = mi.load_dict({"type": "scene", **parts}, optimize=False)
    if is_scalar():  # counts the scene's shapes from 1, else those of the whole process
        numbers = np.arange(len(meshes)) + len(scene.shapes()) - len(meshes) + 1
    else:
        import drjit

        reinterpret: Any = drjit.reinterpret_array
        numbers = [int(reinterpret(mi.UInt32, mi.ShapePtr(item))[0]) for item in meshes]
    return Loaded(scene, np.array(numbers, dtype=np.int64))


_static_of: WeakKeyDictionary[World, list[Any]] = WeakKeyDictionary()


def _static(world: World) -> list[Any]:
    """Shapes and lights of a world, made once: pieces of the same BSDF are one mesh."""
    if world not in _static_of:
        atlas, palette = Atlas(), Palette()
        groups: dict[tuple, list[Look]] = {}
        materials = {}
        for piece in world.pieces:
            key, look = _look_of(piece, atlas, palette)
            groups.setdefault(key, []).append(look)
            materials[key] = piece.material
        made = []
        for key, parts in groups.items():
            if key[0] == "plain":
                bsdf = palette.bsdf(key[1])
            else:
                bsdf = atlas.bsdf(key[2], key[1]) if key[0] == "printed" else _tiled(materials[key])
            made.append(looks.mesh(str(key[0]), looks.merged(parts), bsdf))
        _static_of[world] = made + [mitsuba().load_dict(_light(light)) for light in world.lights]
    return _static_of[world]


def _look_of(piece: Piece, atlas: Atlas, palette: Palette) -> tuple[tuple, Look]:
    """The piece with texture coordinates of its BSDF, and a key that pieces with the same BSDF share."""
    mesh = _with_normals(Shaded(piece.vertices, piece.faces, piece.normals, piece.uv))
    material, step = piece.material, looks.step_of(piece.material)
    texture = material.texture if material.color is None else None
    key: tuple
    if texture is None or mesh.uv is None:
        key, uv = ("plain", step), np.tile(palette.uv(material), (len(mesh.vertices), 1))
    else:
        uv = mesh.uv / np.array(texture.size)
        key = ("tiled", step, id(material))
        if texture.relief is None and uv.min() > -1e-6 and uv.max() < 1 + 1e-6:  # covers the piece once
            slot = atlas.slot(texture, material)
            key, uv = ("printed", step, atlas.sheet(slot)), atlas.uv(slot, uv)
    assert mesh.normals is not None
    return key, Look(mesh.vertices, mesh.faces, mesh.normals, uv)


def _tiled(material: Material) -> Any:
    assert material.texture is not None
    return looks.tiled(material.texture, material)


def _with_normals(mesh: Shaded) -> Shaded:
    """The mesh itself, or with flat faces where it has no normals."""
    if mesh.normals is not None:
        return mesh
    corners = mesh.faces.ravel()
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    uv = None if mesh.uv is None else mesh.uv[corners]
    return Shaded(mesh.vertices[corners], faces, crease_normals(mesh.vertices, mesh.faces, 0.5), uv)


def _object_mesh(item: Object) -> Any:
    """An object in its pose; its rotation is taken as it is."""
    model, material, world_from_model = item
    look = shaded(model)
    assert look.normals is not None
    normals = look.normals @ inverse(world_from_model)[:3, :3]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    vertices = look.vertices @ world_from_model[:3, :3].T + world_from_model[:3, 3]
    posed = Shaded(vertices, look.faces, normals, look.uv, look.colors)
    mesh, bsdf = _dressed(model, posed, material)
    uv = np.zeros((len(mesh.vertices), 2)) if mesh.uv is None else mesh.uv
    assert mesh.normals is not None
    return looks.mesh(f"object {model.obj_id}", Look(mesh.vertices, mesh.faces, mesh.normals, uv), bsdf)


def _dressed(model: Model, mesh: Shaded, material: Material) -> tuple[Shaded, Any]:
    """An object's mesh with the texture coordinates of its BSDF, and that."""
    if material.color is None and mesh.uv is not None:
        if material.texture is not None:
            return replace(mesh, uv=mesh.uv / np.array(material.texture.size)), _tiled(material)
        if model.texture is not None:
            return mesh, looks.pictured(model, material)
    if material.color is None and mesh.colors is not None:
        return looks.vertex_colored(model, mesh, material)
    return mesh, looks.plain(material)


def _light(light: Light) -> dict[str, Any]:
    mi = mitsuba()
    if isinstance(light, Sky):
        return {"type": "constant", "radiance": {"type": "rgb", "value": list(light.radiance)}}
    if isinstance(light, PointLight):
        intensity = {"type": "rgb", "value": list(light.intensity)}
        return {"type": "point", "position": list(light.position), "intensity": intensity}
    if isinstance(light, Beam):
        return _beam(light)
    u, v = np.array(light.half_u), np.array(light.half_v)
    world_from_rectangle = np.eye(4)
    world_from_rectangle[:3] = np.stack([u, v, np.cross(u, v), np.array(light.centre)], axis=1)
    world_from_rectangle[:3, 2] /= np.linalg.norm(world_from_rectangle[:3, 2])
    radiance: dict[str, Any] = {"type": "rgb", "value": list(light.radiance)}
    if light.picture is not None:
        picture = np.ascontiguousarray(light.picture[::-1] * np.array(light.radiance), np.float32)
        radiance = {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True, "wrap_mode": "clamp"}
    to_world = mi.ScalarTransform4f(world_from_rectangle)
    return {"type": "rectangle", "to_world": to_world, "emitter": {"type": "area", "radiance": radiance}}


def _beam(beam: Beam) -> dict[str, Any]:
    """A projector of the pattern."""
    mi = mitsuba()
    origin, target = np.array(beam.position), np.array(beam.target)
    to_world = mi.ScalarTransform4f().look_at(origin.tolist(), target.tolist(), [0.0, 0.0, 1.0])
    # Mitsuba's projector shines like a camera's film: irradiance falls with distance squared from value 1 at depth 1
    strength = np.array(beam.irradiance) * float(np.sum((target - origin) ** 2))
    pattern = looks.linear_from_srgb(beam.pattern) * strength.astype(np.float32)
    image = {"type": "bitmap", "bitmap": mi.Bitmap(pattern.astype(np.float32)), "raw": True, "wrap_mode": "clamp"}
    return {"type": "projector", "to_world": to_world, "fov": beam.angle_deg, "irradiance": image}


class Frame(NamedTuple):
    """What Mitsuba needs to know of a camera besides its pose."""

    fov_x_deg: float
    offset: tuple[float, float]
    """Of the principal point from the middle of the film, in film sizes; positive moves the picture right and down."""
    film: tuple[int, int]
    """A film of square pixels with the same field of view: its aspect holds fx / fy."""


FILM_SCALE = 4096


def frame_of(camera: Camera) -> Frame:
    """Pinhole intrinsics as Mitsuba's perspective camera, exact for any principal point and for non-square pixels.

    Mitsuba's film coordinate of a pixel's centre is its column + 0.5, ours its column, hence cx + 0.5. Mitsuba knows
    square pixels only and takes the vertical field of view from the aspect of the film: so the camera is set up with
    a film of width W and height H fx / fy, which is given its true number of pixels afterwards.

    Raises `InputError` where K has a skew, which Mitsuba cannot render, or no focal length.
    """
    (fx, skew, cx), (_, fy, cy), _ = camera.K.tolist()
    if abs(skew) * camera.height / fy > 0.05 or min(fx, fy) <= 0:
        raise InputError(
            f"camera matrix with fx {fx:g}, fy {fy:g}, skew {skew:g} cannot be ray traced; set the skew to 0"
        )
    offset = (0.5 - (cx + 0.5) / camera.width, 0.5 - (cy + 0.5) / camera.height)
    film = (camera.width * FILM_SCALE, round(camera.height * FILM_SCALE * fx / fy))
    return Frame(float(np.degrees(2 * np.arctan(camera.width / (2 * fx)))), offset, film)


_MITSUBA_FROM_OPENCV = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Mitsuba's camera looks along +z too, but has x to the left and y up."""


def sensor(
    camera: Camera, camera_from_world: Float[np.ndarray, "4 4"], sampler: str, samples: int, jitter: bool
) -> Any:
    """A Mitsuba camera with a box filter, whose samples stay in their own pixel."""
    mi = mitsuba()
    frame = frame_of(camera)
    film = {"type": "hdrfilm", "width": frame.film[0], "height": frame.film[1], "pixel_format": "rgb"}
    film |= {"component_format": "float32", "rfilter": {"type": "box"}}
    description = {
        "type": "perspective",
        "fov_axis": "x",
        "fov": frame.fov_x_deg,
        "principal_point_offset_x": frame.offset[0],
        "principal_point_offset_y": frame.offset[1],
        "near_clip": 0.01,
        "far_clip": 1000.0,
        "to_world": mi.ScalarTransform4f(_rigid(inverse(camera_from_world)) @ _MITSUBA_FROM_OPENCV),
        "film": film,
        "sampler": {"type": sampler, "sample_count": samples} | ({} if jitter else {"jitter": False}),
    }
    made = mi.load_dict(description)
    params = mi.traverse(made.film())
    params["size"] = params["crop_size"] = [camera.width, camera.height]
    params["crop_offset"] = [0, 0]
    params.update()
    return made


def _rigid(world_from_camera: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The pose if it is rigid; Mitsuba refuses others."""
    rotation = world_from_camera[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=4e-4) or np.linalg.det(rotation) < 0:
        raise InputError("camera pose that is not a rotation and a shift; orthonormalize its rotation")
    return world_from_camera
