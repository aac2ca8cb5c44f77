"""Templates from images of single objects, as in a BOP train split."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hashmatch_parts import CAMERA, COARSE, KEY, image_of, looking_at, other_part, part
from parts_dataset import add_train_split, make_parts_dataset

from pipeline.bop.dataset import open_dataset
from pipeline.bop.errors import mssd
from pipeline.exceptions import FormatError, InputError
from pipeline.hashmatch.captured_templates import CapturedTemplates, Sighting, different
from pipeline.hashmatch.captured_views import captured_view
from pipeline.hashmatch.channels import normal_bins
from pipeline.hashmatch.estimator import HashMatchEstimator
from pipeline.hashmatch.templates import joined
from pipeline.hashmatch.viewpoints import about_axis
from pipeline.hashmatch.views import fitting_distance, render_views
from pipeline.recording import NullRecorder
from pipeline.rendering import render
from pipeline.scene import GroundTruth, ImageKey, Target

MODELS = {1: part(), 2: other_part()}
CONFIG = replace(COARSE, angle_step_deg=20, in_plane_limit_deg=40)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = make_parts_dataset(tmp_path_factory.mktemp("captured") / "parts")
    add_train_split(root)
    return root


def source_of(root: Path) -> CapturedTemplates:
    return CapturedTemplates(open_dataset(root, "train"), MODELS, CONFIG, 300.0)


def test_a_captured_view_shows_what_a_rendered_one_shows():
    """Off the centre, at another distance, by another camera, before a background."""
    camera = replace(CAMERA, K=np.array([[450.0, 0, 150.0], [0, 450.0, 120.0], [0, 0, 1]]), width=320, height=240)
    pose = looking_at(0.4, (2.4, 0.25, 0.3), x=0.06, y=-0.03)
    image = image_of((part(), pose), camera=camera)
    mask = render(part(), camera, pose, pixel_center=0.0).mask
    seen = captured_view(image, pose, mask, part(), 300.0)
    distance = fitting_distance(part(), 300.0)
    (rendered,) = render_views(part(), seen.rotation[None], distance, 300.0)
    both = seen.mask & rendered.mask
    assert both.sum() > 0.93 * (seen.mask | rendered.mask).sum()  # the perspective of another distance
    difference = np.abs(seen.distance - rendered.distance)[both & (seen.distance > 0)]
    assert np.median(difference) < 0.001
    assert np.percentile(difference, 90) < 0.004
    assert (normal_bins(seen.normals) == normal_bins(rendered.normals))[both].mean() > 0.8
    assert np.abs(seen.rgb[both].astype(int) - rendered.rgb[both]).mean() < 12
    assert not seen.rgb[~seen.mask].any()


def test_objects_are_found_by_templates_from_images(root: Path, tmp_path: Path):
    config = replace(CONFIG, templates=root / "train", cache=tmp_path)
    estimator = HashMatchEstimator.of_dataset(open_dataset(root), config)
    poses = {1: looking_at(0.45, (2.4, 0.25, 0.3), x=0.03, y=-0.01), 2: looking_at(0.5, (2.0, 0.1, -0.2), x=-0.09)}
    image = image_of((part(), poses[1]), (other_part(), poses[2]), noise=0.0005)
    found = estimator.estimate(image, [Target(*KEY, 1, 1), Target(*KEY, 2, 1)], NullRecorder())
    assert {one.obj_id for one in found} == {1, 2}
    for one in found:
        assert mssd(MODELS[one.obj_id], one.camera_from_model, poses[one.obj_id]).value < 0.004
    assert len(estimator.detector.objects[0]) == 72 * 5
    assert estimator.detector.objects[0].colored


def test_without_masks_they_are_rendered(root: Path, tmp_path: Path):
    bare = make_parts_dataset(tmp_path / "parts")
    add_train_split(bare, step_deg=90, masks=False)
    with_masks = make_parts_dataset(tmp_path / "masked")
    add_train_split(with_masks, step_deg=90)
    one, other = (joined([source_of(it).learn(1, 0)]) for it in (bare, with_masks))
    np.testing.assert_allclose(one.areas, other.areas, rtol=0.02)
    np.testing.assert_array_equal(one.rotations, other.rotations)


def test_what_changes_templates_changes_their_name(root: Path, tmp_path: Path):
    own = make_parts_dataset(tmp_path / "parts")
    train = add_train_split(own, step_deg=90)
    before = source_of(own).digest(1)
    assert source_of(own).digest(1) == before
    path = train / "000001" / "rgb" / "000001.png"
    cv2.imwrite(str(path), np.zeros((180, 240, 3), np.uint8))
    assert source_of(own).digest(1) != before
    assert replace(source_of(own), focal_px=301.0).digest(2) != source_of(own).digest(2)


def test_orientations_that_are_nearly_the_same_are_taken_once():
    turned = [about_axis(np.deg2rad(angle)) for angle in (0, 2, 4, 6, 11)]
    sightings = [Sighting(ImageKey(1, i), GroundTruth(1, _with(rotation), 0)) for i, rotation in enumerate(turned)]
    assert [one.image.im_id for one in different(sightings, 5)] == [0, 3, 4]


def test_only_objects_that_are_seen_alone_and_wholly_count(root: Path, tmp_path: Path):
    own = make_parts_dataset(tmp_path / "parts")
    train = add_train_split(own, step_deg=90)
    info = train / "000001" / "scene_gt_info.json"
    content = json.loads(info.read_text())
    for entries in content.values():
        entries[0]["visib_fract"] = 0.5
    info.write_text(json.dumps(content))
    assert len(source_of(own).sightings(2)) == 4
    with pytest.raises(
        InputError, match=r"^parts/train: no image with colour and depth shows object 1 alone and wholly;"
    ):
        source_of(own).sightings(1)
    truths = json.loads((train / "000002" / "scene_gt.json").read_text())
    truths["0"][0]["cam_t_m2c"][0] = 170.0  # millimetres: half of it is outside the image
    (train / "000002" / "scene_gt.json").write_text(json.dumps(truths))
    assert [one.image.im_id for one in source_of(own).sightings(2)] == [1, 2, 3]


def test_images_without_depth_in_the_masks_are_named(tmp_path: Path):
    own = make_parts_dataset(tmp_path / "parts")
    train = add_train_split(own, step_deg=90)
    for path in (train / "000001" / "depth").iterdir():
        cv2.imwrite(str(path), np.zeros((180, 240), np.uint16))
    with pytest.raises(
        FormatError, match=r"^parts/train: scene 1, image 0 and those behind it: no depth within the masks"
    ):
        source_of(own).learn(1, 0)


def _with(rotation: np.ndarray) -> np.ndarray:
    pose = looking_at(0.4, (0, 0, 0))
    pose[:3, :3] = rotation
    return pose
