"""The turntable: the world frame is the board's at every turn, rays agree with the board, rendered markers are found."""

from functools import cache

import numpy as np
import pytest

from pipeline.exceptions import InputError
from pipeline.geometry import inverse, project, rotation_error, transform_points
from pipeline.rendering import render_scene
from pipeline.scene import Camera
from pipeline.synth.boards import (
    TLESS_TEST,
    TLESS_TRAINING,
    BoardScene,
    board_scene,
    board_sequence,
    board_world,
    camera_pose,
    detect,
    framed_board,
    grid_board,
    turntable_views,
)
from pipeline.synth.worlds import surfaces
from pipeline.synth.worlds.layout import frame
from pipeline.synth.worlds.world import AreaLight

BOARD = framed_board()
CAMERA = Camera(np.array([[380.0, 0, 199.5], [0, 380.0, 149.5], [0, 0, 1.0]]), 400, 300)


@cache
def scene_of(seed: int = 0, with_screen: bool = False) -> BoardScene:
    """A scene with coarse textures, which are most of the work."""
    full, surfaces.SIZE = surfaces.SIZE, 64
    try:
        return board_scene(BOARD, seed, with_screen=with_screen)
    finally:
        surfaces.SIZE = full


def test_the_room_turns_about_the_board_and_the_board_stays():
    still, turned = scene_of().world(0.0), scene_of().world(90.0)
    quarter_back = frame(turn_deg=-90.0)
    for before, after in zip(still.pieces, turned.pieces, strict=True):
        moves = before.name not in ("marker board", "markers", "board middle", "turntable disc", "turntable marks")
        expected = transform_points(quarter_back, before.vertices) if moves else before.vertices
        np.testing.assert_allclose(after.vertices, expected, atol=1e-9)
    for before, after in zip(still.lights, turned.lights, strict=True):
        assert isinstance(before, AreaLight)
        assert isinstance(after, AreaLight)
        np.testing.assert_allclose(after.centre, transform_points(quarter_back, np.array(before.centre)), atol=1e-9)
        np.testing.assert_allclose(after.half_u, quarter_back[:3, :3] @ before.half_u, atol=1e-9)


def test_the_camera_stays_where_it_is_in_the_room():
    views = turntable_views([0, 35, 200], [30, 60], 0.7, (0.0, 0.0, 0.05))
    assert len(views) == 6
    for view in views:
        a, e = np.radians(view.azimuth_deg), np.radians(view.elevation_deg)
        outward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        np.testing.assert_allclose(view.board_from_camera[:3, 3], np.array([0, 0, 0.05]) + 0.7 * outward, atol=1e-12)
        in_room = frame(turn_deg=view.turn_deg) @ view.board_from_camera
        np.testing.assert_allclose(in_room[:3, 3], (0, -0.7 * np.cos(e), 0.05 + 0.7 * np.sin(e)), atol=1e-12)
        np.testing.assert_allclose(in_room[:3, 0], (1, 0, 0), atol=1e-12)  # level
        seen = project(CAMERA.K, transform_points(inverse(view.board_from_camera), np.array([0, 0, 0.05])))
        np.testing.assert_allclose(seen, (199.5, 149.5), atol=1e-9)


def test_the_views_of_tless_are_as_many_as_in_the_thesis():
    assert len(turntable_views(*TLESS_TRAINING, 0.7)) == 1296 // 2  # the upper hemisphere
    assert len(turntable_views(*TLESS_TEST, 0.7)) == 504
    with pytest.raises(InputError, match=r"elevations \[-5\] degrees and 0.7 m: take 0 to 90 degrees"):
        turntable_views([0], [-5], 0.7)


@pytest.mark.parametrize("turn_deg", [0.0, 33.0])
def test_rays_meet_the_markers_where_the_board_says(turn_deg):
    world = scene_of().world(turn_deg)
    for view in turntable_views([-90 - turn_deg], [20, 55], 0.7):
        camera_from_board = inverse(view.board_from_camera)
        depth = render_scene([(world.model, camera_from_board)], CAMERA, pixel_center=0.0).depth.astype(float)
        checked = 0
        for marker_id in BOARD.ids:
            corners = BOARD.corners(marker_id)
            centre = corners.mean(axis=0)
            normal = np.cross(corners[3] - corners[0], corners[1] - corners[0])
            normal /= np.linalg.norm(normal)
            in_camera = transform_points(camera_from_board, 0.98 * corners + 0.02 * centre)
            if normal @ (view.board_from_camera[:3, 3] - centre) <= 0.05:
                continue
            pixels = np.rint(project(CAMERA.K, in_camera)).astype(int)
            inside = ((pixels >= 0) & (pixels < (400, 300))).all(axis=1)
            for u, v in pixels[inside]:
                ray = view.board_from_camera[:3, :3] @ np.linalg.inv(CAMERA.K) @ (u, v, 1.0)
                expected = normal @ (centre - view.board_from_camera[:3, 3]) / (normal @ ray)
                if abs(depth[v, u] - expected) > 0.02:
                    continue  # the pixel's centre is beside the block
                assert abs(depth[v, u] - expected) * abs(ray @ normal) < 1e-4
                checked += 1
        assert checked > 100


def test_the_stage_is_the_free_middle_supported_and_free():
    from open3d.core import Tensor

    from pipeline.ray_casting import _raycaster

    world = scene_of().world(20.0)
    (stage,) = world.stages
    np.testing.assert_array_equal(stage.world_from_stage, np.eye(4))
    assert np.ptp(stage.polygon, axis=0) == pytest.approx(BOARD.free)
    for marker_id in BOARD.ids:
        assert not stage.contains(BOARD.corners(marker_id)[:, :2], margin=-0.005).any()
    points = stage.sample(np.random.default_rng(0), 100)
    for direction, least, most in (((0, 0, -1.0), 0.0099, 0.0101), ((0, 0, 1.0), 1.2, 9.0)):
        rays = np.c_[points, np.full(100, 0.01), np.tile(direction, (100, 1))].astype(np.float32)
        far = _raycaster(world.model).cast_rays(Tensor.from_numpy(rays))["t_hit"].numpy()
        assert far.min() > least
        assert far.max() < most
    hulls = world.hulls_near(stage)
    assert any(abs(hull[:, 2].max()) < 1e-9 for hull in hulls)  # the block
    assert min(hull[:, 2].min() for hull in hulls) < -0.7  # down to the floor


def test_the_turntable_stands_on_the_table_and_the_board_on_the_turntable():
    pieces = {piece.name: piece for piece in scene_of().world().pieces}
    low = {name: piece.vertices[:, 2].min() for name, piece in pieces.items()}
    high = {name: piece.vertices[:, 2].max() for name, piece in pieces.items()}
    assert low["turntable base"] == pytest.approx(high["table top"], abs=1e-6)
    assert low["turntable disc"] == pytest.approx(high["turntable base"], abs=1e-6)
    assert low["marker board"] == pytest.approx(high["turntable disc"], abs=1e-4)
    assert high["marker board"] == pytest.approx(0.0, abs=1e-4)


def test_cameras_of_a_sequence_have_room_and_share_a_world_per_turn():
    turns = list(board_sequence(scene_of(), CAMERA, [0, 120], [10, 85], 0.75))
    assert [len(turn.cameras) for turn in turns] == [2, 2]
    assert turns[0].world is not turns[1].world
    for turn in turns:
        eyes = np.stack([camera.world_from_camera[:3, 3] for camera in turn.cameras])
        assert turn.world.clearance(eyes).min() > 0.1
        assert (eyes > turn.world.room[0]).all()
        assert (eyes < turn.world.room[1]).all()
        for camera, view in zip(turn.cameras, turn.views, strict=True):
            np.testing.assert_array_equal(camera.world_from_camera, view.board_from_camera)
            np.testing.assert_array_equal(camera.K, CAMERA.K)


def test_the_seed_decides_and_the_screen_hides_the_room():
    full, surfaces.SIZE = surfaces.SIZE, 64
    try:
        again, other = board_world(BOARD, 0, 15.0), board_world(BOARD, 1, 15.0)
    finally:
        surfaces.SIZE = full
    world = scene_of().world(15.0)
    np.testing.assert_array_equal(world.model.vertices, again.model.vertices)
    assert world.lights != other.lights
    camera_from_board = inverse(turntable_views([-90], [15], 0.7)[0].board_from_camera)
    for with_screen, farthest in ((False, 1.5), (True, 1.3)):
        model = scene_of(0, with_screen).world().model
        depth = render_scene([(model, camera_from_board)], CAMERA, pixel_center=0.0).depth
        assert (depth[:100].max() > farthest) is not with_screen


def test_a_board_without_a_free_middle_is_a_stage_as_a_whole(monkeypatch):
    monkeypatch.setattr(surfaces, "SIZE", 64)
    world = board_world(grid_board(7, 5, 0.04, 0.01, 0.01))
    (stage,) = world.stages
    assert np.ptp(stage.polygon, axis=0) == pytest.approx((7 * 0.05 + 0.01, 5 * 0.05 + 0.01))
    assert "board middle" not in {piece.name for piece in world.pieces}


def test_a_board_that_is_too_large_for_the_table_is_refused():
    with pytest.raises(
        InputError, match=r"marker board of 1.02 x 1.02 m is too large for the table; take one of at most"
    ):
        board_scene(framed_board(marker_side=0.1, gap=0.025, margin=0.025))


def test_markers_of_a_rendered_image_give_the_camera_back():
    pytest.importorskip("mitsuba")
    pytest.importorskip("mitsuba_oidn")
    from pipeline.synth.tracing.path_tracer import PathTracer

    (turn,) = board_sequence(scene_of(), CAMERA, [-60], [50], 0.7)
    (camera,) = turn.cameras
    camera_from_board = inverse(camera.world_from_camera)
    seen = detect(PathTracer(turn.world, []).render(camera, camera_from_board, "low"), BOARD)
    assert len(seen.ids) > 30
    found = camera_pose(seen, BOARD, camera)
    assert found.errors_px.mean() < 0.25
    off = seen.pixels - np.stack(
        [project(camera.K, transform_points(camera_from_board, BOARD.corners(k))) for k in seen.ids]
    )
    assert np.abs(off.mean(axis=(0, 1))).max() < 0.06  # no half pixel between image and projection
    error = found.camera_from_board @ camera.world_from_camera
    assert np.linalg.norm(error[:3, 3]) < 0.001
    assert np.degrees(rotation_error(error[:3, :3], np.eye(3))) < 0.08
