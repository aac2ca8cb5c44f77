"""What an audit of the ground truth finds, as data: of every instance, every object, and the suspects."""

from dataclasses import asdict, dataclass
from typing import Any

from annotate.quality.agreement import Agreement
from annotate.quality.depth_difference import DepthStatistics
from annotate.quality.instances import ContourDistance
from pipeline.scene import ImageKey


@dataclass(frozen=True)
class InstanceQuality:
    """One annotated instance."""

    key: ImageKey
    index: int
    """Position in the image's list of annotations."""
    obj_id: int
    visible: int
    """Pixels at which it is the nearest of the annotated objects."""
    depth: DepthStatistics | None
    """None where the image has no depth."""
    contour: ContourDistance | None
    """None where the image has no colour, or hardly any of the contour is to be seen."""
    agreement: Agreement | None = None
    """None where the scene's cameras have no world poses, or no other image shows the object."""


@dataclass(frozen=True)
class ObjectQuality:
    """All instances of one object."""

    obj_id: int
    """0 for all objects together."""
    instances: int
    depth: DepthStatistics | None
    """Of all their pixels together, as in the thesis's table; None where there is no depth."""


@dataclass(frozen=True)
class Suspect:
    """An instance whose pose may be wrong."""

    key: ImageKey
    index: int
    obj_id: int
    severity: float
    """How many times the limit its worst measure is; at least 1."""
    reasons: tuple[str, ...]
    """Worst first, for people."""


@dataclass(frozen=True)
class QualityReport:
    """What came out for a split."""

    dataset: str
    split: str
    objects: tuple[ObjectQuality, ...]
    total: ObjectQuality
    instances: tuple[InstanceQuality, ...]
    suspects: tuple[Suspect, ...]
    """Worst first."""
    notes: tuple[str, ...]
    """What could not be looked at and why, and what all instances have in common."""

    def as_dict(self) -> dict[str, Any]:
        """For JSON: metres and pixels, NaN where nothing can be told."""
        return {
            "dataset": self.dataset,
            "split": self.split,
            "unit": "m",
            "total": asdict(self.total),
            "objects": [asdict(one) for one in self.objects],
            "suspects": [_flat(asdict(one)) for one in self.suspects],
            "instances": [_instance(one) for one in self.instances],
            "notes": list(self.notes),
        }


def _flat(entry: dict[str, Any]) -> dict[str, Any]:
    scene_id, im_id = entry.pop("key")
    return {"scene_id": scene_id, "im_id": im_id, **entry}


def _instance(one: InstanceQuality) -> dict[str, Any]:
    agreement = one.agreement
    compared = agreement and {
        "images": agreement.images,
        "distance": agreement.distance,
        "verdict": agreement.verdict,
    }
    return {
        "scene_id": one.key.scene_id,
        "im_id": one.key.im_id,
        "index": one.index,
        "obj_id": one.obj_id,
        "visible": one.visible,
        "depth": None if one.depth is None else asdict(one.depth),
        "contour": None if one.contour is None else asdict(one.contour),
        "agreement": compared,
    }
