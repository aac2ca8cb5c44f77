"""The maps of a recorded image that a window is cut from, made from the recorded image as matching makes them."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float, Integer

from pipeline.hashmatch import channels
from pipeline.hashmatch.config import TEMPLATE_SIZE, HashMatchConfig
from pipeline.hashmatch.pyramid import Base, Level, make_level, prepare
from pipeline.hashmatch.templates import size_points
from pipeline.recording import ColorImage, DepthMap, Mask, RecordingReader
from pipeline.scene import Camera, Image


@dataclass(frozen=True)
class LevelPlace:
    """A level of a recorded pyramid."""

    scale: float
    """s_w."""
    overhang: int
    size: tuple[int, int]
    """Width and height of its maps with their border, pixels of the level."""
    step: int
    """Between two windows, pixels of the level."""

    def nearest_corner(self, corner: Integer[np.ndarray, "2"]) -> Integer[np.ndarray, "2"]:
        """First pixel of the window that begins nearest to a pixel."""
        last = (np.array(self.size) - TEMPLATE_SIZE) // self.step
        return np.clip(np.rint(corner / self.step).astype(int), 0, np.maximum(last, 0)) * self.step


@dataclass(frozen=True, eq=False)
class _Counted:
    """What tells the first stages of a level apart."""

    distance: Float[np.ndarray, "h w"]
    integral: Integer[np.ndarray, "a b"]


class RecordedMaps:
    """Maps of one recorded image; each is made when it is asked for first, and kept."""

    def __init__(self, reader: RecordingReader, config: HashMatchConfig, edgel_threshold_m: float) -> None:
        camera = reader.view.camera
        assert camera is not None, "a recording with depth has a camera"
        self.camera: Camera = camera
        self.config = config
        self._reader = reader
        self._edgel_threshold_m = edgel_threshold_m
        self._counted: dict[int, _Counted] = {}
        self._levels: dict[int, Level] = {}

    def place(self, index: int) -> LevelPlace:
        """Geometry of a level, as `make_level` has it."""
        scale, overhang = self.config.scale_factor**index, self.config.overhang_px
        width, height = max(1, round(self.camera.width * scale)), max(1, round(self.camera.height * scale))
        size = (width + 2 * overhang, height + 2 * overhang)
        return LevelPlace(scale, overhang, size, self.config.window_step_px)

    def edgels(self, index: int, corner: Integer[np.ndarray, "2"]) -> int:
        """Depth edgels in a window."""
        integral, (x, y) = self._count(index).integral, corner
        far_x, far_y = x + TEMPLATE_SIZE, y + TEMPLATE_SIZE
        return int(integral[far_y, far_x] - integral[y, far_x] - integral[far_y, x] + integral[y, x])

    def distances(self, index: int, corner: Integer[np.ndarray, "2"]) -> Float[np.ndarray, "5"]:
        """Metres, at the points of T1."""
        x, y = (size_points() + corner).T
        return self._count(index).distance[y, x]

    @cached_property
    def image(self) -> Image:
        """The image as the method was given it."""
        kinds = self._reader.kinds()
        rgb = self._reader.read("image/rgb", ColorImage).rgb if "image/rgb" in kinds else None
        return Image(self._reader.key, self.camera, rgb, self._reader.read("image/depth", DepthMap).depth)

    @cached_property
    def base(self) -> Base:
        """What all levels share; takes some 0.2 s."""
        return prepare(self.image, self._edgel_threshold_m)

    def level(self, index: int) -> Level:
        """A level with all its maps; takes some 50 ms."""
        if index not in self._levels:
            self._levels[index] = make_level(self.base, index, self.config)
        return self._levels[index]

    def _count(self, index: int) -> _Counted:
        if index not in self._counted:
            place = self.place(index)
            size = (place.size[0] - 2 * place.overhang, place.size[1] - 2 * place.overhang)

            def looked_up(values: np.ndarray) -> np.ndarray:
                return np.pad(cv2.resize(values, size, interpolation=cv2.INTER_NEAREST_EXACT), place.overhang)

            edgel = self._reader.read("hashmatch/edgels", Mask).mask.astype(np.uint8)
            self._counted[index] = _Counted(looked_up(self._distance), cv2.integral(looked_up(edgel)))
        return self._counted[index]

    @cached_property
    def _distance(self) -> Float[np.ndarray, "h w"]:
        assert self.image.depth is not None
        depth = np.nan_to_num(self.image.depth, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)
        return channels.distances(depth, self.camera.K)
