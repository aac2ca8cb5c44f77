"""The decorator of compiled functions: machine code kept on disk, no global lock, no Python checks for zero division."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, no_type_check

from numba import njit

FAST = {"nnan", "nsz", "contract", "arcp", "reassoc"}
"""Licence to reorder float arithmetic, for the loops that the compiler shall turn into vector instructions."""


def compiled(**options: Any) -> Callable[[Callable], Any]:
    """Decorate a function to be compiled; where its machine code cannot be kept, it is compiled in each process.

    numba watches only the file that a function stands in, not the files of the functions that it calls. So the name
    under which the code is kept carries a digest of the folders with compiled functions: after any change there all is compiled anew.
    """

    def decorate(function: Callable) -> Any:
        function = no_type_check(function)  # else jaxtyping's import hook would wrap what numba is to compile
        function.__qualname__ = f"{function.__qualname__}_{_DIGEST}"
        settings = {"error_model": "numpy", "nogil": True, "fastmath": {"contract"}, **options}
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


def _digest() -> str:
    """Short name of the present state of the sources of all compiled functions."""
    sources = sorted(Path(__file__).parent.parent.glob("*/*.py"))
    return hashlib.blake2b(b"".join(source.read_bytes() for source in sources), digest_size=6).hexdigest()


_DIGEST = _digest()
