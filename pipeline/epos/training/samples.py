"""From training images to batches: windows, augmentation, targets; in worker processes, the same for any number of them."""

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing import resource_tracker
from typing import Any

import numpy as np
import torch
from jaxtyping import UInt8
from torch import Tensor
from torch.utils.data import DataLoader
from torch.utils.data import Dataset as TorchDataset

from pipeline.epos.targets import KnownObject, LabelledImage, Targets, make_targets
from pipeline.epos.training.images import ImageSource
from pipeline.epos.training.loss import TargetTensors
from pipeline.exceptions import InputError
from pipeline.scene import Camera
from pipeline.synth.augmentation import Augmentation, augment

_ABOUT_OBJECT = 0.9
"""Share of windows that are laid over a visible pixel of an object; the others are anywhere."""


_OF_IMAGES = 1
"""Tells the random numbers of images from those of samples."""


@dataclass(frozen=True, eq=False)
class Sample:
    """One window."""

    rgb: UInt8[np.ndarray, "h w 3"]
    targets: Targets


@dataclass(frozen=True, eq=False)
class Batch:
    """The windows of a step."""

    images: UInt8[Tensor, "b h w 3"]
    targets: TargetTensors

    def to(self, device: torch.device) -> "Batch":
        """A copy on a device."""
        return Batch(self.images.to(device), TargetTensors(*(tensor.to(device) for tensor in self.targets)))


@dataclass(frozen=True, eq=False)
class SampleSet(TorchDataset[Sample | InputError]):
    """Endless samples; each depends on the seed and its number alone, so that training can go on anywhere."""

    sources: tuple[ImageSource, ...]
    shares: tuple[float, ...]
    """How often each source is taken; they sum to 1."""
    objects: tuple[KnownObject, ...]
    crop: tuple[int, int]
    """Width and height, pixels."""
    augmentation: Augmentation | None
    seed: int
    windows: int = 1
    """So many samples in a row are cut from one image."""
    _last: dict[int, LabelledImage] = field(default_factory=dict, repr=False)
    """The image that was made last, by its number."""

    def __getitem__(self, index: int) -> Sample | InputError:
        """Make a sample; what is wrong with the input is returned, for torch would make several lines of it."""
        rng = np.random.default_rng([self.seed, index])
        try:
            image = random_window(self._image(index // self.windows), self.crop, rng)
        except InputError as error:
            return error
        targets = make_targets(image, self.objects)
        rgb = image.rgb if self.augmentation is None else augment(image.rgb, rng, self.augmentation)
        return Sample(rgb, targets)

    def _image(self, number: int) -> LabelledImage:
        """An image, made once for all its windows. Raises InputError."""
        if number not in self._last:
            rng = np.random.default_rng([self.seed, number, _OF_IMAGES])
            source = self.sources[rng.choice(len(self.sources), p=self.shares)]
            self._last.clear()
            self._last[number] = source.image(rng)
        return self._last[number]


def random_window(image: LabelledImage, size: tuple[int, int], rng: np.random.Generator) -> LabelledImage:
    """Cut a window of (width, height) out of an image, most often such that it shows some object.

    Raises:
        InputError: the image is smaller.

    """
    (width, height), (rows, columns) = size, image.instance_ids.shape
    if width > columns or height > rows:
        raise InputError(f"training image of {columns} x {rows} pixels: smaller than the crop of {width} x {height}")
    x, y = rng.integers(columns - width + 1), rng.integers(rows - height + 1)
    visible = np.unique(image.instance_ids[image.instance_ids >= 0])
    if len(visible) and rng.random() < _ABOUT_OBJECT:
        v, u = np.nonzero(image.instance_ids == rng.choice(visible))
        pixel = rng.integers(len(u))
        x = min(max(u[pixel] - rng.integers(width), 0), columns - width)
        y = min(max(v[pixel] - rng.integers(height), 0), rows - height)
    part = slice(y, y + height), slice(x, x + width)
    K = np.array([[1, 0, -x], [0, 1, -y], [0, 0, 1.0]]) @ image.camera.K
    camera = Camera(K, width, height)
    rgb, ids = (np.ascontiguousarray(array[part]) for array in (image.rgb, image.instance_ids))
    return replace(image, rgb=rgb, camera=camera, instance_ids=ids)


def batches(
    samples: SampleSet, batch: int, first: int, stop: int, workers: int, device: torch.device
) -> Iterator[Batch]:
    """The batches of steps `first` to `stop`, without it, in order.

    Raises:
        InputError: an image cannot be made or read.

    """
    numbers = [list(range(step * batch, (step + 1) * batch)) for step in range(first, stop)]
    processes: dict[str, Any] = {}
    if workers:  # forked, they could not use OpenGL; of a fork server, they would outlive a killed training
        processes = {"num_workers": workers, "multiprocessing_context": "spawn", "prefetch_factor": 4}
    own = torch.Generator()  # else a new loader draws from the generator that dropout uses: no exact resuming
    loader = DataLoader(
        samples,
        batch_sampler=numbers,
        collate_fn=_collate,
        pin_memory=device.type == "cuda",
        generator=own,
        **processes,
    )
    with _uninterrupted():  # what is pressed meanwhile comes after
        made_by_workers = iter(loader)
    for made in made_by_workers:
        if isinstance(made, InputError):
            raise made
        yield Batch(made[0], TargetTensors(*made[1:]))


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Hold Ctrl-C back; processes started inside never get it: to stop them is our business, after the step."""
    resource_tracker.ensure_running()  # it is started with the first process, and lets Ctrl-C through again then
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def batch_of(samples: Sequence[Sample]) -> Batch:
    """Samples of one size, put together."""
    images, *targets = _tensors(samples)
    return Batch(images, TargetTensors(*targets))


def _collate(samples: Sequence[Sample | InputError]) -> list[Tensor] | InputError:
    """Plain tensors, which torch hands over between processes without copying."""
    good = [sample for sample in samples if isinstance(sample, Sample)]
    return _tensors(good) if len(good) == len(samples) else next(s for s in samples if isinstance(s, InputError))


def _tensors(samples: Sequence[Sample]) -> list[Tensor]:
    images = np.stack([sample.rgb for sample in samples])
    targets = [np.stack([getattr(s.targets, name) for s in samples]) for name in TargetTensors._fields]
    return [torch.from_numpy(array) for array in (images, *targets)]
