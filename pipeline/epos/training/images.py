"""Where training images come from: a split of a BOP dataset, or render & paste on the fly."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.bop.gt_info.views import view_instances
from pipeline.epos.targets import BACKGROUND, LabelledImage
from pipeline.epos.training.config import PastedConfig
from pipeline.exceptions import InputError
from pipeline.scene import Camera, ImageKey, Model
from pipeline.synth.render_and_paste import PasteSettings, RenderAndPaste


@runtime_checkable
class ImageSource(Protocol):
    """Something that makes training images; sent to worker processes."""

    def image(self, rng: np.random.Generator) -> LabelledImage:
        """A random image, before augmentation; it depends on the generator alone."""
        ...


class PastedImages:
    """Images made on the fly, poses uniform (thesis sec. epos_network_training, on symmetries)."""

    def __init__(self, models: Sequence[Model], camera: Camera, config: PastedConfig) -> None:
        """Raises InputError where images cannot be made."""
        settings = PasteSettings(
            objects=config.objects, size=config.size, backgrounds=config.backgrounds, augmentation=None
        )
        self._maker = RenderAndPaste(models, camera, settings)

    def image(self, rng: np.random.Generator) -> LabelledImage:
        """See `ImageSource`."""
        made = self._maker.image(rng)
        poses = np.array([truth.camera_from_model for truth in made.ground_truth]).reshape(-1, 4, 4)
        obj_ids = tuple(truth.obj_id for truth in made.ground_truth)
        return LabelledImage(made.rgb, made.camera, obj_ids, poses, made.instance_ids)


@dataclass(frozen=True)
class DatasetImages:
    """Images of a split, all equally often."""

    dataset: Dataset
    keys: tuple[ImageKey, ...]

    @classmethod
    def of(cls, dataset: Dataset) -> "DatasetImages":
        """All annotated images of a split. Raises InputError if there is none."""
        keys = tuple(key for key in dataset.images() if dataset.ground_truth(key))
        if not keys:
            raise InputError(f"{dataset.root / dataset.split}: has no annotated image to train on; give another split")
        return cls(dataset, keys)

    def image(self, rng: np.random.Generator) -> LabelledImage:
        """See `ImageSource`. Raises InputError for an image without colour or with damaged annotations."""
        return labelled_image(self.dataset, self.keys[rng.integers(len(self.keys))])


def labelled_image(dataset: Dataset, key: ImageKey) -> LabelledImage:
    """An image of a dataset; visible masks are those of its files, else found by depth, else from the annotated objects.

    Raises:
        InputError: the image has no colour, or something of it is damaged.

    """
    image = dataset.image(key)
    if image.rgb is None:
        raise InputError(
            f"scene {key.scene_id}, image {key.im_id}: has no colour image to train on; give another split"
        )
    truths = dataset.ground_truth(key)
    poses = np.array([truth.camera_from_model for truth in truths]).reshape(-1, 4, 4)
    masks = [dataset.mask(key, truth.index) for truth in truths]
    if any(mask is None for mask in masks):
        posed = [(dataset.model(truth.obj_id), truth.camera_from_model) for truth in truths]
        masks = [view.visible_mask for view in view_instances(posed, image.camera, image.depth)]
    ids = np.full(image.rgb.shape[:2], BACKGROUND, np.int32)
    for i, mask in enumerate(masks):
        if mask is not None:
            ids[mask] = i
    return LabelledImage(image.rgb, image.camera, tuple(truth.obj_id for truth in truths), poses, ids)
