"""The audit of ground truth: statistics of the thesis's table, wrong and moved annotations told apart, reasons given."""

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from annotate.edges import common_shift, edge_profiles, outline
from annotate.quality import DepthDifferences, QualityConfig, audit
from inspector.commands.gt_quality import GtQualityConfig, run
from pipeline.bop.dataset import open_dataset
from pipeline.bop.writer import AnnotatedImage, write_scene
from pipeline.exceptions import InputError
from pipeline.geometry import inverse
from pipeline.rendering import render_scene
from pipeline.scene import Camera, GroundTruth, Image, ImageKey
from tests.tiny_dataset import box, make_dataset, moved, pose

CAMERA = Camera(np.array([[300.0, 0, 120.0], [0, 300.0, 90.0], [0, 0, 1]]), width=240, height=180)
RESTING = {1: pose(-0.05, 0.0, 0.0), 2: pose(0.05, 0.01, 0.0, (0.1, 0.5, 0.9))}
"""world_from_model by object."""


def turned(step: int) -> np.ndarray:
    """world_from_camera: half a metre away, from another side for each image."""
    return inverse(pose(0.0, 0.0, 0.5, (0.5, 0.15 * step, 0.0)))


def make_scene(
    root: Path, resting: list[dict], annotated: list[dict], *, world: bool = True, depth: bool = True
) -> Path:
    """A scene with an image for each placing of the objects, and annotations that need not agree with it."""
    make_dataset(root)
    shutil.rmtree(root / "test")
    images = []
    for step, (there, claimed) in enumerate(zip(resting, annotated, strict=True)):
        world_from_camera = turned(step)
        camera = replace(CAMERA, world_from_camera=world_from_camera if world else None)
        shown = [(box(k), inverse(world_from_camera) @ p) for k, p in there.items()]
        scene = render_scene(shown, camera, pixel_center=0.5)
        measured = np.where(scene.depth > 0, scene.depth, np.float32(0.7))
        gray = np.choose(scene.instance_ids + 1, [40, 140, 220]).astype(np.uint8)
        rgb = np.repeat(cv2.GaussianBlur(gray, (0, 0), 0.8)[..., None], 3, axis=2)
        truths = [GroundTruth(k, inverse(world_from_camera) @ p, i) for i, (k, p) in enumerate(claimed.items())]
        image = Image(ImageKey(1, step), camera, rgb, measured if depth else None)
        images.append(AnnotatedImage(image, truths))
    write_scene(root, "test", 1, images)
    return root


def shifted(k: int, **metres: float) -> dict:
    return RESTING | {k: moved(RESTING[k], **metres)}


def test_statistics_are_those_of_the_differences():
    rng = np.random.default_rng(0)
    inside, outside = rng.normal(0.003, 0.006, 20000), np.array([0.06, -0.2, 1.0])
    inside = inside[np.abs(inside) < 0.05]
    found = (DepthDifferences.of(inside[:5000]) + DepthDifferences.of(np.append(inside[5000:], outside))).statistics()
    assert found.pixels == len(inside) + 3
    assert found.outliers == pytest.approx(3 / found.pixels)
    assert found.mean == pytest.approx(inside.mean(), abs=1e-9)
    assert found.std == pytest.approx(inside.std(), abs=1e-9)
    assert found.mean_abs == pytest.approx(np.abs(inside).mean(), abs=1e-9)
    assert found.median_abs == pytest.approx(np.median(np.abs(inside)), abs=2e-5)
    near = inside[np.abs(inside) <= 0.02]
    assert found.surface_bias == pytest.approx(np.median(near), abs=5e-5)
    assert found.behind == pytest.approx((np.append(inside, outside) > 0.02).mean())


def test_nothing_measured_and_outliers_only_give_no_numbers():
    assert np.isnan(DepthDifferences().statistics().outliers)
    found = DepthDifferences.of(np.array([0.3, -0.3])).statistics()
    assert found.outliers == 1.0
    assert np.isnan(found.median_abs)


def test_lmo_is_as_far_off_as_is_known(lmo):
    report = audit(open_dataset(lmo), QualityConfig(contours=False))
    medians = [one.depth.surface_median_abs for one in report.objects]
    assert len(medians) == 8
    assert min(medians) == pytest.approx(0.0024, abs=1e-4)
    assert max(medians) == pytest.approx(0.0060, abs=1e-4)
    assert "49 of 50 images have no depth: only their contours are compared" in report.notes
    assert any("no scene has world poses" in note for note in report.notes)


def test_ycbv_is_as_far_off_as_is_known(ycbv):
    report = audit(open_dataset(ycbv), QualityConfig(scenes=(1,)))
    for one in report.objects:
        assert 0.0008 < one.depth.median_abs < 0.0017
    assert report.suspects == ()


def test_right_annotations_are_not_suspect(tmp_path):
    report = audit(open_dataset(make_scene(tmp_path, [RESTING] * 5, [RESTING] * 5)))
    assert report.suspects == ()
    assert report.total.depth.median_abs < 1e-4
    assert all(one.agreement.verdict == "agrees" and one.agreement.images == 4 for one in report.instances)
    assert all(one.contour.median < 1.0 for one in report.instances)


def test_a_wrong_annotation_is_the_first_suspect_and_the_reasons_are_told(tmp_path):
    annotated = [RESTING, RESTING, shifted(2, x=0.02), RESTING, RESTING]
    report = audit(open_dataset(make_scene(tmp_path, [RESTING] * 5, annotated)))
    worst = report.suspects[0]
    assert (worst.key, worst.index, worst.obj_id) == (ImageKey(1, 2), 1, 2)
    assert "20.0 mm from where other images have it, and this image bears them out" in worst.reasons
    assert any("contour" in reason for reason in worst.reasons)
    assert len(report.suspects) == 1


@pytest.mark.parametrize("depth", [True, False])
def test_a_moved_object_is_no_error(tmp_path, depth):
    placings = [RESTING, RESTING, RESTING, shifted(1, x=-0.03), shifted(1, x=-0.03), RESTING]
    report = audit(open_dataset(make_scene(tmp_path, placings, placings, depth=depth)))
    assert report.suspects == ()
    assert "2 annotations are of objects that were moved between images: no error" in report.notes


def test_an_object_moved_for_one_image_is_told_by_what_was_measured(tmp_path):
    placings = [RESTING, RESTING, shifted(1, x=-0.03), RESTING]
    report = audit(open_dataset(make_scene(tmp_path, placings, placings)))
    assert report.suspects == ()
    assert [one.agreement.verdict for one in report.instances if one.obj_id == 1] == [
        "agrees",
        "agrees",
        "moved",
        "agrees",
    ]


def test_a_wrong_world_pose_is_the_cameras_not_the_objects(tmp_path):
    root = make_scene(tmp_path, [RESTING] * 4, [RESTING] * 4)
    path = root / "test/000001/scene_camera.json"
    cameras = json.loads(path.read_text())
    cameras["2"]["cam_t_w2c"][0] += 60.0
    path.write_text(json.dumps(cameras))
    report = audit(open_dataset(root))
    assert report.suspects == ()
    assert any("scene 1 image 2: all objects are elsewhere than in other images" in note for note in report.notes)
    assert not any("were moved" in note for note in report.notes)


def test_objects_without_a_model_are_left_out_and_told(tmp_path):
    root = make_scene(tmp_path, [RESTING] * 2, [RESTING] * 2)
    (root / "models" / "obj_000002.ply").unlink()
    report = audit(open_dataset(root))
    assert {one.obj_id for one in report.instances} == {1}
    assert "objects without a model are left out: 2" in report.notes


def test_symmetric_poses_agree(tmp_path):
    half_turn = RESTING | {2: RESTING[2] @ np.diag([-1.0, -1.0, 1.0, 1.0])}
    report = audit(open_dataset(make_scene(tmp_path, [RESTING] * 3, [RESTING, half_turn, RESTING])))
    assert report.suspects == ()


def test_without_world_poses_images_are_not_compared_and_depth_still_is(tmp_path):
    annotated = [RESTING, shifted(1, z=0.03), RESTING]
    report = audit(open_dataset(make_scene(tmp_path, [RESTING] * 3, annotated, world=False)))
    assert any("no scene has world poses of its cameras" in note for note in report.notes)
    assert (report.suspects[0].key.im_id, report.suspects[0].obj_id) == (1, 1)


def test_a_bias_that_all_share_is_the_sensors(tmp_path):
    root = make_scene(tmp_path, [RESTING] * 3, [RESTING] * 3)
    for path in (root / "test" / "000001" / "depth").iterdir():
        cv2.imwrite(str(path), cv2.imread(str(path), cv2.IMREAD_UNCHANGED) - 80)  # 0.1 mm each
    report = audit(open_dataset(root))
    assert report.suspects == ()
    assert "surfaces are measured 8.0 mm before their poses as a rule; see inspector depth-correct" in report.notes


def test_a_damaged_image_is_left_out_and_told(tmp_path):
    root = make_scene(tmp_path, [RESTING] * 3, [RESTING] * 3)
    (root / "test/000001/depth/000001.png").write_bytes(b"no image")
    report = audit(open_dataset(root))
    assert {one.key.im_id for one in report.instances} == {0, 2}
    assert any("000001.png: is no image or is cut off" in note for note in report.notes)


def test_outline_and_shift_are_right_to_a_fraction_of_a_pixel():
    v, u = np.indices((80, 100))
    fine = np.hypot(u - 50.3, v - 40.6) < 20
    found = outline(fine)
    radius = np.hypot(*(found.points - (50.3, 40.6)).T)
    assert np.abs(radius - 20).max() < 0.7
    assert abs(radius.mean() - 20) < 0.15
    image = np.where(np.hypot(u - 52.8, v - 39.1) < 20, 200, 60).astype(np.uint8)
    shift = common_shift(found, *edge_profiles(image, found, 8))
    assert (shift.x, shift.y) == pytest.approx((2.5, -1.5), abs=0.2)
    assert common_shift(found, *edge_profiles(np.full((80, 100), 90, np.uint8), found, 8)) is None


def test_command_prints_the_table_and_the_suspects_and_writes_json(tmp_path):
    root = make_scene(tmp_path / "data", [RESTING] * 4, [RESTING, RESTING, shifted(1, y=0.02), RESTING])
    out, json_file = io.StringIO(), tmp_path / "quality.json"
    assert run(GtQualityConfig(root, json=json_file, workers=2), Console(file=out, width=160)) == 0
    text = out.getvalue()
    assert "measured minus rendered depth, mm" in text
    assert "1 of 8 annotations are suspect; 1 shown, worst first" in text
    content = json.loads(json_file.read_text())
    assert content["suspects"][0]["im_id"] == 2
    assert content["objects"][0]["depth"]["median_abs"] is not None
    assert len(content["instances"]) == 8


def test_command_tells_what_there_is_nothing_of(tmp_path):
    root = make_dataset(tmp_path / "data")
    with pytest.raises(InputError, match="test has no annotated image; choose another with --split"):
        run(GtQualityConfig(root, scenes=(2,)))
    with pytest.raises(InputError, match="scene 9 is not in"):
        run(GtQualityConfig(root, scenes=(9,)))
