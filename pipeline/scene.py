"""The nouns that everything else speaks of: camera, image, object model, ground truth, target, estimate.

Metres, radians and pixels throughout. Poses are 4x4 float64 arrays `camera_from_model` (BOP: `cam_R_m2c`,
`cam_t_m2c`), whose 3x3 part is kept as it was read.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8


class ImageKey(NamedTuple):
    """Names one image of a dataset split."""

    scene_id: int
    im_id: int


class Target(NamedTuple):
    """What a method is asked for: `inst_count` instances of one object in one image (thesis sec. bop_6d_object_localization)."""

    scene_id: int
    im_id: int
    obj_id: int
    inst_count: int

    @property
    def image(self) -> ImageKey:
        """The image that the target is in."""
        return ImageKey(self.scene_id, self.im_id)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera of one image."""

    K: Float[np.ndarray, "3 3"]
    width: int
    """Pixels."""
    height: int
    """Pixels."""
    world_from_camera: Float[np.ndarray, "4 4"] | None = None
    """Pose of the camera in the scene's world frame, metres; None where the dataset has none."""


@dataclass(frozen=True)
class GroundTruth:
    """An annotated object instance in an image."""

    obj_id: int
    camera_from_model: Float[np.ndarray, "4 4"]
    """Metres; the rotation is as annotated, possibly not orthonormal."""
    index: int
    """Position in the image's list of annotations; masks are named by it."""
    visible_fraction: float | None = None
    """Visible share of the silhouette, 0..1 (BOP `visib_fract`); None where unknown."""
    visible_pixels: int | None = None
    """Pixels of the visible silhouette (BOP `px_count_visib`)."""
    bbox_visible: tuple[float, float, float, float] | None = None
    """Bounding box of the visible silhouette: x, y, width, height in pixels (BOP `bbox_visib`)."""


@dataclass(frozen=True)
class PoseEstimate:
    """A pose that a method claims for an object in an image."""

    scene_id: int
    im_id: int
    obj_id: int
    score: float
    """Confidence; larger is better, no fixed range."""
    camera_from_model: Float[np.ndarray, "4 4"]
    """Metres; the rotation is as submitted."""
    time_s: float = -1.0
    """Seconds spent on the whole image; -1 where not reported (BOP)."""

    @property
    def image(self) -> ImageKey:
        """The image that the estimate is in."""
        return ImageKey(self.scene_id, self.im_id)


@dataclass(frozen=True)
class Image:
    """One image with what its dataset provides for it."""

    key: ImageKey
    camera: Camera
    rgb: UInt8[np.ndarray, "h w 3"] | None
    """RGB; a gray image is repeated in the three channels. None where the dataset has no colour or gray image."""
    depth: Float[np.ndarray, "h w"] | None
    """float32 metres along z, 0 where not measured; None where the dataset has no depth for this image."""


@dataclass(frozen=True, eq=False)
class Model:
    """A triangle mesh of an object."""

    obj_id: int
    vertices: Float[np.ndarray, "v 3"]
    """float64 metres, model frame."""
    faces: Int[np.ndarray, "f 3"]
    """int32 vertex indices."""
    diameter: float
    """Metres; largest distance between two vertices (from `models_info.json`, else computed)."""
    symmetries: Float[np.ndarray, "s 4 4"] = field(default_factory=lambda: np.eye(4)[None])
    """Global symmetry transforms S_M (thesis sec. symmetries), identity first, continuous ones discretized."""
    normals: Float[np.ndarray, "v 3"] | None = None
    """Unit vertex normals."""
    colors: UInt8[np.ndarray, "v 3"] | None = None
    """Vertex colours."""
    texture: UInt8[np.ndarray, "th tw 3"] | None = None
    """Texture image, RGB."""
    texture_uv: Float[np.ndarray, "v 2"] | None = None
    """Texture coordinates 0..1, origin at the lower left."""
