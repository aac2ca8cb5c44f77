"""How many threads the libraries of a process use: all processes together as many as there are cores."""

import contextlib
import os
import sys
import threading
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Read by the libraries when they are loaded."""

_OPEN3D = "open3d"

_limited = threading.Lock()
"""Held for ever once this process is limited."""
_limit: list[int] = []


def thread_limit() -> int | None:
    """How many threads a library may use in this process; None for as many as it likes."""
    return _limit[0] if _limit else None


def limit_threads(count: int) -> None:
    """Let OpenCV and Open3D use as many threads, now and when Open3D is imported; only the first call counts.

    Libraries that are set up at one place only ask for `thread_limit` there.
    """
    if not _limited.acquire(blocking=False):
        return
    _limit.append(count)
    import cv2

    cv2.setNumThreads(count)
    if _OPEN3D in sys.modules:
        _limit_open3d(count)
    else:
        sys.meta_path.insert(0, _WhenImported(count))


class _WhenImported(MetaPathFinder):
    """Limits Open3D right after its import, which takes too long to be done where it is not needed."""

    def __init__(self, count: int) -> None:
        self._count = count

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Find Open3D as ever, and have it limited once it is executed."""
        if fullname != _OPEN3D:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_limit(module: ModuleType) -> None:
                execute(module)
                _limit_open3d(self._count)

            spec.loader.exec_module = execute_and_limit  # type: ignore[method-assign]
        return spec


def _limit_open3d(count: int) -> None:
    """Cast a ray on few cores: its pool of threads (TBB) counts the cores of the process then, and never again."""
    import numpy as np
    import open3d as o3d

    allowed = os.sched_getaffinity(0)
    _run_on(set(sorted(allowed)[:count]))
    try:
        scene = o3d.t.geometry.RaycastingScene()
        triangle = o3d.core.Tensor.from_numpy(np.eye(3, dtype=np.float32))
        scene.add_triangles(triangle, o3d.core.Tensor.from_numpy(np.array([[0, 1, 2]], np.uint32)))
        scene.cast_rays(o3d.core.Tensor.from_numpy(np.ones((1, 6), np.float32)))
    finally:
        _run_on(allowed)


def _run_on(cores: set[int]) -> None:
    """Where all threads of this process may run, those included that were started elsewhere in the meantime."""
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it has ended; or we may not: then there are more threads, no harm else
            os.sched_setaffinity(int(thread.name), cores)
