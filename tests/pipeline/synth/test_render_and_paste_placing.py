"""Random poses of render-and-paste images: what is drawn from which range, and how often objects are cut off."""

from typing import NamedTuple

import numpy as np
import pytest
from scipy.stats import kstest

from pipeline.color_rendering import gl_available
from pipeline.geometry import inverse, project, transform_points
from pipeline.scene import Camera, Model
from pipeline.synth.cameras import viewpoints_of
from pipeline.synth.render_and_paste import (
    LightError,
    LightRanges,
    PasteSettings,
    PasteSettingsError,
    RenderAndPaste,
    ViewRanges,
)
from pipeline.synth.render_and_paste.lights import sample_light
from pipeline.synth.render_and_paste.placing import sample_poses

CAMERA = Camera(np.array([[572.4, 0.0, 325.3], [0.0, 573.6, 242.0], [0.0, 0.0, 1.0]]), width=640, height=480)


def box(obj_id: int = 1, size: tuple[float, float, float] = (0.1, 0.06, 0.03), shift: float = 0.0) -> Model:
    vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(size) / 2 + shift
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Model(obj_id, vertices, np.array(faces, np.int32), float(np.linalg.norm(size)))


def sampled(settings: PasteSettings, models: list[Model], images: int) -> list[list[tuple[Model, np.ndarray]]]:
    rng = np.random.default_rng(0)
    return [sample_poses(models, CAMERA, settings, rng) for _ in range(images)]


def flat(scenes: list[list[tuple[Model, np.ndarray]]]) -> list[tuple[Model, np.ndarray]]:
    return [posed for scene in scenes for posed in scene]


def is_truncated(model: Model, pose: np.ndarray) -> bool:
    pixels = project(CAMERA.K, transform_points(pose, model.vertices))
    return bool((pixels < 0).any() or (pixels > [639, 479]).any())


def test_counts_and_models_are_uniform():
    scenes = sampled(PasteSettings(objects=(2, 5)), [box(1), box(2), box(3)], 300)
    counts = np.bincount([len(scene) for scene in scenes], minlength=7)
    assert counts[:2].sum() == counts[6:].sum() == 0
    assert counts[2:6] == pytest.approx([75] * 4, abs=28)
    models = np.bincount([model.obj_id for model, _ in flat(scenes)])[1:]
    assert models == pytest.approx([models.mean()] * 3, rel=0.15)


@pytest.mark.parametrize("count", [1, 8])  # many do not push each other into other views
def test_rotations_and_sizes_are_uniform_and_seen_the_same_anywhere_in_the_image(count: int):
    posed = flat(sampled(PasteSettings(objects=(count, count), size=(0.1, 0.3)), [box(shift=0.4)], 800 // count))
    middle = np.full(3, 0.4)
    rays = np.stack([transform_points(inverse(pose), np.zeros(3)) - middle for _, pose in posed])
    distances = np.linalg.norm(rays, axis=1)
    directions = rays / distances[:, None]  # towards the camera, model frame
    for axis in directions.T:  # a coordinate of points on a sphere is uniform
        assert kstest(axis, "uniform", (-1, 2)).pvalue > 1e-3
    sizes = posed[0][0].diameter * np.sqrt(572.4 * 573.6) / distances / 480
    assert kstest(np.log(sizes), "uniform", (np.log(0.1), np.log(3))).pvalue > 1e-3


@pytest.mark.parametrize("share", [0.0, 0.15, 0.5, 1.0])
def test_as_many_objects_are_truncated_as_the_setting_says(share: float):
    posed = flat(sampled(PasteSettings(objects=(3, 8), truncated=share), [box(), box(2, (0.05, 0.05, 0.2))], 70))
    cut = np.mean([is_truncated(model, pose) for model, pose in posed])
    assert cut == pytest.approx(share, abs=0.06 if 0 < share < 1 else 0.01)
    middles = np.stack([project(CAMERA.K, pose[:3, 3]) for _, pose in posed])
    assert ((middles >= -1) & (middles <= [640, 480])).all()


def test_objects_do_not_run_into_each_other():
    scenes = sampled(PasteSettings(objects=(8, 8)), [box(), box(2)], 60)
    touching = [
        np.linalg.norm(a[:3, 3] - b[:3, 3]) < 0.03  # the thickness of the boxes
        for scene in scenes
        for i, (_, a) in enumerate(scene)
        for _, b in scene[:i]
    ]
    assert np.mean(touching) < 1e-3


class Ranges(NamedTuple):
    """Not the class of the cameras, but with its fields."""

    azimuth_deg: tuple[float, float] = (20.0, 50.0)
    elevation_deg: tuple[float, float] = (-10.0, 35.0)
    distance: tuple[float, float] = (0.4, 0.9)
    roll_deg: tuple[float, float] = (-15.0, 15.0)


def test_views_are_drawn_uniformly_from_given_ranges():
    assert isinstance(Ranges(), ViewRanges)
    posed = flat(sampled(PasteSettings(objects=(1, 1), views=Ranges(), truncated=0.0), [box()], 600))
    world_from_cameras = np.stack([inverse(pose) for _, pose in posed])
    seen = viewpoints_of(world_from_cameras, np.zeros((len(posed), 3)))
    pairs = [(seen.azimuth_deg, (20, 50)), (seen.elevation_deg, (-10, 35)), (seen.distance, (0.4, 0.9))]
    for values, (low, high) in pairs:
        assert kstest(np.asarray(values), "uniform", (low, high - low)).pvalue > 1e-3
    straight = [i for i, (_, pose) in enumerate(posed) if np.hypot(*pose[:2, 3]) < 0.06]
    assert len(straight) > 20
    assert np.abs(np.asarray(seen.roll_deg)[straight]).max() < 18.0  # exact for objects straight ahead


def test_objects_of_which_too_little_is_seen_are_left_out():
    if not gl_available():
        pytest.skip("no OpenGL through EGL here: install libegl1 and libgl1-mesa-dri")
    settings = PasteSettings(objects=(3, 14), min_visible=0.5, augmentation=None, size=(0.2, 0.7))
    camera = Camera(CAMERA.K / [[4], [4], [1]], 160, 120)
    with RenderAndPaste([box()], camera, settings) as source:
        images = [source.image(np.random.default_rng(seed)) for seed in range(10)]
    for image in images:
        shares = [seen.sum() / full.sum() for seen, full in zip(image.visible_masks, image.masks, strict=True)]
        assert len(shares) == 3 or min(shares) >= 0.5
        assert len(shares) == len(image.ground_truth) == image.instance_ids.max() + 1
    assert max(len(image.ground_truth) for image in images) > 5


def test_light_is_within_its_ranges_and_comes_from_the_side_of_the_camera():
    ranges = LightRanges(lamps=(0, 4), strength=(0.2, 0.4), ambient=(0.1, 0.3), color=0.25)
    lights = [sample_light(ranges, np.random.default_rng(seed)) for seed in range(300)]
    assert {len(light.directions) for light in lights} == {0, 1, 2, 3, 4}
    directions = np.concatenate([light.directions for light in lights])
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
    assert (directions @ [0.0, -0.6, -0.8]).min() >= 0
    strengths = np.concatenate([light.colors.mean(axis=1) for light in lights])
    assert 0.2 <= strengths.min() < 0.22
    assert 0.38 < strengths.max() <= 0.4
    tints = np.concatenate([light.colors / light.colors.mean(axis=1, keepdims=True) for light in lights])
    assert 0.1 < np.abs(tints - 1).max() <= 0.26


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PasteSettings(objects=(5, 2)), "objects from 5 to 2; give two numbers from 0 on, low before high"),
        (lambda: PasteSettings(size=(0.0, 0.5)), "size from 0.0 to 0.5; give shares above 0, low before high"),
        (lambda: PasteSettings(truncated=1.5), r"truncated 1.5 is outside 0\.\.1; give a share"),
        (lambda: PasteSettings(edge_blur=9), r"edge_blur 9 is outside 0\.\.5 pixels; 0 leaves edges hard"),
    ],
)
def test_settings_without_a_meaning_are_refused(make, message: str):
    with pytest.raises(PasteSettingsError, match=message):
        make()


def test_light_without_a_meaning_is_refused():
    with pytest.raises(LightError, match="5 lamps; at most 4 can be drawn"):
        LightRanges(lamps=(1, 5))
    with pytest.raises(LightError, match="strength of the light from -1 to 1; give numbers from 0 on"):
        LightRanges(strength=(-1, 1))
