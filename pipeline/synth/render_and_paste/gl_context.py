"""An OpenGL context of one's own, off screen through EGL (pyrender's platform), for a process that draws many images.

Current only while something is drawn, so that any thread may draw and other contexts of the program are left in peace.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import Any
from weakref import finalize

from pipeline.gl_rendering import GL, GlError


def require_opengl() -> None:
    """Raise GlError where OpenGL does not work; the first call of a program tries it out in a child process: seconds."""
    if not GL.available():
        raise GlError("no OpenGL through EGL on this machine; install libegl1 and libgl1-mesa-dri")


class GlContext:
    """A context; use it by `with context.current() as gl`, `gl` being PyOpenGL's functions."""

    def __init__(self) -> None:
        """Create it. Raises GlError where OpenGL does not work."""
        require_opengl()
        self._lock = RLock()
        self._pid = os.getpid()
        self._platform: Any = _new_platform()
        self._destroy = finalize(self, _destroy, self._platform, self._pid)
        self._release()

    @contextmanager
    def current(self) -> Iterator[Any]:
        """Make it the context of this thread for a while; other threads wait.

        Raises GlError if it is closed, if this is a fork of the process that made it, or if the driver fails.
        """
        _refuse_after_fork(self._pid)
        import OpenGL.GL
        from OpenGL.error import Error

        with self._lock:
            if self._platform is None:
                raise GlError("the OpenGL context is closed; make a new one")
            try:
                self._platform.make_current()
                yield OpenGL.GL
            except Error as error:
                raise GlError(f"OpenGL failed while drawing: {' '.join(str(error).split())}") from error
            finally:
                self._release()

    def close(self) -> None:
        """Destroy it, with all that was uploaded; a second time does nothing. Also done when it is forgotten."""
        with self._lock:
            self._platform = None
            self._destroy()

    def _release(self) -> None:
        from OpenGL.EGL import EGL_NO_CONTEXT, EGL_NO_SURFACE, eglMakeCurrent

        eglMakeCurrent(self._platform._egl_display, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT)


def _destroy(platform: Any, pid: int) -> None:
    """Destroy a context, but not by the platform's own method: that ends the display, and so all other contexts."""
    from OpenGL.EGL import eglDestroyContext

    display, platform._egl_display = (
        platform._egl_display,
        None,
    )  # the method is called at deletion, and now does nothing
    if pid == os.getpid():
        eglDestroyContext(display, platform._egl_context)


_first_process: list[int] = []
"""Process that made the first context of this program; its forks inherit this and cannot make any."""


def _refuse_after_fork(first_process: int) -> None:
    """A driver's threads do not live on in a fork, where drawing would wait for them for ever."""
    if first_process != os.getpid():
        raise GlError("OpenGL was used before this process was forked; fork first, or start processes by 'spawn'")


def _new_platform() -> Any:
    if _first_process:
        _refuse_after_fork(_first_process[0])
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")  # read by PyOpenGL when it is first imported
    from pyrender.platforms import egl

    try:
        device = egl.get_device_by_index(int(os.environ.get("EGL_DEVICE_ID", "0")))
        platform = egl.EGLPlatform(0, 0, device)
        platform.init_context()
    except Exception as error:  # whatever a driver may do
        raise GlError(f"no OpenGL context through EGL: {error!r}; check EGL_DEVICE_ID and the driver") from error
    _first_process.append(os.getpid())
    return platform
