"""Why HashMatch found or lost an instance: failures are planted, and the trace has to name the stage."""

import json
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hashmatch_parts import COARSE, KEY, image_of, looking_at, other_part, part

from pipeline.exceptions import UnknownIdError
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.detector import Detector
from pipeline.hashmatch.estimator import Found, HashMatchEstimator
from pipeline.hashmatch.explaining import explanation
from pipeline.hashmatch.proposals import Instance
from pipeline.hashmatch.templates import PER_TEMPLATE, Templates
from pipeline.hashmatch.trace import Trace, trace
from pipeline.hashmatch.tracing.verdicts import STAGES
from pipeline.recording import NullRecorder
from pipeline.scene import GroundTruth, Image, Model, Target

MODELS = {1: part(), 2: other_part()}
POSE = looking_at(0.45, (2.4, 0.25, 0.3), x=0.03, y=-0.01)
OTHER = looking_at(0.5, (2.0, 0.1, -0.2), x=-0.09, y=0.02)
TRUTHS = [GroundTruth(1, POSE, 0), GroundTruth(2, OTHER, 1)]
TARGETS = [Target(*KEY, 1, 1), Target(*KEY, 2, 1)]


class World(NamedTuple):
    """What failures are planted in."""

    estimator: HashMatchEstimator
    image: Image


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> World:
    config = replace(COARSE, angle_step_deg=20, in_plane_limit_deg=40, cache=tmp_path_factory.mktemp("cache"))
    image = image_of((part(), POSE), (other_part(), OTHER), noise=0.0005)
    return World(HashMatchEstimator(MODELS, config, 300.0), image)


def found_with(
    world: World, objects: Sequence[Templates] | None = None, image: Image | None = None, **changes: object
) -> tuple[HashMatchEstimator, Found]:
    """What the method finds with something changed: its templates, its settings, the image."""
    config: HashMatchConfig = replace(world.estimator.config, **changes)
    estimator = copy(world.estimator)
    estimator.config = config
    estimator.detector = Detector(objects or world.estimator.detector.objects, replace(config, threads=1))
    return estimator, estimator.found(image or world.image, TARGETS, NullRecorder())[1]


def traced(estimator: HashMatchEstimator, found: Found, truth: GroundTruth = TRUTHS[0]) -> Trace:
    model: Model = MODELS[truth.obj_id]
    return trace(estimator.detector, found.matching, truth, model, found.proposed, found.chosen)


def without(own: Templates, rows: np.ndarray) -> Templates:
    """Templates but some of them."""
    left = np.setdiff1d(np.arange(len(own)), rows)
    return replace(own, **{name: getattr(own, name)[left] for name in PER_TEMPLATE})


def angles_to(own: Templates, rotation: np.ndarray) -> np.ndarray:
    cosines = (np.einsum("tij,ij->t", own.rotations.astype(float), rotation) - 1) / 2
    return np.rad2deg(np.arccos(np.clip(cosines, -1, 1)))


def test_what_was_found_is_said_to_be(world: World):
    estimator, found = found_with(world)
    for truth in TRUTHS:
        result = traced(estimator, found, truth)
        assert result.stage == "found"
        assert result.verdict.startswith(f"object {truth.obj_id} was found (MSSD 0.0")
        refinement = result.refinement
        assert refinement.chosen_error is not None
        assert refinement.rough_error is not None
        assert refinement.chosen_error < refinement.rough_error
        assert result.best is not None
        assert result.best.objectness
        assert result.best.angle_deg < 21
        assert result.detections.count > 0


def test_a_raised_theta_loses_it_at_objectness(world: World):
    estimator, found = found_with(world, edgel_share=1000.0)
    result = traced(estimator, found)
    assert result.stage == "objectness"
    assert result.best is not None
    assert f"its window holds {result.best.edgels} depth edgels, more than {result.edgels_needed:.0f}" in result.verdict
    assert result.best.edgels <= result.edgels_needed


def test_templates_taken_away_are_missed(world: World):
    own, other = world.estimator.detector.objects
    near = np.flatnonzero(angles_to(own, POSE[:3, :3]) < 75)
    estimator, found = found_with(world, [without(own, near), other])
    result = traced(estimator, found)
    assert result.stage == "template"
    assert "degrees off; use all views" in result.verdict
    assert traced(estimator, found, TRUTHS[1]).stage == "found"


def test_emptied_tables_lose_it_at_hashing(world: World):
    estimator = found_with(world)[0]
    tables = estimator.detector.tables
    mine = tables.objects[tables.ids] == 0
    before = np.concatenate([[0], np.cumsum(~mine)])
    emptied = replace(tables, ids=tables.ids[~mine], starts=before[tables.starts].astype(tables.starts.dtype))
    estimator.detector.tables = emptied
    result = traced(estimator, estimator.found(world.image, TARGETS, NullRecorder())[1])
    assert result.stage == "hashing"
    assert result.verdict == "object 1: its template got no vote at its window."


def test_more_votes_needed_than_there_are_tables_lose_it_at_hashing(world: World):
    result = traced(*found_with(world, votes_needed=101))
    assert result.stage == "hashing"
    assert "votes at its window, 101 are needed" in result.verdict


@pytest.mark.parametrize(("test", "name"), [(2, "T2 normals"), (3, "T3 gradients"), (5, "T5 color")])
def test_a_test_that_cannot_be_passed_is_named(world: World, test: int, name: str):
    own, other = world.estimator.detector.objects
    damage = {
        2: {"normal_bits": np.zeros_like(own.normal_bits)},
        3: {"gradient_bits": np.zeros_like(own.gradient_bits)},
        5: {"point_hues": (own.point_hues.astype(int) + 90).astype(np.uint8) % 180},
    }
    result = traced(*found_with(world, [replace(own, **damage[test]), other]))
    assert result.stage == "verification"
    assert result.best is not None
    assert result.best.failed_test == test
    assert f"its template failed {name}: {result.best.fractions[test - 2]:.2f} of 0.60 needed" in result.verdict
    assert traced(*found_with(world, [replace(own, **damage[test]), other]), TRUTHS[1]).stage == "found"


def test_a_raised_threshold_fails_a_test_by_what_is_missing(world: World):
    result = traced(*found_with(world, matches_needed=1.01))
    assert result.stage == "verification"
    failed = next(test for test in result.as_dict()["tests"] if not test["passed"])
    assert failed["test"] == result.as_dict()["failed_test"]
    assert failed["needed"] == 1.01
    assert failed["fraction"] < 1.01


def test_an_object_too_far_away_has_no_level(world: World):
    result = traced(*found_with(world), truth=GroundTruth(1, looking_at(3.0, (2.4, 0.25, 0.3)), 4))
    assert result.stage == "pyramid"
    assert result.verdict == "object 1: no level of the pyramid and window fit its distance and place."
    assert result.as_dict()["template"] is None


def test_an_object_that_is_not_measured_fails_by_size(world: World):
    assert world.image.depth is not None
    depth = world.image.depth.copy()
    v, u = np.nonzero(depth < 0.6)
    depth[v[u > 100], u[u > 100]] = 0.82  # a wall where object 1 is
    result = traced(*found_with(world, image=replace(world.image, depth=depth), edgel_share=0.0))
    assert result.stage == "size"
    assert "m is measured," in result.verdict


def test_a_neighbour_suppresses_it(world: World):
    """Without refinement one detection of a place is kept; here it is that of a neighbour with another orientation."""
    estimator, found = found_with(world, refine=False)
    assert traced(estimator, found).stage == "found"
    detections, away = found.matching.detections, POSE @ np.diag([-1.0, -1.0, 1.0, 1.0])
    neighbour = int(detections.kept[detections.objects[detections.kept] == 0][0])
    templates = detections.templates.copy()
    templates[neighbour] = angles_to(estimator.detector.objects[0], POSE[:3, :3]).argmax()
    suppressed_by = np.where(detections.objects == 0, neighbour, detections.suppressed_by)
    matching = replace(found.matching, detections=replace(detections, templates=templates, suppressed_by=suppressed_by))
    chosen = [replace(one, pose=away) if one.position == 0 else one for one in found.chosen]
    result = traced(estimator, replace(found, matching=matching, proposed=chosen, chosen=chosen))
    assert result.stage == "suppression"
    assert result.verdict.endswith(f"and was suppressed by detection {neighbour}.")
    u, v = detections.centers[neighbour]
    assert result.as_dict()["detections"]["suppressed_by"] == {
        "detection": neighbour, "u": u, "v": v, "score": detections.ranking[neighbour],
    }  # fmt: skip


def test_refinement_that_moves_a_pose_away_is_named(world: World):
    estimator, found = found_with(world)
    away = np.eye(4)
    away[0, 3] = 0.08
    moved = {id(one): replace(one, pose=away @ one.pose) for one in found.proposed}
    damaged = Found(
        found.matching,
        [moved[id(one)] for one in found.proposed],
        [moved[id(one)] for one in found.chosen],
        found.seconds,
    )
    result = traced(estimator, damaged)
    assert result.stage == "refinement"
    assert result.refinement.moved_error is not None
    assert result.refinement.moved_error > 0.3
    assert "refinement moved its rough pose away, from MSSD 0." in result.verdict


def test_a_pose_that_was_refined_and_not_chosen_is_lost_at_selection(world: World):
    estimator, found = found_with(world)
    chosen: list[Instance] = [one for one in found.chosen if one.position != 0]
    result = traced(estimator, replace(found, chosen=chosen))
    assert result.stage == "selection"
    assert "was detected and refined, but other poses explained its pixels" in result.verdict


def test_without_refinement_the_same_instance_is_found_less_exactly(world: World):
    result = traced(*found_with(world, refine=False))
    assert result.stage == "found"
    refined = traced(*found_with(world))
    assert result.refinement.chosen_error is not None
    assert refined.refinement.chosen_error is not None
    assert result.refinement.chosen_error > refined.refinement.chosen_error


def test_the_explanation_is_json_with_the_numbers_of_the_trace(world: World):
    estimator, found = found_with(world)
    told = explanation(estimator.detector, found, TRUTHS[1], MODELS[2])
    content = json.loads(json.dumps(told.as_dict()))
    assert content["gt_index"] == 1
    assert content["stage"] in STAGES
    details, evidence = content["details"], {one["name"]: one for one in content["evidence"]}
    assert evidence["depth edgels"]["value"] == details["objectness"]["edgels"]
    assert evidence["depth edgels"]["limit"] == details["objectness"]["needed"]
    assert evidence["votes"]["value"] == details["votes"]["votes"]
    assert evidence["T2 normals"]["value"] == details["tests"][1]["fraction"]
    assert [test["name"] for test in details["tests"]] == [
        "T1 size", "T2 normals", "T3 gradients", "T4 surface distance", "T5 color",
    ]  # fmt: skip
    assert len(details["followed"]) > 1
    assert details["refinement"]["chosen_error"] == evidence["error of the nearest estimate"]["value"]


def test_an_object_without_templates_is_named(world: World):
    estimator, found = found_with(world)
    with pytest.raises(UnknownIdError, match="object 7 is not in the templates of this run; available: 1, 2"):
        trace(estimator.detector, found.matching, GroundTruth(7, POSE, 0), part())
