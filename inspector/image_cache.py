"""The images that browsers look at, decoded once for all of them, and as far as they can be read."""

import threading
from collections import OrderedDict
from typing import NamedTuple

from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.scene import Image, ImageKey

IMAGES_KEPT = 16
"""Decoded images kept in memory, for all browsers together."""


class LoadedImage(NamedTuple):
    """An image as far as it could be read."""

    image: Image
    problems: tuple[str, ...]
    """Why a channel is missing that should be there, one line each."""


class ImageCache:
    """The images of a dataset that were looked at last; may be used from any thread."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset
        self._images: OrderedDict[ImageKey, LoadedImage] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._images)

    def get(self, key: ImageKey) -> LoadedImage:
        """Return an image; a channel that cannot be read is None, InputError if not even the camera can."""
        with self._lock:
            if key in self._images:
                self._images.move_to_end(key)
                return self._images[key]
        loaded = _load(self._dataset, key)
        with self._lock:
            self._images[key] = loaded
            while len(self._images) > IMAGES_KEPT:
                self._images.popitem(last=False)
        return loaded


def _load(dataset: Dataset, key: ImageKey) -> LoadedImage:
    camera = dataset.camera(key)
    problems: list[str] = []
    rgb, depth = None, None
    try:
        rgb = dataset.rgb(key)
    except InputError as error:
        problems.append(str(error))
    try:
        depth = dataset.depth(key)
    except InputError as error:
        problems.append(str(error))
    if depth is not None and depth.shape != (camera.height, camera.width):
        found, wanted = "x".join(map(str, depth.shape[::-1])), f"{camera.width}x{camera.height}"
        problems.append(f"{dataset.depth_path(key)}: has {found} pixels, the image {wanted}; register it to the image")
        depth = None
    return LoadedImage(Image(key, camera, rgb, depth), tuple(problems))
