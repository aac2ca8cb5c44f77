"""Making a dataset; an interrupted run continues where it stopped, whatever ended it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pipeline.bop.gt_info.files import remove_leftovers
from pipeline.bop.journal import Journal
from pipeline.bop.json_files import read_json_object
from pipeline.exceptions import InputError
from pipeline.parallel import HERE, Workers
from pipeline.synth.generation import finishing
from pipeline.synth.generation.config import SynthesisConfig
from pipeline.synth.generation.planning import as_json, difference, intrinsics, make_recipes
from pipeline.synth.generation.store import Store
from pipeline.synth.generation.work import Job, make_images

Progress = Callable[[int], None]
"""Told the number of finished images, those of the run that is continued with them; from another thread."""

LOOK_EVERY = 0.5
"""Seconds between two looks at how many images are finished."""


def synthesize(
    config: SynthesisConfig,
    out: Path,
    workers: Workers | None = None,
    count: int = 1,
    progress: Progress | None = None,
) -> bool:
    """Make the dataset's split, or what an interrupted run of the same configuration has left to do.

    `count` is the number of workers. Returns False where the split was complete already. Whatever ends it, the images
    that are finished stay, with their annotations.
    Raises InputError, before any work is done, if the configuration cannot be, the split's folder holds something
    else, or another run is at work; later if a file cannot be written or an arrangement admits no camera.
    """
    store = Store(out, config.split, f".{config.rgb}", config.depth_scale)
    told = as_json(config)
    if store.summary.is_file() and not store.journal.is_file():
        _refuse_other(read_json_object(store.summary).get("config"), told, store.summary)
        return False
    if not store.journal.is_file() and store.folder.exists() and any(store.folder.iterdir()):
        raise InputError(f"{store.folder}: is not empty and was not made by this; give another --out or split")
    recipes = make_recipes(config)
    out.mkdir(parents=True, exist_ok=True)
    journal = Journal(store.journal)
    try:
        if journal.head is None:
            journal.start(told)
        _refuse_other(journal.head, told, store.journal)
        remove_leftovers(*store.folder.glob("*/*/"), store.folder, out)
        _make(config, Job(recipes, store), workers or HERE, count, progress or (lambda done: None))
        finishing.write_target_lists(store)
        finishing.write_summary(store, told, recipes)
        journal.remove()
        store.remove_work()
    finally:
        journal.close()
    return True


def _make(config: SynthesisConfig, job: Job, workers: Workers, count: int, progress: Progress) -> None:
    """Make all images and what is beside them; the JSON files of scenes are written however this ends."""
    store, recipes = job.store, job.recipes
    library = next(iter(recipes.values())).library
    library.copy_to(store.root)
    finishing.write_camera(store.root / "camera.json", intrinsics(config.camera), config.depth_scale)
    for scene_id, recipe in recipes.items():
        recipe_files(store, scene_id, recipe)
    try:
        with _watched(store, progress):
            tasks = list(job.tasks(count))
            for _ in workers.map_unordered(make_images, tasks, job, total=len(tasks), describe=str):
                pass
    finally:
        for scene_id in recipes:
            finishing.write_scene_files(store, scene_id, library.obj_ids, store.root.name)


def recipe_files(store: Store, scene_id: int, recipe: Any) -> None:
    """Write what belongs to a scene of one kind only: the description of its marker board."""
    from pipeline.synth.generation.config import BoardScene

    if isinstance(recipe.scene, BoardScene):
        from pipeline.synth.boards import write_board
        from pipeline.synth.generation.board import board_of

        write_board(store.scene_folder(scene_id) / "board.json", board_of(recipe.scene.board))


def _refuse_other(old: Any, new: Any, path: Path) -> None:
    """Another configuration would mix two kinds of images."""
    if text := difference(old, new):
        raise InputError(f"{path}: was made with other settings: {text}; give them again, or another --out")


@contextmanager
def _watched(store: Store, progress: Progress) -> Iterator[None]:
    """Tell how many images are finished while the block runs, and at its end."""
    over = threading.Event()

    def look() -> None:
        while not over.wait(LOOK_EVERY):
            progress(store.finished())

    progress(store.finished())
    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        progress(store.finished())
