"""Make the demo: our eight parts as models, a small BOP dataset of them, and made results of two made methods.

    python -m pipeline.synth.demo --out assets

The same seed gives the same files on the same machine. Needs the extra `synth`; what it makes needs nothing.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.bop.dataset import open_dataset
from pipeline.bop.json_files import write_atomically
from pipeline.bop.results import Results, write_results
from pipeline.bop.targets import MIN_VISIBLE_FRACTION
from pipeline.bop.writer import AnnotatedImage, write_scene, write_targets
from pipeline.geometry import inverse, transform
from pipeline.rendering import render, render_scene
from pipeline.scene import Camera, GroundTruth, Image, ImageKey, Model, Target
from pipeline.synth import made_errors, part_files, ray_shading, scenes, sensor
from pipeline.synth.arrangement import arrange
from pipeline.synth.preview import contact_sheet
from pipeline.synth.things import Placed

DEPTH_SCALE_MM = 0.1
WORLD = 1000
"""Object ids from here on stand for table, bin and clutter, which are rendered but not annotated."""


@dataclass(frozen=True)
class DemoConfig:
    """What to make, and how well."""

    out: Path = Path("assets")
    """Folder that gets `models/` and `demo/`."""
    seed: int = 2024
    """Layouts, cameras, sensor noise and shading."""
    pixel_grid: int = 3
    """Colour samples per pixel are the square of this."""


def make_demo(config: DemoConfig) -> None:
    """Write everything under `config.out`."""
    root = config.out / "demo"
    part_files.write_part_models(config.out / "models")
    write_atomically(config.out / "models" / "preview.png", _png(contact_sheet(config.pixel_grid)))
    part_files.write_part_models(root / "models")
    part_files.write_eval_models(root / "models_eval")
    write_atomically(root / "camera.json", _camera_json())
    targets: list[Target] = []
    for recipe in scenes.RECIPES:
        placed = arrange(recipe, config.seed)
        write_scene(root, "test", recipe.scene_id, _images(recipe, placed, config, targets), DEPTH_SCALE_MM, ".jpg")
    write_targets(root / "test_targets_bop19.json", targets)
    write_made_results(root)


def write_made_results(root: Path) -> None:
    """Write the results of the made methods, and beside them what was done to each estimate."""
    dataset = open_dataset(root)
    kinds = {}
    for method in made_errors.METHODS:
        made = made_errors.made_estimates(dataset, method)
        results = Results.from_estimates([item.estimate for item in made], method.name, "demo", "test")
        write_results(root / "results" / f"{method.name}_demo-test.csv", results)
        kinds[method.name] = {"seed": method.seed, "kind_of_row": [item.kind for item in made]}
    write_atomically(root / "results" / "made_errors.json", json.dumps(kinds, indent=1).encode())


def shade_view(
    recipe: scenes.Recipe, placed: Sequence[Placed], camera: Camera, im_id: int, seed: int, pixel_grid: int
) -> UInt8[np.ndarray, "h w 3"]:
    """The photograph of one view."""
    world, lighting = scenes.world_of(recipe, placed)
    config = ray_shading.ShadingConfig(pixel_grid, light_samples=2, bounce_samples=2)
    radiance = ray_shading.shade(world, lighting, camera, config, seed=seed + 100 * recipe.scene_id + im_id)
    return sensor.photograph(radiance, _rng(seed, recipe.scene_id, im_id, 1), recipe.exposure)


def _images(
    recipe: scenes.Recipe, placed: Sequence[Placed], config: DemoConfig, targets: list[Target]
) -> Iterator[AnnotatedImage]:
    """All images of a scene; their targets are added to the list."""
    for im_id, camera in enumerate(scenes.camera_ring(recipe, placed, config.seed)):
        key = ImageKey(recipe.scene_id, im_id)
        annotated = _annotated(recipe, placed, _rounded(camera), key, config)
        visible = [t.obj_id for t in annotated.ground_truth or () if (t.visible_fraction or 0) >= MIN_VISIBLE_FRACTION]
        targets += [Target(*key, obj_id, count) for obj_id, count in sorted(Counter(visible).items())]
        yield annotated


def _annotated(
    recipe: scenes.Recipe, placed: Sequence[Placed], camera: Camera, key: ImageKey, config: DemoConfig
) -> AnnotatedImage:
    assert camera.world_from_camera is not None
    camera_from_world = inverse(camera.world_from_camera)
    count = len(recipe.parts)  # parts come first, then clutter
    poses = [_rounded_pose(camera_from_world @ item.world_from_model) for item in placed[:count]]
    things = [(part_files.part_model(obj_id), pose) for obj_id, pose in zip(recipe.parts, poses, strict=True)]
    things += [(model, camera_from_world) for model in _surroundings(recipe, placed)]
    # The masks are exact for the image: pixel centres are at integer coordinates.
    rendering = render_scene(things, camera, pixel_center=0.0)
    visible_masks = [rendering.instance_ids == i for i in range(count)]
    truths = [_ground_truth(i, things[i], visible_masks[i], camera) for i in range(count)]
    rgb = shade_view(recipe, placed, camera, key.im_id, config.seed, config.pixel_grid)
    depth = sensor.measured_depth(rendering.depth.astype(float), camera.K, _rng(config.seed, *key, 2))
    image = Image(key, camera, rgb, depth.astype(np.float32))
    return AnnotatedImage(image, truths, [alone.mask for alone in rendering.renderings[:count]], visible_masks)


def _ground_truth(
    index: int, thing: tuple[Model, Float[np.ndarray, "4 4"]], visible: Bool[np.ndarray, "h w"], camera: Camera
) -> GroundTruth:
    """The annotation; the visible fraction counts what lies outside the image as hidden, as BOP does."""
    model, pose = thing
    margin = np.array([[1.0, 0, camera.width], [0, 1.0, camera.height], [0, 0, 1.0]])
    canvas = Camera(margin @ camera.K, 3 * camera.width, 3 * camera.height)
    count = int(render(model, canvas, pose, pixel_center=0.0).mask_crop.sum())
    return GroundTruth(model.obj_id, pose, index, visible_fraction=int(visible.sum()) / count if count else 0.0)


def _surroundings(recipe: scenes.Recipe, placed: Sequence[Placed]) -> list[Model]:
    """Everything that hides parts or is measured behind them, in the world frame."""
    world, _ = scenes.world_of(recipe, placed)
    rest = world.surfaces[len(recipe.parts) :]
    return [Model(WORLD + i, s.vertices.astype(float), s.faces.astype(np.int32), 1.0) for i, s in enumerate(rest)]


def _rounded(camera: Camera) -> Camera:
    """The camera as its file will tell it: masks and depth are rendered from the poses that are written."""
    assert camera.world_from_camera is not None
    camera_from_world = _rounded_pose(inverse(camera.world_from_camera))
    return Camera(camera.K, camera.width, camera.height, inverse(camera_from_world))


def _rounded_pose(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    return transform(np.round(pose[:3, :3], 10), np.round(pose[:3, 3] * 1000.0, 6) / 1000.0)


def _camera_json() -> bytes:
    K = scenes.INTRINSICS
    values = {"cx": K[0, 2], "cy": K[1, 2], "depth_scale": DEPTH_SCALE_MM, "fx": K[0, 0], "fy": K[1, 1]}
    return (json.dumps(values | {"height": scenes.HEIGHT, "width": scenes.WIDTH}, indent=2) + "\n").encode()


def _png(rgb: UInt8[np.ndarray, "h w 3"]) -> bytes:
    return cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


def _rng(*seeds: int) -> np.random.Generator:
    return np.random.default_rng(seeds)


if __name__ == "__main__":
    import tyro

    make_demo(tyro.cli(DemoConfig))
