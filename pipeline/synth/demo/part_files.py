"""The parts as a BOP `models` folder: PLY files in millimetres and `models_info.json`."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.bop.json_files import write_atomically, write_json_by_id
from pipeline.bop.models import diameter_of
from pipeline.scene import Model
from pipeline.symmetry import symmetry_transforms
from pipeline.synth.demo.parts import PARTS, part_mesh, symmetry_info
from pipeline.synth.demo.solids import PartMesh


def write_part_models(folder: Path) -> None:
    """Write `obj_ID.ply` with normals and colours for looking at; vertices on sharp edges are repeated per side."""
    for part in PARTS:
        write_atomically(folder / f"obj_{part.obj_id:06d}.ply", _ply(part_mesh(part.obj_id), appearance=True))
    _write_info(folder)


def write_eval_models(folder: Path) -> None:
    """Write `obj_ID.ply` for evaluation: the same surfaces, watertight, each vertex once, without normals and colours."""
    for part in PARTS:
        write_atomically(folder / f"obj_{part.obj_id:06d}.ply", _ply(merged(part_mesh(part.obj_id)), appearance=False))
    _write_info(folder)


def merged(mesh: PartMesh) -> PartMesh:
    """The mesh with vertices at the same position joined; their normals and colours are those of one of them."""
    _, first, joined = np.unique(mesh.vertices_mm, axis=0, return_index=True, return_inverse=True)
    kept = np.sort(first)  # in the order of the file
    faces = np.searchsorted(kept, first[joined.ravel()])[mesh.faces].astype(np.int32)
    return PartMesh(mesh.vertices_mm[kept], faces, mesh.normals[kept], mesh.colors[kept])


@cache
def part_model(obj_id: int) -> Model:
    """Shape of a part as it reads back from its file (metres)."""
    mesh = part_mesh(obj_id)
    vertices = mesh.vertices_mm.astype(np.float64) / 1000.0
    return Model(obj_id, vertices, mesh.faces, diameter_of(vertices))


@cache
def part_display_model(obj_id: int) -> Model:
    """The same with normals, colours and symmetries."""
    mesh, shape = part_mesh(obj_id), part_model(obj_id)
    symmetries = symmetry_transforms(symmetry_info(PARTS[obj_id - 1]))
    return replace(shape, symmetries=symmetries, normals=mesh.normals.astype(np.float64), colors=mesh.colors)


def _write_info(folder: Path) -> None:
    write_json_by_id(folder / "models_info.json", {part.obj_id: _model_info(part.obj_id) for part in PARTS})


def _model_info(obj_id: int) -> dict[str, Any]:
    vertices = part_mesh(obj_id).vertices_mm.astype(np.float64)
    low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
    info: dict[str, Any] = {"diameter": round(diameter_of(vertices), 6)}
    info |= {f"min_{axis}": round(float(value), 6) for axis, value in zip("xyz", low, strict=True)}
    info |= {f"size_{axis}": round(float(value), 6) for axis, value in zip("xyz", size, strict=True)}
    return info | symmetry_info(PARTS[obj_id - 1])


def _ply(mesh: PartMesh, appearance: bool) -> bytes:
    """A binary little-endian PLY file."""
    columns: list[tuple[str, str]] = [(name, "<f4") for name in ("x", "y", "z")]
    if appearance:
        columns += [(name, "<f4") for name in ("nx", "ny", "nz")] + [(name, "u1") for name in ("red", "green", "blue")]
    vertices = np.empty(len(mesh.vertices_mm), columns)
    values = [*mesh.vertices_mm.T, *mesh.normals.T, *mesh.colors.T]
    for (name, _), column in zip(columns, values, strict=False):
        vertices[name] = column
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    properties = [f"property {'float' if kind == '<f4' else 'uchar'} {name}" for name, kind in columns]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment millimetres",
        f"element vertex {len(vertices)}",
        *properties,
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    return ("\n".join(header) + "\n").encode() + vertices.tobytes() + faces.tobytes()
