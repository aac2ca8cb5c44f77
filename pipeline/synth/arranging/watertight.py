"""Whether a mesh is closed."""

from __future__ import annotations

import numpy as np

from pipeline.model_cache import per_model
from pipeline.scene import Model


@per_model
def is_watertight(model: Model) -> bool:
    """Whether every edge belongs to an even number of faces, vertices at the same place taken as one."""
    _, place = np.unique(model.vertices.round(9), axis=0, return_inverse=True)
    faces = place.ravel()[model.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1).astype(np.int64)
    _, uses = np.unique(edges[:, 0] * (len(place) + 1) + edges[:, 1], return_counts=True)
    return bool(len(uses)) and bool((uses % 2 == 0).all())
