"""Colour pictures by OpenGL: pyrender, off screen through EGL, kept from hanging or killing the program.

A GL driver can do both. So GL is first tried out in a child process; only if that drew something is it used here,
by one thread (a GL context belongs to a thread) and with a time limit per picture.
"""

import logging
import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from threading import Lock, Thread
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.exceptions import InputError
from pipeline.geometry import transform_points
from pipeline.model_cache import convex_hull, per_model
from pipeline.ray_casting import NEAR
from pipeline.scene import Camera, Model
from pipeline.shading import AMBIENT, GRAY, LIGHTS, ColorRendering, linear_from_srgb

TRIAL_SECONDS = 60.0
PICTURE_SECONDS = 30.0

_GL_CAMERA_FROM_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
"""GL looks along -z with y up."""


class GlError(InputError):
    """There is no OpenGL here that works."""


class GlThread:
    """Runs jobs one after the other in the thread that owns the GL context, once GL has been tried out."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._works: bool | None = None
        self._jobs: SimpleQueue[tuple[Callable[[], Any], Future]] = SimpleQueue()

    def available(self) -> bool:
        """Tell whether GL works, trying it out on the first call."""
        with self._lock:
            if self._works is None:
                self._works = _try_in_child()
                if self._works:
                    # A daemon, so that a hung driver cannot keep the program from ending.
                    Thread(target=self._work, name="gl", daemon=True).start()
            return self._works

    def run(self, job: Callable[[], ColorRendering]) -> ColorRendering:
        """Do a job in the thread. Raises GlError if GL does not work, or fails at this job and so for good."""
        if not self.available():
            raise GlError("no OpenGL through EGL on this machine; install libegl1 and libgl1-mesa-dri")
        future: Future[ColorRendering] = Future()
        self._jobs.put((job, future))
        try:
            return future.result(timeout=PICTURE_SECONDS)
        except Exception as error:  # whatever a driver may do: from now on do without it
            self._works = False
            logging.getLogger(__name__).warning("OpenGL failed (%r); pictures are ray cast from now on", error)
            raise GlError(f"OpenGL failed while drawing: {error!r}") from error

    def _work(self) -> None:
        while True:
            job, future = self._jobs.get()
            try:
                future.set_result(job())
            except Exception as error:
                future.set_exception(error)


GL = GlThread()
"""The only one: a process has one thread that draws."""


def _try_in_child() -> bool:
    """Draw a triangle in a child process; false if it fails, crashes or hangs."""
    code = f"import sys; sys.path[:] = {sys.path!r}; from pipeline.gl_rendering import _trial; _trial()"
    try:
        child = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", code],
            timeout=TRIAL_SECONDS,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return child.returncode == 0


def _trial() -> None:
    vertices = np.array([[-1.0, -1.0, 3.0], [1.0, -1.0, 3.0], [0.0, 1.0, 3.0]])
    model = Model(0, vertices, np.array([[0, 1, 2]], np.int32), 2.3)
    camera = Camera(np.array([[30.0, 0.0, 16.0], [0.0, 30.0, 16.0], [0.0, 0.0, 1.0]]), 32, 32)
    if not draw(model, camera, np.eye(4), 0.5).mask[16, 16]:
        raise SystemExit(1)


def _pyrender() -> Any:
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")  # read by PyOpenGL when it is first imported
    import pyrender

    return pyrender


_offscreen: list[Any] = []
"""The renderer, made by the thread that uses it."""


def draw(model: Model, camera: Camera, camera_from_model: np.ndarray, pixel_center: float) -> ColorRendering:
    """Draw with pyrender; in the GL thread only."""
    pyrender = _pyrender()
    if not _offscreen:
        _offscreen.append(pyrender.OffscreenRenderer(camera.width, camera.height))
    renderer = _offscreen[0]
    renderer.viewport_width, renderer.viewport_height = camera.width, camera.height
    scene = pyrender.Scene(bg_color=[0.0, 0.0, 0.0, 0.0], ambient_light=[AMBIENT] * 3)
    scene.add(_mesh(model), pose=_GL_CAMERA_FROM_CAMERA @ camera_from_model)
    scene.add(_gl_camera(model, camera, camera_from_model, pixel_center))
    for direction, share in LIGHTS:
        scene.add(pyrender.DirectionalLight(intensity=share * np.pi), pose=_light_pose(np.array(direction)))
    rgba, _ = renderer.render(scene, flags=pyrender.RenderFlags.RGBA)
    return _cut_out(rgba)


def _cut_out(rgba: UInt8[np.ndarray, "h w 4"]) -> ColorRendering:
    """Picture and silhouette of the pixels that the object covers by half or more.

    GL looks at four points of each pixel and takes the mean; the depth it hands out belongs to one of them, which lies
    0.4 pixels off. So alpha, the covered share, decides, and the share of the black background is taken out again.
    """
    mask = rgba[..., 3] >= 128
    rgb = np.zeros((*mask.shape, 3), np.uint8)
    rgb[mask] = np.minimum(rgba[mask, :3] * 255.0 / rgba[mask, 3:], 255)
    return ColorRendering(rgb, mask)


def _gl_camera(model: Model, camera: Camera, camera_from_model: np.ndarray, pixel_center: float) -> Any:
    z = transform_points(camera_from_model, model.vertices[convex_hull(model)])[:, 2]
    shift = 0.5 - pixel_center  # GL samples pixel c at c + 0.5
    return _pyrender().IntrinsicsCamera(
        fx=camera.K[0, 0],
        fy=camera.K[1, 1],
        cx=camera.K[0, 2] + shift,
        cy=camera.K[1, 2] + shift,
        znear=max(0.9 * z.min(), NEAR),
        zfar=1.1 * z.max(),
    )


def _light_pose(from_direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Pose of a GL light, which shines along its -z, that sits in the given direction of the camera frame."""
    z = _GL_CAMERA_FROM_CAMERA[:3, :3] @ from_direction / np.linalg.norm(from_direction)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return pose


@per_model
def _mesh(model: Model) -> Any:
    """Pyrender's mesh of a model; kept, so that drawing the same model again does not upload it again."""
    pyrender = _pyrender()
    corners = model.faces.reshape(-1)
    primitive = pyrender.Primitive(
        positions=model.vertices[corners],
        normals=_face_normals(model) if model.normals is None else model.normals[corners],
        **_paint(model, corners),
    )
    return pyrender.Mesh([primitive])


def _face_normals(model: Model) -> Float[np.ndarray, "c 3"]:
    """Unit normals of the faces, one for each corner of each face."""
    a, b, c = np.moveaxis(model.vertices[model.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return np.repeat(normals, 3, axis=0)


def _paint(model: Model, corners: Int[np.ndarray, "c"]) -> dict[str, Any]:
    """Colour of the primitive: per corner, or by texture, or gray."""
    pyrender = _pyrender()
    matt = {"metallicFactor": 0.0, "roughnessFactor": 0.9, "doubleSided": True}
    if model.colors is not None:
        material = pyrender.MetallicRoughnessMaterial(**matt)
        return {"color_0": linear_from_srgb(model.colors[corners]), "material": material}
    if model.texture is not None and model.texture_uv is not None:
        texture = pyrender.Texture(source=model.texture, source_channels="RGB")
        material = pyrender.MetallicRoughnessMaterial(baseColorTexture=texture, **matt)
        return {"texcoord_0": model.texture_uv[corners], "material": material}
    gray = [GRAY**2.2] * 3 + [1.0]
    return {"material": pyrender.MetallicRoughnessMaterial(baseColorFactor=gray, **matt)}
