"""Where the templates of objects come from: renderings of their models, or images of them."""

import hashlib
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.templates import Templates
from pipeline.scene import Model

PART = 36
"""Views that are learned at a time, about a second's work: what is lost when learning is stopped."""

_OF_ALL = (
    "in_plane", "angle_step_deg", "in_plane_limit_deg", "edgel_threshold", "grid", "points", "orientation_margin_deg",
    "template_gradient_threshold",
)  # fmt: skip
"""Settings on which all templates depend."""


@runtime_checkable
class TemplateSource(Protocol):
    """Gives templates of objects part by part; fit to be pickled, so that several processes can learn."""

    def digest(self, obj_id: int) -> str:
        """A short text that changes with whatever the object's templates depend on, other than this program."""
        ...

    def parts(self, obj_id: int) -> list[int]:
        """How many templates each part has."""
        ...

    def learn(self, obj_id: int, part: int) -> Templates:
        """Templates of one part."""
        ...


def parts_of(views: int, angles: int) -> list[int]:
    """Numbers of templates in parts of PART views, each shown at so many in-plane angles."""
    return [min(PART, views - first) * angles for first in range(0, views, PART)]


def digest_of(model: Model, config: HashMatchConfig, focal_px: float, *more: Any) -> str:
    """Digest of what all templates of an object depend on, and more: arrays, or what `repr` tells apart."""
    digest = hashlib.sha256()
    settings = tuple(getattr(config, name) for name in _OF_ALL)
    for value in (model.vertices, model.faces, (model.obj_id, model.diameter, focal_px, settings), *more):
        digest.update(np.ascontiguousarray(value).tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
        digest.update(b"|")
    return digest.hexdigest()[:16]
