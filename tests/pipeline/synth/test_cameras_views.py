"""Views of arranged objects: the rules they keep, what is said when there are none, and exact annotations."""

import numpy as np
import pytest
from scipy import stats

from pipeline.bop.dataset import open_dataset
from pipeline.bop.writer import AnnotatedImage, write_scene
from pipeline.exceptions import InputError
from pipeline.geometry import inverse, transform, transform_points
from pipeline.scene import Camera, Image, ImageKey, Model
from pipeline.synth.cameras import (
    CameraRanges,
    CameraSettingsError,
    NoViewError,
    View,
    ViewChooser,
    ViewRules,
    annotate_view,
    choose_view,
    render_view,
    viewpoints_of,
)
from pipeline.synth.cameras.visibility import visible_fraction
from pipeline.synth.materials import LAMBERTIAN
from pipeline.synth.worlds.shapes import ball, box
from pipeline.synth.worlds.world import World

CAMERA = Camera(np.array([[70.0, 0, 31.5], [0, 70.0, 23.5], [0, 0, 1]]), 64, 48)
RANGES = CameraRanges(elevation_deg=(10.0, 80.0), distance=(0.5, 1.0))


def make_world(*pieces, room=((-3.0, -3.0, 0.02), (3.0, 3.0, 3.0))) -> World:
    floor = box(6.0, 6.0, 0.1).moved(z=-0.1).piece("floor", LAMBERTIAN)
    return World("test room", 0, (floor, *pieces), (), (), np.array(room))


def block(name: str, size: tuple[float, float, float], at: tuple[float, float, float]):
    """A box that stands at a point."""
    return box(*size).moved(*at).piece(name, LAMBERTIAN)


def model_of(shape, obj_id: int) -> Model:
    return Model(obj_id, shape.vertices, shape.faces.astype(np.int32), 0.1)


CUBE, BALL = model_of(box(0.08, 0.08, 0.08), 1), model_of(ball(0.05), 2)


def at(x: float, y: float, z: float = 0.0) -> np.ndarray:
    return transform(np.eye(3), np.array([x, y, z]))


CROWD = ([CUBE, BALL, CUBE, BALL], [at(0.0, 0.0), at(0.1, 0.0), at(0.0, 0.12), at(-0.1, 0.05)])
CUPBOARD = [
    block("back", (0.5, 0.02, 0.5), (0.0, 0.25, 0.0)),
    block("left", (0.02, 0.5, 0.5), (-0.25, 0.0, 0.0)),
    block("right", (0.02, 0.5, 0.5), (0.25, 0.0, 0.0)),
    block("top", (0.5, 0.5, 0.02), (0.0, 0.0, 0.5)),
]
"""Open to -y."""


@pytest.fixture(scope="module")
def cupboard() -> World:
    return make_world(*CUPBOARD)


def test_every_view_keeps_the_rules_and_its_ranges(cupboard):
    chooser = ViewChooser(cupboard, *CROWD)
    rng = np.random.default_rng(1)
    views = [chooser.choose(CAMERA, RANGES, rng) for _ in range(15)]
    assert max(view.tries for view in views) > 3  # the cupboard is open to one side only
    for view in views:
        eye = view.world_from_camera[:3, 3]
        assert ((eye >= cupboard.room[0]) & (eye <= cupboard.room[1])).all()
        assert cupboard.clearance(eye[None])[0] >= 0.1 - 1e-6
        assert 0.3 <= view.visible_fraction <= 1.0
        centre = CROWD[0][view.focus].vertices
        focus = transform_points(CROWD[1][view.focus], (centre.min(axis=0) + centre.max(axis=0)) / 2)
        found = viewpoints_of(view.world_from_camera[None], focus[None])
        assert 10 - 1e-6 <= found.elevation_deg[0] <= 80 + 1e-6
        assert 0.5 - 1e-6 <= found.distance[0] <= 1 + 1e-6
        np.testing.assert_allclose(transform_points(inverse(view.world_from_camera), focus)[:2], 0, atol=1e-7)


def test_where_nothing_is_in_the_way_views_stay_uniform_and_objects_equally_often():
    chooser = ViewChooser(make_world(), [CUBE, BALL], [at(-0.5, 0.0), at(0.5, 0.0)], ViewRules(min_visible=0.9))
    rng = np.random.default_rng(0)
    ranges = CameraRanges((20.0, 340.0), (10.0, 80.0), (0.8, 1.6), (-90.0, 90.0))
    views = [chooser.choose(CAMERA, ranges, rng) for _ in range(250)]
    assert {view.tries for view in views} == {1}
    assert stats.binomtest(sum(view.focus for view in views), len(views)).pvalue > 0.01
    centres = np.array([(view.focus - 0.5, 0.0, (0.04, BALL.vertices[:, 2].max() / 2)[view.focus]) for view in views])
    found = viewpoints_of(np.array([view.world_from_camera for view in views]), centres)
    for values, (low, high) in zip(found, [(20, 340), (10, 80), (0.8, 1.6), (-90, 90)], strict=True):
        assert stats.kstest(values, "uniform", (low, high - low)).pvalue > 0.01


def test_the_seed_decides_also_after_failed_tries(cupboard):
    def views(seed: int) -> list[View]:
        rng = np.random.default_rng(seed)
        return [choose_view(cupboard, *CROWD, CAMERA, RANGES, rng) for _ in range(3)]

    first, again, other = views(7), views(7), views(8)
    assert sum(view.tries for view in first) > 3
    for one, two in zip(first, again, strict=True):
        assert (one.tries, one.focus, one.visible_fraction) == (two.tries, two.focus, two.visible_fraction)
        np.testing.assert_array_equal(one.world_from_camera, two.world_from_camera)
        np.testing.assert_array_equal(one.rendering.depth, two.rendering.depth)
    assert (first[0].world_from_camera != other[0].world_from_camera).any()


# ---- no view


def no_view(world: World, ranges: CameraRanges, rules: ViewRules, models=None, poses=None) -> NoViewError:
    chooser = ViewChooser(world, models or [CUBE], poses or [at(0.0, 0.0)], rules)
    with pytest.raises(NoViewError) as caught:
        chooser.choose(CAMERA, ranges, np.random.default_rng(0))
    assert isinstance(caught.value, InputError)
    assert sum(caught.value.counts.values()) == rules.max_tries
    assert "\n" not in str(caught.value)
    return caught.value


def test_ranges_beyond_the_walls_are_told():
    error = no_view(make_world(), CameraRanges(distance=(8.0, 9.0)), ViewRules(max_tries=20))
    assert str(error) == (
        "world test room: no view in 20 tries: 20 outside the room; shorten distance (now 8 to 9 m), or change "
        "azimuth_deg (now 0 to 360) and elevation_deg (now 15 to 75)"
    )


def test_cameras_too_near_to_surfaces_are_told():
    low = CameraRanges(elevation_deg=(0.0, 2.0), distance=(0.5, 1.0))
    error = no_view(make_world(), low, ViewRules(max_tries=15))
    assert error.counts == {"nearer than 0.1 m to a surface": 15}
    assert "change distance (now 0.5 to 1 m) and elevation_deg (now 0 to 2), or lower the clearance" in str(error)


def test_objects_take_up_room_too():
    """The camera that looks at the cube, and sees it, would touch the tower, though it is far from all that is static."""
    models, poses = [CUBE, model_of(box(0.2, 0.2, 1.0), 3)], [at(0.0, 0.0), at(0.45, 0.15)]
    ranges = CameraRanges((0.0, 0.0), (45.0, 45.0), (0.6, 0.6))
    rng = np.random.default_rng(0)
    assert choose_view(make_world(), models[:1], poses[:1], CAMERA, ranges, rng).tries == 1
    views = [choose_view(make_world(), models, poses, CAMERA, ranges, rng) for _ in range(8)]
    assert {view.focus for view in views} == {1}
    assert max(view.tries for view in views) > 1


CLOSED = make_world(*CUPBOARD, block("door", (0.5, 0.02, 0.5), (0.0, -0.25, 0.0)))


def test_hidden_objects_are_told():
    error = no_view(CLOSED, CameraRanges(distance=(0.9, 1.2)), ViewRules(max_tries=25))
    assert error.counts == {"with the object hidden": 25}
    assert str(error).endswith("or take another stage")


def test_too_little_visible_is_told_with_the_share_asked_for():
    fence = make_world(*(block("board", (0.05, 0.01, 0.4), (x, -0.2, 0.0)) for x in np.arange(-0.5, 0.5, 0.07)))
    front = CameraRanges((265.0, 275.0), (5.0, 15.0), (0.9, 1.0), (0.0, 0.0))
    error = no_view(fence, front, ViewRules(min_visible=0.8, max_tries=25))
    assert error.counts["with less than 80 % of the object visible"] == 25
    assert str(error).endswith("or lower min_visible")
    assert choose_view(fence, [CUBE], [at(0, 0)], CAMERA, front, np.random.default_rng(0), 0.05).visible_fraction < 0.8


def test_the_most_frequent_reason_comes_first():
    error = no_view(CLOSED, CameraRanges(distance=(0.5, 6.0)), ViewRules(max_tries=100), *CROWD)
    first, second, third = sorted(error.counts.items(), key=lambda item: -item[1])
    assert first[1] > second[1] > third[1]
    assert str(error).startswith(
        f"world test room: no view in 100 tries: {first[1]} {first[0]}, {second[1]} {second[0]}, {third[1]} {third[0]}; "
    )


def test_distractors_hide_but_are_not_looked_at_nor_annotated(cupboard):
    models, poses = CROWD
    chooser = ViewChooser(cupboard, models, poses, focusable=2)
    rng = np.random.default_rng(0)
    views = [chooser.choose(CAMERA, RANGES, rng) for _ in range(12)]
    assert {view.focus for view in views} == {0, 1}
    for view in views:
        assert set(annotate_view(view, models[:2]).objects) <= {0, 1}
        assert view.object_ids.max() >= 2
    with pytest.raises(NoViewError, match="no object to look at"):
        ViewChooser(cupboard, models, poses, focusable=0).choose(CAMERA, RANGES, rng)


def test_without_objects_there_is_no_view(cupboard):
    with pytest.raises(NoViewError, match="there is no object to look at, arrange one"):
        choose_view(cupboard, [], [], CAMERA, RANGES, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"min_visible": 30.0}, "min_visible 30: not a share; give 0 to 1, such as 0.3"),
        ({"clearance": -0.1}, "clearance -0.1: not a distance; give metres, such as 0.1"),
        ({"max_tries": 0}, "max_tries 0: no try at all; give 1 or more"),
    ],
)
def test_rules_that_cannot_be_kept_are_told(values, message):
    with pytest.raises(CameraSettingsError) as caught:
        ViewRules(**values)
    assert str(caught.value) == message


# ---- what a view shows


def brute_force(world: World, view: View, models, poses) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ids in the image (world -1), silhouettes inside it, and sizes of the whole ones: all rays in the world frame."""
    from open3d.core import Tensor
    from open3d.t.geometry import RaycastingScene

    def scene_of(items) -> RaycastingScene:
        scene = RaycastingScene()
        for model, pose in items:
            vertices = transform_points(pose, model.vertices).astype(np.float32)
            scene.add_triangles(Tensor.from_numpy(vertices), Tensor.from_numpy(model.faces.astype(np.uint32)))
        return scene

    h, w = CAMERA.height, CAMERA.width
    v, u = np.mgrid[-h : 2 * h, -w : 2 * w]
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(view.camera.K).T
    rays = rays @ view.world_from_camera[:3, :3].T
    rays = np.concatenate([np.broadcast_to(view.world_from_camera[:3, 3], rays.shape), rays], axis=-1)
    tensor = Tensor.from_numpy(rays.astype(np.float32))
    items = [(world.model, np.eye(4)), *zip(models, poses, strict=True)]
    ids = scene_of(items).cast_rays(tensor)["geometry_ids"].numpy().astype(np.int64)[h : 2 * h, w : 2 * w]
    alone = [np.isfinite(scene_of([item]).cast_rays(tensor)["t_hit"].numpy()) for item in items[1:]]
    inside = np.array([mask[h : 2 * h, w : 2 * w] for mask in alone])
    return np.where(ids > len(models), -1, ids - 1), inside, np.array([mask.sum() for mask in alone])


@pytest.mark.parametrize("seed", range(6))
def test_annotations_agree_with_an_independent_count(cupboard, seed):
    models, poses = CROWD
    near = CameraRanges((230.0, 310.0), (10.0, 60.0), (0.15, 0.8))  # objects reach beyond the image
    rules = ViewRules(clearance=0.02)
    view = ViewChooser(cupboard, models, poses, rules).choose(CAMERA, near, np.random.default_rng(seed))
    found = annotate_view(view, models)
    ids, silhouettes, sizes = brute_force(cupboard, view, models, poses)
    assert (view.object_ids != ids).sum() <= 2  # rays in other frames differ in the last digit of float32
    for i, truth, mask, visible in zip(
        found.objects, found.ground_truth, found.masks, found.visible_masks, strict=True
    ):
        assert truth.obj_id == models[i].obj_id
        assert (mask != silhouettes[i]).sum() <= 2
        assert (visible != (ids == i)).sum() <= 2
        assert truth.visible_pixels == visible.sum()
        assert truth.visible_fraction == pytest.approx((ids == i).sum() / sizes[i], abs=4 / sizes[i])
        np.testing.assert_allclose(truth.camera_from_model, inverse(view.world_from_camera) @ poses[i], atol=1e-8)
    assert [truth.index for truth in found.ground_truth] == list(range(len(found.objects)))
    assert set(range(len(models))) - set(found.objects) == {i for i in range(4) if not silhouettes[i].any()}
    assert view.visible_fraction == found.ground_truth[found.objects.index(view.focus)].visible_fraction


def test_the_quick_count_is_that_of_the_whole_view(cupboard):
    models, poses = CROWD
    rng = np.random.default_rng(3)
    for _ in range(10):
        view = ViewChooser(cupboard, models, poses, ViewRules(0.0, 0.02)).choose(
            CAMERA, CameraRanges((200.0, 340.0), (5.0, 60.0), (0.12, 0.8)), rng
        )
        things = [*zip(models, view.camera_from_models, strict=True), (cupboard.model, view.camera_from_world)]
        assert visible_fraction(things, view.focus, CAMERA) == pytest.approx(view.visible_fraction, abs=0.004)


def test_what_lies_outside_the_image_is_hidden():
    """A camera that looks past a lone ball, so that half of it is in the image."""
    pose = transform(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.array([0.0, -1.0, 0.05]))
    pose[0, 3] = -1.0 * (31.5 + 0.5) / 70.0  # the ball's centre is seen at the right border
    view = render_view(make_world(), [BALL], [at(0, 0)], Camera(CAMERA.K, 64, 48, pose), focus=0)
    assert view.visible_fraction == pytest.approx(0.5, abs=0.04)
    truth = annotate_view(view, [BALL]).ground_truth[0]
    assert truth.visible_fraction == view.visible_fraction


def test_objects_out_of_sight_are_not_annotated_but_hidden_ones_are():
    wall = make_world(block("wall", (1.0, 0.02, 1.0), (0.0, 0.3, 0.0)))
    models, poses = [CUBE, BALL, BALL], [at(0, 0), at(0, 0.6), at(0, -2.5)]
    straight = CameraRanges((270.0, 270.0), (10.0, 10.0), (1.0, 1.0), (0.0, 0.0))
    view = ViewChooser(wall, models[:1], poses[:1]).choose(CAMERA, straight, np.random.default_rng(0))
    found = annotate_view(render_view(wall, models, poses, view.camera, focus=0), models)
    assert found.objects == (0, 1)
    assert found.ground_truth[1].visible_fraction == 0.0
    assert found.masks[1].any()
    assert not found.visible_masks[1].any()


def test_a_dataset_tells_the_very_poses_that_were_rendered(cupboard, tmp_path):
    models, poses = CROWD
    view = ViewChooser(cupboard, models, poses).choose(CAMERA, RANGES, np.random.default_rng(2))
    found = annotate_view(view, models)
    rgb = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    key = ImageKey(1, 0)
    image = Image(key, view.camera, rgb, view.rendering.depth)
    write_scene(
        tmp_path / "made", "test", 1, [AnnotatedImage(image, found.ground_truth, found.masks, found.visible_masks)]
    )
    dataset = open_dataset(tmp_path / "made")
    for truth, read in zip(found.ground_truth, dataset.ground_truth(key), strict=True):
        np.testing.assert_array_equal(read.camera_from_model, truth.camera_from_model)
        assert read.visible_fraction == truth.visible_fraction
        assert read.visible_pixels == truth.visible_pixels
    world = dataset.camera(key).world_from_camera
    assert world is not None
    np.testing.assert_allclose(world, view.world_from_camera, rtol=0, atol=1e-14)
    camera_from_world = inverse(world)
    np.testing.assert_allclose(camera_from_world, camera_from_world.round(10), rtol=0, atol=1e-14)


def test_a_furnished_view_is_rendered_with_the_worlds_geometry():
    from pipeline.synth.worlds import build_world

    world = build_world("cube_room", 0)
    stage = world.stages[0]
    poses = [stage.world_from_stage @ pose for pose in CROWD[1]]
    view = choose_view(world, CROWD[0], poses, CAMERA, RANGES, np.random.default_rng(0))
    assert (view.rendering.depth > 0).all()  # the room is closed
    assert set(np.unique(view.object_ids)) >= {-1, view.focus}
