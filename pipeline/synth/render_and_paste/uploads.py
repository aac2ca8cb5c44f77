"""Meshes and textures in the memory of an OpenGL context, uploaded once per model."""

from __future__ import annotations

from ctypes import c_void_p
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import UInt8

from pipeline.scene import Model
from pipeline.synth.render_and_paste.meshes import DrawnMesh, drawn_mesh

_COLUMNS = (3, 3, 3, 2)
"""Position, normal, colour, texture coordinates: the attributes 0 to 3 of the programs."""


@dataclass(frozen=True)
class Upload:
    """Names of a model's things in the context."""

    vertex_array: Any
    corners: int
    """Of all triangles together."""
    texture: Any | None
    closed: bool


class Uploads:
    """The models that were uploaded to one context."""

    def __init__(self) -> None:
        self._known: dict[Model, Upload] = {}

    def of(self, gl: Any, model: Model) -> Upload:
        """Upload a model if that was not done yet; the context must be current."""
        if model not in self._known:
            mesh = drawn_mesh(model)
            texture = None if mesh.texture is None else _texture(gl, mesh.texture)
            self._known[model] = Upload(_vertex_array(gl, mesh), mesh.indices.size, texture, mesh.closed)
        return self._known[model]


def _vertex_array(gl: Any, mesh: DrawnMesh) -> Any:
    array = gl.glGenVertexArrays(1)
    gl.glBindVertexArray(array)
    vertices, elements = gl.glGenBuffers(2)
    gl.glBindBuffer(gl.GL_ARRAY_BUFFER, vertices)
    gl.glBufferData(gl.GL_ARRAY_BUFFER, mesh.rows.nbytes, np.ascontiguousarray(mesh.rows), gl.GL_STATIC_DRAW)
    offset = 0
    for place, columns in enumerate(_COLUMNS):
        gl.glVertexAttribPointer(place, columns, gl.GL_FLOAT, False, mesh.rows.strides[0], c_void_p(offset))
        gl.glEnableVertexAttribArray(place)
        offset += columns * mesh.rows.itemsize
    gl.glBindBuffer(gl.GL_ELEMENT_ARRAY_BUFFER, elements)
    indices = np.ascontiguousarray(mesh.indices)
    gl.glBufferData(gl.GL_ELEMENT_ARRAY_BUFFER, indices.nbytes, indices, gl.GL_STATIC_DRAW)
    gl.glBindVertexArray(0)
    return array


def _texture(gl: Any, image: UInt8[np.ndarray, "h w 3"]) -> Any:
    """A texture with smaller copies of itself for seeing it from far; GL decodes sRGB before it takes means."""
    texture = gl.glGenTextures(1)
    gl.glBindTexture(gl.GL_TEXTURE_2D, texture)
    gl.glPixelStorei(gl.GL_UNPACK_ALIGNMENT, 1)
    height, width = image.shape[:2]
    pixels = np.ascontiguousarray(image)
    gl.glTexImage2D(
        gl.GL_TEXTURE_2D, 0, gl.GL_SRGB8, width, height, 0, gl.GL_RGB, gl.GL_UNSIGNED_BYTE, pixels
    )  # row 0 of the picture at texture coordinate 0
    gl.glGenerateMipmap(gl.GL_TEXTURE_2D)
    gl.glTexParameteri(gl.GL_TEXTURE_2D, gl.GL_TEXTURE_MIN_FILTER, gl.GL_LINEAR_MIPMAP_LINEAR)
    gl.glTexParameteri(gl.GL_TEXTURE_2D, gl.GL_TEXTURE_MAG_FILTER, gl.GL_LINEAR)
    return texture
