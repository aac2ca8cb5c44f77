"""Drawing objects by OpenGL, each alone and only inside the box around it: light and exact depth of every pixel.

pyrender itself draws the whole image with four samples per pixel and cannot tell the hidden parts of objects, so that
it would have to draw once more per object; this draws each object once and leaves it to the caller to put the nearer
before the farther. One sample per pixel, at its centre (integer coordinates): colour, depth and mask say the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32, UInt16

from pipeline.gl_rendering import GlError
from pipeline.ray_casting import NEAR, Box
from pipeline.scene import Camera
from pipeline.synth.render_and_paste import shots
from pipeline.synth.render_and_paste.gl_context import GlContext
from pipeline.synth.render_and_paste.lights import Light
from pipeline.synth.render_and_paste.shaders import compile_program
from pipeline.synth.render_and_paste.shots import Painted, Shot
from pipeline.synth.render_and_paste.uploads import Upload, Uploads

MOST_BUFFERS = 12
"""Objects drawn before the first of them is read; each needs the memory of an image."""


class Drawing(NamedTuple):
    """One object alone, cut to the box around it."""

    box: Box
    light: UInt16[np.ndarray, "h w 4"]
    """Linear RGB, 65535 being `shaders.BRIGHTEST`; undefined where there is no object."""
    depth: Float32[np.ndarray, "h w"]
    """Metres along z at the pixel centre, 0 where there is no object."""


class Rasterizer:
    """Draws; keeps meshes and textures in its own OpenGL context until it is closed."""

    def __init__(self) -> None:
        """Create the context. Raises GlError where OpenGL does not work."""
        self._context = GlContext()
        self._uploads = Uploads()
        self._programs: dict[bool, tuple[Any, dict[str, int]]] = {}
        self._framebuffers: dict[tuple[int, int, int], Any] = {}

    def close(self) -> None:
        """Destroy the context; a second time does nothing."""
        self._context.close()

    def draw(self, objects: Sequence[Painted], camera: Camera, light: Light) -> list[Drawing]:
        """Draw each object as if alone; one that is out of sight has an empty box.

        Raises GlError if the driver fails or the rasterizer is closed.
        """
        taken = [shots.shot_of(item, camera) for item in objects]
        drawings: list[Drawing] = []
        with self._context.current() as gl:
            _set_state(gl)
            lit: set[bool] = set()
            for start in range(0, len(taken), MOST_BUFFERS):
                batch = taken[start : start + MOST_BUFFERS]
                for slot, shot in enumerate(batch):
                    if shot.box.area:
                        self._bind_framebuffer(gl, camera, slot)
                        self._draw_one(gl, shot, camera, light, lit)
                        gl.glFlush()  # a driver that draws on the CPU fills pixels while the next object is sent
                drawings += [self._read(gl, camera, slot, shot) for slot, shot in enumerate(batch)]
        return drawings

    def _draw_one(self, gl: Any, shot: Shot, camera: Camera, light: Light, lit: set[bool]) -> None:
        upload = self._uploads.of(gl, shot.item.model)
        places = self._use_program(gl, upload, light, lit)
        shots.set_object(gl, places, shot, camera)
        # The box is moved to the corner of the buffer; samples keep their places inside their pixels.
        gl.glViewport(-shot.box.x0, -shot.box.y0, camera.width, camera.height)
        gl.glScissor(0, 0, *_size(shot.box))
        gl.glClear(gl.GL_COLOR_BUFFER_BIT | gl.GL_DEPTH_BUFFER_BIT)
        outside = upload.closed and shot.near > NEAR  # else the camera may be inside the object
        (gl.glEnable if outside else gl.glDisable)(gl.GL_CULL_FACE)
        gl.glBindVertexArray(upload.vertex_array)
        gl.glDrawElements(gl.GL_TRIANGLES, upload.corners, gl.GL_UNSIGNED_INT, None)

    def _use_program(self, gl: Any, upload: Upload, light: Light, lit: set[bool]) -> dict[str, int]:
        """Take the program for a model; `lit` are those that have this image's light."""
        textured = upload.texture is not None
        if textured not in self._programs:
            program = compile_program(gl, textured)
            names = shots.OBJECT_UNIFORMS + shots.LIGHT_UNIFORMS
            self._programs[textured] = program, {name: gl.glGetUniformLocation(program, name) for name in names}
        program, places = self._programs[textured]
        gl.glUseProgram(program)
        if textured not in lit:
            lit.add(textured)
            shots.set_light(gl, places, light)
        if textured:
            gl.glBindTexture(gl.GL_TEXTURE_2D, upload.texture)
        return places

    def _bind_framebuffer(self, gl: Any, camera: Camera, slot: int) -> None:
        key = camera.width, camera.height, slot
        if key not in self._framebuffers:
            self._framebuffers[key] = _new_framebuffer(gl, camera.width, camera.height)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._framebuffers[key])

    def _read(self, gl: Any, camera: Camera, slot: int, shot: Shot) -> Drawing:
        light, buffer = np.empty((*shot.box.shape, 4), np.uint16), np.empty(shot.box.shape, np.float32)
        if shot.box.area:
            self._bind_framebuffer(gl, camera, slot)
            gl.glReadPixels(0, 0, *_size(shot.box), gl.GL_RGBA, gl.GL_UNSIGNED_SHORT, light)
            gl.glReadPixels(0, 0, *_size(shot.box), gl.GL_DEPTH_COMPONENT, gl.GL_FLOAT, buffer)
        return Drawing(shot.box, light, shots.depth_from_buffer(buffer, shot))


def _size(box: Box) -> tuple[int, int]:
    """Width and height."""
    return box.x1 - box.x0, box.y1 - box.y0


def _set_state(gl: Any) -> None:
    gl.glEnable(gl.GL_DEPTH_TEST)
    gl.glEnable(gl.GL_SCISSOR_TEST)
    gl.glCullFace(gl.GL_FRONT)  # rows are drawn from top to bottom, which turns every triangle round
    gl.glClearColor(0.0, 0.0, 0.0, 0.0)
    gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 1)


def _new_framebuffer(gl: Any, width: int, height: int) -> Any:
    framebuffer = gl.glGenFramebuffers(1)
    gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, framebuffer)
    for attachment, kind in (
        (gl.GL_COLOR_ATTACHMENT0, gl.GL_RGBA16),
        (gl.GL_DEPTH_ATTACHMENT, gl.GL_DEPTH_COMPONENT32F),
    ):
        buffer = gl.glGenRenderbuffers(1)
        gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, buffer)
        gl.glRenderbufferStorage(gl.GL_RENDERBUFFER, kind, width, height)
        gl.glFramebufferRenderbuffer(gl.GL_FRAMEBUFFER, attachment, gl.GL_RENDERBUFFER, buffer)
    if gl.glCheckFramebufferStatus(gl.GL_FRAMEBUFFER) != gl.GL_FRAMEBUFFER_COMPLETE:
        raise GlError(f"OpenGL has no framebuffer of {width}x{height} pixels with 16-bit colour and float depth")
    return framebuffer
