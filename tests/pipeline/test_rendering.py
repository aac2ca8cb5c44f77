import gc
import weakref
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pipeline import color_rendering, gl_rendering, rendering
from pipeline.bop.dataset import open_dataset
from pipeline.color_rendering import GlError, gl_available, render_color
from pipeline.geometry import inverse, points_from_depth, transform, transform_points
from pipeline.model_cache import convex_hull, per_model
from pipeline.ray_casting import Box, first_hit
from pipeline.rendering import render, render_depths, render_scene
from pipeline.scene import Camera, ImageKey, Model

CAMERA = Camera(np.array([[60.0, 0.0, 23.3], [0.0, 61.0, 17.8], [0.0, 0.0, 1.0]]), width=48, height=36)


def cube(side: float = 0.1, **appearance) -> Model:
    """An axis-aligned cube about the origin, corners outward counter-clockwise."""
    vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * side / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Model(1, vertices, np.array(faces, np.int32), side * 3**0.5, **appearance)


def pebble(seed: int = 0) -> Model:
    """An irregular convex solid some 10 cm across, off-centre, faces turned outward."""
    points = np.random.default_rng(seed).normal(size=(60, 3))
    points *= 0.05 / np.linalg.norm(points, axis=1, keepdims=True)
    faces = ConvexHull(points).simplices.astype(np.int32)
    inward = np.linalg.det(points[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Model(2, points + np.array([0.01, -0.02, 0.03]), faces, 0.1)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.25, angles: tuple[float, ...] = (0.4, -0.7, 1.1)) -> np.ndarray:
    return transform(Rotation.from_euler("xyz", angles).as_matrix(), np.array([x, y, z]))


def sheared(camera_from_model: np.ndarray) -> np.ndarray:
    """The pose with a rotation that is as far from orthonormal as LM-O's are."""
    result = camera_from_model.copy()
    result[:3, :3] += 9e-3 * np.array([[1, -0.5, 0.2], [0.3, -1, 0.6], [0.1, 0.8, 1]])
    return result


def meet_every_ray_with_every_face(model: Model, camera: Camera, camera_from_model: np.ndarray, pixel_center: float):
    """Depth by writing each pixel's ray as a sum of the corners of each face: it meets the face if no weight is negative."""
    corners = transform_points(camera_from_model, model.vertices)[model.faces]
    v, u = np.indices((camera.height, camera.width)) + pixel_center
    rays = np.linalg.inv(camera.K) @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    weights = np.linalg.inv(corners.transpose(0, 2, 1)) @ rays
    z = 1 / weights.sum(axis=1)
    z[(weights < 0).any(axis=1)] = np.inf
    depth = z.min(axis=0).reshape(u.shape)
    return np.where(np.isfinite(depth), depth, 0)


@pytest.mark.parametrize("pixel_center", [0.0, 0.5])
def test_depth_is_that_of_every_ray_met_with_every_face(pixel_center: float):
    for model, camera_from_model in ((cube(), pose()), (pebble(), sheared(pose(0.02, -0.03)))):
        expected = meet_every_ray_with_every_face(model, CAMERA, camera_from_model, pixel_center)
        depth = render(model, CAMERA, camera_from_model, pixel_center).depth
        assert depth.dtype == np.float32
        assert (expected > 0).sum() > 250
        np.testing.assert_allclose(depth, expected, atol=1e-6)


def test_sampling_at_pixel_centres_is_a_shift_of_the_principal_point():
    shifted = Camera(CAMERA.K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]], CAMERA.width, CAMERA.height)
    at_half = render(pebble(), CAMERA, pose(), pixel_center=0.5).depth
    np.testing.assert_allclose(at_half, render(pebble(), shifted, pose(), pixel_center=0.0).depth, atol=1e-6)


def test_the_crop_lies_where_the_object_is_and_is_not_much_larger():
    rendering_ = render(cube(), CAMERA, pose(0.03, 0.02))
    rows, columns = np.nonzero(rendering_.mask)
    assert rendering_.depth_crop.shape == rendering_.box.shape
    assert 0 <= columns.min() - rendering_.box.x0 <= 2
    assert 0 <= rendering_.box.x1 - 1 - columns.max() <= 2
    assert 0 <= rows.min() - rendering_.box.y0 <= 2
    assert 0 <= rendering_.box.y1 - 1 - rows.max() <= 2


def test_expand_puts_a_crop_into_an_image_of_the_fill():
    rendering_ = render(cube(), CAMERA, pose())
    image = rendering_.expand(np.full(rendering_.box.shape, 7.0), fill=np.nan)
    assert image.shape == (36, 48)
    assert np.nansum(image == 7) == rendering_.box.area
    assert np.isnan(image).sum() == image.size - rendering_.box.area


@pytest.mark.parametrize(
    "camera_from_model",
    [
        pose(z=-0.3),
        pose(x=2.0),
        pose(y=-2.0),
        np.full((4, 4), np.nan),
        transform(np.zeros((3, 3)), np.array([0, 0, 1.0])),
        transform(np.eye(3), np.array([0, 0, np.inf])),
    ],
    ids=["behind the camera", "right of the image", "above the image", "NaN", "singular", "infinitely far"],
)
def test_what_cannot_be_seen_renders_as_nothing(camera_from_model: np.ndarray):
    rendering_ = render(cube(), CAMERA, camera_from_model, with_surface=True)
    assert rendering_.box == Box(0, 0, 0, 0)
    assert rendering_.depth.shape == (36, 48)
    assert not rendering_.depth.any()
    assert not rendering_.mask.any()


def test_an_object_cut_by_the_image_border_fills_it_up_to_the_border():
    mask = render(cube(), CAMERA, pose(x=0.1, angles=(0, 0, 0))).mask
    assert mask[18, -1]
    assert not mask[18, 0]


def test_an_object_that_reaches_behind_the_camera_is_seen_where_it_is_before_it():
    slab = Model(1, cube().vertices * [2, 2, 20], cube().faces, 2.1)  # from z = -0.5 to 1.5, the camera inside
    depth = render(slab, CAMERA, transform(np.eye(3), np.array([0.0, 0.0, 0.5])), pixel_center=0.0).depth
    assert (depth > 0).all()
    assert depth[17, 23] == pytest.approx(1.5, rel=1e-5)  # the far end
    assert depth[17, 0] == pytest.approx(0.1 * 60 / 23.3, rel=1e-5)  # the left wall, at x = -0.1


def test_many_poses_at_once_are_each_pose_alone(monkeypatch: pytest.MonkeyPatch):
    poses = np.stack([pose(), pose(z=-1.0), sheared(pose(0.03)), pose(z=0.5), np.full((4, 4), np.nan)])
    alone = [render(pebble(), CAMERA, one).depth for one in poses]
    np.testing.assert_array_equal([r.depth for r in render_depths(pebble(), CAMERA, poses)], alone)
    monkeypatch.setattr(rendering, "MAX_RAYS", 500)  # now in several batches
    np.testing.assert_array_equal([r.depth for r in render_depths(pebble(), CAMERA, poses)], alone)


def test_no_poses_give_no_renderings():
    assert render_depths(cube(), CAMERA, np.empty((0, 4, 4))) == []
    scene = render_scene([], CAMERA)
    assert not scene.depth.any()
    assert (scene.instance_ids == -1).all()


def test_the_surface_names_the_point_of_the_model_that_each_pixel_shows():
    model, camera_from_model = pebble(), sheared(pose())
    rendering_ = render(model, CAMERA, camera_from_model, pixel_center=0.0, with_surface=True)
    surface = rendering_.surface
    assert surface is not None
    np.testing.assert_array_equal(surface.face_ids >= 0, rendering_.mask_crop)
    b, c = surface.barycentric[rendering_.mask_crop].T
    corners = model.vertices[model.faces[surface.face_ids[rendering_.mask_crop]]]
    points = np.einsum("nk,nkc->nc", np.stack([1 - b - c, b, c], axis=1), corners)
    points_in_camera, _ = points_from_depth(CAMERA.K, rendering_.depth)
    np.testing.assert_allclose(points, transform_points(inverse(camera_from_model), points_in_camera), atol=1e-6)
    edges = corners[:, 1] - corners[:, 0]
    normals = surface.normals[rendering_.mask_crop]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(np.einsum("nc,nc->n", normals, edges), 0, atol=1e-6)


def test_a_single_ray_meets_the_model_where_the_rendering_does():
    depth = render(pebble(), CAMERA, sheared(pose()), pixel_center=0.0).depth
    row, column = np.argwhere(depth > 0)[40]
    ray = np.linalg.inv(CAMERA.K) @ [column, row, 1.0]
    assert first_hit(pebble(), sheared(pose()), np.zeros(3), ray) == pytest.approx(depth[row, column], abs=1e-6)
    assert first_hit(pebble(), sheared(pose()), np.zeros(3), -ray) is None
    assert first_hit(pebble(), np.full((4, 4), np.nan), np.zeros(3), ray) is None


def test_in_a_scene_the_nearer_object_is_seen_and_each_keeps_its_own_silhouette():
    model, other = cube(), pebble()
    scene = render_scene([(model, pose(z=0.4)), (other, pose(0.03, z=0.3)), (model, pose(-0.1, z=0.5))], CAMERA)
    alone = [render(m, CAMERA, p).depth for m, p in ((model, pose(z=0.4)), (other, pose(0.03, z=0.3)))]
    both = (alone[0] > 0) & (alone[1] > 0)
    assert both.sum() > 50
    np.testing.assert_array_equal(scene.instance_ids[both], np.where(alone[0] < alone[1], 0, 1)[both])
    np.testing.assert_array_equal(scene.depth[both], np.minimum(*alone)[both])
    np.testing.assert_array_equal(scene.instance_ids >= 0, scene.depth > 0)
    np.testing.assert_array_equal(scene.renderings[0].depth, alone[0])
    assert (scene.instance_ids == 2).any()


def test_threads_that_meet_a_model_for_the_first_time_together_see_the_same():
    model, expected = pebble(5), render(pebble(5), CAMERA, pose()).depth
    with ThreadPoolExecutor(8) as pool:
        for rendering_ in pool.map(lambda _: render(model, CAMERA, pose()), range(32)):
            np.testing.assert_array_equal(rendering_.depth, expected)


def test_what_is_kept_per_model_is_built_once_and_goes_with_the_model():
    built = []
    remember = per_model(lambda model: built.append(model.obj_id) or np.zeros(3))
    model = cube()
    assert remember(model) is remember(model)
    assert built == [1]
    kept, seen = weakref.ref(remember(model)), weakref.ref(model)
    del model
    gc.collect()
    assert seen() is None
    assert kept() is None


def test_the_hull_of_a_flat_model_is_all_its_vertices():
    flat = Model(
        1, np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, 0]], float), np.array([[0, 1, 2]], np.int32), 1.4
    )
    assert convex_hull(flat).tolist() == [0, 1, 2, 3]
    assert convex_hull(cube()).tolist() == list(range(8))


def median_difference_mm(root: Path, key: ImageKey) -> dict[int, float]:
    """Per object, of the pixels where it is not hidden, how far rendered and measured depth are apart."""
    dataset = open_dataset(root)
    depth, medians = dataset.depth(key), {}
    assert depth is not None
    for gt in dataset.ground_truth(key):
        rendered = render(dataset.model(gt.obj_id), dataset.camera(key), gt.camera_from_model, pixel_center=0.0).depth
        off = np.abs(rendered - depth)[(rendered > 0) & (depth > 0)]
        medians[gt.obj_id] = float(np.median(off[off < 0.03])) * 1000
    return medians


def test_lmo_models_lie_on_the_measured_depth(lmo: Path):
    medians = median_difference_mm(lmo, ImageKey(2, 3))
    assert set(medians) == {1, 5, 6, 8, 9, 10, 11, 12}
    assert all(2.0 < median < 6.5 for median in medians.values()), medians


def test_ycbv_models_lie_on_the_measured_depth(ycbv: Path):
    medians = median_difference_mm(ycbv, ImageKey(1, 1))
    assert medians
    assert all(median < 1.7 for median in medians.values()), medians


# ---- colour


def textured_square() -> Model:
    """A square before the camera: texture red at upper left, green at upper right, blue at lower left, white else."""
    texture = np.full((64, 64, 3), 255, np.uint8)
    texture[:32, :32], texture[:32, 32:], texture[32:, :32] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.05  # camera axes: the first is upper left
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], float)
    return Model(1, vertices, np.array([[0, 2, 1], [0, 3, 2]], np.int32), 0.14, texture=texture, texture_uv=uv)


@pytest.fixture(params=["gl", "raycast"])
def backend(request: pytest.FixtureRequest) -> str:
    if request.param == "gl" and not gl_available():
        pytest.skip("no OpenGL through EGL here")
    return request.param


def test_a_texture_is_the_right_way_up(backend: color_rendering.Backend):
    rgb, mask = render_color(textured_square(), CAMERA, pose(angles=(0, 0, 0)), backend=backend)
    u, v = 23, 18
    for (column, row), strongest in {(-6, -6): [0], (6, -6): [1], (-6, 6): [2], (6, 6): [0, 1, 2]}.items():
        color = rgb[v + row, u + column].astype(int)
        assert mask[v + row, u + column]
        assert [k for k in range(3) if color[k] > color.max() - 20] == strongest, color


def test_vertex_colours_go_before_texture_and_shade_over_the_face(backend: color_rendering.Backend):
    square = textured_square()
    colors = np.array([[200, 30, 30], [30, 200, 30], [30, 200, 30], [200, 30, 30]], np.uint8)
    colored = Model(
        1, square.vertices, square.faces, 0.1, colors=colors, texture=square.texture, texture_uv=square.texture_uv
    )
    rgb, _ = render_color(colored, CAMERA, pose(angles=(0, 0, 0)), backend=backend)
    red, green, blue = rgb[18].astype(int).T
    assert red[13] > green[13] + 50
    assert green[33] > red[33] + 50
    assert abs(red[23] - green[23]) < 30
    assert blue[23] < 60


def test_a_model_without_colour_is_gray_and_lit(backend: color_rendering.Backend):
    rgb, mask = render_color(cube(), CAMERA, pose(), backend=backend)
    assert rgb.dtype == np.uint8
    assert (rgb[~mask] == 0).all()
    gray = rgb[mask].astype(int)
    assert np.ptp(gray, axis=1).max() <= 1
    assert 60 < gray.mean() < 230
    assert len({int(value) // 4 for value in gray[:, 0]}) >= 3  # the three faces in sight differ


def test_the_silhouette_is_that_of_the_depth_rendering_for_overlays(backend: color_rendering.Backend):
    mask = render_color(pebble(), CAMERA, sheared(pose()), backend=backend).mask
    expected = render(pebble(), CAMERA, sheared(pose()), pixel_center=0.0).mask
    assert (mask ^ expected).sum() < 0.03 * expected.sum()  # GL samples the edges in another way
    rows, columns = np.nonzero(mask)
    expected_rows, expected_columns = np.nonzero(expected)
    assert abs(rows.mean() - expected_rows.mean()) < 0.15
    assert abs(columns.mean() - expected_columns.mean()) < 0.15


def test_gl_and_ray_casting_paint_alike():
    if not gl_available():
        pytest.skip("no OpenGL through EGL here")
    gl, cast = (render_color(pebble(), CAMERA, pose(), backend=backend) for backend in ("gl", "raycast"))
    both = gl.mask & cast.mask
    assert np.abs(gl.rgb[both].astype(int) - cast.rgb[both]).mean() < 12


@pytest.mark.parametrize(
    "camera_from_model",
    [pose(z=-1.0), np.full((4, 4), np.nan), transform(np.zeros((3, 3)), np.array([0, 0, 1.0]))],
    ids=["behind", "NaN", "singular"],
)
def test_a_colour_picture_of_nothing_is_black(backend: color_rendering.Backend, camera_from_model: np.ndarray):
    rgb, mask = render_color(cube(), CAMERA, camera_from_model, backend=backend)
    assert not rgb.any()
    assert not mask.any()
    assert rgb.shape == (36, 48, 3)


def test_pictures_of_different_sizes_may_follow_each_other(backend: color_rendering.Backend):
    doubled = Camera(CAMERA.K * [[2], [2], [1]], 96, 72)
    sizes = [render_color(cube(), camera, pose(), backend=backend).mask.sum() for camera in (CAMERA, doubled, CAMERA)]
    assert sizes[0] == sizes[2]
    assert sizes[1] == pytest.approx(4 * sizes[0], rel=0.05)


def test_threads_may_draw_at_the_same_time():
    expected = render_color(pebble(), CAMERA, pose()).rgb
    with ThreadPoolExecutor(4) as pool:
        for picture in pool.map(lambda _: render_color(pebble(), CAMERA, pose()), range(8)):
            np.testing.assert_array_equal(picture.rgb, expected)


def test_without_gl_pictures_are_ray_cast_and_demanding_gl_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    tried = []
    monkeypatch.setattr(gl_rendering, "_try_in_child", lambda: bool(tried.append(1)))
    monkeypatch.setattr(color_rendering, "GL", gl_rendering.GlThread())
    assert not gl_available()
    picture = render_color(cube(), CAMERA, pose())
    np.testing.assert_array_equal(picture.rgb, render_color(cube(), CAMERA, pose(), backend="raycast").rgb)
    with pytest.raises(GlError, match="no OpenGL through EGL on this machine; install libegl1"):
        render_color(cube(), CAMERA, pose(), backend="gl")
    assert len(tried) == 1


def test_gl_that_fails_or_hangs_while_drawing_is_given_up(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gl_rendering, "_try_in_child", lambda: True)
    monkeypatch.setattr(gl_rendering, "PICTURE_SECONDS", 0.05)
    for failure in (lambda *_: 1 / 0, lambda *_: __import__("threading").Event().wait()):
        monkeypatch.setattr(color_rendering, "GL", gl_rendering.GlThread())
        monkeypatch.setattr(color_rendering, "draw", failure)
        assert render_color(cube(), CAMERA, pose()).mask.any()
        assert not gl_available()


def test_a_trial_that_crashes_or_hangs_means_no_gl(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    for script in ("kill -SEGV $$", "sleep 60"):
        fake = tmp_path / "python"
        fake.write_text(f"#!/bin/sh\n{script}\n")
        fake.chmod(0o755)
        monkeypatch.setattr(gl_rendering.sys, "executable", str(fake))
        monkeypatch.setattr(gl_rendering, "TRIAL_SECONDS", 0.2)
        assert not gl_rendering._try_in_child()
