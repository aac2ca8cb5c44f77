"""What is known of each BOP dataset, read from `datasets.toml`."""

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any


@dataclass(frozen=True)
class DatasetFacts:
    """Facts about a dataset; of a name that is not in the table only the defaults."""

    name: str
    """Name of the dataset's folder, such as `lmo`."""
    title: str
    """Name for people, such as `LM-O (Linemod-Occluded)`."""
    known: bool
    """Whether the table holds the dataset."""
    core: bool
    """One of the seven core datasets of the BOP Challenge (thesis sec. bop_challenge_2020)."""
    obj_ids: tuple[int, ...]
    """Ids of all objects; empty where unknown."""
    symmetric_obj_ids: tuple[int, ...]
    """Objects with ambiguous views, to which ADI applies instead of ADD."""
    image_size: tuple[int, int] | None
    """Width and height of the test images in pixels."""
    depth_range: tuple[float, float] | None
    """Range of camera-object distances in the test images, metres."""
    splits: tuple[str, ...]
    """Folders of the splits that the dataset is published with."""
    test_split: str
    """Folder of the split on which methods are compared."""
    sensors: tuple[str, ...]
    """File name suffixes of the sensors, preferred first; empty where there is one unnamed sensor."""
    eval_models: str
    """Folder of the models for evaluation."""
    display_models: str
    """Folder of the models for display (with colour, where there is one)."""
    vsd_delta: float
    """Tolerance of the visibility test of VSD, metres (thesis sec. bop_vsd, delta)."""
    public_test_gt: bool
    """Whether the ground truth of the test split is published."""
    test_images: int | None
    """Number of test images used in the BOP Challenge."""
    test_instances: int | None
    """Number of test instances used in the BOP Challenge."""
    hub_repository: str
    """Dataset repository on huggingface.co."""
    base_archives: tuple[str, ...]
    """Archives of the repository with targets and camera files."""
    models_archives: tuple[str, ...]
    """Archives of the repository with the models."""
    test_archives: tuple[str, ...]
    """Archives of the repository with the test (and validation) images used in the BOP Challenge."""


def dataset_facts(name: str) -> DatasetFacts:
    """Facts about the dataset of that name; upper and lower case are the same."""
    name = name.lower()
    table = _tables().get(name, {})
    return DatasetFacts(
        name=name,
        title=table.get("title", name),
        known=bool(table),
        core=table.get("core", False),
        obj_ids=_ids(table.get("obj_ids", "")),
        symmetric_obj_ids=_ids(table.get("symmetric_obj_ids", "")),
        image_size=_pair(table.get("image_size")),
        depth_range=_pair(table.get("depth_range_mm"), 1000.0),
        splits=tuple(table.get("splits", ())),
        test_split=table.get("test_split", "test"),
        sensors=tuple(table.get("sensors", ())),
        eval_models=table.get("eval_models", "models_eval"),
        display_models=table.get("display_models", "models"),
        vsd_delta=table.get("vsd_delta_mm", 15) / 1000.0,
        public_test_gt=table.get("public_test_gt", True),
        test_images=table.get("test_images"),
        test_instances=table.get("test_instances"),
        hub_repository=table.get("hub_repository", f"bop-benchmark/{name}"),
        base_archives=tuple(table.get("base_archives", (f"{name}_base.zip",))),
        models_archives=tuple(table.get("models_archives", (f"{name}_models.zip",))),
        test_archives=tuple(table.get("test_archives", ())),
    )


def known_datasets() -> tuple[str, ...]:
    """Names of all datasets in the table."""
    return tuple(_tables())


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(files("pipeline.bop").joinpath("datasets.toml").read_text(encoding="utf-8"))


def _ids(text: str) -> tuple[int, ...]:
    """Ids of a list such as `1,5,8-12`."""
    spans = [part.split("-") for part in text.split(",") if part]
    return tuple(i for span in spans for i in range(int(span[0]), int(span[-1]) + 1))


def _pair(values: list | None, unit: float | None = None) -> tuple | None:
    if values is None:
        return None
    return (values[0], values[1]) if unit is None else (values[0] / unit, values[1] / unit)
