"""The table of entity paths: where in a recording each thing lies, and of which kind it is.

`{...}` in a path stands for one part of letters, digits, `_`, `-` and `.` (an object id, the number of an instance).
Other methods log to these same paths, so that the views of a stage work for them too, or to anything below `method/`.
"""

import re
from functools import cache
from typing import NamedTuple

from pipeline.exceptions import UnknownIdError


class Entity(NamedTuple):
    """A path of the table."""

    path: str
    kind: str
    description: str


ENTITIES = (
    Entity("image", "view", "image key and camera; parent of everything with pixel coordinates"),
    Entity("image/rgb", "image", "the colour image that the method was given"),
    Entity("image/depth", "depth", "the depth image that the method was given"),
    Entity("log", "text", "messages of the method, in order"),
    Entity("estimates/{instance}", "estimate", "poses that the method submits, best first per object"),
    Entity("ground_truth/{instance}", "ground_truth", "annotated poses, named by their index in the annotation"),
    Entity("epos/object_probability", "probabilities", "a: background and each object, per cell"),
    Entity("epos/fragments/{obj}", "probabilities", "b: fragments of an object, with their predicted 3D points"),
    Entity("epos/fragment_model/{obj}", "table", "centre_in_model (n, 3) and size (n,) of each fragment, metres"),
    Entity("epos/correspondences/{obj}", "correspondences", "2D-3D correspondences kept by tau_a and tau_b"),
    Entity("epos/hypotheses/{obj}", "hypotheses", "poses in the order of the search"),
    Entity("epos/fitting/{obj}", "text", "what the search took, and why it stopped"),
    Entity("epos/targets/object", "heatmap", "the object that each cell shows, by the ground truth; 0 is background"),
    Entity(
        "epos/targets/fragments/{obj}",
        "table",
        "ground truth of cells: instance, fragment, coordinates in it, points_in_model",
    ),
    Entity("epos/training/{name}", "series", "losses and other curves of training"),
    Entity("hashmatch/settings", "text", "JSON: config, tau (edgel_threshold_m), theta (edgels_needed), focal_px"),
    Entity("hashmatch/objects", "table", "learned objects: templates, diameter, distance and centroid, metres"),
    Entity("hashmatch/sizes", "table", "nearest and farthest distance (metres) at which an object fits a level"),
    Entity("hashmatch/stages", "table", "windows and candidates that each stage leaves at each level"),
    Entity("hashmatch/windows", "heatmap", "candidates per pixel before any test: all templates in all windows"),
    Entity("hashmatch/objectness", "heatmap", "candidates per pixel after objectness"),
    Entity("hashmatch/hashing", "heatmap", "candidates per pixel after hashing"),
    Entity("hashmatch/verification", "heatmap", "candidates per pixel after verification"),
    Entity("hashmatch/nms", "heatmap", "candidates per pixel after non-maxima suppression"),
    Entity("hashmatch/scales/{stage}", "table", "the same by level of the pyramid: heat (n, h, w), cells of 8 px"),
    Entity("hashmatch/edgels", "mask", "depth-discontinuity edgels, which objectness counts"),
    Entity(
        "hashmatch/candidates/{stage}",
        "table",
        "what a stage left: windows (hashing), detections (verification, nms), poses (refined)",
    ),
    Entity("hashmatch/votes", "table", "best templates of the windows of hashing: votes, rank, first failed test"),
    Entity("hashmatch/templates", "table", "orientation (quaternion_xyzw) of the templates that are named elsewhere"),
    Entity("hashmatch/tests/{detection}", "table", "points of the tests T1..T5 at a detection, and which matched"),
    Entity("hashmatch/rough/{instance}", "estimate", "poses before refinement"),
    Entity("hashmatch/pso/{instance}", "hypotheses", "particles of the swarm, iteration by iteration"),
    Entity("hashmatch/pso_score/{instance}", "series", "best score of the swarm over iterations"),
    Entity("vsd/{pair}/visible_estimate", "mask", "visibility mask of the estimate"),
    Entity("vsd/{pair}/visible_gt", "mask", "visibility mask of the ground truth"),
    Entity(
        "vsd/{pair}/distance_difference", "heatmap", "distance of the estimate minus that of the ground truth, metres"
    ),
    Entity("vsd/{pair}/cost", "heatmap", "matching cost per pixel, 0..1"),
    Entity("diagnosis/{gt}", "table", "why an annotated instance was found or lost, as numbers: value, limit, unit"),
    Entity("diagnosis/{gt}/verdict", "text", "the same in one sentence"),
    Entity("diagnosis/{gt}/details", "text", "the same as JSON: stage, verdict, evidence, and what the method adds"),
)

FOREIGN_PREFIX = "method"
"""Below this anybody may log anything, of any kind."""

_PART = r"[A-Za-z0-9_.\-]+"
_PATH = re.compile(rf"{_PART}(/{_PART})*")


def find_entity(path: str) -> Entity | None:
    """The row of the table that a path belongs to, None where there is none."""
    return next((entity for entity, pattern in _patterns() if pattern.fullmatch(path)), None)


def check_entity(path: str, kind: str) -> None:
    """Refuse a path that the table does not have, or has for another kind.

    Raises:
        UnknownIdError: the path is neither in the table nor below `method/`.
        ValueError: the path has bad characters, or is of another kind.

    """
    if not _PATH.fullmatch(path):
        raise ValueError(f"entity path {path!r} may have parts of letters, digits, _, - and . joined by /")
    if path.startswith(f"{FOREIGN_PREFIX}/"):
        return
    entity = find_entity(path)
    if entity is None:
        paths = [entity.path for entity in ENTITIES]
        raise UnknownIdError("entity path", path, "the table of entities", [*paths, f"{FOREIGN_PREFIX}/..."])
    if entity.kind != kind:
        raise ValueError(f"entity path {path} is for {entity.kind}, not for {kind}")


@cache
def _patterns() -> tuple[tuple[Entity, re.Pattern[str]], ...]:
    return tuple((entity, re.compile(re.sub(r"\\\{\w+\\\}", _PART, re.escape(entity.path)))) for entity in ENTITIES)
