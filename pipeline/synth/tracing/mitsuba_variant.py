"""Which variant of Mitsuba 3 runs here.

`llvm_ad_rgb` is several times as fast as `scalar_rgb`, but needs a shared LLVM library, and old ones abort the whole
process; so it is taken only where a new enough one is found.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from typing import Any

from pipeline.parallel.threads import thread_limit

VARIANT = "INSPECTOR_MITSUBA_VARIANT"
"""Environment variable that chooses the variant, `scalar_rgb` or `llvm_ad_rgb`."""
LLVM_VERSIONS = range(25, 18, -1)
"""Tried in this order. With versions up to 16 Mitsuba aborts on processors with AVX-512."""


@cache
def mitsuba() -> Any:
    """The module, with the fastest variant that works here switched on."""
    name = os.environ.get(VARIANT) or ("llvm_ad_rgb" if _found_llvm() else "scalar_rgb")
    import mitsuba as mi  # after the search, which tells it the library

    module: Any = mi
    module.set_variant(name)
    module.set_log_level(module.LogLevel.Error)
    if limit := thread_limit():
        import drjit

        drjit.set_thread_count(limit)
    return module


def is_scalar() -> bool:
    """Whether the slow variant is in use."""
    return str(mitsuba().variant()).startswith("scalar")


def _found_llvm() -> bool:
    """Whether an LLVM library is here that Mitsuba works with; Dr.Jit is told which."""
    if os.environ.get("DRJIT_LIBLLVM_PATH"):
        return True
    for version in LLVM_VERSIONS:
        for name in (f"libLLVM.so.{version}.1", f"libLLVM-{version}.so", f"libLLVM-{version}.so.1"):
            try:
                ctypes.CDLL(name)
            except OSError:
                continue
            os.environ["DRJIT_LIBLLVM_PATH"] = name
            return True
    return False
