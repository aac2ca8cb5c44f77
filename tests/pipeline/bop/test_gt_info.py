"""What is measured of annotated instances, against BOP's definition followed pixel by pixel."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.bop.dataset import open_dataset
from pipeline.bop.gt_info.views import NO_BOX, view_instances
from pipeline.bop.vsd import vsd_of_poses
from pipeline.exceptions import FormatError
from pipeline.rendering import render_scene
from pipeline.scene import ImageKey, Model
from tests.tiny_dataset import CAMERA, box, pose

W, H = CAMERA.width, CAMERA.height
DELTA = 0.015


# ---- the definition, slowly


def slow_depth(model: Model, camera_from_model: np.ndarray) -> np.ndarray:
    """Depth on the canvas of 3 x 3 images, by meeting every triangle with every pixel's ray, in float64."""
    corners = model.vertices @ camera_from_model[:3, :3].T + camera_from_model[:3, 3]
    v, u = np.mgrid[: 3 * H, : 3 * W]
    pixels = np.stack([u + 0.5 - W, v + 0.5 - H, np.ones_like(u)], axis=-1)
    rays = pixels @ np.linalg.inv(CAMERA.K).T  # z is 1, so the factor of a ray is a depth
    nearest = np.full((3 * H, 3 * W), np.inf)
    for a, b, c in corners[model.faces]:
        weights = rays @ np.linalg.inv(np.stack([a, b, c], axis=1)).T  # the ray as a sum of corners
        inside = (weights >= 0).all(axis=-1)
        nearest[inside] = np.minimum(nearest[inside], 1 / weights.sum(axis=-1)[inside])
    return np.where(np.isfinite(nearest), nearest, 0.0)


def slow_box(mask: np.ndarray) -> tuple[int, ...]:
    ys, xs = np.nonzero(mask)
    return int(xs.min()), int(ys.min()), int(xs.max() - xs.min()), int(ys.max() - ys.min())


def slow_distance(depth: np.ndarray) -> np.ndarray:
    fx, fy, cx, cy = CAMERA.K[0, 0], CAMERA.K[1, 1], CAMERA.K[0, 2], CAMERA.K[1, 2]
    v, u = np.mgrid[:H, :W]
    return np.sqrt(((u - cx) / fx * depth) ** 2 + ((v - cy) / fy * depth) ** 2 + depth**2)


def slow_info(instances: list, depth: np.ndarray | None) -> list[dict]:
    canvases = [slow_depth(model, p) for model, p in instances]
    crops = [canvas[H : 2 * H, W : 2 * W] for canvas in canvases]
    delta = DELTA
    if depth is None:
        nearest = np.min([np.where(crop > 0, crop, np.inf) for crop in crops], axis=0)
        depth, delta = np.where(np.isfinite(nearest), nearest, 0.0), 0.0
    measured = slow_distance(depth)
    found = []
    for canvas, crop in zip(canvases, crops, strict=True):
        distance = slow_distance(crop)
        visible = (distance > 0) & ((distance - measured <= delta) | (measured == 0))
        count, all_ = int(visible.sum()), int((canvas > 0).sum())
        x, y, w, h = slow_box(canvas > 0) if count else (0, 0, 0, 0)
        found.append(
            {
                "bbox_obj": (x - W, y - H, w, h) if count else (-1, -1, -1, -1),
                "bbox_visib": slow_box(visible) if count else (-1, -1, -1, -1),
                "px_count_all": all_,
                "px_count_valid": int((measured[distance > 0] > 0).sum()),
                "px_count_visib": count,
                "visib_fract": count / all_ if all_ else 0.0,
                "mask": crop > 0,
                "visible_mask": visible,
            }
        )
    return found


def wall(z: float) -> np.ndarray:
    return np.full((H, W), z, np.float32)


def with_holes(depth: np.ndarray) -> np.ndarray:
    return np.where(np.random.default_rng(3).random(depth.shape) < 0.2, np.float32(0), depth)


BIG, SMALL = box(1), box(2)
ALONE = [(BIG, pose(0.01, 0.02, 0.35))]
IN_FRONT_OF_EACH_OTHER = [(BIG, pose(0.0, 0.0, 0.5)), (SMALL, pose(0.015, 0.01, 0.4)), (BIG, pose(-0.02, 0.0, 0.6))]
HIDDEN = [(BIG, pose(0.0, 0.0, 0.3)), (SMALL, pose(0.0, 0.0, 0.6))]
CUT_OFF = [(BIG, pose(-0.17, 0.0, 0.4)), (BIG, pose(0.15, 0.09, 0.4)), (SMALL, pose(0.02, -0.11, 0.4))]
OUTSIDE = [(BIG, pose(0.3, 0.0, 0.4)), (BIG, pose(3.0, 0.0, 0.4)), (BIG, pose(0.0, 0.0, 0.4))]
LARGER_THAN_THE_CANVAS = [(BIG, pose(0.0, 0.0, 0.035)), (SMALL, pose(0.0, 0.0, 0.03))]
BEHIND = [(BIG, pose(0.0, 0.0, -0.4)), (BIG, pose(0.01, 0.0, 0.01)), (SMALL, pose(0.0, 0.0, 0.5))]

CASES = {
    "on a wall": (ALONE, wall(0.5)),
    "in the wall, by less than delta": (ALONE, wall(0.345)),
    "in the wall, by more than delta": (ALONE, wall(0.34)),
    "all behind the wall": (ALONE, wall(0.2)),
    "depth has holes": (ALONE, with_holes(wall(0.34))),
    "nothing measured": (ALONE, wall(0.0)),
    "occlusion without depth": (IN_FRONT_OF_EACH_OTHER, None),
    "occlusion with depth": (IN_FRONT_OF_EACH_OTHER, wall(0.42)),
    "fully hidden": (HIDDEN, None),
    "partly outside": (CUT_OFF, wall(0.41)),
    "partly outside without depth": (CUT_OFF, None),
    "outside the image and the canvas": (OUTSIDE, wall(1.0)),
    "larger than the canvas": (LARGER_THAN_THE_CANVAS, None),
    "behind the camera": (BEHIND, wall(0.6)),
    "behind the camera without depth": (BEHIND, None),
}


@pytest.mark.parametrize(("instances", "depth"), CASES.values(), ids=CASES.keys())
def test_all_values_are_those_of_the_definition(instances, depth):
    views = view_instances(instances, CAMERA, depth, DELTA)
    for view, expected in zip(views, slow_info(instances, depth), strict=True):
        assert np.array_equal(view.mask, expected.pop("mask"))
        assert np.array_equal(view.visible_mask, expected.pop("visible_mask"))
        for name, value in expected.items():
            assert getattr(view.info, name) == value, name


def test_the_cases_show_what_they_are_made_for():
    infos = {name: [view.info for view in view_instances(shown, CAMERA, z)] for name, (shown, z) in CASES.items()}
    assert infos["on a wall"][0].visib_fract == 1.0
    assert 0 < infos["in the wall, by more than delta"][0].visib_fract < 1
    assert infos["fully hidden"][1].px_count_all > 30
    assert infos["fully hidden"][1].px_count_visib == 0
    cut = infos["partly outside"]
    assert all(0 < info.visib_fract < 0.9 for info in cut)
    assert cut[0].bbox_obj[0] < 0
    outside = infos["outside the image and the canvas"]
    assert outside[0].px_count_all > 0
    assert (outside[0].bbox_obj, outside[0].px_count_visib) == (NO_BOX, 0)
    assert outside[1].px_count_all == 0
    assert infos["larger than the canvas"][1].bbox_obj[1::2] == (-H, 3 * H - 1)
    assert infos["behind the camera"][0].px_count_all == 0
    assert infos["behind the camera"][1].px_count_all > 0


def test_random_scenes_follow_the_definition():
    rng = np.random.default_rng(11)
    for _ in range(12):
        instances = []
        for _ in range(int(rng.integers(1, 5))):
            x, y, z = rng.uniform((-0.2, -0.15, 0.2), (0.2, 0.15, 0.7))
            instances.append((BIG if rng.random() < 0.5 else SMALL, pose(x, y, z, tuple(rng.uniform(-3, 3, 3)))))
        depth = (
            with_holes(render_scene(instances[::2], CAMERA).depth + np.float32(0.002)) if rng.random() < 0.7 else None
        )
        views = view_instances(instances, CAMERA, depth, DELTA)
        for view, expected in zip(views, slow_info(instances, depth), strict=True):
            assert np.array_equal(view.mask, expected["mask"])
            # the one rounds distances to float32, as BOP does, the other does not
            assert np.count_nonzero(view.visible_mask ^ expected["visible_mask"]) <= 1
            assert view.info.px_count_all == expected["px_count_all"]


# ---- how it fits to the rest


def test_visible_silhouette_is_the_one_that_vsd_takes():
    depth = with_holes(wall(0.42))
    for (model, at), view in zip(
        IN_FRONT_OF_EACH_OTHER, view_instances(IN_FRONT_OF_EACH_OTHER, CAMERA, depth), strict=True
    ):
        compared = vsd_of_poses(model, CAMERA, at, at, depth)
        assert np.array_equal(compared.expand(compared.visible_gt), view.visible_mask)


def test_without_depth_visible_silhouettes_do_not_overlap():
    views = view_instances(IN_FRONT_OF_EACH_OTHER, CAMERA, None)
    assert sum(view.visible_mask.astype(int) for view in views).max() == 1
    together = np.any([view.visible_mask for view in views], axis=0)
    assert np.array_equal(together, np.any([view.mask for view in views], axis=0))


def test_pose_that_cannot_be_rendered_shows_nothing():
    flat = np.diag([1.0, 1.0, 0.0, 1.0])
    (view,) = view_instances([(BIG, flat)], CAMERA, wall(1.0))
    assert (view.info.px_count_all, view.info.visib_fract, view.info.bbox_obj) == (0, 0.0, NO_BOX)
    assert not view.mask.any()


def test_no_instances_give_nothing():
    assert view_instances([], CAMERA, wall(1.0)) == []
    assert view_instances([], CAMERA, None) == []


def test_depth_of_another_size_is_refused():
    with pytest.raises(FormatError, match="depth image has 10 x 10 pixels, but its camera has 64 x 48"):
        view_instances(ALONE, CAMERA, np.ones((10, 10), np.float32))


# ---- real data


def test_targets_of_lmo_follow_from_what_is_computed(lmo: Path):
    dataset, key = open_dataset(lmo), ImageKey(2, 3)
    truths = dataset.ground_truth(key)
    pairs = [(dataset.model(truth.obj_id, "display"), truth.camera_from_model) for truth in truths]
    infos = [view.info for view in view_instances(pairs, dataset.camera(key), dataset.depth(key))]
    visible = {truth.obj_id for truth, info in zip(truths, infos, strict=True) if info.visib_fract >= 0.1}
    assert visible == {target.obj_id for target in dataset.targets() if target.image == key}
    assert len(visible) == 8
    by_object = {truth.obj_id: info for truth, info in zip(truths, infos, strict=True)}
    assert by_object[1].visib_fract < 0.3  # the ape, behind the can
    assert all(by_object[obj_id].visib_fract > 0.9 for obj_id in (5, 6, 8, 9, 12))
