"""Checks of ids: what the file gives against what the dataset asks for."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.bop.dataset import Dataset
from pipeline.bop.submission.asked import Asked, image_keys, image_name
from pipeline.bop.submission.findings import Finding, Given, Task

_IGNORED = "BOP ignores it: remove it, or mend the ids"


def check_ids(given: Given, asked: Asked, named_dataset: str) -> Iterator[Finding]:
    """Estimates that nothing asks for."""
    left_out = np.zeros(len(given), bool)
    found: list[Finding] = []
    for kind, rows, message, fix in _not_asked(given, asked):
        rows = rows & ~left_out
        left_out |= rows
        found += given.warn(kind, rows, message, fix)
    if len(given) and left_out.all():
        yield _nothing_matches(given, asked, named_dataset, found)
    else:
        yield from found
    if not len(asked.target_images):
        message = f"{asked.where} has neither a list of targets nor ground truth, so only its images and models count"
        yield Finding("warning", "no targets", message, "add the list of targets that comes with the dataset")


def _not_asked(given: Given, asked: Asked) -> Iterator[tuple]:
    """Name, rows, message and fix of every reason for which a row is of no use; earlier ones take precedence."""
    scene_id, obj_id = given["scene_id"], given["obj_id"]
    images = image_keys(scene_id, given["im_id"])
    absent = ~np.isin(images, asked.images)
    where = asked.where
    yield (
        "image not on disk",
        absent & np.isin(images, asked.listed),
        lambda row: f"{given.place(row)} is a target, but is not on disk",
        "it cannot be scored here: get the whole split",
    )
    yield (
        "unknown scene",
        ~np.isin(scene_id, asked.scenes),
        lambda row: f"column scene_id: scene {scene_id[row]} is not in {where}",
        _IGNORED,
    )
    yield "unknown image", absent, lambda row: f"column im_id: {given.place(row)} is not in {where}", _IGNORED
    if len(asked.objects):
        yield (
            "unknown object",
            ~np.isin(obj_id, asked.objects),
            lambda row: f"column obj_id: object {obj_id[row]} is not in {where}",
            _IGNORED,
        )
    if len(asked.target_images):
        yield (
            "image without target",
            ~np.isin(images, asked.target_images),
            lambda row: f"column im_id: nothing is asked for in {given.place(row)}",
            _IGNORED,
        )
    if len(asked.targets):
        yield (
            "object without target",
            ~np.isin(asked.target_keys(images, obj_id), asked.targets),
            lambda row: f"column obj_id: object {obj_id[row]} is not asked for in {given.place(row)}",
            _IGNORED,
        )


NOT_ASKED = frozenset(
    {
        "image not on disk",
        "unknown scene",
        "unknown image",
        "unknown object",
        "image without target",
        "object without target",
    }
)
"""Kinds of findings whose rows are of no use; a row is in one of them at most."""
_WHY_NOTHING = {
    "image not on disk": "get the whole split: images of its targets are not here",
    "image without target": "give the list of targets that comes with the split, or a file for its targets",
}


def _nothing_matches(given: Given, asked: Asked, named_dataset: str, found: list[Finding]) -> Finding:
    """Say it once instead of every reason by itself."""
    main = max(found, key=lambda finding: finding.count)
    named = f" (by its name the file is for {named_dataset})" if named_dataset else ""
    message = f"no row of {len(given):,} is for a target of {asked.where}{named}: {main.message}"
    fix = _WHY_NOTHING.get(main.kind, "give the dataset and split that the file is for")
    return replace(main, severity="error", kind="nothing matches", message=message, fix=fix, count=len(given))


def check_counts(given: Given, asked: Asked, task: Task, dataset: Dataset) -> Iterator[Finding]:
    """Whether there are as many estimates as BOP scores."""
    images = image_keys(given["scene_id"], given["im_id"])
    if task == "detection":
        from pipeline.bop.evaluation.detection_outcomes import most_estimates

        yield from _counts_of_images(given, asked, images, most_estimates(dataset))
    elif len(asked.targets):
        yield from _counts_of_targets(given, asked, asked.target_keys(images, given["obj_id"]))


def _counts_of_targets(given: Given, asked: Asked, keys: Int[np.ndarray, " n"]) -> Iterator[Finding]:
    targets = asked.targets
    rows = np.flatnonzero(np.isin(keys, targets))
    places = np.searchsorted(targets, keys[rows])
    counts = np.bincount(places, minlength=len(targets))
    yield from _too_few(asked, "targets without estimate", counts == 0, "no estimate", "they count as missed")
    few = (counts > 0) & (counts < asked.instances)
    fix = "the other instances count as missed"
    yield from _too_few(asked, "fewer than instances", few, "fewer estimates than instances", fix)
    beyond = np.zeros(len(given), bool)
    beyond[rows] = _ranks(places, given["score"][rows]) >= asked.instances[places]

    def message(row: int) -> str:
        place = int(np.searchsorted(targets, keys[row]))
        few, many = asked.instances[place], counts[place]
        return f"{asked.target_name(int(keys[row]))} has {many} estimates for {few} instance{'s' if few > 1 else ''}"

    fix = "BOP ignores those of lowest score, such as this one"
    yield from given.warn("more than instances", beyond, message, fix)


def _too_few(asked: Asked, kind: str, which: Bool[np.ndarray, " t"], has: str, fix: str) -> Iterator[Finding]:
    if which.any():
        first = asked.target_name(int(asked.targets[np.argmax(which)]))
        count, total = int(which.sum()), len(which)
        message = f"{count:,} of {total:,} targets have {has}, the first is {first}"
        yield Finding("warning", kind, message, fix, value=f"{count} of {total}", count=count, of="target")


def _counts_of_images(given: Given, asked: Asked, images: Int[np.ndarray, " n"], most: int) -> Iterator[Finding]:
    without = ~np.isin(asked.target_images, images)
    if without.any():
        count, total = int(without.sum()), len(without)
        first = image_name(int(asked.target_images[np.argmax(without)]))
        message = f"{count:,} of {total:,} images have no estimate, the first is {first}"
        fix = "all their objects count as missed"
        yield Finding(
            "warning", "images without estimate", message, fix, value=f"{count} of {total}", count=count, of="image"
        )
    _, places, counts = np.unique(images, return_inverse=True, return_counts=True)

    def message_of(row: int) -> str:
        return f"{given.place(row)} has {counts[places[row]]} estimates, above {most}"

    fix = "BOP ignores those of lowest score, such as this one"
    yield from given.warn("too many of an image", _ranks(places, given["score"]) >= most, message_of, fix)


def _ranks(groups: Int[np.ndarray, " n"], scores: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Place of each row among those of its group by falling score, from 0; equal scores stay in their order."""
    order = np.lexsort((-scores, groups))
    ordered = groups[order]
    ranks = np.empty(len(groups), np.int64)
    ranks[order] = np.arange(len(groups)) - np.searchsorted(ordered, ordered, "left")
    return ranks
