"""The path tracer: exact projection, silhouettes as the ray caster's, determinism, presets, models of all kinds."""

import os
import subprocess
import sys

import numpy as np
import pytest

from pipeline.exceptions import InputError, UnknownIdError
from pipeline.geometry import inverse, transform, unproject
from pipeline.rendering import render_scene
from pipeline.scene import Camera, Model
from pipeline.synth.cameras import Viewpoint, world_from_camera
from pipeline.synth.materials import LAMBERTIAN, Material, Texture, linear, random_material
from pipeline.synth.tracing.path_tracer import PRESETS, PathTracer, Preset, preset_of, render
from pipeline.synth.worlds.rooms import light
from pipeline.synth.worlds.shapes import ball, box
from pipeline.synth.worlds.world import AreaLight, PointLight, Sky, World

pytest.importorskip("mitsuba")
pytest.importorskip("mitsuba_oidn")

from pipeline.synth.tracing import mitsuba_scene
from pipeline.synth.tracing.mitsuba_variant import is_scalar, mitsuba

RAW = Preset(4, 1, denoised=False)


@pytest.fixture(scope="module")
def world() -> World:
    """A table top under a lamp and a sky."""
    pieces = (box(1.2, 1.2, 0.1).moved(z=-0.1).piece("table", Material(linear(120), roughness=0.8)),)
    lamp = AreaLight((0.0, 0.0, 1.5), (0.3, 0.0, 0.0), (0.0, -0.3, 0.0), light(5000, 10.0))
    room = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.4]])
    return World("table", 0, pieces, (lamp, Sky((0.3, 0.3, 0.3))), (), room)


def model_of(shape, obj_id: int = 1, **look) -> Model:
    return Model(obj_id, shape.vertices, shape.faces.astype(np.int32), 0.1, **look)


def camera(width: int = 64, height: int = 48, **K) -> Camera:
    fx, fy = K.get("fx", 1.1 * width), K.get("fy", 1.1 * width)
    matrix = np.array([[fx, 0, K.get("cx", width / 2 - 0.5)], [0, fy, K.get("cy", height / 2 - 0.5)], [0, 0, 1.0]])
    return Camera(matrix, width, height)


def view(eye: tuple[float, float, float] = (0.3, -0.5, 0.4), roll: float = 0.2) -> np.ndarray:
    focus = np.array([0.0, 0.0, 0.03])
    x, y, z = eye - focus
    distance, azimuth = np.sqrt(x**2 + y**2 + z**2), np.degrees(np.arctan2(y, x))
    seen_from = Viewpoint(azimuth, np.degrees(np.arcsin(z / distance)), distance, np.degrees(roll))
    return inverse(world_from_camera(seen_from, focus))


@pytest.mark.parametrize(
    "K",
    [
        {},
        {"cx": 20.3, "cy": 31.7},
        {"fx": 70.0, "fy": 83.0},
        {"fx": 171.2, "fy": 150.1, "cx": 40.9, "cy": 8.2},
    ],
)
def test_rays_go_through_the_projections_of_points(K):
    seen = camera(**K)
    sensor = mitsuba_scene.sensor(seen, view(), "independent", 1, jitter=True)
    mi = mitsuba()
    for u, v in ((0.0, 0.0), (63.0, 47.0), (10.4, 33.3), (50.0, 5.5)):
        place = mi.Point2f((u + 0.5) / 64, (v + 0.5) / 48)
        ray, _ = sensor.sample_ray_differential(0.0, 0.0, place, mi.Point2f(0.5, 0.5))
        origin, direction = (np.array(vector).ravel() for vector in (ray.o, ray.d))
        in_camera = view()[:3, :3] @ direction
        expected = unproject(seen.K, np.array([u, v]), np.array(1.0))
        error_px = (in_camera / in_camera[2] - expected)[:2] * seen.K[[0, 1], [0, 1]]
        assert np.abs(error_px).max() < 0.01
        np.testing.assert_allclose(origin, inverse(view())[:3, 3], atol=0.02)  # begins at the near plane


@pytest.mark.parametrize("K", [{"fx": 290.0, "fy": 310.0, "cx": 70.2, "cy": 66.9}, {}])
def test_object_ids_are_the_ray_casters_silhouettes(world, K):
    shapes = [ball(0.06), box(0.1, 0.06, 0.08, 0.01), ball(0.03, 1.6)]
    poses = [transform(np.eye(3), np.array(at)) for at in ((0.0, 0, 0), (0.08, 0.02, 0.0), (-0.05, -0.1, 0.05))]
    objects = [(model_of(s, k), LAMBERTIAN, pose) for k, (s, pose) in enumerate(zip(shapes, poses, strict=True))]
    seen = camera(160, 120, **K)
    ids = PathTracer(world, objects).object_ids(seen, view())
    everything = [(world.model, view()), *((model, view() @ pose) for model, _, pose in objects)]
    expected = np.maximum(render_scene(everything, seen, pixel_center=0.0).instance_ids - 1, -1)
    assert set(np.unique(expected)) == {-1, 0, 1, 2}
    assert (ids != expected).sum() <= 2


def test_ids_stay_right_when_several_scenes_live(world):
    first = PathTracer(world, [(model_of(ball(0.05)), LAMBERTIAN, np.eye(4))])
    second = PathTracer(world, [(model_of(ball(0.05)), LAMBERTIAN, np.eye(4))] * 2)
    assert set(np.unique(first.object_ids(camera(), view()))) == {-1, 0}
    assert second.object_ids(camera(), view()).max() in (0, 1)
    assert PathTracer(world, []).object_ids(camera(), view()).max() == -1


def test_the_colour_image_shows_the_object_where_the_ids_do(world):
    """Red ball on gray: its colour and its id cover the same pixels, but for those on the outline."""
    red = Material((0.8, 0.02, 0.02), roughness=1.0, specular=0.0)
    tracer = PathTracer(world, [(model_of(ball(0.08)), red, np.eye(4))])
    seen = camera(96, 72, fx=140.0, fy=120.0, cx=30.0, cy=41.0)
    albedo, _ = tracer.guides(seen, view(), 16)  # the table about the ball is reddened by it, but not its albedo
    colored = albedo[..., 0] - albedo[..., 1] > 0.39
    masked = tracer.object_ids(seen, view()) == 0
    rows, columns = np.indices(masked.shape)
    for axis in (rows, columns):
        assert abs(axis[colored].mean() - axis[masked].mean()) < 0.15
    assert abs(colored.sum() / masked.sum() - 1) < 0.05


def test_the_same_seed_gives_the_same_image(world):
    objects = [(model_of(ball(0.05)), Material(roughness=0.3), np.eye(4))]
    images = [render(world, objects, camera(), view(), Preset(4, 2), seed) for seed in (3, 3, 4)]
    assert images[0].dtype == np.uint8
    assert images[0].shape == (48, 64, 3)
    assert (images[0] == images[1]).all()
    assert (images[0] != images[2]).any()


def test_denoising_brings_few_samples_nearer_to_many(world):
    tracer = PathTracer(world, [(model_of(ball(0.08)), Material((0.2, 0.5, 0.3)), np.eye(4))])
    many = tracer.radiance(camera(), view(), Preset(256, 2, denoised=False))
    noisy = tracer.radiance(camera(), view(), Preset(4, 2, denoised=False))
    clean = tracer.radiance(camera(), view(), Preset(4, 2))
    assert np.abs(clean - many).mean() < 0.6 * np.abs(noisy - many).mean()
    assert abs(clean.mean() / many.mean() - 1) < 0.05


def test_presets_grow_as_in_the_table():
    assert set(PRESETS) == {"low", "medium", "high", "bop20"}
    low, medium, high = (PRESETS[name] for name in ("low", "medium", "high"))
    assert low.samples_per_pixel < medium.samples_per_pixel == 9 * 4 < high.samples_per_pixel == 25 * 9
    assert low.max_reflections < medium.max_reflections < high.max_reflections
    assert preset_of("bop20").max_reflections == 3
    assert preset_of(RAW) is RAW


def test_an_unknown_preset_is_told_with_those_there_are():
    with pytest.raises(
        UnknownIdError, match=r"quality ultra is not in the presets; available: bop20, high, low, medium"
    ):
        preset_of("ultra")


def test_cameras_that_cannot_be_traced_are_told(world):
    tracer = PathTracer(world, [])
    skewed = camera()
    skewed.K[0, 1] = 3.0
    with pytest.raises(InputError, match="skew 3 cannot be ray traced"):
        tracer.render(skewed, view(), RAW)
    scaled = view()
    scaled[:3, :3] *= 1.1
    with pytest.raises(InputError, match="orthonormalize"):
        tracer.render(camera(), scaled, RAW)


# ---- models of all kinds


def mean_color(world: World, model: Model, material: Material, eye=(0.02, -0.05, 0.6)) -> np.ndarray:
    """Mean radiance of the pixels that show the model, seen from above."""
    tracer = PathTracer(world, [(model, material, np.eye(4))])
    radiance = tracer.radiance(camera(), view(eye), Preset(16, 1, denoised=False))
    return radiance[tracer.object_ids(camera(), view(eye)) == 0].mean(axis=0)


def test_a_model_without_normals_and_colours_is_gray_and_smooth(world):
    shape = ball(0.06)
    bare = mean_color(world, model_of(shape), LAMBERTIAN)
    smooth = mean_color(world, model_of(shape, normals=shape.normals), LAMBERTIAN)
    np.testing.assert_allclose(bare, smooth, rtol=0.03)
    assert bare[0] > bare[1] > bare[2] > 0.1  # the warm light's colour on gray


def test_an_open_surface_is_seen_from_both_sides(world):
    """Half a box, its inside turned up: not watertight, and lit all the same."""
    shape = box(0.1, 0.1, 0.1)
    kept = shape.faces[(shape.vertices[shape.faces][..., 2] < 0.09).all(axis=1)]
    model = Model(1, shape.vertices, kept.astype(np.int32), 0.1)
    assert mean_color(world, model, Material((0.5, 0.5, 0.5))).min() > 0.02


def test_vertex_colours_are_shown_and_the_material_may_overrule_them(world):
    shape = box(0.12, 0.12, 0.05)
    colors = np.where(shape.vertices[:, :1] > 0, np.uint8([[220, 20, 20]]), np.uint8([[20, 20, 220]])).astype(np.uint8)
    model = model_of(shape, colors=colors, normals=shape.normals)
    seen = mean_color(world, model, LAMBERTIAN)
    assert seen[0] > 2 * seen[1]
    assert seen[2] > 2 * seen[1]
    green = mean_color(world, model, Material((0.05, 0.6, 0.05), roughness=1.0, specular=0.0))
    assert green[1] > 4 * max(green[0], green[2])


def test_vertex_colours_interpolate_linearly(world):
    """A square from black to white: the middle is half as bright as the white end."""
    vertices = np.array([[-0.1, -0.1, 0.01], [0.1, -0.1, 0.01], [0.1, 0.1, 0.01], [-0.1, 0.1, 0.01]])
    colors = np.array([[0, 0, 0], [255, 255, 255], [255, 255, 255], [0, 0, 0]], np.uint8)
    model = Model(1, vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), 0.3, colors=colors)
    tracer = PathTracer(world, [(model, LAMBERTIAN, np.eye(4))])
    albedo, _ = tracer.guides(camera(), view((0.0, -0.001, 0.3), 0.0), samples=16)
    ids = tracer.object_ids(camera(), view((0.0, -0.001, 0.3), 0.0))
    row = albedo[24, ids[24] == 0, 0][1:-1]  # the outermost pixels see the table too
    np.testing.assert_allclose(row, np.linspace(row[0], row[-1], len(row)), atol=0.03)
    assert row[-1] - row[0] > 0.8


def test_a_texture_has_its_first_row_on_top(world):
    """Upper half red, lower half blue, on a square whose texture coordinates begin at the lower left."""
    vertices = np.array([[-0.1, -0.1, 0.01], [0.1, -0.1, 0.01], [0.1, 0.1, 0.01], [-0.1, 0.1, 0.01]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    image = np.zeros((32, 32, 3), np.uint8)
    image[:16, :, 0] = image[16:, :, 2] = 230
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    own = Model(1, vertices, faces, 0.3, texture=image, texture_uv=uv)
    lent = Model(1, vertices, faces, 0.3, texture_uv=uv)
    for model, material in ((own, LAMBERTIAN), (lent, Material(None, Texture(image, (1.0, 1.0)), 1.0, 0.0))):
        tracer = PathTracer(world, [(model, material, np.eye(4))])
        albedo, _ = tracer.guides(camera(), view((0.0, -0.001, 0.3), 0.0))
        top, bottom = albedo[18, 32], albedo[30, 32]
        assert top[0] > 5 * top[2]
        assert bottom[2] > 5 * bottom[0]


def test_metal_mirrors_and_plastic_does_not(world):
    plate, aside = model_of(box(0.2, 0.2, 0.02)), (0.0, -0.5, 0.35)  # from where the mirror shows the sky, not the lamp
    metal = mean_color(world, plate, Material((0.9, 0.9, 0.9), None, 0.05, 0.5, 1.0), aside)
    matt = mean_color(world, plate, Material((0.9, 0.9, 0.9), None, 1.0, 0.0), aside)
    assert metal.mean() < 0.6 * matt.mean()


def test_a_point_light_lights():
    piece = box(1.0, 1.0, 0.1).moved(z=-0.1).piece("table", Material(linear(200), roughness=1.0, specular=0.0))
    lamp = PointLight((0.0, 0.0, 1.0), (2.0, 1.0, 0.5))
    lit = World("lit", 0, (piece,), (lamp,), (), np.array([[-1, -1, 0], [1, 1, 1.0]]))
    radiance = PathTracer(lit, []).radiance(camera(), view((0.0, -0.01, 0.5)), RAW)
    middle = radiance[24, 32]
    expected = np.array((2.0, 1.0, 0.5)) * linear(200)[0] / np.pi  # intensity / distance^2 * albedo / pi
    np.testing.assert_allclose(middle, expected, rtol=0.05)


def test_random_materials_load(world):
    rng = np.random.default_rng(0)
    objects = [(model_of(ball(0.03)), random_material(rng), transform(np.eye(3), np.array([0.07 * k - 0.15, 0, 0])))
               for k in range(5)]  # fmt: skip
    image = PathTracer(world, objects).render(camera(), view(), RAW)
    assert 20 < image.mean() < 235


@pytest.mark.skipif(is_scalar(), reason="runs in the slow variant already")
def test_both_variants_show_the_same(world, tmp_path):
    """The slow variant, in a process of its own, gives the same picture but for noise."""
    code = (
        "import sys, numpy as np\n"
        "from pipeline.scene import Camera\n"
        "from pipeline.synth.tracing.path_tracer import PathTracer, Preset\n"
        "from pipeline.synth.worlds.shapes import box\n"
        "from pipeline.synth.worlds.world import AreaLight, World\n"
        "from pipeline.synth.materials import Material\n"
        "piece = box(1, 1, 0.1).moved(z=-0.1).piece('t', Material((0.5, 0.4, 0.3)))\n"
        "lamp = AreaLight((0, 0, 1.0), (0.3, 0, 0), (0, -0.3, 0), (5, 5, 5))\n"
        "world = World('t', 0, (piece,), (lamp,), (), np.zeros((2, 3)))\n"
        "K = np.array([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]])\n"
        "pose = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.6], [0, 0, 0, 1.0]])\n"
        "r = PathTracer(world, []).radiance(Camera(K, 32, 24), pose, Preset(36, 1, denoised=False))\n"
        "np.save(sys.argv[1], r)\n"
    )
    images = []
    for variant in ("scalar_rgb", mitsuba().variant()):
        out = tmp_path / f"{variant}.npy"
        environment = os.environ | {"INSPECTOR_MITSUBA_VARIANT": variant}
        subprocess.run([sys.executable, "-c", code, str(out)], env=environment, check=True, timeout=300)
        images.append(np.load(out))
    np.testing.assert_allclose(images[0].mean(axis=(0, 1)), images[1].mean(axis=(0, 1)), rtol=0.03)
