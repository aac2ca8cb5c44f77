"""Things that are computed once per object model: a cache keyed by the model itself, and the convex hull.

Models are compared by identity and their arrays are never written to, so what was derived from one stays true as
long as it lives, and goes away with it.
"""

from collections.abc import Callable
from functools import wraps
from threading import Lock
from typing import Generic, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Int

from pipeline.scene import Model

T = TypeVar("T")


class _Slot(Generic[T]):
    """The place of one model's value; its own lock, so that building one model does not hold up another."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.value: T | None = None


def per_model(build: Callable[[Model], T]) -> Callable[[Model], T]:
    """Make a function of a model compute its result once per model; safe to call from many threads."""
    slots: WeakKeyDictionary[Model, _Slot[T]] = WeakKeyDictionary()
    slots_lock = Lock()

    @wraps(build)
    def cached(model: Model) -> T:
        with slots_lock:
            slot = slots.get(model)
            if slot is None:
                slot = slots[model] = _Slot()
        if slot.value is None:
            with slot.lock:
                if slot.value is None:
                    slot.value = build(model)
        return slot.value

    return cached


@per_model
def convex_hull(model: Model) -> Int[np.ndarray, "h"]:
    """Indices of the vertices on the model's convex hull, ascending; all vertices where the model is flat or a line."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.sort(ConvexHull(model.vertices).vertices)
    except (QhullError, ValueError):
        return np.arange(len(model.vertices))
