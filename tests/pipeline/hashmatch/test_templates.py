"""Templates: how many, what they show, and that turning a view is as good as rendering it."""

from dataclasses import replace

import numpy as np
import pytest
from hashmatch_parts import COARSE, part

from pipeline.exceptions import FormatError, InputError
from pipeline.hashmatch import templates
from pipeline.hashmatch.channels import normal_bins
from pipeline.hashmatch.config import TEMPLATE_SIZE, HashMatchConfig
from pipeline.hashmatch.rendered_templates import learn
from pipeline.hashmatch.view_points import normal_points, scattered
from pipeline.hashmatch.viewpoints import in_plane_angles, view_rotations, without_symmetric
from pipeline.hashmatch.views import centroid_of, render_views
from pipeline.scene import Model


@pytest.fixture(scope="module")
def learned() -> templates.Templates:
    return learn(part(), COARSE, 300.0)


def test_the_thesis_has_2916_templates_of_an_object():
    config = HashMatchConfig()
    rotations = view_rotations(config)
    assert len(rotations) * len(in_plane_angles(config)) == 2916
    assert (rotations[:, 2, 2] < 0).all()  # seen from above: looking down the model's z
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (324, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1)
    assert np.rad2deg(in_plane_angles(config)).round().tolist() == [-40, -30, -20, -10, 0, 10, 20, 30, 40]


def test_the_whole_sphere_leaves_no_direction_far_from_a_view():
    config = HashMatchConfig(views="sphere", in_plane="circle")
    views = -view_rotations(config)[:, 2]
    assert 11_000 < len(views) * len(in_plane_angles(config)) < 23_500
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.degrees(np.arccos((directions @ views.T).max(axis=1))).max() < 8


def test_views_that_a_symmetry_makes_alike_are_left_out():
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    model = replace_symmetries(part(), np.stack([np.eye(4), half_turn]))
    rotations = view_rotations(HashMatchConfig())
    assert len(without_symmetric(rotations, part(), 10)) == len(rotations)
    assert len(without_symmetric(rotations, model, 10)) <= len(rotations) // 2


def replace_symmetries(model: Model, symmetries: np.ndarray) -> Model:
    return replace(model, symmetries=symmetries)


def test_every_silhouette_fits_the_window_and_the_nearest_fills_it(learned: templates.Templates):
    assert len(learned) == 108
    margin = np.minimum(learned.boxes[:, :2], TEMPLATE_SIZE - 1 - learned.boxes[:, 2:].astype(int))
    assert margin.min() >= 1
    assert learned.areas.min() > 1000
    radius = np.linalg.norm(part().vertices - centroid_of(part()), axis=1).max()
    seen = 300.0 * radius / np.sqrt(learned.distance**2 - radius**2)
    assert seen == pytest.approx(TEMPLATE_SIZE / 2 - 2)


def test_a_turned_template_shows_what_a_rendering_shows(learned: templates.Templates):
    template = 3 * 5 + 2  # a view turned by 30 degrees
    view = render_views(part(), learned.rotations[[template]].astype(float), learned.distance, 300.0)[0]
    x, y = templates.reference_points(COARSE.grid).T
    stored = templates.stored_distances(view.distance[y, x], learned.distance)
    both = (stored != templates.NO_DISTANCE) & (learned.grid_distances[template] != templates.NO_DISTANCE)
    assert both.sum() > 0.85 * max((stored != templates.NO_DISTANCE).sum(), 1)
    difference = np.abs(stored.astype(int) - learned.grid_distances[template])[both] * templates.DISTANCE_UNIT
    assert np.median(difference) < 0.0015
    agree = normal_bins(view.normals[y, x])[both] == learned.grid_normals[template][both]
    assert agree.mean() > 0.75


def test_points_lie_on_the_object_and_are_spread(learned: templates.Templates):
    view = render_views(part(), learned.rotations[[1]].astype(float), learned.distance, 300.0)[0]  # not turned
    points = learned.normal_points[1, : learned.normal_counts[1]]
    assert len(points) == COARSE.points
    assert (view.depth[points[:, 1], points[:, 0]] > 0).all()
    near = np.abs(points[:, None].astype(int) - points).max(axis=-1) + 99 * np.eye(len(points), dtype=int)
    assert near.min() >= 2
    assert (learned.normal_bits[1, : len(points)] != 0).all()
    assert (learned.gradient_bits[1, : learned.gradient_counts[1]] != 0).all()


def test_unstable_normals_are_not_chosen():
    normals = np.zeros((108, 108, 3), np.float32)
    normals[20:80, 20:80] = (0, 0, -1)
    noise = np.random.default_rng(0).normal(size=(60, 20, 3))
    normals[20:80, 60:80] = noise / np.linalg.norm(noise, axis=-1, keepdims=True)
    points = normal_points(normals, 100)
    assert points[:, 0].max() < 61


def test_scattered_takes_the_first_points_that_are_far_enough():
    line = np.stack([np.arange(20), np.zeros(20, int)], axis=-1)
    assert scattered(line, 5)[:, 0].tolist() == [0, 4, 8, 12, 16]
    assert len(scattered(line[:3], 5)) == 3


def test_15_objects_need_less_than_a_gibibyte(learned: templates.Templates):
    assert learned.nbytes() / len(learned) * 43_740 < 2**30 / 4


def test_the_pose_of_a_template_has_the_centroid_on_the_axis(learned: templates.Templates):
    centroid = centroid_of(part())
    assert learned.pose(7)[:3, :3] @ centroid + learned.pose(7)[:3, 3] == pytest.approx([0, 0, learned.distance])


def test_models_that_cannot_be_rendered_are_refused():
    model = part()
    points = replace(model, faces=np.zeros((0, 3), np.int32))
    with pytest.raises(FormatError, match=r"object 1: its mesh has no faces; .*export a triangle mesh"):
        learn(points, COARSE, 300.0)
    broken = replace(model, vertices=model.vertices * np.nan)
    with pytest.raises(FormatError, match="object 1: its mesh has vertices that are not finite"):
        learn(broken, COARSE, 300.0)
    with pytest.raises(InputError, match=r"its diameter is 0\.0 m; correct models_info\.json"):
        learn(replace(model, diameter=0.0), COARSE, 300.0)


def test_without_colour_templates_say_so():
    config = replace(COARSE, angle_step_deg=90, in_plane_limit_deg=0)
    assert not learn(part(color=None), config, 300.0).colored
    assert learn(part(), config, 300.0).colored
