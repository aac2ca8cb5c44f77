"""What a worker does: some images of a set, straight into the dataset's folder."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from pipeline.scene import ImageKey
from pipeline.synth.generation.config import BoardScene, PastedScene, TracedScene
from pipeline.synth.generation.images import ImageSet
from pipeline.synth.generation.recipe import Recipe
from pipeline.synth.generation.store import Store

LARGEST_TASK = 25
"""Images."""
TASKS_PER_WORKER = 4
"""At least, where there are enough images: so that none idles long at the end."""


class Task(NamedTuple):
    """Images of one set."""

    scene_id: int
    set_index: int
    first: int
    """Position of the first image in its set."""
    images: int

    def __str__(self) -> str:
        return f"images {self.first} to {self.first + self.images - 1} of set {self.set_index} in scene {self.scene_id}"


@dataclass
class Job:
    """What all tasks share; a process keeps the set that it was last at."""

    recipes: dict[int, Recipe[Any]]
    """By scene id."""
    store: Store
    _ready: tuple[tuple[int, int], ImageSet] | None = field(default=None, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """Sets stay in their process."""
        return {**self.__dict__, "_ready": None}

    def tasks(self, workers: int) -> Iterator[Task]:
        """All images, finished or not, in pieces for so many workers."""
        total = sum(recipe.scene.sets * recipe.scene.images_per_set for recipe in self.recipes.values())
        size = max(1, min(LARGEST_TASK, total // (TASKS_PER_WORKER * workers)))
        for scene_id, recipe in self.recipes.items():
            count = recipe.scene.images_per_set
            for index in range(recipe.scene.sets):
                for first in range(0, count, size):
                    yield Task(scene_id, index, first, min(size, count - first))

    def key(self, task: Task, position: int) -> ImageKey:
        """Name of the image at a position of the task's set."""
        return ImageKey(task.scene_id, task.set_index * self.recipes[task.scene_id].scene.images_per_set + position)

    def ready(self, scene_id: int, index: int) -> ImageSet:
        """A set, ready to make its images."""
        if self._ready is None or self._ready[0] != (scene_id, index):
            self._ready = None  # frees its memory first
            self._ready = (scene_id, index), _made(self.recipes[scene_id], index, self.store)
        return self._ready[1]


def make_images(job: Job, task: Task) -> None:
    """Make and write the task's images that are not finished. Raises InputError for what cannot be made or written."""
    for position in range(task.first, task.first + task.images):
        key = job.key(task, position)
        if not job.store.is_finished(key):
            begun = time.perf_counter()
            images = job.ready(task.scene_id, task.set_index)
            waited = time.perf_counter() - begun
            image = images.image(position)
            setup = waited if waited > 1e-3 else 0.0
            job.store.write(key, replace(image, seconds={**image.seconds, "setup": setup}))


def _made(recipe: Recipe[Any], index: int, store: Store) -> ImageSet:
    """Set up a set; what was arranged once, by whichever process, stays as it is."""
    match recipe.scene:
        case TracedScene():
            from pipeline.synth.generation.traced import Arranged, TracedSet, arranged

            kept = store.arrangement(recipe.scene_id, index)
            plan = Arranged.from_json(kept) if kept else arranged(recipe, index)
            if not kept:
                store.keep_arrangement(recipe.scene_id, index, plan)
            return TracedSet(recipe, index, plan)
        case BoardScene():
            from pipeline.synth.generation.board import BoardSet, Placed, placed

            kept = store.arrangement(recipe.scene_id, 0)
            place = Placed.from_json(kept) if kept else placed(recipe)
            if not kept:
                store.keep_arrangement(recipe.scene_id, 0, place)
            return BoardSet(recipe, index, place)
        case PastedScene():
            from pipeline.synth.generation.pasted import PastedSet

            return PastedSet(recipe)
    raise AssertionError(recipe.scene)
