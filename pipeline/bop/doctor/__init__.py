"""The dataset doctor: looks for the faults that users of BOP datasets lose days to, each with evidence and fix.

It reads only. Large datasets are sampled (`Effort`), `deep` looks at everything. Checks run in the order of the
table; one whose ground another check found rotten (`needs`) is not judged, so that one fault is one error.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pipeline.bop.doctor import cameras, depth, files, images, models, poses
from pipeline.bop.doctor.findings import SEVERITIES, Finding, Severity, counts, worst_first
from pipeline.bop.doctor.survey import THOROUGH, Effort, Survey

__all__ = ["CHECKS", "SEVERITIES", "Check", "Finding", "Severity", "counts", "diagnose", "worst_first"]


@dataclass(frozen=True)
class Check:
    """One question that the doctor asks."""

    id: str
    title: str
    run: Callable[[Survey], Iterator[Finding]]
    needs: tuple[str, ...] = ()
    """Checks without whose approval this one would only repeat their errors."""


_POSES = ("model-units", "pose-units")
_RENDERED = (*_POSES, "models-info", "intrinsics", "in-view", "rotations")
_MEASURED = (*_RENDERED, "image-content")

CHECKS = (
    Check("json", "Scene files can be read", files.check_json),
    Check("image-ids", "Cameras and annotations are of the same images", files.check_image_ids),
    Check("image-files", "Listed images exist", images.check_image_files),
    Check("image-content", "Image files are whole, depth has 16 bits", images.check_image_content),
    Check("models", "Models can be read and have faces", models.check_models),
    Check("model-units", "Models are in millimetres", models.check_model_units),
    Check("models-info", "models_info.json agrees with the meshes", models.check_models_info, ("model-units",)),
    Check("origins", "Model origins are in the middle", models.check_origins),
    Check("object-ids", "Annotated objects have models", models.check_object_ids),
    Check("pose-units", "Poses are in millimetres", poses.check_pose_units),
    Check("rotations", "Rotations are orthonormal", poses.check_rotations),
    Check("intrinsics", "Intrinsics fit the image size", cameras.check_intrinsics),
    Check("apparent-size", "Objects are neither huge nor tiny", poses.check_apparent_size, (*_POSES, "intrinsics")),
    Check("in-view", "Objects are before the camera and in the image", poses.check_in_view, (*_POSES, "intrinsics")),
    Check("duplicates", "Objects are annotated once", poses.check_duplicates),
    Check("targets", "Targets exist", files.check_targets),
    Check("masks", "Masks exist", files.check_masks),
    Check("world-direction", "World poses map from world to camera", cameras.check_world_direction, _POSES),
    Check("depth-scale", "Depth scale is right", depth.check_depth_scale, _MEASURED),
    Check("poses-depth", "Poses lie on the depth", depth.check_poses_against_depth, (*_MEASURED, "depth-scale")),
    Check("gt-info", "scene_gt_info.json agrees with the poses", depth.check_gt_info, (*_RENDERED, "poses-depth")),
    Check("results", "Results are in millimetres and of known objects", poses.check_results),
)  # fmt: skip

_ALIKE_SHOWN = 3

ProgressCallback = Callable[[int, int, str], None]


def diagnose(
    root: Path,
    split: str | None = None,
    progress: ProgressCallback | None = None,
    *,
    deep: bool = False,
    results: Sequence[Path] = (),
) -> list[Finding]:
    """Examine a split of a dataset, and results files on it, and return what was found, worst first.

    progress: called with checks done, checks in all, and the title of the next. Raises MissingFileError where there is
    no dataset and UnknownIdError for a split that it does not have; everything else becomes a finding.
    """
    survey = Survey(root, split, THOROUGH if deep else Effort(), results)
    findings: list[Finding] = []
    for number, check in enumerate(CHECKS):
        if progress:
            progress(number, len(CHECKS), check.title)
        failed = {finding.check for finding in findings if finding.severity == "error"}
        findings += _examine(check, survey, failed)
    if progress:
        progress(len(CHECKS), len(CHECKS), "done")
    return worst_first(findings)


def _examine(check: Check, survey: Survey, failed: set[str]) -> Iterator[Finding]:
    blocking = [needed for needed in check.needs if needed in failed]
    if blocking:
        evidence = f"it needs what {', '.join(blocking)} found wrong"
        yield Finding("note", f"Not judged: {check.title}", survey.split, evidence, "mend that and run again", check.id)
        return
    alike: dict[tuple[str, str], list[Finding]] = defaultdict(list)
    for finding in check.run(survey):
        alike[finding.severity, finding.title].append(replace(finding, check=check.id))
    for group in alike.values():
        yield from group if len(group) <= _ALIKE_SHOWN else [_bundled(group)]


def _bundled(alike: list[Finding]) -> Finding:
    """One finding for many of a kind, say for every scene."""
    more = f"and {len(alike) - 1} more"
    return replace(alike[0], subject=f"{alike[0].subject} {more}", evidence=f"{alike[0].evidence}; {more} like it")
