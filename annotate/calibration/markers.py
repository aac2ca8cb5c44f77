"""Finding markers of any dictionary: OpenCV's, or one of our own from a file of bit patterns."""

import cv2
import numpy as np
from jaxtyping import UInt8

from annotate.calibration.dictionary import MarkerDictionary
from pipeline.synth.boards import Detections
from pipeline.synth.boards.edge_corners import refined


def detect_markers(
    image: UInt8[np.ndarray, "h w *rgb"], dictionary: MarkerDictionary, sharp: bool = True
) -> Detections:
    """All markers of a dictionary in a gray or RGB image, sorted by id; those seen more than once are left out.

    With `sharp` corners are those where lines fitted to the edges meet, to some hundredths of a pixel, and markers one
    of whose edges cannot be measured are left out; without, they are OpenCV's.
    """
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.markerBorderBits = dictionary.border
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary.opencv, parameters).detectMarkers(gray)
    seen: list[int] = [] if ids is None else np.asarray(ids, int).ravel().tolist()
    once = sorted(k for k in set(seen) if seen.count(k) == 1)
    rough = np.array([np.reshape(corners[seen.index(k)], (4, 2)) for k in once], np.float64).reshape(-1, 4, 2)
    if not sharp:
        return Detections(tuple(once), rough)
    pixels = refined(image, rough, dictionary.patterns.shape[1] + 2 * dictionary.border)
    kept = np.flatnonzero(np.isfinite(pixels).all(axis=(1, 2)))
    return Detections(tuple(once[row] for row in kept), pixels[kept])
