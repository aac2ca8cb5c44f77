"""From a configuration to the recipes of all scenes; what cannot be made is found out before any work is done."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.bop.json_files import read_json_object
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from pipeline.scene import Camera
from pipeline.synth.generation.config import (
    BoardScene,
    CameraConfig,
    Count,
    DepthConfig,
    PastedScene,
    SceneConfig,
    SynthesisConfig,
    TracedScene,
)
from pipeline.synth.generation.library import ModelLibrary
from pipeline.synth.generation.objects import Distractors
from pipeline.synth.generation.recipe import Recipe
from pipeline.synth.sensors import DepthSensor, depth_sensor, sensor_camera
from pipeline.synth.tracing.path_tracer import preset_of
from pipeline.synth.worlds import WORLDS, build_world

FREE_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")


def make_recipes(config: SynthesisConfig) -> dict[int, Recipe[Any]]:
    """Recipes of all scenes by scene id.

    Raises InputError, one line that names the setting, its value and the fix, for whatever cannot be made.
    """
    if not config.scene:
        raise InputError("no [[scene]]; give at least one table [[scene]] with its kind")
    if not config.split or Path(config.split).name != config.split:
        raise InputError(f"split is {config.split!r}; give the name of a folder, such as train_pbr")
    for name in ("seed", "first_scene"):
        if (value := getattr(config, name)) < 0:
            raise InputError(f"{name} is {value}; give 0 or more")
    if not 0 < config.depth_scale < 100:
        raise InputError(f"depth_scale is {config.depth_scale:g}; give the millimetres of one step, such as 0.1")
    library = ModelLibrary(config.models)
    for obj_id in library.chosen(config.objects):
        library.model(obj_id)  # read now, so that a damaged one stops nothing halfway
    camera = intrinsics(config.camera)
    made = {scene: _recipe(config, scene, library, camera) for scene in config.scene}
    return {scene_id: replace(made[scene], scene_id=scene_id) for scene_id, scene in config.scenes()}


def _recipe(config: SynthesisConfig, scene: Any, library: ModelLibrary, camera: Camera) -> Recipe[Any]:
    scene.check()
    _check(scene)
    return Recipe(
        scene=scene,
        scene_id=0,
        seed=config.seed,
        obj_ids=library.chosen(scene.objects, config.objects),
        library=library,
        distractors=Distractors.of(scene.distractors) if isinstance(scene, TracedScene) and scene.distractors else None,
        camera=camera,
        sensor=sensor(scene.depth or config.depth),
    )


def _check(scene: SceneConfig) -> None:
    match scene:
        case TracedScene():
            preset_of(scene.quality)
            _check_count(scene, "count", scene.count)
            _check_places(scene)
        case BoardScene():
            from pipeline.synth.boards import turntable_views
            from pipeline.synth.generation.board import board_of

            preset_of(scene.quality)
            _check_count(scene, "count", scene.count)
            board_of(scene.board)
            turntable_views(scene.azimuths_deg, scene.elevations_deg, scene.distance)
        case PastedScene():
            from pipeline.synth.render_and_paste import PhotoFolder

            if scene.settings.backgrounds is not None:
                PhotoFolder(scene.settings.backgrounds)


def _check_places(scene: TracedScene) -> None:
    """Worlds and stages exist."""
    if not scene.worlds:
        raise InputError(f"{scene.name}: worlds is empty; name some of: {', '.join(WORLDS)}")
    for name in scene.worlds:
        if name not in WORLDS:
            raise UnknownIdError("world", name, "the worlds", WORLDS)
        if scene.stages:
            there = {stage.name for stage in build_world(name, scene.world_seed or 0).stages}
            for stage in scene.stages:
                if stage not in there:
                    raise UnknownIdError("stage", stage, f"world {name}", there)


def _check_count(scene: SceneConfig, name: str, count: Count | None) -> None:
    if count is not None and not 1 <= count[0] <= count[1]:
        raise InputError(f"{scene.name}: {name} is {list(count)}; give the least, from 1 on, and the most")


def intrinsics(config: CameraConfig) -> Camera:
    """The camera that a configuration tells. Raises InputError."""
    given = [name for name in FREE_INTRINSICS if getattr(config, name) is not None]
    if given:
        if missing := [name for name in FREE_INTRINSICS if name not in given]:
            raise InputError(f"camera: {', '.join(given)} without {', '.join(missing)}; give all of them, or a sensor")
        return _camera({name: getattr(config, name) for name in FREE_INTRINSICS}, "camera")
    if config.dataset is not None:
        path = config.dataset / "camera.json"
        content = read_json_object(path)
        numbers = {name: content.get(name) for name in FREE_INTRINSICS}
        for name, value in numbers.items():
            if not isinstance(value, int | float):
                raise FormatError(f"{path}: {name} is {value!r}; expected a number")
        return _camera(numbers, str(path))
    if config.sensor is None:
        raise InputError("camera: no sensor, no dataset and no numbers; give one of them")
    return sensor_camera(config.sensor)


def _camera(numbers: dict[str, Any], where: str) -> Camera:
    width, height, fx, fy, cx, cy = (numbers[name] for name in FREE_INTRINSICS)
    for name in ("width", "height", "fx", "fy"):
        if not 0 < numbers[name] < 1e5:
            raise InputError(f"{where}: {name} is {numbers[name]:g}; give pixels, more than 0")
    return Camera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), int(width), int(height))


def sensor(config: DepthConfig) -> DepthSensor:
    """The depth sensor that a configuration tells. Raises InputError."""
    base = depth_sensor(config.sensor) if config.settings is None else config.settings
    own = {name: value for name in ("a", "b") if (value := getattr(config, name)) is not None}
    return replace(base, **own)


def difference(old: Any, new: Any, where: str = "") -> str:
    """The first setting in which two configurations, as JSON, differ, with both values; empty if none."""
    if isinstance(old, dict) and isinstance(new, dict):
        parts = [(f"{where}.{name}" if where else name, old.get(name), new.get(name)) for name in {**old, **new}]
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new) and where == "scene":
        parts = [(f"{where} {i + 1}", a, b) for i, (a, b) in enumerate(zip(old, new, strict=True))]
    else:
        return "" if old == new else f"{where} was {old}, now {new}"
    return next((text for name, a, b in parts if (text := difference(a, b, name))), "")


def as_json(config: Any) -> Any:
    """A configuration as JSON has it, with the kinds of its scenes."""
    if isinstance(config, Path):
        return str(config)
    if isinstance(config, tuple | list):
        return [as_json(item) for item in config]
    if not hasattr(config, "__dataclass_fields__"):
        return config
    kind = {"kind": config.kind} if isinstance(config, SceneConfig) else {}
    way = {"type": type(config).__name__} if not kind else {}
    return kind | way | {item.name: as_json(getattr(config, item.name)) for item in fields(config)}
