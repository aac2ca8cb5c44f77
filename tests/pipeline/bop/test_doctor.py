import io
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from inspector.commands.doctor import DoctorConfig, run
from pipeline.bop.doctor import CHECKS, Finding, diagnose
from pipeline.bop.doctor.cameras import intrinsics_fault
from pipeline.bop.doctor.depth import most_frequent_ratio
from pipeline.bop.models import read_model
from pipeline.exceptions import MissingFileError, UnknownIdError
from pipeline.geometry import inverse, transform
from pipeline.rendering import render_scene
from pipeline.scene import Camera

WIDTH, HEIGHT = 160, 120
K = np.array([[150.0, 0, 81.0], [0, 151.0, 59.0], [0, 0, 1]])
DEPTH_SCALE_MM = 0.5
IMAGES = (0, 3, 4, 7)
SIZES_MM = {1: (80.0, 60.0, 40.0), 5: (50.0, 90.0, 70.0)}


@pytest.fixture(scope="session")
def healthy(tmp_path_factory) -> Path:
    """A sound dataset: two boxes that stand still before a wall, seen by a moving camera from four places."""
    root = tmp_path_factory.mktemp("doctor") / "made"
    (root / "models").mkdir(parents=True)
    write_json(root / "models/models_info.json", {obj_id: write_box(root, obj_id) for obj_id in SIZES_MM})
    models = {obj_id: read_model(root / f"models/obj_{obj_id:06d}.ply", obj_id) for obj_id in SIZES_MM}
    world_from_model = {
        1: transform(rotation((1, 2, 3), 0.8), np.array([-0.06, 0.01, 0.0])),
        5: transform(rotation((-2, 1, 1), 1.7), np.array([0.06, -0.01, 0.03])),
    }
    scene = root / "test/000002"
    cameras, annotations, infos = {}, {}, {}
    for im_id, angle in zip(IMAGES, (-0.25, -0.1, 0.1, 0.3), strict=True):
        camera_from_world = transform(rotation((0.3, 1, 0.1), angle), np.array([0.02 * angle, 0.0, 0.6 + 0.2 * angle]))
        poses = {obj_id: camera_from_world @ pose for obj_id, pose in world_from_model.items()}
        scene_rendering = render_scene(
            [(models[i], poses[i]) for i in poses], Camera(K, WIDTH, HEIGHT), pixel_center=0.0
        )
        depth = np.where(scene_rendering.depth > 0, scene_rendering.depth, 0.9)
        write_png(scene / f"depth/{im_id:06d}.png", (depth * 1000.0 / DEPTH_SCALE_MM).round().astype(np.uint16))
        write_png(scene / f"rgb/{im_id:06d}.png", np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
        infos[im_id] = []
        for index, alone in enumerate(scene_rendering.renderings):
            visible = scene_rendering.instance_ids == index
            write_png(scene / f"mask/{im_id:06d}_{index:06d}.png", alone.mask.astype(np.uint8) * 255)
            write_png(scene / f"mask_visib/{im_id:06d}_{index:06d}.png", visible.astype(np.uint8) * 255)
            infos[im_id].append(gt_info(alone.mask, visible))
        cameras[im_id] = {
            "cam_K": K.ravel().tolist(),
            "depth_scale": DEPTH_SCALE_MM,
            "cam_R_w2c": camera_from_world[:3, :3].ravel().tolist(),
            "cam_t_w2c": (camera_from_world[:3, 3] * 1000.0).tolist(),
        }
        annotations[im_id] = [annotation(obj_id, pose) for obj_id, pose in poses.items()]
    write_json(scene / "scene_camera.json", cameras)
    write_json(scene / "scene_gt.json", annotations)
    write_json(scene / "scene_gt_info.json", infos)
    write_json(
        root / "camera.json", {"width": WIDTH, "height": HEIGHT, "fx": 150.0, "fy": 151.0, "cx": 81.0, "cy": 59.0}
    )
    targets = [{"scene_id": 2, "im_id": i, "obj_id": o, "inst_count": 1} for i in IMAGES for o in SIZES_MM]
    write_json(root / "test_targets_bop19.json", targets)
    return root


@pytest.fixture
def dataset(healthy, tmp_path) -> Path:
    """A copy of the sound dataset, to be harmed."""
    return Path(shutil.copytree(healthy, tmp_path / "made"))


def rotation(axis, angle: float) -> np.ndarray:
    axis = np.array(axis, float)
    return cv2.Rodrigues(axis / np.linalg.norm(axis) * angle)[0]


def write_box(root: Path, obj_id: int, shift_mm: tuple[float, float, float] = (0, 0, 0), unit: float = 1.0) -> dict:
    """Write a box as a PLY and return its entry in models_info.json."""
    size = np.array(SIZES_MM[obj_id])
    corners = (np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2 + shift_mm) * unit
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    write_ply(root / f"models/obj_{obj_id:06d}.ply", corners, quads)
    names = ("min_x", "min_y", "min_z", "size_x", "size_y", "size_z")
    return {"diameter": float(np.linalg.norm(size) * unit)} | dict(
        zip(names, [*corners.min(0), *(size * unit)], strict=True)
    )


def write_ply(path: Path, vertices: np.ndarray, quads: list[tuple[int, ...]]) -> None:
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(quads)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, vertex)) for vertex in vertices.tolist()]
    lines += [" ".join(map(str, (len(quad), *quad))) for quad in quads]
    path.write_text("\n".join(lines) + "\n")


def annotation(obj_id: int, pose: np.ndarray) -> dict:
    return {"obj_id": obj_id, "cam_R_m2c": pose[:3, :3].ravel().tolist(), "cam_t_m2c": (pose[:3, 3] * 1000.0).tolist()}


def gt_info(mask: np.ndarray, visible: np.ndarray) -> dict:
    rows, columns = np.nonzero(visible)
    box = [columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1]
    return {
        "px_count_all": int(mask.sum()),
        "px_count_visib": int(visible.sum()),
        "visib_fract": float(visible.sum() / mask.sum()),
        "bbox_visib": [int(value) for value in box],
    }


def write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def write_json(path: Path, content) -> None:
    path.write_text(json.dumps(content, default=float))


def edit(path: Path, change: Callable[[dict], object]) -> None:
    """Change a JSON file in place."""
    content = json.loads(path.read_text())
    change(content)
    write_json(path, content)


def edit_poses(root: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change every ground-truth pose (4x4, millimetres)."""

    def change_all(content: dict) -> None:
        for entry in (entry for entries in content.values() for entry in entries):
            pose = change(transform(np.reshape(entry["cam_R_m2c"], (3, 3)), np.array(entry["cam_t_m2c"])))
            entry["cam_R_m2c"], entry["cam_t_m2c"] = pose[:3, :3].ravel().tolist(), pose[:3, 3].tolist()

    edit(scene_of(root) / "scene_gt.json", change_all)


def edit_cameras(root: Path, change: Callable[[dict], object]) -> None:
    edit(scene_of(root) / "scene_camera.json", lambda content: [change(camera) for camera in content.values()])


def scene_of(root: Path) -> Path:
    return root / "test/000002"


def of_severity(findings: list[Finding], *severities: str) -> list[Finding]:
    return [finding for finding in findings if finding.severity in severities]


# Each of these plants one fault.


def models_in_metres(root: Path) -> None:
    write_json(root / "models/models_info.json", {obj_id: write_box(root, obj_id, unit=0.001) for obj_id in SIZES_MM})


def one_model_in_metres(root: Path) -> None:
    write_box(root, 5, unit=0.001)


def origin_in_a_corner(root: Path) -> None:
    """Model and poses are shifted together, so that nothing else is wrong."""
    shift = np.array([40.0, 30.0, 20.0])
    edit(root / "models/models_info.json", lambda info: info.update({"1": write_box(root, 1, tuple(shift))}))
    edit(
        scene_of(root) / "scene_gt.json",
        lambda content: [shift_pose(entry, shift) for entries in content.values() for entry in entries],
    )


def shift_pose(entry: dict, shift: np.ndarray) -> None:
    if entry["obj_id"] == 1:
        entry["cam_t_m2c"] = (np.array(entry["cam_t_m2c"]) - np.reshape(entry["cam_R_m2c"], (3, 3)) @ shift).tolist()


def model_without_faces(root: Path) -> None:
    write_ply(root / "models/obj_000001.ply", np.eye(3) * 50, [])


def model_cut_off(root: Path) -> None:
    path = root / "models/obj_000001.ply"
    path.write_text(path.read_text()[:-60])


def stray_vertices(root: Path) -> None:
    path = root / "models/obj_000001.ply"
    lines = path.read_text().replace("element vertex 8", "element vertex 9").splitlines()
    end = lines.index("end_header")
    path.write_text("\n".join([*lines[: end + 9], "0 0 70", *lines[end + 9 :]]) + "\n")
    edit(root / "models/models_info.json", lambda info: info["1"].update(size_z=90.0))


def wrong_diameter(root: Path) -> None:
    edit(root / "models/models_info.json", lambda info: info["5"].update(diameter=100.0))


def poses_in_metres(root: Path) -> None:
    edit_poses(root, lambda pose: transform(pose[:3, :3], pose[:3, 3] / 1000.0))


def stretched_rotations(root: Path) -> None:
    edit_poses(root, lambda pose: transform(pose[:3, :3] * 1.1, pose[:3, 3]))


def mirrored_rotations(root: Path) -> None:
    edit_poses(root, lambda pose: transform(pose[:3, :3] @ np.diag([1, 1, -1]), pose[:3, 3]))


def transposed_rotations(root: Path) -> None:
    edit_poses(root, lambda pose: transform(pose[:3, :3].T, pose[:3, 3]))


def opengl_poses(root: Path) -> None:
    edit_poses(root, lambda pose: np.diag([1.0, -1.0, -1.0, 1.0]) @ pose)


def nan_pose(root: Path) -> None:
    edit(scene_of(root) / "scene_gt.json", lambda content: content["3"][0].update(cam_t_m2c=[float("nan"), 0, 500]))


def pose_aside(root: Path) -> None:
    edit(scene_of(root) / "scene_gt.json", lambda content: content["3"][0].update(cam_t_m2c=[2000.0, 0, 600]))
    edit(scene_of(root) / "scene_gt_info.json", lambda content: content["3"][0].update(visib_fract=0.9))


def depth_scale_times_ten(root: Path) -> None:
    edit_cameras(root, lambda camera: camera.update(depth_scale=10 * DEPTH_SCALE_MM))


def depth_scale_forgotten(root: Path) -> None:
    edit_cameras(root, lambda camera: camera.pop("depth_scale"))


def depth_scale_3_percent_off(root: Path) -> None:
    edit_cameras(root, lambda camera: camera.update(depth_scale=1.03 * DEPTH_SCALE_MM))


def no_ground_truth_and_wrong_scale(root: Path) -> None:
    (scene_of(root) / "scene_gt.json").unlink()
    edit_cameras(root, lambda camera: camera.update(depth_scale=1000 * DEPTH_SCALE_MM))


def camera_to_world(root: Path) -> None:
    def invert(camera: dict) -> None:
        pose = inverse(transform(np.reshape(camera["cam_R_w2c"], (3, 3)), np.array(camera["cam_t_w2c"])))
        camera.update(cam_R_w2c=pose[:3, :3].ravel().tolist(), cam_t_w2c=pose[:3, 3].tolist())

    edit_cameras(root, invert)


def world_in_metres(root: Path) -> None:
    edit_cameras(root, lambda camera: camera.update(cam_t_w2c=(np.array(camera["cam_t_w2c"]) / 1000.0).tolist()))


def k_of_twice_the_size(root: Path) -> None:
    edit_cameras(root, lambda camera: camera.update(cam_K=[2 * value for value in camera["cam_K"][:8]] + [1]))


def k_transposed(root: Path) -> None:
    edit_cameras(root, lambda camera: camera.update(cam_K=np.reshape(camera["cam_K"], (3, 3)).T.ravel().tolist()))


def focal_length_in_millimetres(root: Path) -> None:
    edit_cameras(root, lambda camera: camera.update(cam_K=[4.2, 0, 81, 0, 4.2, 59, 0, 0, 1]))


def principal_point_outside(root: Path) -> None:
    edit_cameras(root, lambda camera: camera.update(cam_K=[150, 0, 200, 0, 151, 59, 0, 0, 1]))


def camera_json_of_another_size(root: Path) -> None:
    edit(root / "camera.json", lambda camera: camera.update(width=640, height=480))


def camera_json_cut_off(root: Path) -> None:
    (root / "camera.json").write_text('{"width": 160')


def images_missing(root: Path) -> None:
    for im_id in IMAGES[1:3]:
        (scene_of(root) / f"rgb/{im_id:06d}.png").unlink()


def image_without_camera(root: Path) -> None:
    edit(scene_of(root) / "scene_camera.json", lambda content: content.pop("4"))
    edit(scene_of(root) / "scene_gt.json", lambda content: content.pop("4"))
    edit(
        root / "test_targets_bop19.json",
        lambda targets: targets.__setitem__(slice(None), [t for t in targets if t["im_id"] != 4]),
    )


def annotation_without_camera(root: Path) -> None:
    edit(scene_of(root) / "scene_gt.json", lambda content: content.update({"99": content["3"]}))


def image_without_annotation(root: Path) -> None:
    edit(scene_of(root) / "scene_gt.json", lambda content: content.pop("7"))


def png_cut_off(root: Path) -> None:
    path = scene_of(root) / "rgb/000003.png"
    path.write_bytes(path.read_bytes()[:-40])


def image_is_text(root: Path) -> None:
    (scene_of(root) / "rgb/000003.png").write_text("no picture")


def depth_of_8_bits(root: Path) -> None:
    for path in (scene_of(root) / "depth").iterdir():
        write_png(path, (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) // 16).astype(np.uint8))


def depth_of_another_size(root: Path) -> None:
    for path in (scene_of(root) / "depth").iterdir():
        write_png(path, cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::2, ::2])


def depth_all_zero(root: Path) -> None:
    for path in (scene_of(root) / "depth").iterdir():
        write_png(path, np.zeros((HEIGHT, WIDTH), np.uint16))


def json_cut_in_half(root: Path) -> None:
    path = scene_of(root) / "scene_gt.json"
    path.write_text(path.read_text()[:200])


def unknown_object(root: Path) -> None:
    edit(scene_of(root) / "scene_gt.json", lambda content: content["3"][0].update(obj_id=31))


def repeated_annotation(root: Path) -> None:
    edit(scene_of(root) / "scene_gt.json", lambda content: content["3"].append(content["3"][0]))
    edit(scene_of(root) / "scene_gt_info.json", lambda content: content["3"].append(content["3"][0]))
    for folder in ("mask", "mask_visib"):
        shutil.copy(scene_of(root) / folder / "000003_000000.png", scene_of(root) / folder / "000003_000002.png")


def target_in_absent_image(root: Path) -> None:
    edit(root / "test_targets_bop19.json", lambda targets: targets.append(targets[0] | {"im_id": 1000}))


def target_of_absent_object(root: Path) -> None:
    edit(root / "test_targets_bop19.json", lambda targets: targets.append(targets[0] | {"obj_id": 7}))


def mask_missing(root: Path) -> None:
    (scene_of(root) / "mask_visib/000003_000001.png").unlink()


def info_of_other_poses(root: Path) -> None:
    def double(content: dict) -> None:
        for info in (info for infos in content.values() for info in infos):
            info["px_count_visib"] *= 2

    edit(scene_of(root) / "scene_gt_info.json", double)


def poses_15_mm_off(root: Path) -> None:
    edit_poses(root, lambda pose: transform(pose[:3, :3], pose[:3, 3] + (0, 0, 15)))


PLANTED = [
    (models_in_metres, "model-units", "error", "Models in metres", "2 of 2 models have diameters of 0.108 to 0.124 mm", "multiply"),
    (one_model_in_metres, "model-units", "error", "Models in metres", "1 of 2 models have diameters of 0.124 mm", "multiply"),
    (origin_in_a_corner, "origins", "note", "Origins off-centre", "object 1 53.9 mm (50%)", "shift the vertices"),
    (model_without_faces, "models", "error", "Unreadable model", "has no faces", "triangle mesh"),
    (model_cut_off, "models", "error", "Unreadable model", "ends after 0 of 6 rows", "cut off"),
    (stray_vertices, "models", "warning", "Vertices without faces", "models/obj_000001.ply grows by", "remove vertices"),
    (wrong_diameter, "models-info", "error", "models_info.json disagrees", "object 5 diameter is 100 instead of 124.5 mm", "compute"),
    (poses_in_metres, "pose-units", "error", "Poses in metres", "8 of 8 poses are 0.", "multiply cam_t_m2c by 1000"),
    (stretched_rotations, "rotations", "error", "Rotations not orthonormal", "up to 2.1e-01", "nearest rotation"),
    (mirrored_rotations, "rotations", "error", "Mirrored rotations", "8 of 8 have a determinant of 0 or less", "negate one axis"),
    (transposed_rotations, "poses-depth", "error", "Poses in another convention", "if their rotations were transposed", "transposed"),
    (opengl_poses, "in-view", "error", "Objects behind the camera", "8 of 8 objects have z <= 0", "negate y and z"),
    (nan_pose, "json", "error", "Damaged annotations", "annotation 0", "mend or replace"),
    (pose_aside, "in-view", "warning", "Objects outside the image", "1 of 8 objects", "check cam_K"),
    (depth_scale_times_ten, "depth-scale", "error", "Wrong depth_scale", "depth is 10 times", "set depth_scale to 0.5"),
    (depth_scale_forgotten, "depth-scale", "error", "Wrong depth_scale", "depth is 2 times", "set depth_scale to 0.5"),
    (depth_scale_3_percent_off, "depth-scale", "warning", "Depth scale a little off", "depth is 1.03 times", "0.5 would fit"),
    (no_ground_truth_and_wrong_scale, "depth-scale", "error", "Implausible depth_scale", "median depth 9e+05 mm", "set depth_scale"),
    (camera_to_world, "world-direction", "error", "World poses are inverted", "objects wander", "write the inverse"),
    (world_in_metres, "world-direction", "error", "World poses are in metres", "objects wander", "multiply cam_t_w2c by 1000"),
    (k_of_twice_the_size, "intrinsics", "error", "cam_K is for another resolution", "images 2 times as large", "divide fx, fy, cx and cy by 2"),
    (k_transposed, "intrinsics", "error", "cam_K is transposed", "last row", "row by row"),
    (focal_length_in_millimetres, "intrinsics", "error", "Impossible focal length", "field of view of 174 degrees", "in pixels"),
    (principal_point_outside, "intrinsics", "error", "Principal point outside", "cx 200", "cropped"),
    (camera_json_of_another_size, "intrinsics", "warning", "camera.json is of another size", "640x480, the images are 160x120", "correct"),
    (camera_json_cut_off, "intrinsics", "warning", "Unreadable camera.json", "no complete JSON", "again"),
    (images_missing, "image-files", "warning", "Missing images", "2 of 4 images in scene_camera.json have no image file", "inspector download"),
    (image_without_camera, "image-files", "warning", "Images without camera", "1 image on disk", "cam_K"),
    (annotation_without_camera, "image-ids", "error", "Annotated images without camera", "1 of 5 images", "image ids"),
    (image_without_annotation, "image-ids", "warning", "Images without annotation entry", "1 of 4 images", "empty list"),
    (png_cut_off, "image-content", "error", "Broken image files", "rgb/000003.png is cut off after", "again"),
    (image_is_text, "image-content", "error", "Broken image files", "is no PNG, JPEG or TIFF", "again"),
    (depth_of_8_bits, "image-content", "error", "Depth with 8 bits", "4 of 8 files", "16-bit PNG"),
    (depth_of_another_size, "image-content", "error", "Depth of another size", "80x60 against 160x120", "register"),
    (depth_all_zero, "image-content", "error", "Depth without any measurement", "4 of 4 depth images", "again"),
    (json_cut_in_half, "json", "error", "Damaged annotations", "no complete JSON", "mend"),
    (unknown_object, "object-ids", "error", "Annotated objects without model", "object 31 (1 times)", "correct obj_id"),
    (repeated_annotation, "duplicates", "warning", "Duplicate annotations", "scene 2 image 3 object 1", "remove the repeated"),
    (target_in_absent_image, "targets", "warning", "Targets in absent images", "scene 2 image 1000", "remove these targets"),
    (target_of_absent_object, "targets", "warning", "Targets without annotation", "object 7 (0 of 1)", "correct obj_id"),
    (mask_missing, "masks", "warning", "Missing masks", "1 of 16 masks", "inspector gt-info"),
    (info_of_other_poses, "gt-info", "warning", "scene_gt_info.json disagrees", "8 of 8 annotations", "inspector gt-info"),
    (poses_15_mm_off, "poses-depth", "warning", "Ground truth away from the depth", "object 1 15.", "align"),
]  # fmt: skip


def test_healthy_dataset_gives_no_finding_but_ok(healthy):
    findings = diagnose(healthy)
    assert of_severity(findings, "error", "warning", "note") == []
    assert {finding.check for finding in findings} == {check.id for check in CHECKS} - {"results"}


@pytest.mark.parametrize(
    ("plant", "check", "severity", "title", "evidence", "fix"), PLANTED, ids=[case[0].__name__ for case in PLANTED]
)
def test_planted_fault_is_found_and_no_other_error(dataset, plant, check, severity, title, evidence, fix):
    plant(dataset)
    findings = diagnose(dataset)
    found = [f for f in findings if f.check == check and f.severity == severity and f.title.startswith(title)]
    assert len(found) == 1, findings
    assert evidence in found[0].evidence
    assert fix in found[0].fix
    assert found[0].subject
    others = [finding for finding in of_severity(findings, "error") if finding not in found]
    assert others == []


def test_findings_come_worst_first_and_one_line_each(dataset):
    depth_scale_times_ten(dataset)
    images_missing(dataset)
    findings = diagnose(dataset)
    order = ["error", "warning", "note", "ok"]
    ranks = [order.index(finding.severity) for finding in findings]
    assert ranks == sorted(ranks)
    assert not any("\n" in text for finding in findings for text in finding.as_dict().values())


def test_what_a_fault_spoils_is_not_judged(dataset):
    poses_in_metres(dataset)
    notes = of_severity(diagnose(dataset), "note")
    assert {note.check for note in notes} >= {"depth-scale", "poses-depth", "world-direction"}
    assert all("pose-units" in note.evidence for note in notes if note.check == "depth-scale")


def test_nothing_on_disk_changes(dataset):
    before = {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in dataset.rglob("*")}
    diagnose(dataset, deep=True)
    assert {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in dataset.rglob("*")} == before


def test_deep_finds_a_flipped_byte_that_a_glance_does_not(dataset):
    path = scene_of(dataset) / "depth/000003.png"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    findings = of_severity(diagnose(dataset, deep=True), "error")
    assert [finding.check for finding in findings] == ["image-content"]
    assert "wrong checksum at byte" in findings[0].evidence


def test_results_are_examined_too(dataset, tmp_path):
    path = tmp_path / "method_made-test.csv"
    pose = "1 0 0 0 1 0 0 0 1"
    path.write_text(f"scene_id,im_id,obj_id,score,R,t,time\n2,3,1,0.9,{pose},0 0 0.6,-1\n2,3,9,0.9,{pose},0 0 600,-1\n")
    findings = {finding.title: finding for finding in diagnose(dataset, results=[path]) if finding.check == "results"}
    assert findings["Estimates in metres"].severity == "error"
    assert "1 of 2 poses are 0.6 mm" in findings["Estimates in metres"].evidence
    assert "object 9" in findings["Estimates of objects without model"].evidence


def test_unreadable_results_are_a_finding(dataset, tmp_path):
    findings = diagnose(dataset, results=[tmp_path / "absent.csv"])
    assert [finding.title for finding in of_severity(findings, "error")] == ["Unreadable results"]


def test_absent_dataset_and_split_are_errors_of_one_line(healthy, tmp_path):
    with pytest.raises(MissingFileError, match="no such folder"):
        diagnose(tmp_path / "nothing")
    with pytest.raises(UnknownIdError, match=r"split tset is not in .*; available: test"):
        diagnose(healthy, "tset")


def test_progress_is_reported_for_every_check(healthy):
    steps: list[tuple[int, int, str]] = []
    diagnose(healthy, progress=lambda *step: steps.append(step))
    assert [done for done, _, _ in steps] == list(range(len(CHECKS) + 1))


@pytest.mark.parametrize("factor", [0.1, 10.0, 1000.0, 0.001])
def test_ratio_is_robust_against_occluders(factor):
    rng = np.random.default_rng(1)
    surface = factor * rng.normal(1.0, 0.01, 600)
    occluders = factor * rng.uniform(0.2, 0.9, 400)
    ratio, share = most_frequent_ratio(np.concatenate([surface, occluders]))
    assert ratio == pytest.approx(factor, rel=0.01)
    assert 0.6 <= share < 0.8


@pytest.mark.parametrize(
    ("fx", "cx", "cy", "width", "height"),
    [
        (572.4, 325.3, 242.0, 640, 480),  # LM-O
        (1066.8, 313.0, 241.3, 640, 480),  # YCB-V
        (1075.7, 202.2, 228.5, 400, 400),  # T-LESS, training
        (1075.7, 367.1, 247.6, 720, 540),  # T-LESS, test, cropped
        (2992.6, 633.9, 489.6, 1280, 960),  # ITODD
        (550.0, 316.0, 244.0, 640, 480),  # IC-BIN
        (3981.98, 1954.1, 1103.6, 3840, 2160),  # IPD
    ],
)
def test_intrinsics_of_real_datasets_raise_no_alarm(fx, cx, cy, width, height):
    assert intrinsics_fault(np.array([[fx, 0, cx], [0, fx, cy], [0, 0, 1]]), width, height) is None


def test_lmo_findings_are_the_known_ones(lmo):
    findings = diagnose(lmo, results=[lmo / "results/megapose_lmo-test.csv"])
    assert of_severity(findings, "error") == []
    assert [finding.title for finding in of_severity(findings, "warning")] == ["Missing depth images"]
    assert "49 of 50 images" in of_severity(findings, "warning")[0].evidence
    notes = {finding.check: finding for finding in of_severity(findings, "note")}
    assert set(notes) == {"rotations", "masks", "gt-info"}
    assert "up to 9.6e-03" in notes["rotations"].evidence
    gaps = next(finding for finding in findings if finding.check == "poses-depth").evidence
    assert "object 5 6.1 mm" in gaps


def test_ycbv_findings_are_the_known_ones(ycbv):
    findings = diagnose(ycbv, results=sorted((ycbv / "results").glob("*.csv")))
    assert of_severity(findings, "error", "warning") == []
    assert {finding.check for finding in of_severity(findings, "note")} == {"json", "masks", "gt-info"}


def test_icbin_findings_are_the_known_ones(shared_data):
    findings = diagnose(shared_data / "icbin", results=[shared_data / "icbin/results/megapose_icbin-test.csv"])
    assert of_severity(findings, "error") == []
    assert [f.title for f in of_severity(findings, "warning")] == ["Estimates of objects without model"]
    assert [f.check for f in of_severity(findings, "note")] == ["json"]


def test_command_prints_a_table_and_exits_with_1_on_errors(dataset, tmp_path):
    depth_scale_times_ten(dataset)
    output = tmp_path / "findings.json"
    console = Console(file=io.StringIO(), width=160)
    assert run(DoctorConfig(dataset, json=output), console) == 1
    text = console.file.getvalue()
    assert "Wrong depth_scale" in text
    assert "made: 1 errors, 0 warnings" in text
    written = json.loads(output.read_text())
    assert written[0]["severity"] == "error"
    assert set(written[0]) == {"severity", "title", "subject", "evidence", "fix", "check"}


def test_command_exits_with_0_on_a_healthy_dataset(healthy):
    console = Console(file=io.StringIO(), width=160)
    assert run(DoctorConfig(healthy), console) == 0
    assert "0 errors, 0 warnings, 0 notes" in console.file.getvalue()
