import json
import shutil
import struct
import threading
import time

import cv2
import numpy as np
import pytest

from pipeline.bop import models as models_module
from pipeline.bop.dataset import open_dataset, splits
from pipeline.bop.facts import dataset_facts, known_datasets
from pipeline.bop.models import diameter_of, read_model
from pipeline.bop.writer import AnnotatedImage, write_ground_truth, write_scene, write_targets
from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from pipeline.scene import Camera, GroundTruth, Image, ImageKey, Target

K = [500.0, 0, 4, 0, 500.0, 3, 0, 0, 1]
CAMERA = {"cam_K": K, "depth_scale": 1.0}
ANNOTATION = {"obj_id": 1, "cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [10.0, -20.0, 700.0]}
TETRAHEDRON = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
30 0 0
0 40 0
0 0 10
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""


def write_image(path, value=100, shape=(6, 8), dtype=np.uint8):
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full(shape, value, dtype))


def write_json(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def make_scene(folder, im_ids=(0, 1), image="rgb", suffix=".png", depth="depth", sensor="", gt=True):
    tail = f"_{sensor}" if sensor else ""
    for im_id in im_ids:
        write_image(folder / image / f"{im_id:06d}{suffix}", shape=(6, 8, 3) if image.startswith("rgb") else (6, 8))
        if depth:
            write_image(folder / depth / f"{im_id:06d}{'.tif' if suffix == '.tif' else '.png'}", 700, dtype=np.uint16)
    write_json(folder / f"scene_camera{tail}.json", {im_id: CAMERA for im_id in im_ids})
    if gt:
        write_json(folder / f"scene_gt{tail}.json", {im_id: [ANNOTATION] for im_id in im_ids})


@pytest.fixture
def root(tmp_path):
    """A dataset with two scenes of two images, one object, and a model."""
    root = tmp_path / "parts"
    make_scene(root / "test" / "000003")
    make_scene(root / "test" / "000012")
    (root / "models").mkdir()
    (root / "models" / "obj_000001.ply").write_bytes(TETRAHEDRON)
    return root


@pytest.mark.parametrize(
    "split", ["test", "test_primesense", "test_kinect", "test_bop19", "val_primesense", "train_pbr", "train_synt"]
)
def test_every_name_of_a_split_is_found(tmp_path, split):
    make_scene(tmp_path / split / "000001")
    dataset = open_dataset(tmp_path)
    assert dataset.split == split
    assert dataset.targets() == (Target(1, 0, 1, 1), Target(1, 1, 1, 1))


def test_the_official_test_split_is_preferred_then_test_val_train(tmp_path):
    names = ("train_real", "val", "test_canon", "test_primesense")
    for name in names:
        make_scene(tmp_path / "tless" / name / "000001")
        make_scene(tmp_path / "unknown" / name / "000001")
    (tmp_path / "tless" / "test_empty").mkdir()
    assert splits(tmp_path / "tless") == ("test_canon", "test_primesense", "val", "train_real")
    assert open_dataset(tmp_path / "tless").split == "test_primesense"
    assert open_dataset(tmp_path / "unknown").split == "test_canon"
    assert open_dataset(tmp_path / "unknown", "val").split == "val"


@pytest.mark.parametrize(
    ("image", "suffix"), [("rgb", ".png"), ("rgb", ".jpg"), ("gray", ".tif"), ("gray", ".png"), ("rgb", ".JPG")]
)
def test_colour_and_gray_images_of_any_format(tmp_path, image, suffix):
    make_scene(tmp_path / "test" / "000001", image=image, suffix=suffix)
    loaded = open_dataset(tmp_path).image(ImageKey(1, 0))
    assert loaded.rgb is not None
    assert loaded.rgb.shape == (6, 8, 3)
    assert loaded.rgb.dtype == np.uint8
    assert np.abs(loaded.rgb.astype(int) - 100).max() <= 2  # jpg is not exact
    assert loaded.depth is not None
    assert loaded.depth.dtype == np.float32
    assert loaded.depth == pytest.approx(0.7)
    assert (loaded.camera.width, loaded.camera.height) == (8, 6)


def test_colours_come_as_rgb(root):
    bgr = np.zeros((6, 8, 3), np.uint8)
    bgr[..., 2] = 255
    cv2.imwrite(str(root / "test" / "000003" / "rgb" / "000000.png"), bgr)
    rgb = open_dataset(root).rgb(ImageKey(3, 0))
    assert rgb is not None
    assert rgb[0, 0].tolist() == [255, 0, 0]


@pytest.mark.parametrize(
    ("sensor", "image", "depth", "mask"),
    [
        ("cam1", "rgb_cam1", "depth_cam1", "mask_visib_cam1"),
        ("3dlong", "gray_3dlong", "depth_3dlong", "mask_visib_3dlong"),
        ("gray1", "gray1", None, "mask_visib_gray1"),
        ("rgb", "rgb", None, "mask_visib_rgb"),
    ],
)
def test_names_with_a_sensor(tmp_path, sensor, image, depth, mask):
    folder = tmp_path / "test" / "000004"
    make_scene(folder, image=image, depth=depth, sensor=sensor)
    write_json(folder / f"scene_gt_info_{sensor}.json", {i: [{"visib_fract": 0.4}] for i in range(2)})
    write_image(folder / mask / "000001_000000.png", 255)
    dataset = open_dataset(tmp_path)
    key = ImageKey(4, 1)
    assert dataset.sensor(4) == sensor
    assert dataset.image(key).rgb is not None
    assert (dataset.depth(key) is None) == (depth is None)
    assert dataset.ground_truth(key)[0].visible_fraction == 0.4
    visible = dataset.mask(key, 0)
    assert visible is not None
    assert visible.all()
    assert dataset.mask(key, 0, visible=False) is None


def test_the_preferred_sensor_is_taken_scene_by_scene_unless_one_is_asked_for(tmp_path):
    root = tmp_path / "hot3d"
    for sensor in ("gray1", "gray2", "rgb"):
        make_scene(root / "test_aria" / "000001", image=sensor, depth=None, sensor=sensor)
    make_scene(root / "test_aria" / "000002", image="gray2", depth=None, sensor="gray2")
    dataset = open_dataset(root)
    assert [dataset.sensor(scene_id) for scene_id in dataset.scene_ids] == ["rgb", "gray2"]
    assert open_dataset(root, sensor="gray1").sensor(1) == "gray1"
    with pytest.raises(UnknownIdError, match=r"sensor cam9 is not in .*; available: gray1, gray2, rgb"):
        open_dataset(root, sensor="cam9")


def test_ids_may_be_sparse_and_other_folders_are_ignored(root):
    make_scene(root / "test" / "000100", im_ids=(7, 1500))
    (root / "test" / "obj_000001_up").mkdir()
    (root / "test" / "000100" / "rgb" / "notes.txt").touch()
    dataset = open_dataset(root)
    assert dataset.scene_ids == (3, 12, 100)
    assert dataset.image_ids(100) == (7, 1500)


def test_camera_and_depth_scale_are_per_image(root):
    other = {"cam_K": [600.0, 0, 1, 0, 610.0, 2, 0, 0, 1], "depth_scale": 0.1}
    write_json(root / "test" / "000003" / "scene_camera.json", {"0": CAMERA, "1": other})
    dataset = open_dataset(root)
    assert dataset.camera(ImageKey(3, 0)).K.ravel().tolist() == K
    assert dataset.camera(ImageKey(3, 1)).K.ravel().tolist() == other["cam_K"]
    assert dataset.depth(ImageKey(3, 0)) == pytest.approx(0.7)
    assert dataset.depth(ImageKey(3, 1)) == pytest.approx(0.07)


def test_the_world_pose_is_inverted_to_world_from_camera(root):
    entry = CAMERA | {"cam_R_w2c": [0, -1, 0, 1, 0, 0, 0, 0, 1], "cam_t_w2c": [100, 0, 500]}
    write_json(root / "test" / "000003" / "scene_camera.json", {"0": entry, "1": CAMERA})
    dataset = open_dataset(root)
    world_from_camera = dataset.camera(ImageKey(3, 0)).world_from_camera
    assert world_from_camera is not None
    assert world_from_camera @ [0.1, 0, 0.5, 1] == pytest.approx([0, 0, 0, 1])  # the origin of the world
    assert dataset.camera(ImageKey(3, 1)).world_from_camera is None


def test_ground_truth_is_in_metres_with_what_the_info_knows(root):
    info = {"visib_fract": 0.5, "px_count_visib": 12, "bbox_visib": [1, 2, 3, 4], "px_count_all": 24}
    write_json(root / "test" / "000003" / "scene_gt_info.json", {"0": [info]})
    dataset = open_dataset(root)
    truth = dataset.ground_truth(ImageKey(3, 0))[0]
    assert truth.camera_from_model[:3, 3] == pytest.approx([0.01, -0.02, 0.7])
    assert (truth.obj_id, truth.index, truth.visible_fraction, truth.visible_pixels) == (1, 0, 0.5, 12)
    assert truth.bbox_visible == (1, 2, 3, 4)
    assert dataset.ground_truth(ImageKey(3, 1))[0].visible_fraction is None


def test_a_split_without_annotations_depth_and_images_still_opens(tmp_path):
    write_json(tmp_path / "lmo" / "test" / "000002" / "scene_camera.json", {"5": CAMERA})
    dataset = open_dataset(tmp_path / "lmo")
    image = dataset.image(ImageKey(2, 5))
    assert image.rgb is None
    assert image.depth is None
    assert (image.camera.width, image.camera.height) == (640, 480)  # from the facts about LM-O
    assert not dataset.has_ground_truth(2)
    assert dataset.ground_truth(ImageKey(2, 5)) == ()
    assert dataset.targets() == ()
    assert dataset.obj_ids == (1, 5, 6, 8, 9, 10, 11, 12)


@pytest.mark.parametrize("name", ["test_targets_bop19.json", "test_targets_bop24.json", "test_targets.json"])
def test_targets_come_from_the_list_for_images_on_disk(root, name):
    write_targets(root / name, [Target(12, 1, 1, 3), Target(3, 0, 1, 1), Target(3, 999, 1, 1), Target(77, 0, 1, 1)])
    assert open_dataset(root).targets() == (Target(12, 1, 1, 3), Target(3, 0, 1, 1))


def test_detection_targets_name_images_and_get_the_visible_objects(root):
    annotations = [ANNOTATION, ANNOTATION, ANNOTATION | {"obj_id": 2}, ANNOTATION | {"obj_id": 5}]
    write_json(root / "test" / "000003" / "scene_gt.json", {"1": annotations})
    info = [{"visib_fract": fraction} for fraction in (0.9, 0.1, 0.09, -1)]
    write_json(root / "test" / "000003" / "scene_gt_info.json", {"1": info})
    write_json(root / "test_targets_bop24.json", [{"scene_id": 3, "im_id": 1}])
    assert open_dataset(root).targets() == (Target(3, 1, 1, 2),)


def test_targets_of_the_test_split_do_not_leak_into_others(tmp_path):
    make_scene(tmp_path / "test" / "000001", im_ids=(0,), gt=False)
    make_scene(tmp_path / "val" / "000001", im_ids=(0, 1))
    write_targets(tmp_path / "test_targets_bop19.json", [Target(1, 0, 28, 9)])
    assert open_dataset(tmp_path, "test").targets() == (Target(1, 0, 28, 9),)
    assert open_dataset(tmp_path, "val").targets() == (Target(1, 0, 1, 1), Target(1, 1, 1, 1))


def test_models_for_evaluation_and_display_fall_back_to_each_other(tmp_path):
    make_scene(tmp_path / "tless" / "test_primesense" / "000001")
    for i, folder in enumerate(("models_eval", "models_cad", "models_reconst", "models_fine")):
        (tmp_path / "tless" / folder).mkdir()
        for obj_id in range(1, i + 2):
            (tmp_path / "tless" / folder / f"obj_{obj_id:06d}.ply").write_bytes(TETRAHEDRON)
    models = open_dataset(tmp_path / "tless").models
    assert models.obj_ids == (1, 2, 3, 4)
    assert [models.path(obj_id, "eval").parent.name for obj_id in (1, 2)] == ["models_eval", "models_cad"]
    assert models.path(1, "display").parent.name == "models_reconst"
    assert models.path(4, "display").parent.name == models.path(4, "eval").parent.name == "models_fine"


def test_a_model_is_in_metres_with_its_diameter_computed_or_read(root):
    model = open_dataset(root).model(1)
    assert model.vertices.dtype == np.float64
    assert model.vertices.tolist()[1] == [0.03, 0, 0]
    assert model.diameter == pytest.approx(0.05)
    assert len(model.symmetries) == 1
    entry = {"diameter": 49.5, "symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}
    write_json(root / "models" / "models_info.json", {"1": entry})
    dataset = open_dataset(root)
    assert dataset.model(1).diameter == 0.0495
    assert len(dataset.model(1, "display").symmetries) == 315
    assert dataset.model(1) is dataset.model(1)


def ply(form, vertex_properties, rows, faces, texture=None):
    """A PLY file; `faces` are vertex lists, or pairs of a vertex list and texture coordinates of its corners."""
    wedges = isinstance(faces[0][0], tuple | list)
    header = ["ply", f"format {form} 1.0", *([f"comment TextureFile {texture}"] if texture else [])]
    header += [f"element vertex {len(rows)}", *(f"property {kind} {name}" for kind, name in vertex_properties)]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header += ["property list uchar float texcoord"] if wedges else []
    lists = [(corners, *([uv] if wedges else [])) for corners, uv in faces] if wedges else [(face,) for face in faces]
    text = "\n".join([*header, "end_header", ""]).encode()
    if form == "ascii":
        lines = [" ".join(map(str, row)) for row in rows]
        lines += [" ".join(f"{len(part)} {' '.join(map(str, part))}" for part in face) for face in lists]
        return text + "\n".join(lines).encode()
    order = "<" if "little" in form else ">"
    codes = order + "".join({"float": "f", "double": "d", "uchar": "B"}[kind] for kind, _ in vertex_properties)
    body = b"".join(struct.pack(codes, *row) for row in rows)
    for face in lists:
        for part, code in zip(face, "if", strict=False):
            body += struct.pack(f"{order}B{len(part)}{code}", len(part), *part)
    return text + body


XYZ = [("float", "x"), ("float", "y"), ("float", "z")]
SQUARE = [(0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 0)]
FORMS = ["ascii", "binary_little_endian", "binary_big_endian"]


@pytest.mark.parametrize("form", FORMS)
def test_ply_polygons_of_different_sizes_become_triangles_and_vertices_keep_their_order(tmp_path, form):
    path = tmp_path / "obj_000001.ply"
    path.write_bytes(ply(form, XYZ, SQUARE, [(0, 1, 2), (0, 1, 2, 3), (0, 2, 3), (1, 2, 3)]))
    model = read_model(path, 1)
    assert (model.vertices * 1000).tolist() == [list(map(float, row)) for row in SQUARE]
    assert model.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 2, 3], [1, 2, 3]]
    assert model.faces.dtype == np.int32


@pytest.mark.parametrize("form", FORMS)
def test_ply_normals_colours_and_texture(tmp_path, form):
    properties = [*XYZ, ("float", "nx"), ("float", "ny"), ("float", "nz"), ("uchar", "red"), ("uchar", "green")]
    properties += [("uchar", "blue"), ("uchar", "alpha"), ("float", "texture_u"), ("float", "texture_v")]
    rows = [(*row, 0, 0, 2, 255, 128, 0, 255, row[0] / 10, row[1] / 10) for row in SQUARE]
    path = tmp_path / "obj_000001.ply"
    path.write_bytes(ply(form, properties, rows, [(0, 1, 2), (0, 2, 3)], texture="obj_000001.png"))
    write_image(tmp_path / "obj_000001.png", 50, (4, 4, 3))
    model = read_model(path, 1)
    assert model.normals is not None
    assert model.normals[0].tolist() == [0, 0, 1]
    assert model.colors is not None
    assert model.colors[3].tolist() == [255, 128, 0]
    assert model.texture_uv is not None
    assert model.texture_uv.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert model.texture is not None
    assert model.texture.shape == (4, 4, 3)
    plain = read_model(path, 1, appearance=False)
    assert plain.colors is None
    assert plain.texture is None
    assert plain.texture_uv is None


@pytest.mark.parametrize("form", FORMS)
def test_ply_texture_coordinates_of_corners_double_only_the_vertices_of_seams(tmp_path, form):
    faces = [((0, 1, 2), (0, 0, 1, 0, 1, 1)), ((0, 2, 3), (0.5, 0, 1, 1, 0, 1))]
    path = tmp_path / "obj_000001.ply"
    path.write_bytes(ply(form, XYZ, SQUARE, faces))
    model = read_model(path, 1)
    assert len(model.vertices) == 5
    assert (model.vertices[:4] * 1000).tolist() == [list(map(float, row)) for row in SQUARE]
    assert model.vertices[4].tolist() == model.vertices[0].tolist()
    assert model.texture_uv is not None
    assert model.texture_uv[model.faces].tolist() == [[[0, 0], [1, 0], [1, 1]], [[0.5, 0], [1, 1], [0, 1]]]
    assert len(read_model(path, 1, appearance=False).vertices) == 4


def test_gltf_models_are_in_metres(tmp_path):
    import trimesh

    path = tmp_path / "obj_000001.glb"
    trimesh.creation.box((0.1, 0.2, 0.2)).export(path)
    assert read_model(path, 1).diameter == pytest.approx(0.3)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(FormatError, match=r"obj_000001\.glb: is no readable glTF mesh"):
        read_model(path, 1)


def test_a_texture_name_cannot_lead_out_of_the_folder(tmp_path):
    write_image(tmp_path / "secret.png", 1, (4, 4, 3))
    (tmp_path / "models").mkdir()
    path = tmp_path / "models" / "obj_000001.ply"
    properties = [*XYZ, ("float", "texture_u"), ("float", "texture_v")]
    path.write_bytes(ply("ascii", properties, [(*row, 0, 0) for row in SQUARE], [(0, 1, 2)], texture="../secret.png"))
    assert read_model(path, 1).texture is None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "does not begin with 'ply'"),
        (b"\x89PNG", "does not begin with 'ply', so it is no PLY mesh"),
        (TETRAHEDRON[:60], "the header has no end_header"),
        (TETRAHEDRON[:-30], "face ends after 0 of 4 rows; it is cut off, get it again"),
        (ply("binary_little_endian", XYZ, SQUARE, [(0, 1, 2)])[:-8], "face ends after 0 of 1 rows; it is cut off"),
        (ply("binary_little_endian", XYZ, SQUARE, [(0, 1, 2)])[:-20], "vertex ends after 3 of 4 rows; it is cut off"),
        (TETRAHEDRON.replace(b"element face 4", b"element face 0"), "has no faces; a point cloud cannot be rendered"),
        (TETRAHEDRON.replace(b"3 0 2 1", b"3 0 2 9"), "a face names vertex 9 of 4"),
        (TETRAHEDRON.replace(b"30 0 0", b"nan 0 0"), "a vertex that is NaN"),
        (TETRAHEDRON.replace(b"30 0 0", b"3x 0 0"), "holds what is no number"),
        (
            TETRAHEDRON.replace(b"property float x", b"property real x"),
            "header line 'property real x' is not understood",
        ),
    ],
)
def test_a_damaged_model_is_named_and_the_others_stay(root, content, message):
    path = root / "models" / "obj_000002.ply"
    path.write_bytes(content)
    dataset = open_dataset(root)
    with pytest.raises(FormatError, match=message) as caught:
        dataset.model(2)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert dataset.model(1).obj_id == 1


def test_an_object_without_a_model_is_named_with_those_that_have_one(root):
    with pytest.raises(UnknownIdError, match="object 31 is not in parts/models; available: 1"):
        open_dataset(root).model(31)
    shutil.rmtree(root / "models")
    with pytest.raises(UnknownIdError, match="which has no models folder; available: none"):
        open_dataset(root).model(1)


def test_bad_models_info_is_named(root):
    write_json(root / "models" / "models_info.json", {"1": {"diameter": -3}})
    with pytest.raises(FormatError, match="diameter of object 1 is -3; expected millimetres above 0"):
        open_dataset(root).model(1)


def test_the_diameter_is_exact_also_of_flat_meshes():
    points = np.random.default_rng(0).normal(size=(300, 3))
    brute = max(np.linalg.norm(points - point, axis=1).max() for point in points)
    assert diameter_of(points) == pytest.approx(brute, rel=1e-15)
    assert diameter_of(points * [1, 1, 0]) == pytest.approx(
        max(np.linalg.norm((points - point)[:, :2], axis=1).max() for point in points), rel=1e-15
    )


def test_unknown_ids_are_named_with_those_available(root):
    dataset = open_dataset(root)
    with pytest.raises(UnknownIdError, match="scene 4 is not in parts/test; available: 3, 12"):
        dataset.image_ids(4)
    with pytest.raises(UnknownIdError, match="image 9 is not in scene 3 of parts/test; available: 0, 1"):
        dataset.rgb(ImageKey(3, 9))
    with pytest.raises(UnknownIdError, match=r"split val is not in .*parts; available: test"):
        open_dataset(root, "val")


def test_folders_that_are_no_dataset(tmp_path, root):
    with pytest.raises(MissingFileError, match="absent: no such folder; give the folder of a BOP dataset"):
        open_dataset(tmp_path / "absent")
    (tmp_path / "file").touch()
    with pytest.raises(MissingFileError, match="file: is not a folder"):
        open_dataset(tmp_path / "file")
    with pytest.raises(MissingFileError, match="no split holds a scene; expected folders such as test/000001"):
        open_dataset(root / "models")
    with pytest.raises(MissingFileError, match=r"test: is a split itself; open its parent .*parts with split test"):
        open_dataset(root / "test")


@pytest.mark.parametrize("name", ["scene_gt.json", "scene_camera.json"])
def test_a_file_cut_in_half_costs_its_scene_only(root, name):
    path = root / "test" / "000003" / name
    path.write_text(path.read_text()[:40])
    dataset = open_dataset(root)
    access = dataset.ground_truth if name == "scene_gt.json" else dataset.camera
    for _ in range(2):
        with pytest.raises(FormatError, match=rf"000003.{name}: is no complete JSON .*; get the file again"):
            access(ImageKey(3, 0))
    assert len(dataset.ground_truth(ImageKey(12, 0))) == 1
    assert dataset.camera(ImageKey(12, 0)).width == 8
    assert Target(12, 0, 1, 1) in dataset.targets()
    assert [str(path) in str(problem) for problem in dataset.problems()] == [True]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0]}, "cam_R_m2c has 8 numbers; expected 9"),
        ({"cam_t_m2c": [0, float("nan"), 700]}, "cam_t_m2c holds nan; expected 3 finite numbers"),
        ({"cam_t_m2c": [0, None, 700]}, "cam_t_m2c holds None"),
        ({"cam_R_m2c": "identity"}, "cam_R_m2c is 'identity'; expected 9 numbers"),
        ({"obj_id": None}, "obj_id is None; expected a whole number"),
    ],
)
def test_a_damaged_annotation_costs_its_image_only(root, change, message):
    write_json(root / "test" / "000003" / "scene_gt.json", {"0": [ANNOTATION, ANNOTATION | change], "1": [ANNOTATION]})
    dataset = open_dataset(root)
    with pytest.raises(FormatError, match=f"image 0, annotation 1: {message}") as caught:
        dataset.ground_truth(ImageKey(3, 0))
    assert str(root / "test" / "000003" / "scene_gt.json") in str(caught.value)
    assert len(dataset.ground_truth(ImageKey(3, 1))) == 1
    assert Target(3, 0, 1, 1) not in dataset.targets()
    assert Target(3, 1, 1, 1) in dataset.targets()
    assert [str(problem) for problem in dataset.problems()] == [str(caught.value)]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({}, "image 0: cam_K is missing; add its 9 numbers"),
        ({"cam_K": K[:8]}, "image 0: cam_K has 8 numbers; expected 9"),
        ({"cam_K": [0.0, *K[1:]]}, "cam_K has a focal length of 0"),
        ({"cam_K": K, "depth_scale": 0}, "depth_scale is 0; expected the millimetres"),
        ({"cam_model": {"projection_model_type": "FISHEYE624"}}, "cam_model and no cam_K; undistort the images"),
        ([], r"image 0 holds \[\]; expected an object"),
    ],
)
def test_a_damaged_camera_costs_its_image_only(root, entry, message):
    write_json(root / "test" / "000003" / "scene_camera.json", {"0": entry, "1": CAMERA})
    dataset = open_dataset(root)
    with pytest.raises(FormatError, match=message):
        dataset.camera(ImageKey(3, 0))
    assert dataset.camera(ImageKey(3, 1)).K.ravel().tolist() == K
    assert dataset.rgb(ImageKey(3, 0)) is not None


def test_an_image_without_a_camera_is_named(root):
    write_json(root / "test" / "000003" / "scene_camera.json", {"1": CAMERA})
    with pytest.raises(FormatError, match=r"scene_camera\.json: image 0 has no entry; add its cam_K"):
        open_dataset(root).camera(ImageKey(3, 0))
    (root / "test" / "000003" / "scene_camera.json").unlink()
    with pytest.raises(FormatError, match=r"scene_camera\.json: no such file"):
        open_dataset(root).camera(ImageKey(3, 0))


@pytest.mark.parametrize("content", [b"", b"no image", b"half"])
def test_an_image_that_is_none_is_named_and_the_others_stay(root, content):
    path = root / "test" / "000003" / "rgb" / "000000.png"
    path.write_bytes(path.read_bytes()[:50] if content == b"half" else content)
    dataset = open_dataset(root)
    with pytest.raises(FormatError, match=r"rgb.000000\.png: is (empty|no image or is cut off) \(\d+ bytes\)"):
        dataset.rgb(ImageKey(3, 0))
    assert dataset.rgb(ImageKey(3, 1)) is not None
    assert len(dataset.ground_truth(ImageKey(3, 0))) == 1


def test_a_colour_image_in_place_of_depth_is_named(root):
    write_image(root / "test" / "000003" / "depth" / "000000.png", 5, (6, 8, 3))
    with pytest.raises(FormatError, match=r"depth.000000\.png: has 3 channels; a depth image has one"):
        open_dataset(root).depth(ImageKey(3, 0))


def test_info_that_does_not_match_is_reported_and_ignored(root):
    write_json(root / "test" / "000003" / "scene_gt_info.json", {"0": [], "1": [{"visib_fract": 0.3}]})
    dataset = open_dataset(root)
    assert dataset.ground_truth(ImageKey(3, 0))[0].visible_fraction is None
    assert dataset.ground_truth(ImageKey(3, 1))[0].visible_fraction == 0.3
    assert "image 0 has 0 entries for 1 annotations" in str(dataset.problems()[0])


@pytest.mark.parametrize(
    ("content", "message"),
    [({"a": 1}, "expected a list of targets"), ([{"scene_id": 3}], "target 0: im_id is None; expected a whole number")],
)
def test_a_bad_list_of_targets_is_named(root, content, message):
    write_json(root / "test_targets_bop19.json", content)
    with pytest.raises(FormatError, match=message):
        open_dataset(root).targets()


def test_threads_share_one_dataset_and_a_model_is_read_once(root, monkeypatch):
    dataset, reads, begin = open_dataset(root), [], threading.Barrier(8)
    read_ply = models_module.read_ply

    def slow_read(path):
        reads.append(path)
        time.sleep(0.02)  # long enough for the other threads to ask as well
        return read_ply(path)

    monkeypatch.setattr(models_module, "read_ply", slow_read)
    found = []

    def use():
        begin.wait()
        found.append((dataset.model(1), dataset.targets()))

    threads = [threading.Thread(target=use) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(reads) == 1
    assert all(model is found[0][0] and targets == found[0][1] for model, targets in found)


def test_the_table_knows_all_datasets_of_the_thesis_and_later_ones():
    names = "lm lmo tless itodd hb ycbv ruapc icbin icmi tudl tyol hope hopev2 handal hot3d ipd xyzibd itoddmv"
    assert set(names.split()) == set(known_datasets())
    counts = {"lm": 15, "lmo": 8, "tless": 30, "itodd": 28, "hb": 33, "ycbv": 21, "ruapc": 14, "icbin": 2}
    counts |= {"icmi": 6, "tudl": 3, "tyol": 21}  # thesis, table of dataset parameters
    assert {name: len(dataset_facts(name).obj_ids) for name in counts} == counts
    core = {name for name in known_datasets() if dataset_facts(name).core}
    assert core == {"lmo", "tless", "tudl", "icbin", "itodd", "hb", "ycbv"}
    for name in known_datasets():
        facts = dataset_facts(name)
        assert facts.known
        assert set(facts.symmetric_obj_ids) <= set(facts.obj_ids)
        assert facts.test_split in facts.splits
    assert dataset_facts("itodd").vsd_delta == 0.005
    assert dataset_facts("LMO").depth_range == pytest.approx((0.34631, 1.49984))


def test_an_unknown_dataset_has_sensible_facts():
    facts = dataset_facts("my_parts")
    assert (facts.known, facts.obj_ids, facts.test_split, facts.vsd_delta) == (False, (), "test", 0.015)
    assert (facts.eval_models, facts.display_models) == ("models_eval", "models")


def annotated(im_id=5, depth=True):
    rng = np.random.default_rng(im_id)
    pose = np.eye(4)
    pose[:3, :3] += 0.01 * rng.normal(size=(3, 3))
    pose[:3, 3] = rng.normal(size=3)
    world = np.linalg.inv(pose)
    world[3] = [0, 0, 0, 1]
    masks = np.zeros((2, 6, 8), bool)
    masks[0, 1:5, 2:7] = True
    masks[1] = masks[0]
    masks[1, :, :4] = False
    raw = rng.integers(0, 65536, (6, 8)).astype(np.float32)
    raw[3, 3] = 0
    return AnnotatedImage(
        Image(
            ImageKey(9, im_id),
            Camera(np.array(K).reshape(3, 3), 8, 6, world),
            rng.integers(0, 256, (6, 8, 3)).astype(np.uint8),
            raw * np.float32(0.0001) if depth else None,
        ),
        [GroundTruth(4, pose, 0)],
        [masks[0]],
        [masks[1]],
    )


def test_a_written_scene_reads_back_as_it_was(tmp_path):
    given = [annotated(5), annotated(900)]
    write_scene(tmp_path, "train_pbr", 9, iter(given), depth_scale_mm=0.1)
    dataset = open_dataset(tmp_path)
    assert list(dataset.images()) == [ImageKey(9, 5), ImageKey(9, 900)]
    for item in given:
        key = item.image.key
        read = dataset.image(key)
        assert np.array_equal(read.rgb, item.image.rgb)
        assert np.array_equal(read.depth, item.image.depth)
        assert np.array_equal(read.camera.K, item.image.camera.K)
        assert read.camera.world_from_camera == pytest.approx(item.image.camera.world_from_camera, abs=1e-12)
        truth = dataset.ground_truth(key)[0]
        assert truth.camera_from_model == pytest.approx(item.ground_truth[0].camera_from_model, abs=1e-9)
        assert np.array_equal(truth.camera_from_model[:3, :3], item.ground_truth[0].camera_from_model[:3, :3])
        assert (truth.visible_fraction, truth.visible_pixels, truth.bbox_visible) == (0.6, 12, (4, 1, 2, 3))
        assert np.array_equal(dataset.mask(key, 0), item.visible_masks[0])
        assert np.array_equal(dataset.mask(key, 0, visible=False), item.masks[0])
    info = json.loads((tmp_path / "train_pbr" / "000009" / "scene_gt_info.json").read_text())["5"][0]
    assert (info["px_count_all"], info["px_count_valid"], info["bbox_obj"]) == (20, 19, [2, 1, 4, 3])


def test_json_has_a_line_for_each_image_and_later_images_are_added(tmp_path):
    folder = write_scene(tmp_path, "train", 9, [annotated(5)])
    write_scene(tmp_path, "train", 9, [annotated(2), annotated(5, depth=False)])
    lines = (folder / "scene_gt.json").read_text().splitlines()
    assert [line[:6] for line in lines] == ["{", '  "2":', '  "5":', "}"]
    assert not [path for path in folder.rglob(".*")]  # no temporary files stay


def test_depth_that_does_not_fit_is_refused_with_the_limit(tmp_path):
    item = annotated(5)
    item.image.depth[0, 0] = 7.2
    with pytest.raises(
        InputError, match=r"depth from 0 to 7.2 m does not fit in 0 to 6.553 m; take a depth_scale above"
    ):
        write_scene(tmp_path, "train", 9, [item], depth_scale_mm=0.1)


def test_lmo_is_read_and_rewriting_its_poses_changes_no_number(lmo, tmp_path):
    dataset = open_dataset(lmo)
    assert (dataset.name, dataset.split, dataset.scene_ids) == ("lmo", "test", (2,))
    assert dataset.obj_ids == (1, 5, 6, 8, 9, 10, 11, 12)
    assert len(dataset.image_ids(2)) == 50
    assert len(dataset.targets()) == 365
    assert dataset.targets()[0] == Target(2, 3, 1, 1)
    assert dataset.facts.core
    assert dataset.depth(ImageKey(2, 3)) is not None
    assert dataset.depth(ImageKey(2, 36)) is None
    assert [len(dataset.model(obj_id).symmetries) for obj_id in (9, 10, 11)] == [1, 2, 2]
    assert dataset.model(1).diameter == pytest.approx(0.102099)
    assert dataset.model(1, "display").colors is not None
    assert dataset.problems() == ()
    truths = {im_id: dataset.ground_truth(ImageKey(2, im_id)) for im_id in dataset.image_ids(2)}
    write_ground_truth(tmp_path / "scene_gt.json", truths)
    assert json.loads((tmp_path / "scene_gt.json").read_text()) == json.loads(
        (lmo / "test" / "000002" / "scene_gt.json").read_text()
    )


def test_lmo_models_agree_with_trimesh(lmo):
    import trimesh

    for path in sorted((lmo / "models_eval").glob("*.ply")):
        ours, theirs = read_model(path, 1), trimesh.load_mesh(path, process=False)
        assert np.array_equal(ours.vertices, np.asarray(theirs.vertices, float) / 1000)
        assert np.array_equal(ours.faces, theirs.faces)


def test_depth_scales_of_ycbv_differ_by_scene(ycbv):
    dataset = open_dataset(ycbv)
    assert dataset.scene_ids == (1, 901)
    assert dataset.depth_scale_mm(ImageKey(1, 1)) == 0.1
    assert dataset.depth_scale_mm(ImageKey(901, 0)) == 1.0
    medians = [np.median(depth[depth > 0]) for key in dataset.images() if (depth := dataset.depth(key)) is not None]
    assert len(medians) == 4
    assert all(0.5 < median < 1.5 for median in medians)
    assert dataset.has_ground_truth(1)
    assert not dataset.has_ground_truth(901)
    assert {target.scene_id for target in dataset.targets()} == {1}


def test_icbin_has_no_ground_truth_and_is_usable(shared_data):
    dataset = open_dataset(shared_data / "icbin")
    assert dataset.targets() == ()
    assert dataset.problems() == ()
    image = dataset.image(ImageKey(1, 0))
    assert image.rgb is not None
    assert image.camera.K[0, 0] == 550
