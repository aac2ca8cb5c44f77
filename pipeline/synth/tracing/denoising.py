"""Taking the noise out of ray-traced images by Intel Open Image Denoise (thesis sec. synth_bop20)."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Float32

from pipeline.exceptions import InputError
from pipeline.parallel.threads import thread_limit


def denoise(
    radiance: Float32[np.ndarray, "h w 3"],
    albedo: Float32[np.ndarray, "h w 3"] | None = None,
    normals: Float32[np.ndarray, "h w 3"] | None = None,
) -> Float32[np.ndarray, "h w 3"]:
    """The image without noise; albedo and normals of what each pixel shows keep textures and edges sharp.

    Runs on the CPU, so that the result does not depend on the graphics card. Raises `InputError` where
    `mitsuba-oidn` (extra `synth`) is not installed.
    """
    oidn, device = _oidn()
    guides = {
        name: np.ascontiguousarray(image, np.float32)
        for name, image in (("albedo", albedo), ("normal", normals))
        if image is not None
    }
    clean = oidn.denoise(np.ascontiguousarray(radiance), **guides, hdr=True, device=device)
    return np.maximum(np.array(clean), 0.0)


@cache
def _oidn() -> tuple[Any, Any]:
    try:
        import mitsuba_oidn
    except ImportError as error:
        raise InputError(f"denoising: {error}; install the extra `synth` (pip install mitsuba-oidn)") from None
    module: Any = mitsuba_oidn
    device = module.Device(module.DeviceType.CPU)
    if limit := thread_limit():
        device.set_bool("setAffinity", False)  # else the threads of all processes would share the first cores
        device.num_threads = limit
    return module, device
