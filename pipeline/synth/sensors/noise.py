"""Random fields over an image, and outlines disturbed by them. Depth in metres, 0 where there is nothing."""

import numpy as np
from jaxtyping import Bool, Float32


def grain(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> Float32[np.ndarray, "h w"]:
    """Normal noise of standard deviation 1, alike within a Gaussian window."""
    import cv2

    if sigma <= 0:
        return rng.standard_normal(shape, np.float32)
    reach = int(np.ceil(3 * sigma))
    kernel = cv2.getGaussianKernel(2 * reach + 1, sigma, cv2.CV_32F)
    kernel /= np.sqrt(np.sum(kernel**2))
    white = rng.standard_normal((shape[0] + 2 * reach, shape[1] + 2 * reach), np.float32)
    return cv2.sepFilter2D(white, -1, kernel, kernel)[reach : reach + shape[0], reach : reach + shape[1]]


def chance(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> Float32[np.ndarray, "h w"]:
    """Uniform in 0..1 at each pixel, neighbours alike: holes come in patches, not as salt."""
    from scipy.special import ndtr

    return ndtr(grain(shape, sigma, rng))


def grown(mask: Bool[np.ndarray, "h w"], pixels: int) -> Bool[np.ndarray, "h w"]:
    """The mask with all within some pixels of it, diagonals too."""
    import cv2

    size = 2 * pixels + 1
    return cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0


def jittered(
    depth: Float32[np.ndarray, "h w"],
    edges: Bool[np.ndarray, "h w"],
    sigma: float,
    window: float,
    rng: np.random.Generator,
) -> Float32[np.ndarray, "h w"]:
    """Pixels near an edge show a neighbour some pixels away instead: outlines waver."""
    v, u = np.nonzero(grown(edges, int(np.ceil(3 * sigma))))
    down, right = (np.rint(sigma * grain(depth.shape, window, rng)[v, u]).astype(int) for _ in range(2))
    result = depth.copy()
    rows, columns = depth.shape
    result[v, u] = depth[np.clip(v + down, 0, rows - 1), np.clip(u + right, 0, columns - 1)]
    return result


def mixed(
    depth: Float32[np.ndarray, "h w"], edges: Bool[np.ndarray, "h w"], share: float, rng: np.random.Generator
) -> Float32[np.ndarray, "h w"]:
    """Some pixels at edges lie anywhere between the nearest and the farthest of their neighbours (flying pixels)."""
    import cv2

    v, u = np.nonzero(edges)
    chosen = rng.random(len(v)) < share
    weight = rng.random(len(v), np.float32)[chosen]
    v, u = v[chosen], u[chosen]
    square = np.ones((3, 3), np.uint8)
    near, far = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), square), cv2.dilate(depth, square)
    result = depth.copy()
    result[v, u] = near[v, u] + weight * (far[v, u] - near[v, u])
    return result
