"""A dataset small enough to be made in every test: two kinds of boxes, three annotated images, one without annotations.

scene 1  image 0: boxes 1, 1 and 2     image 1: box 1
scene 2  image 5: no ground truth
"""

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.bop.results import Results
from pipeline.bop.writer import AnnotatedImage, write_scene
from pipeline.geometry import transform
from pipeline.rendering import render_scene
from pipeline.scene import Camera, GroundTruth, Image, ImageKey, Model, PoseEstimate

CAMERA = Camera(np.array([[80.0, 0, 33.0], [0, 81.0, 22.0], [0, 0, 1]]), width=64, height=48)
SIDES_MM = {1: (60.0, 40.0, 20.0), 2: (40.0, 40.0, 20.0)}
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""The symmetry that box 2 is listed with."""
FIRST, SECOND, BARE = ImageKey(1, 0), ImageKey(1, 1), ImageKey(2, 5)


def pose(x: float, y: float, z: float, angles: tuple[float, float, float] = (0.3, -0.4, 0.2)) -> np.ndarray:
    return transform(Rotation.from_euler("xyz", angles).as_matrix(), np.array([x, y, z]))


ANNOTATED = {
    FIRST: ((1, pose(-0.07, 0.0, 0.4)), (1, pose(0.06, -0.03, 0.5)), (2, pose(0.0, 0.05, 0.45))),
    SECOND: ((1, pose(0.01, 0.02, 0.35)),),
    BARE: (),
}
"""Object and `camera_from_model` of every annotation; also the content of the images."""


def box(obj_id: int) -> Model:
    """An axis-aligned box about the origin."""
    half = np.array(SIDES_MM[obj_id]) / 2000
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return Model(obj_id, corners, np.array(faces, np.int32), float(np.linalg.norm(2 * half)))


def make_dataset(root: Path, *, depth: bool = True) -> Path:
    """Write the dataset and return its folder."""
    for key, annotated in ANNOTATED.items():
        truths = [GroundTruth(obj_id, p, index) for index, (obj_id, p) in enumerate(annotated)]
        found = AnnotatedImage(_image(key, depth), truths if key is not BARE else None)
        write_scene(root, "test", key.scene_id, [found])
    _write_models(root / "models")
    return root


def claim(key: ImageKey, obj_id: int, camera_from_model: np.ndarray, score: float = 0.5) -> PoseEstimate:
    return PoseEstimate(*key, obj_id, score, camera_from_model)


def moved(camera_from_model: np.ndarray, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """The pose moved by metres in the camera's frame."""
    result = camera_from_model.copy()
    result[:3, 3] += (x, y, z)
    return result


def results_of(*claims: PoseEstimate, method: str = "method") -> Results:
    return Results.from_estimates(claims, method, "tiny", "test")


def perfect(method: str = "perfect") -> Results:
    """The annotated poses as results."""
    claims = (claim(key, obj_id, p) for key, annotated in ANNOTATED.items() for obj_id, p in annotated)
    return results_of(*claims, method=method)


def _image(key: ImageKey, depth: bool) -> Image:
    rgb = np.random.default_rng(sum(key)).integers(0, 255, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
    shown = ANNOTATED[key] or ((1, pose(0.0, 0.0, 0.4)),)
    measured = render_scene([(box(obj_id), p) for obj_id, p in shown], CAMERA, pixel_center=0.0).depth
    measured[measured == 0] = 0.8
    return Image(key, CAMERA, rgb, measured if depth else None)


def _write_models(folder: Path) -> None:
    folder.mkdir(parents=True)
    infos = {}
    for obj_id in SIDES_MM:
        model = box(obj_id)
        header = ["ply", "format ascii 1.0", "element vertex 8", *(f"property float {axis}" for axis in "xyz")]
        header += ["element face 12", "property list uchar int vertex_indices", "end_header"]
        vertices = [" ".join(map(str, vertex)) for vertex in (model.vertices * 1000).tolist()]
        faces = [" ".join(map(str, (3, *face))) for face in model.faces.tolist()]
        (folder / f"obj_{obj_id:06d}.ply").write_text("\n".join([*header, *vertices, *faces, ""]))
        infos[obj_id] = {"diameter": model.diameter * 1000}
    infos[2]["symmetries_discrete"] = [HALF_TURN.ravel().tolist()]
    (folder / "models_info.json").write_text(json.dumps(infos))
