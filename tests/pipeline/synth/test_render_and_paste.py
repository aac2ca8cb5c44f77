"""What render-and-paste images show: geometry, colour and annotations agree with each other and with ray casting."""

import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.bop.models import read_model
from pipeline.color_rendering import gl_available, render_color
from pipeline.exceptions import UnknownIdError
from pipeline.geometry import transform
from pipeline.gl_rendering import GlError
from pipeline.rendering import render, render_scene
from pipeline.scene import Camera, Model
from pipeline.synth.demo.part_files import part_model
from pipeline.synth.render_and_paste import LightRanges, PasteSettings, PasteSettingsError, RenderAndPaste
from pipeline.synth.render_and_paste.lights import Light
from pipeline.synth.render_and_paste.rasterizer import MOST_BUFFERS, Rasterizer
from pipeline.synth.render_and_paste.shots import Painted

CAMERA = Camera(np.array([[320.0, 0.6, 161.3], [0.0, 322.0, 118.7], [0.0, 0.0, 1.0]]), width=320, height=240)
PLAIN = PasteSettings(augmentation=None, edge_blur=0.0)
ASSETS = Path(__file__).resolve().parents[3] / "assets"
WHITE = 65535 / 4  # of light that is written: `shaders.BRIGHTEST` is four times white

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


@pytest.fixture(scope="module", autouse=True)
def _opengl() -> None:
    if not gl_available():
        pytest.skip("no OpenGL through EGL here: install libegl1 and libgl1-mesa-dri")


@pytest.fixture(scope="module")
def rasterizer():
    made = Rasterizer()
    yield made
    made.close()


def cube(obj_id: int = 1, side: float = 0.1, **appearance) -> Model:
    vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * side / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Model(obj_id, vertices, np.array(faces, np.int32), side * 3**0.5, **appearance)


def painted_cube(obj_id: int, color: tuple[int, int, int]) -> Model:
    return cube(obj_id, colors=np.tile(np.array(color, np.uint8), (8, 1)))


def square(texture: np.ndarray) -> Model:
    """A square of 0.1 m that faces the camera in the identity pose, its texture upright."""
    vertices = np.array([[-0.05, -0.05, 0], [0.05, -0.05, 0], [0.05, 0.05, 0], [-0.05, 0.05, 0]])
    uv = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Model(1, vertices, faces, 0.1414, texture=texture, texture_uv=uv)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.3, angles: tuple[float, ...] = (0.4, -0.7, 1.1)) -> np.ndarray:
    return transform(Rotation.from_euler("xyz", angles).as_matrix(), np.array([x, y, z]))


def light(*lamps: tuple[tuple[float, float, float], float], ambient: float = 0.0) -> Light:
    directions = np.array([lamp[0] for lamp in lamps], float).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = np.array([[lamp[1]] * 3 for lamp in lamps], float).reshape(-1, 3)
    return Light(directions, colors, np.full(3, ambient), np.full(3, ambient), np.array([0.0, -1.0, 0.0]))


def read_real_model(root: Path, obj_id: int) -> Model:
    return read_model(root / "models" / f"obj_{obj_id:06d}.ply", obj_id)


def random_scene(models: list[Model], seed: int, count: int) -> list[tuple[Model, np.ndarray]]:
    rng = np.random.default_rng(seed)
    scene = []
    for index in rng.integers(len(models), size=count):
        pixel, z = rng.uniform([0, 0], [320, 240]), models[index].diameter * rng.uniform(2, 6)
        place = np.linalg.inv(CAMERA.K) @ [*pixel, 1.0] * z
        scene.append((models[index], transform(Rotation.random(rng=rng).as_matrix(), place)))
    return scene


def compare_with_ray_casting(rasterizer: Rasterizer, scene: list[tuple[Model, np.ndarray]]) -> None:
    """Silhouettes within a pixel per thousand, depth of the others within a micrometre but at inner edges."""
    drawings = rasterizer.draw([Painted(model, p) for model, p in scene], CAMERA, light(ambient=0.5))
    differing = total = 0
    depth_errors = []
    for drawing, alone in zip(drawings, render_scene(scene, CAMERA, pixel_center=0.0).renderings, strict=True):
        assert drawing.box == alone.box
        differing += np.count_nonzero((drawing.depth > 0) != alone.mask_crop)
        total += np.count_nonzero(alone.mask_crop)
        both = (drawing.depth > 0) & alone.mask_crop
        depth_errors.append(np.abs(drawing.depth - alone.depth_crop)[both])
    assert total > 5000
    assert differing <= 1e-3 * total
    errors = np.concatenate(depth_errors)
    assert np.quantile(errors, 0.5) < 1e-6
    assert (errors > 1e-4).mean() < 1e-3


def test_silhouettes_and_depth_are_those_of_the_ray_caster(rasterizer: Rasterizer):
    parts = [read_real_model(ASSETS, 1), read_real_model(ASSETS, 8), part_model(5)]
    compare_with_ray_casting(rasterizer, random_scene(parts, 0, 12))


def test_an_open_mesh_shows_its_inside(rasterizer: Rasterizer):
    closed = cube()
    open_box = Model(2, closed.vertices, closed.faces[2:], closed.diameter)
    compare_with_ray_casting(rasterizer, random_scene([open_box], 1, 12))


def test_an_object_that_reaches_behind_the_camera_is_drawn_as_far_as_it_is_seen(rasterizer: Rasterizer):
    long = Model(3, cube().vertices * [1, 1, 30], cube().faces, 3.0)
    drawing = rasterizer.draw([Painted(long, pose(0.08, 0.02, 0.4, (0, 0, 0)))], CAMERA, light(ambient=0.5))[0]
    alone = render(long, CAMERA, pose(0.08, 0.02, 0.4, (0, 0, 0)), pixel_center=0.0)
    assert alone.mask_crop.sum() > 500
    assert np.count_nonzero((drawing.depth > 0) != alone.mask_crop) < 20


def test_real_models_agree_with_the_ray_caster_too(rasterizer: Rasterizer, shared_data: Path):
    models = [read_real_model(shared_data / "lmo", i) for i in (1, 5)]
    models += [read_real_model(shared_data / "ycbv", 14), read_real_model(shared_data / "icbin", 1)]
    compare_with_ray_casting(rasterizer, random_scene(models, 2, 8))


def test_every_pixel_shows_what_its_mask_says(tmp_path: Path):
    cv2.imwrite(str(tmp_path / "blue.png"), np.full((240, 320, 3), (255, 0, 0), np.uint8))  # BGR
    models = [painted_cube(1, (255, 40, 40)), painted_cube(2, (40, 255, 40))]
    settings = PasteSettings(backgrounds=tmp_path, augmentation=None, edge_blur=0.0, lights=LightRanges(color=0.0))
    with RenderAndPaste(models, CAMERA, settings) as source:
        images = [source.image(np.random.default_rng(seed)) for seed in range(6)]
    for image in images:
        shown = image.rgb.argmax(axis=-1)  # 0 red, 1 green, 2 blue
        painted = np.full(shown.shape, 2)
        for truth, visible in zip(image.ground_truth, image.visible_masks, strict=True):
            painted[visible] = truth.obj_id - 1
        assert np.array_equal(shown, painted)
        assert np.array_equal(image.depth > 0, shown != 2)
        assert np.array_equal(image.rgb[shown == 2] == (0, 0, 255), np.ones(((shown == 2).sum(), 3), bool))


def test_the_nearer_object_hides_the_farther_whatever_their_order():
    near, far = (1, pose(0.0, 0.0, 0.3)), (2, pose(0.12, 0.02, 0.5))
    models = [painted_cube(1, (255, 40, 40)), painted_cube(2, (40, 255, 40))]
    with RenderAndPaste(models, CAMERA, PLAIN) as source:
        one, other = (source.image(np.random.default_rng(0), given) for given in ([near, far], [far, near]))
    assert [truth.obj_id for truth in other.ground_truth] == [2, 1]
    assert np.array_equal(one.visible_masks[0], one.masks[0])
    assert np.array_equal(one.visible_masks[0], other.visible_masks[1])
    assert np.array_equal(one.visible_masks[1], one.masks[1] & ~one.masks[0])
    assert 0 < one.ground_truth[1].visible_fraction < 1
    expected = render_scene([(models[0], near[1]), (models[1], far[1])], CAMERA, pixel_center=0.0)
    assert np.count_nonzero(expected.instance_ids != one.instance_ids) <= 5


def test_objects_that_run_into_each_other_are_cut_where_they_meet():
    models, crossing = [cube(1), cube(2)], [(1, pose(0, 0, 0.4, (0, 0, 0))), (2, pose(0.03, 0, 0.4, (0, 0.7, 0)))]
    with RenderAndPaste(models, CAMERA, PLAIN) as source:
        image = source.image(np.random.default_rng(0), crossing)
    expected = render_scene([(models[0], crossing[0][1]), (models[1], crossing[1][1])], CAMERA, pixel_center=0.0)
    assert np.count_nonzero(image.instance_ids != expected.instance_ids) <= 20
    assert min(mask.sum() for mask in image.visible_masks) > 500


def test_smoothed_outlines_change_only_pixels_that_touch_them():
    given = [(1, pose(0.0, 0.0, 0.3)), (1, pose(0.05, 0.02, 0.5))]
    images = []
    for blur in (0.0, 1.0):
        with RenderAndPaste([cube()], CAMERA, PasteSettings(augmentation=None, edge_blur=blur)) as source:
            images.append(source.image(np.random.default_rng(0), given))
    hard, soft = images
    ids = hard.instance_ids
    touching = np.zeros(ids.shape, bool)
    for shift, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        touching |= np.roll(ids, shift, axis) != ids
    differs = (hard.rgb != soft.rgb).any(axis=-1)
    assert not (differs & ~touching).any()
    assert differs.sum() > 0.5 * touching.sum()
    assert np.array_equal(ids, soft.instance_ids)


def test_light_falls_as_its_formula_says(rasterizer: Rasterizer):
    turned = np.deg2rad(25.0)
    model = painted_cube(1, (186, 186, 186))  # half of the light, gamma 2.2
    lit = light(((0, 0, -1), 0.6), ambient=0.2)
    facing, aslant = rasterizer.draw(
        [
            Painted(model, pose(0, 0, 0.4, (0, 0, 0)), gloss=0.0),
            Painted(model, pose(0, 0, 0.4, (0, turned, 0)), gloss=0.0),
        ],
        CAMERA,
        lit,
    )
    albedo = (186 / 255) ** 2.2
    values = facing.light[facing.depth > 0][:, 0] / WHITE
    assert np.abs(np.median(values) - albedo * (0.2 + 0.6)) < 1e-3
    middle = aslant.light[100:140, 100:140] if min(aslant.depth.shape) > 140 else aslant.light
    expected = [albedo * (0.2 + 0.6 * np.cos(angle)) for angle in (turned, np.pi / 2 - turned)]
    seen = np.unique(np.round(middle[..., 0][middle[..., 3] > 0] / WHITE, 3))
    assert all(np.abs(seen - value).min() < 2e-3 for value in expected[:1])
    assert all(np.abs(np.array(expected) - value).min() < 2e-3 for value in seen)  # flat faces: no shade in between


def test_a_lamp_from_the_left_lights_the_left_of_a_turned_ball(rasterizer: Rasterizer):
    theta, phi = np.meshgrid(np.linspace(0, np.pi, 24), np.arange(48) * 2 * np.pi / 48, indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    rows = np.arange(24 * 48).reshape(24, 48)
    a, b, c, d = rows[:-1], np.roll(rows, -1, 1)[:-1], np.roll(rows, -1, 1)[1:], rows[1:]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, d, c), (a, c, b))]).astype(np.int32)
    ball = Model(1, points.reshape(-1, 3) * 0.05, faces, 0.1)  # without normals: smooth ones are made
    for angles in ((0, 0, 0), (0.9, 2.0, -0.4)):
        drawing = rasterizer.draw(
            [Painted(ball, pose(0, 0, 0.3, angles), gloss=0.0)], CAMERA, light(((-1, 0, 0), 0.8))
        )[0]
        shown = drawing.light[..., 0] / WHITE * (drawing.depth > 0)
        row = shown[shown.shape[0] // 2]
        assert row[10] > 0.2
        assert row[-10:].max() < 0.02
        assert np.abs(np.diff(row[5:-5])).max() < 0.03  # smooth, not in facets


def test_textures_are_upright_and_seen_from_afar_without_flicker(rasterizer: Rasterizer):
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:32, :32] = (255, 0, 0)
    texture[32:, 32:] = (0, 255, 0)
    drawing = rasterizer.draw([Painted(square(texture), pose(0, 0, 0.3, (0, 0, 0)))], CAMERA, light(ambient=1.0))[0]
    rows, columns = drawing.depth.shape
    parts = drawing.light[rows // 4 :: rows // 2, columns // 4 :: columns // 2][:2, :2, :3] / WHITE
    assert np.abs(parts - [[[1, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 1, 0]]]).max() < 0.01
    stripes = np.zeros((256, 256, 3), np.uint8)
    stripes[:, ::2] = 255
    far = rasterizer.draw([Painted(square(stripes), pose(0, 0, 1.0, (0, 0, 0)))], CAMERA, light(ambient=1.0))[0]
    inner = far.light[2:-2, 2:-2, 0] / WHITE
    assert np.abs(inner - 0.5).max() < 0.1  # the mean of black and white as light


def test_repainting_gives_plain_colours_to_the_chosen_models():
    models = [cube(1), painted_cube(2, (10, 20, 250))]
    given = [(1, pose(-0.08)), (2, pose(0.08))]
    dim = LightRanges(lamps=(1, 1), strength=(0.3, 0.4), ambient=(0.2, 0.3), color=0.0, gloss=(0.0, 0.0))

    def hues(repaint: str) -> list[np.ndarray]:
        settings = PasteSettings(augmentation=None, edge_blur=0.0, repaint=repaint, lights=dim)
        with RenderAndPaste(models, CAMERA, settings) as source:
            images = [source.image(np.random.default_rng(seed), given) for seed in range(8)]
        return [np.stack([i.rgb[i.visible_masks[k]].mean(axis=0) for i in images]) for k in (0, 1)]

    def spread(colors: np.ndarray) -> float:
        return float((colors / colors.sum(axis=1, keepdims=True)).std(axis=0).max())

    bare, blue = hues("none")
    assert np.ptp(bare, axis=1).max() < 1.0  # gray
    bare, same = hues("uncolored")
    assert spread(bare) > 0.02
    assert np.array_equal(same, blue)
    assert spread(hues("all")[1]) > 0.02 > spread(blue)


def test_given_poses_are_annotated_in_their_order_also_out_of_sight():
    behind, aside = (1, pose(0, 0, -0.3)), (1, pose(2.0, 0, 0.3))
    hidden, seen = (1, pose(0, 0, 2.0)), (2, pose(0, 0, 0.3))
    with RenderAndPaste([cube(1), cube(2)], CAMERA, PLAIN) as source:
        image = source.image(np.random.default_rng(0), [behind, seen, hidden, aside])
        nothing = source.image(np.random.default_rng(0), [])
    assert [truth.index for truth in image.ground_truth] == [0, 1, 2, 3]
    assert [truth.visible_fraction for truth in image.ground_truth] == [0.0, 1.0, 0.0, 0.0]
    assert [bool(mask.any()) for mask in image.masks] == [False, True, True, False]
    assert all(
        np.array_equal(t.camera_from_model, p)
        for t, (_, p) in zip(image.ground_truth, [behind, seen, hidden, aside], strict=True)
    )
    assert not (nothing.depth > 0).any()
    assert nothing.ground_truth == ()


def test_visible_fraction_counts_what_lies_beyond_the_image():
    place = pose(-0.15, 0.02, 0.3)
    shift = np.array([[1.0, 0, 400], [0, 1, 300], [0, 0, 1]])
    wide = Camera(shift @ CAMERA.K, 1120, 840)
    with RenderAndPaste([cube()], CAMERA, PLAIN) as source:
        image = source.image(np.random.default_rng(0), [(1, place)])
    truth, mask = image.ground_truth[0], image.masks[0]
    whole = render(cube(), wide, place, pixel_center=0.0).mask.sum()
    assert truth.visible_pixels == mask.sum()
    assert 0.2 < truth.visible_fraction < 0.8
    assert truth.visible_fraction == pytest.approx(mask.sum() / whole, rel=1e-3)
    rows, columns = np.nonzero(mask)
    assert truth.bbox_visible == (columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1)


def test_another_camera_may_be_given_for_one_image():
    small = Camera(CAMERA.K / [[2], [2], [1]], 160, 120)
    with RenderAndPaste([cube()], CAMERA) as source:
        image = source.image(np.random.default_rng(0), [(1, pose())], small)
        assert source.image(np.random.default_rng(0)).rgb.shape == (240, 320, 3)
    assert image.rgb.shape == (120, 160, 3)
    assert image.camera is small
    assert np.array_equal(image.masks[0], render(cube(), small, pose(), pixel_center=0.0).mask)


def test_images_depend_on_the_seed_alone():
    source = RenderAndPaste([cube(1), painted_cube(2, (200, 90, 40))], CAMERA)
    first = source.image(np.random.default_rng(11))
    source.image(np.random.default_rng(5))
    again = source.image(np.random.default_rng(11))
    source.close()
    source.close()
    reopened = source.image(np.random.default_rng(11))  # after closing, a new context is made
    copy = pickle.loads(pickle.dumps(source)).image(np.random.default_rng(11))
    other = source.image(np.random.default_rng(12))
    for image in (again, reopened, copy):
        assert np.array_equal(image.rgb, first.rgb)
        assert np.array_equal(image.depth, first.depth)
    assert not np.array_equal(other.rgb, first.rgb)
    assert set(first.seconds) == {"poses", "drawing", "annotating", "background", "pasting", "augmentation"}


def test_threads_take_turns():
    with RenderAndPaste([cube()], CAMERA) as source, ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda seed: source.image(np.random.default_rng(seed)).rgb, range(6)))
        alone = [source.image(np.random.default_rng(seed)).rgb for seed in range(6)]
    assert all(np.array_equal(a, b) for a, b in zip(together, alone, strict=True))


def test_more_objects_than_buffers_are_drawn_in_turns(rasterizer: Rasterizer):
    compare_with_ray_casting(rasterizer, random_scene([cube()], 3, 2 * MOST_BUFFERS + 5))


def test_a_camera_inside_an_object_sees_its_inside(rasterizer: Rasterizer):
    inside = pose(0.01, 0.0, 0.02)
    drawing = rasterizer.draw([Painted(cube(), inside)], CAMERA, light(ambient=0.5))[0]
    assert (drawing.depth > 0).all()
    assert np.abs(drawing.depth - render(cube(), CAMERA, inside, pixel_center=0.0).depth).max() < 1e-5


def test_closing_leaves_other_opengl_of_the_program_alone():
    with RenderAndPaste([cube()], CAMERA) as source:
        source.image(np.random.default_rng(0))
        before = render_color(cube(), CAMERA, pose(), backend="gl")
        source.image(np.random.default_rng(1))
    after = render_color(cube(), CAMERA, pose(), backend="gl")
    assert np.array_equal(before.rgb, after.rgb)


_WORKERS = """
import hashlib, multiprocessing, sys
import numpy as np
from pipeline.scene import Camera
from pipeline.gl_rendering import GL, GlError
from pipeline.synth.render_and_paste import RenderAndPaste
from tiny_dataset import box

GL.available = lambda: True  # was tried by the test that runs this

def hashed(source, seed):
    return hashlib.md5(source.image(np.random.default_rng(seed)).rgb.tobytes()).hexdigest()

def work(source, seed, queue):
    try:
        queue.put((seed, hashed(source, seed)))
    except GlError as error:
        queue.put((seed, str(error)))

def run(source, seeds):
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    workers = [context.Process(target=work, args=(source, seed, queue)) for seed in seeds]
    [worker.start() for worker in workers]
    answers = dict(queue.get(timeout=300) for _ in workers)
    [worker.join() for worker in workers]
    return answers

camera = Camera(np.array([[160.0, 0, 80], [0, 160, 60], [0, 0, 1]]), 160, 120)
source = RenderAndPaste([box(1), box(2)], camera)
answers = run(source, [0, 1])
assert answers == {seed: hashed(source, seed) for seed in (0, 1)}, answers
assert answers[0] != answers[1]
print(run(source, [0])[0])
"""


def test_processes_make_the_same_images_and_a_late_fork_is_refused_instead_of_hanging():
    code = [sys.executable, "-W", "ignore", "-c", _WORKERS]
    root = ASSETS.parent
    paths = {"PYTHONPATH": f"{root}:{root / 'tests'}"}
    done = subprocess.run(
        code, cwd=root, env=os.environ | paths, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "OpenGL was used before this process was forked; fork first, or start processes by 'spawn'" in done.stdout


def test_what_cannot_be_drawn_is_refused_in_one_line():
    source = RenderAndPaste([cube(3)], CAMERA)
    rng = np.random.default_rng(0)
    with pytest.raises(UnknownIdError, match=r"object 7 is not in the models to render; available: 3"):
        source.image(rng, [(7, pose())])
    with pytest.raises(PasteSettingsError, match=r"pose of object 3 is no finite 4x4 matrix; give camera_from_model"):
        source.image(rng, [(3, np.full((4, 4), np.nan))])
    with pytest.raises(PasteSettingsError, match="no models to render; give at least one"):
        RenderAndPaste([], CAMERA)
    with pytest.raises(PasteSettingsError, match=r"two models of the same object among \[3, 3\]"):
        RenderAndPaste([cube(3), cube(3)], CAMERA)
    closed = Rasterizer()
    closed.close()
    with pytest.raises(GlError, match="the OpenGL context is closed; make a new one"):
        closed.draw([], CAMERA, light())
