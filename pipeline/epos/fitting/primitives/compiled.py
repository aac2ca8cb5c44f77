"""The decorator of compiled functions: machine code kept on disk, no global lock, no Python checks for zero division."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, no_type_check

from numba import njit

FAST = {"nnan", "nsz", "contract", "arcp", "reassoc"}
"""Licence to reorder float arithmetic, for the loops that the compiler shall turn into vector instructions."""


def compiled(**options: Any) -> Callable[[Callable], Any]:
    """Decorate a function to be compiled; where its machine code cannot be kept, it is compiled in each process.

    numba watches only the file that a function stands in, not the files of the functions that it calls. So the name
    under which the code is kept carries a digest of the function's folder and this one, which are all that it may call:
    after any change there all is compiled anew.
    """

    def decorate(function: Callable) -> Any:
        function = no_type_check(function)  # else jaxtyping's import hook would wrap what numba is to compile
        folder = Path(function.__code__.co_filename).parent
        function.__qualname__ = f"{function.__qualname__}_{_digest(folder)}"
        settings = {
            "error_model": "numpy",
            "nogil": True,
            "fastmath": {"contract"},
            "no_cfunc_wrapper": True,
            **options,
        }
        try:
            return njit(cache=True, **settings)(function)
        except RuntimeError:  # numba found no folder that it may write to
            return njit(**settings)(function)

    return decorate


def kernel(**options: Any) -> Callable[[Callable], Any]:
    """Decorate a function for inner loops: compiled without counting references to arrays, which took 40 % of the time.

    Such a function is called by compiled functions only, makes no arrays and returns none.
    """
    return compiled(_nrt=False, forceinline=True, **options)


def is_kept(function: Any) -> bool:
    """Tell whether the machine code of a compiled function, as its source is now, is on disk."""
    stats = getattr(function, "stats", None)
    folder = Path(stats.cache_path) if stats and stats.cache_path else None
    return folder is not None and any(folder.glob(f"*{function.py_func.__qualname__}-*.nbi"))


@cache
def _digest(folder: Path) -> str:
    """Short name of the present state of the sources in a folder and in this one."""
    sources = [source for place in (Path(__file__).parent, folder) for source in sorted(place.glob("*.py"))]
    return hashlib.blake2b(b"".join(source.read_bytes() for source in sources), digest_size=6).hexdigest()
