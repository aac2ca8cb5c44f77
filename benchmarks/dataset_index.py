"""Time to open a large dataset split and list everything in it, against a straightforward reader; also results and models.

The split is made in a temporary folder: 10,000 images in 20 scenes with 67,000 ground-truth poses (T-LESS has 10,080
and 67,308). Usage: python benchmarks/dataset_index.py [--repeats 3] [--models FOLDER_OF_PLY_FILES]
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.bop.dataset import open_dataset
from pipeline.bop.json_files import write_json_by_id
from pipeline.bop.models import read_model
from pipeline.bop.results import Results, read_results, write_results
from pipeline.scene import GroundTruth, ImageKey, Target

SCENES, IMAGES_PER_SCENE, POSES = 20, 500, 67_000


def main() -> None:
    """Make the data, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--models", type=Path, help="folder of PLY files to read with our reader and with trimesh")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "bench"
        make_split(root / "test")
        ours, counts = best(arguments.repeats, lambda: list_ours(root))
        naive, naive_counts = best(arguments.repeats, lambda: list_naively(root))
        assert counts == naive_counts, (counts, naive_counts)
        images, poses, targets = counts
        print(f"{SCENES} scenes, {images} images, {poses} poses, {targets} targets: {ours:.2f} s to open and list all")
        print(f"straightforward reader: {naive:.2f} s, {naive / ours:.1f} times as long")
        opening, _ = best(arguments.repeats, lambda: open_dataset(root).image_ids(1))
        print(f"open and list the images of one scene: {1000 * opening:.1f} ms")
        measure_results(Path(folder) / "method_bench-test.csv", arguments.repeats)
    if arguments.models:
        measure_models(arguments.models, arguments.repeats)


def make_split(split: Path) -> None:
    """Scenes with annotations and visibility, and empty files in place of the images."""
    rng = np.random.default_rng(0)
    per_image = np.diff(np.linspace(0, POSES, SCENES * IMAGES_PER_SCENE + 1).astype(int))
    for scene, counts in enumerate(per_image.reshape(SCENES, IMAGES_PER_SCENE), start=1):
        folder = split / f"{scene:06d}"
        rotations = Rotation.random(counts.sum(), rng=rng).as_matrix().reshape(-1, 9).tolist()
        translations = rng.normal([0, 0, 800], 100, (counts.sum(), 3)).tolist()
        rows = iter(zip(rotations, translations, strict=True))
        truths = {
            im_id: [
                {"cam_R_m2c": R, "cam_t_m2c": t, "obj_id": 1 + i % 30}
                for i, (R, t) in zip(range(n), rows, strict=False)
            ]
            for im_id, n in enumerate(counts.tolist())
        }
        info = {"bbox_obj": [1, 2, 30, 40], "bbox_visib": [1, 2, 30, 40], "px_count_all": 900, "px_count_valid": 900}
        info |= {"px_count_visib": 600, "visib_fract": 0.6667}
        camera = {"cam_K": [1075.65, 0, 360, 0, 1073.9, 270, 0, 0, 1], "depth_scale": 0.1}
        camera |= {"cam_R_w2c": rotations[0], "cam_t_w2c": translations[0]}
        write_json_by_id(folder / "scene_gt.json", truths)
        write_json_by_id(folder / "scene_gt_info.json", {im_id: [info] * len(t) for im_id, t in truths.items()})
        write_json_by_id(folder / "scene_camera.json", dict.fromkeys(truths, camera))
        for kind in ("rgb", "depth"):
            (folder / kind).mkdir()
            for im_id in truths:
                (folder / kind / f"{im_id:06d}.png").touch()


def list_ours(root: Path) -> tuple[int, int, int]:
    """Numbers of images, poses and targets, with an object for every pose."""
    dataset = open_dataset(root)
    targets = dataset.targets()
    keys = list(dataset.images())
    return len(keys), sum(len(dataset.ground_truth(key)) for key in keys), len(targets)


def list_naively(root: Path) -> tuple[int, int, int]:
    """The same with the json module and one array and object at a time."""
    keys, truths, targets = [], {}, []
    for folder in sorted((root / "test").iterdir()):
        scene_id = int(folder.name)
        contents = [json.loads((folder / f"scene_{name}.json").read_text()) for name in ("gt", "gt_info", "camera")]
        for path in sorted((folder / "rgb").glob("*.png")):
            key = ImageKey(scene_id, int(path.stem))
            keys.append(key)
            camera = contents[2][str(key.im_id)]
            truths[key] = np.array(camera["cam_K"]).reshape(3, 3), read_naively(contents, str(key.im_id))
            visible = [t.obj_id for t in truths[key][1] if t.visible_fraction >= 0.1]
            targets += [Target(*key, obj_id, visible.count(obj_id)) for obj_id in sorted(set(visible))]
    return len(keys), sum(len(found) for _, found in truths.values()), len(targets)


def read_naively(contents: list[dict], im_id: str) -> list[GroundTruth]:
    """Annotations of one image."""
    found = []
    for index, (entry, info) in enumerate(zip(contents[0][im_id], contents[1][im_id], strict=True)):
        pose = np.eye(4)
        pose[:3, :3] = np.array(entry["cam_R_m2c"]).reshape(3, 3)
        pose[:3, 3] = np.array(entry["cam_t_m2c"]) / 1000
        bbox = tuple(map(float, info["bbox_visib"]))
        found.append(GroundTruth(entry["obj_id"], pose, index, info["visib_fract"], info["px_count_visib"], bbox))
    return found


def measure_results(path: Path, repeats: int, count: int = 100_000) -> None:
    """Write and read a results file."""
    rng = np.random.default_rng(0)
    results = Results(
        scene_id=rng.integers(1, 21, count),
        im_id=rng.integers(0, 500, count),
        obj_id=rng.integers(1, 31, count),
        score=rng.random(count),
        rotation=Rotation.random(count, rng=rng).as_matrix(),
        translation_mm=rng.normal([0, 0, 800], 100, (count, 3)),
        time_s=rng.random(count),
    )
    writing, _ = best(repeats, lambda: write_results(path, results))
    reading, _ = best(repeats, lambda: read_results(path))
    print(f"results of {count} rows: {reading:.2f} s to read, {writing:.2f} s to write")


def measure_models(folder: Path, repeats: int) -> None:
    """Read all PLY files of a folder with our reader and with trimesh (whose import is not counted)."""
    import trimesh

    paths = sorted(folder.glob("*.ply"))
    ours, _ = best(repeats, lambda: [read_model(path, 1, {"diameter": 100}) for path in paths])
    theirs, _ = best(repeats, lambda: [trimesh.load_mesh(path, process=False) for path in paths])
    print(f"{len(paths)} models of {folder.name}: {ours:.3f} s, trimesh {theirs:.3f} s")


def best(repeats: int, function: Callable[[], Any]) -> tuple[float, Any]:
    """Shortest time in seconds, and the result."""
    times, result = [], None
    for _ in range(repeats):
        begin = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - begin)
    return min(times), result


if __name__ == "__main__":
    main()
