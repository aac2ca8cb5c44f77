"""What HashMatch takes from a dataset as a whole: the models with their looks, and a focal length."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from pipeline.hashmatch.template_making import check_model
from pipeline.scene import Model


class DatasetModels(dict[int, Model]):
    """Models of a dataset by object id; sent to another process, they are read anew there."""

    def __init__(self, dataset: Dataset, obj_ids: Sequence[int] = ()) -> None:
        """Read objects, all by default.

        Raises UnknownIdError for an object that the dataset does not have, FormatError for a model that cannot be used.
        """
        chosen = tuple(obj_ids) or dataset.obj_ids
        for obj_id in chosen:
            if obj_id not in dataset.obj_ids:
                raise UnknownIdError("object", obj_id, f"the models of {dataset.name}", dataset.obj_ids)
        super().__init__({obj_id: _usable_model(dataset, obj_id) for obj_id in chosen})
        self._dataset = dataset

    def __reduce__(self) -> tuple[Any, ...]:
        return DatasetModels, (self._dataset, tuple(self))


def _usable_model(dataset: Dataset, obj_id: int) -> Model:
    """A model with its colours. Raises FormatError that names the file if it cannot be used."""
    model = dataset.model(obj_id, "display")
    try:
        check_model(model)
    except InputError as error:
        raise FormatError(f"{dataset.models.path(obj_id, 'display')}: {error}") from error
    return model


def focal_length(dataset: Dataset) -> float:
    """Focal length (pixels) of the first image whose camera can be used. Raises FormatError if there is none."""
    problem = FormatError(f"{dataset.name}/{dataset.split}: has no images")
    for key in dataset.images():
        try:
            K = dataset.camera(key).K
        except InputError as error:
            problem = error
            continue
        focal = float(np.sqrt(abs(K[0, 0] * K[1, 1])))
        if np.isfinite(focal) and focal > 0:
            return focal
        text = f"K has focal lengths {K[0, 0]} and {K[1, 1]}"
        problem = FormatError(f"scene {key.scene_id}, image {key.im_id}: {text}; correct cam_K in scene_camera.json")
    raise problem
