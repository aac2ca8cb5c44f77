"""Which objects are arranged together, and what they are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.scene import Model
from pipeline.synth.generation.config import Count, DistractorConfig, Materials
from pipeline.synth.generation.library import ModelLibrary
from pipeline.synth.materials import Material, fixed_material, random_material, randomized

FIRST_DISTRACTOR = 1_000_000
"""Distractors have ids from here on, while they are arranged together with the objects."""


@dataclass(frozen=True, eq=False)
class Distractors:
    """Models that are arranged and rendered, but not annotated."""

    library: ModelLibrary
    obj_ids: tuple[int, ...]
    """As in the library."""
    count: Count

    @staticmethod
    def of(config: DistractorConfig) -> Distractors:
        """Those of a configuration. Raises InputError if there are no such models."""
        library = ModelLibrary(config.models)
        return Distractors(library, library.chosen(config.objects), config.count)

    def model(self, obj_id: int) -> Model:
        """The model of an id from `FIRST_DISTRACTOR` on."""
        return replace(self.library.model(obj_id - FIRST_DISTRACTOR), obj_id=obj_id)

    def chosen(self, rng: np.random.Generator) -> tuple[Model, ...]:
        """Draw some."""
        ids = chosen_ids(self.obj_ids, self.count, rng)
        return tuple(self.model(FIRST_DISTRACTOR + obj_id) for obj_id in ids)


def is_distractor(obj_id: int) -> bool:
    """Whether it is one, by its id."""
    return obj_id >= FIRST_DISTRACTOR


def chosen_ids(obj_ids: Sequence[int], count: Count | None, rng: np.random.Generator) -> list[int]:
    """Draw some of the objects, all if there is no count; in order."""
    if count is None:
        return sorted(obj_ids)
    number = min(int(rng.integers(count[0], count[1] + 1)), len(obj_ids))
    return sorted(rng.permutation(np.array(obj_ids))[:number].tolist())


def materials_of(models: Sequence[Model], materials: Materials, rng: np.random.Generator) -> list[Material]:
    """What each instance is made of; one without colours of its own is gray, unless it is painted."""
    if materials == "plain":
        return [random_material(rng) for _ in models]
    own = fixed_material()
    return [randomized(own, rng) if materials == "randomized" else own for _ in models]
