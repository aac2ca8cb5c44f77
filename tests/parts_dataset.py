"""A BOP dataset of two small parts on a board, fit for HashMatch: three test images, and a train split of each part alone."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from hashmatch_parts import CAMERA, image_of, looking_at, other_part, part

from pipeline.bop.writer import AnnotatedImage, write_scene, write_targets
from pipeline.geometry import transform
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.viewpoints import view_rotations
from pipeline.rendering import render
from pipeline.scene import GroundTruth, ImageKey, Model, Target

POSES = {
    0: {1: looking_at(0.45, (2.4, 0.25, 0.3), x=0.03, y=-0.01), 2: looking_at(0.5, (2.0, 0.1, -0.2), x=-0.09, y=0.02)},
    1: {1: looking_at(0.42, (2.2, -0.2, 0.1), x=-0.05, y=0.0), 2: looking_at(0.48, (2.1, 0.3, 0.0), x=0.08, y=-0.01)},
    2: {2: looking_at(0.46, (2.3, -0.1, 0.2), x=0.02, y=0.01)},
}
"""`camera_from_model` of each part by image of scene 1."""

COARSE = ("--angle-step-deg", "20", "--scales-up", "2", "--scales-down", "2", "--triplets", "600")
"""Options that are enough for these images: 72 views, 360 templates of a part."""


def make_parts_dataset(root: Path, color: bool = True) -> Path:
    """Write the dataset with its test split, and return its folder."""
    write_models(root / "models", color=color)
    models = {1: part(), 2: other_part()}
    images = [
        _annotated(ImageKey(1, im_id), [(models[obj_id], pose) for obj_id, pose in poses.items()], noise=0.0005)
        for im_id, poses in POSES.items()
    ]
    write_scene(root, "test", 1, images)
    write_targets(
        root / "test_targets_bop19.json",
        [Target(1, im_id, obj_id, 1) for im_id, poses in POSES.items() for obj_id in poses],
    )
    return root


def add_train_split(
    root: Path, step_deg: int = 20, masks: bool = True, models: Sequence[Model] = (part(), other_part())
) -> Path:
    """Write images of each part alone from all sides of the upper half, and return the split's folder."""
    for model in models:
        images = []
        for i, rotation in enumerate(view_rotations(HashMatchConfig(angle_step_deg=step_deg))):
            aside = np.array([0.02 * np.cos(i), 0.02 * np.sin(i), 0.4])  # not only in the middle of the image
            seen = [(model, transform(rotation, aside))]
            images.append(_annotated(ImageKey(model.obj_id, i), seen, masks=masks))
        write_scene(root, "train", model.obj_id, images)
    return root / "train"


def write_models(folder: Path, color: bool = True, only: Sequence[int] = (1, 2)) -> None:
    """Write the parts as PLY files with `models_info.json`."""
    folder.mkdir(parents=True, exist_ok=True)
    chosen = [model for model in (part(), other_part()) if model.obj_id in only]
    for model in chosen:
        write_ply(folder / f"obj_{model.obj_id:06d}.ply", model if color else replace(model, colors=None))
    infos = {str(model.obj_id): {"diameter": model.diameter * 1000} for model in chosen}
    (folder / "models_info.json").write_text(json.dumps(infos))


def write_ply(path: Path, model: Model) -> None:
    """Write a mesh in millimetres, with the colours of its vertices."""
    names = [f"property float {axis}" for axis in "xyz"]
    if model.colors is not None:
        names += [f"property uchar {name}" for name in ("red", "green", "blue")]
    rows = []
    for i, vertex in enumerate((model.vertices * 1000).tolist()):
        rows.append(" ".join(map(str, [*vertex, *([] if model.colors is None else model.colors[i].tolist())])))
    rows += [" ".join(map(str, (3, *face))) for face in model.faces.tolist()]
    header = ["ply", "format ascii 1.0", f"element vertex {len(model.vertices)}", *names]
    header += [f"element face {len(model.faces)}", "property list uchar int vertex_indices", "end_header"]
    path.write_text("\n".join([*header, *rows, ""]))


def _annotated(
    key: ImageKey, seen: Sequence[tuple[Model, np.ndarray]], noise: float = 0.0, masks: bool = True
) -> AnnotatedImage:
    image = replace(image_of(*seen, noise=noise), key=key)
    truths = [GroundTruth(model.obj_id, pose, i) for i, (model, pose) in enumerate(seen)]
    if not masks:
        return AnnotatedImage(image, truths)
    silhouettes = [render(model, CAMERA, pose, pixel_center=0.0).mask for model, pose in seen]
    return AnnotatedImage(image, truths, silhouettes, silhouettes)
