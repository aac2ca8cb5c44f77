import gzip
import json
import math
from pathlib import Path

import numpy as np
import pytest
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from pipeline.bop.coco.detection import evaluate_detections
from pipeline.bop.coco.results import read_detections
from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.summary import Summary
from pipeline.exceptions import FormatError, InputError, MissingFileError
from tests.random_dataset import make_random

WIDTH, HEIGHT = 64, 48
ONE = pytest.approx(1.0, abs=1e-12)
"""COCO's precision of right detections only is a little below."""
FIRST_HALF, WHOLE = 51, 101
"""Recalls 0, 0.01, ..., 0.50, and all that are sampled."""


def silhouette(box: list[int]) -> np.ndarray:
    x, y, width, height = box
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[y : y + height, x : x + width] = True
    return mask


def run_lengths(box: list[int]) -> dict:
    """Uncompressed, as BOP writes them: column by column, beginning with the zeros."""
    flat = silhouette(box).ravel(order="F")
    counts, value = [0], False
    for pixel in flat.tolist():
        if pixel != value:
            counts.append(0)
            value = pixel
        counts[-1] += 1
    return {"counts": counts, "size": [HEIGHT, WIDTH]}


def annotation(image_id: int, obj_id: int, box: list[int], ignore: bool = False) -> dict:
    area = box[2] * box[3]
    own = {"image_id": image_id, "category_id": obj_id, "bbox": box, "area": area, "segmentation": run_lengths(box)}
    return own | {"iscrowd": 0, "ignore": ignore, "width": WIDTH, "height": HEIGHT}


def detection(image_id: int, obj_id: int, box: list[int], score: float, scene_id: int = 1, **more) -> dict:
    own = {"scene_id": scene_id, "image_id": image_id, "category_id": obj_id, "score": score, "bbox": box, "time": 0.5}
    return own | more


def with_annotations(root: Path, scenes: dict[int, list[dict]], stem: str = "scene_gt_coco") -> Path:
    """A dataset of images without content, with these annotations."""
    if not root.exists():
        make_random(root, 0, scenes=len(scenes))
    for scene_id, annotations in scenes.items():
        content = {
            "images": [{"id": i, "width": WIDTH, "height": HEIGHT, "file_name": f"rgb/{i:06d}.png"} for i in range(3)],
            "annotations": [own | {"id": number} for number, own in enumerate(annotations, start=1)],
            "categories": [{"id": i, "name": str(i), "supercategory": "random"} for i in (1, 2)],
        }
        (root / "test" / f"{scene_id:06d}" / f"{stem}.json").write_text(json.dumps(content))
    return root


def written(root: Path, content: object, name: str = "method_random-test.json") -> Path:
    path = root.parent / name
    path.write_text(json.dumps(content))
    return path


def evaluated(root: Path, detections: list[dict], measure=None, **options) -> Summary:
    return evaluate_detections(open_dataset(root), read_detections(written(root, detections)), measure, **options)


A, B, ELSEWHERE = [4, 4, 10, 10], [30, 20, 10, 10], [50, 4, 8, 8]
MOSTLY_B = [30, 20, 10, 16]
"""Contains B; the intersection over union is 10 / 16 = 0.625, which is above three of ten thresholds."""


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    """Two instances of object 1 in image 0, and one in image 1 that is to be ignored."""
    annotations = [annotation(0, 1, A), annotation(0, 1, B), annotation(1, 1, A, ignore=True)]
    return with_annotations(tmp_path / "random", {1: annotations})


# ---- cases of known precision


def test_boxes_score_what_was_worked_out_by_hand(pair: Path):
    found = evaluated(pair, [detection(0, 1, A, 0.9), detection(0, 1, ELSEWHERE, 0.8), detection(0, 1, MOSTLY_B, 0.7)])
    both = (FIRST_HALF * 1.0 + (WHOLE - FIRST_HALF) * 2 / 3) / WHOLE  # right, wrong, right
    one = FIRST_HALF * 1.0 / WHOLE  # right, wrong, wrong
    assert found.scores["AP"] == pytest.approx((3 * both + 7 * one) / 10, abs=1e-12)
    assert found.scores["AP50"] == pytest.approx(both, abs=1e-12)
    assert found.scores["AP75"] == pytest.approx(one, abs=1e-12)
    assert found.scores["AR100"] == pytest.approx((3 * 1.0 + 7 * 0.5) / 10, abs=1e-12)
    assert found.scores["AR1"] == pytest.approx(0.5, abs=1e-12)
    assert found.per_object[1]["AP"] == found.scores["AP"]
    assert found.per_scene[1] == found.scores
    assert (found.task, found.targets, found.targets_per_object) == ("bbox", 2, {1: 2})
    assert found.time_per_image == 0.5


def test_what_is_to_be_ignored_costs_nothing(pair: Path):
    right = [detection(0, 1, A, 0.9), detection(0, 1, B, 0.8)]
    assert evaluated(pair, right).scores["AP"] == ONE
    assert evaluated(pair, [*right, detection(1, 1, A, 1.0)]).scores["AP"] == ONE  # of the ignored instance
    assert evaluated(pair, [*right, detection(1, 1, ELSEWHERE, 1.0)]).scores["AP"] == pytest.approx(2 / 3, abs=1e-12)


def test_masks_are_compared_where_there_are_any(pair: Path):
    masks = [detection(0, 1, [], s, segmentation=run_lengths(box)) for box, s in ((A, 0.9), (MOSTLY_B, 0.7))]
    found = evaluated(pair, masks)
    assert found.task == "segm"
    assert found.scores["AP"] == pytest.approx((3 * 1.0 + 7 * FIRST_HALF / WHOLE) / 10, abs=1e-12)


def test_masks_may_be_compressed_and_boxes_beside_them_ignored(pair: Path):
    packed = coco_mask.encode(np.asfortranarray(silhouette(B).astype(np.uint8)))
    packed["counts"] = packed["counts"].decode()
    entries = [
        detection(0, 1, ELSEWHERE, 0.9, segmentation=run_lengths(A)),
        detection(0, 1, ELSEWHERE, 0.8, segmentation=packed),
    ]
    assert evaluated(pair, entries).scores["AP"] == ONE
    assert evaluated(pair, entries, "bbox").scores["AP"] == 0.0


def test_boxes_of_visible_parts_come_from_a_file_of_their_own(pair: Path):
    with_annotations(pair, {1: [annotation(0, 1, ELSEWHERE)]}, "scene_gt_coco_modal")
    claims = [detection(0, 1, ELSEWHERE, 0.9)]
    assert evaluated(pair, claims).scores["AP"] == 0.0
    assert evaluated(pair, claims, modal=True).scores["AP"] == ONE


def test_the_same_image_id_in_two_scenes_is_two_images(tmp_path: Path):
    root = with_annotations(tmp_path / "random", {1: [annotation(0, 1, A)], 2: [annotation(0, 1, B)]})
    found = evaluated(root, [detection(0, 1, A, 0.9), detection(0, 1, B, 0.8, scene_id=2)])
    assert found.scores["AP"] == ONE
    crossed = evaluated(root, [detection(0, 1, B, 0.9), detection(0, 1, B, 0.8, scene_id=2)])
    assert crossed.scores["AP"] == pytest.approx(FIRST_HALF / WHOLE / 2, abs=1e-12)
    assert (crossed.per_scene[1]["AP"], crossed.per_scene[2]["AP"]) == (0.0, ONE)


def test_only_images_of_the_list_count(pair: Path):
    (pair / "test_targets_bop19.json").write_text(
        json.dumps([{"scene_id": 1, "im_id": 0, "obj_id": 1, "inst_count": 2}])
    )
    right = [detection(0, 1, A, 0.9), detection(0, 1, B, 0.8)]
    found = evaluated(pair, [*right, detection(1, 1, ELSEWHERE, 1.0), detection(1, 1, ELSEWHERE, 1.0)])
    assert found.scores["AP"] == ONE
    assert (
        "2 of 4 detections are not in an image with targets and do not count (first: scene 1, image 1)" in found.notes
    )


def test_sizes_that_do_not_occur_have_no_score(pair: Path):
    found = evaluated(pair, [detection(0, 1, A, 0.9)])
    assert found.scores["AP_large"] is None
    assert found.reasons["AP_large"] == "no annotated instance is of this size"
    assert found.scores["AP_small"] == pytest.approx(FIRST_HALF / WHOLE, abs=1e-12)


def test_no_detections_score_zero(pair: Path):
    assert evaluated(pair, []).scores["AP"] == 0.0


def test_nothing_is_printed(pair: Path, capsys: pytest.CaptureFixture):
    evaluated(pair, [detection(0, 1, A, 0.9)])
    assert capsys.readouterr().out == ""


def test_compressed_files_are_read(pair: Path):
    path = pair.parent / "method_random-test.json.gz"
    path.write_bytes(gzip.compress(json.dumps([detection(0, 1, A, 0.9)]).encode()))
    detections = read_detections(path)
    assert (len(detections), detections.method, detections.dataset_name) == (1, "method", "random")


# ---- parity with COCO's own loader


def jittered(rng: np.random.Generator, box: list[int]) -> list[int]:
    x, y, width, height = (np.array(box) + rng.integers(-3, 4, 4)).tolist()
    return [min(max(x, 0), 50), min(max(y, 0), 34), min(max(width, 2), 14), min(max(height, 2), 14)]


@pytest.mark.parametrize("measure", ["bbox", "segm"])
@pytest.mark.parametrize("seed", range(5))
def test_all_scores_equal_those_of_scenes_merged_by_hand(tmp_path: Path, seed: int, measure):
    rng = np.random.default_rng(seed)
    scenes: dict[int, list[dict]] = {1: [], 2: []}
    detections = []
    for scene_id, image_id in ((scene, image) for scene in (1, 2) for image in range(3)):
        for _ in range(rng.integers(1, 5)):
            box, obj_id = jittered(rng, rng.integers(5, 40, 4).tolist()), int(rng.integers(1, 3))
            scenes[scene_id].append(annotation(image_id, obj_id, box))
            for _ in range(rng.integers(0, 3)):
                near, score = jittered(rng, box), float(rng.choice([0.3, 0.6, 0.6, 0.9]))
                more = {"segmentation": run_lengths(near)}
                detections.append(detection(image_id, obj_id, near, score, scene_id, **more))
    truth: dict = {"images": [], "annotations": [], "categories": [{"id": i, "name": str(i)} for i in (1, 2)]}
    for scene_id, annotations in scenes.items():
        offset = 1000 * scene_id
        truth["images"] += [{"id": offset + i, "width": WIDTH, "height": HEIGHT} for i in range(3)]
        for own in annotations:
            number = len(truth["annotations"]) + 1
            truth["annotations"].append(own | {"id": number, "image_id": offset + own["image_id"]})
    merged = [d | {"image_id": 1000 * d["scene_id"] + d["image_id"]} for d in detections]
    gt = COCO()
    gt.dataset = json.loads(json.dumps(truth))
    gt.createIndex()
    evaluator = COCOeval(gt, gt.loadRes(json.loads(json.dumps(merged))), measure)
    evaluator.evaluate()
    evaluator.accumulate()
    evaluator.summarize()
    found = evaluated(with_annotations(tmp_path / "random", scenes), detections, measure)
    assert [-1.0 if value is None else value for value in found.scores.values()] == evaluator.stats.tolist()


# ---- bad input


def test_missing_ground_truth_names_the_command_that_makes_it(pair: Path):
    (pair / "test" / "000001" / "scene_gt_coco.json").unlink()
    with pytest.raises(
        MissingFileError, match=r"scene_gt_coco\.json: no such file; make it: inspector gt-info .* --only coco$"
    ):
        evaluated(pair, [detection(0, 1, A, 0.9)])


def test_ground_truth_without_an_image_of_the_list_is_refused(pair: Path):
    path = pair / "test" / "000001" / "scene_gt_coco.json"
    content = json.loads(path.read_text())
    content["images"] = content["images"][:2]
    path.write_text(json.dumps(content))
    with pytest.raises(FormatError, match="image 2 is on the list of targets and not in it; make it again"):
        evaluated(pair, [detection(0, 1, A, 0.9)])


@pytest.mark.parametrize("content", [{"images": []}, {"images": [3], "annotations": [], "categories": []}])
def test_ground_truth_in_another_form_is_refused(pair: Path, content: dict):
    (pair / "test" / "000001" / "scene_gt_coco.json").write_text(json.dumps(content))
    with pytest.raises(FormatError, match=r"scene_gt_coco\.json: is not in COCO's form"):
        evaluated(pair, [detection(0, 1, A, 0.9)])


def test_detections_of_other_data_are_refused(pair: Path):
    with pytest.raises(
        InputError, match="none of its 1 detections has a box and is in an image with targets of random"
    ):
        evaluated(pair, [detection(0, 1, A, 0.9, scene_id=7)])
    with pytest.raises(InputError, match="none of its 1 detections has a mask"):
        evaluated(pair, [detection(0, 1, A, 0.9)], "segm")


def test_a_mask_of_another_size_is_refused(pair: Path):
    small = {"counts": [100], "size": [10, 10]}
    with pytest.raises(FormatError, match=r"its mask has the size \[10, 10\] \(height, width\), the image \[48, 64\]"):
        evaluated(pair, [detection(0, 1, [], 0.9, segmentation=small)])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scene_id": "1"}, "detection 2: scene_id is '1'; expected a whole number"),
        ({"score": math.nan}, "detection 2: score is None; expected a finite number"),
        ({"score": "high"}, "detection 2: score is 'high'; expected a finite number"),
        ({"bbox": [1, 2, 3]}, r"detection 2: bbox is \[1, 2, 3\]; expected x, y, width and height"),
        ({"bbox": [1, 2, -3, 4]}, r"detection 2: bbox is \[1, 2, -3, 4\]"),
        ({"segmentation": [[1, 2, 3, 4]]}, "detection 2: segmentation is .*; expected run lengths"),
        ({"segmentation": {"counts": [5, 10], "size": [48, 64]}}, r"are of 15 pixels, its size \[48, 64\] has 3072"),
        ({"segmentation": {"counts": "zzzz", "size": [48, 64]}}, "counts of segmentation are 'zzzz'; expected numbers"),
        ({"segmentation": {"counts": [5, -10], "size": [48, 64]}}, r"counts of segmentation are \[5, -10\]; expected"),
    ],
)
def test_a_bad_detection_is_named(tmp_path: Path, change: dict, message: str):
    path = tmp_path / "method_random-test.json"
    text = json.dumps([detection(0, 1, A, 0.9), detection(0, 1, A, 0.9) | change]).replace("NaN", "null")
    path.write_text(text)
    with pytest.raises(FormatError, match=message):
        read_detections(path)


@pytest.mark.parametrize("seed", range(30))
def test_compressed_run_lengths_are_understood(tmp_path: Path, seed: int):
    rng = np.random.default_rng(seed)
    height, width = rng.integers(1, 90, 2).tolist()
    packed = coco_mask.encode(np.asfortranarray((rng.random((height, width)) < rng.random()).astype(np.uint8)))
    rle = {"size": [height, width], "counts": packed["counts"].decode()}
    path = tmp_path / "method_random-test.json"
    path.write_text(json.dumps([detection(0, 1, [], 0.9, segmentation=rle)]))
    assert len(read_detections(path)) == 1
    rle["counts"] = rle["counts"][:-1]
    path.write_text(json.dumps([detection(0, 1, [], 0.9, segmentation=rle)]))
    with pytest.raises(FormatError, match="segmentation"):
        read_detections(path)


def test_how_many_detections_are_bad_is_told(tmp_path: Path):
    path = written(tmp_path / "x", [detection(0, 1, A, 0.9), 3, {}])
    with pytest.raises(FormatError, match=r"detection 2: is 3; expected an object \(one of 2 bad detections\)"):
        read_detections(path)


@pytest.mark.parametrize(("content", "message"), [(b"[{]", "is no JSON"), (b"{}", "holds a dict; expected a list")])
def test_a_file_of_something_else_is_refused(tmp_path: Path, content: bytes, message: str):
    path = tmp_path / "method_random-test.json"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message):
        read_detections(path)
    packed = tmp_path / "method_random-test.json.gz"
    packed.write_bytes(b"\x1f\x8b broken")
    with pytest.raises(FormatError, match="cannot be decompressed"):
        read_detections(packed)
