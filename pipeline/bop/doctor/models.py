"""Checks of object models: readable, in millimetres, centred, and as models_info.json says."""

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np

from pipeline.bop.doctor.findings import Finding, count_of, ok, some
from pipeline.bop.doctor.survey import Mesh, Survey
from pipeline.exceptions import InputError
from pipeline.symmetry import symmetry_transforms

SMALLEST_MM, LARGEST_MM = 3.0, 5000.0
"""Plausible diameters: one below is surely in metres, one above in micrometres or of the wrong scale."""
INFO_TOLERANCE = 0.01
"""Share of the diameter by which mesh and models_info.json may differ."""


def check_models(survey: Survey) -> Iterator[Finding]:
    """Whether there are models, their files can be read and have faces."""
    if not survey.model_folders:
        fix = f"get them (inspector download {survey.facts.name} --parts models), in a folder models/"
        yield Finding("error", "No models", survey.root.name, "there is no folder models*/ with obj_*.ply", fix)
        return
    for mesh in survey.meshes:
        if mesh.problem:
            problem = mesh.problem.removeprefix(f"{mesh.path}: ")
            evidence, _, fix = problem.partition("; ")
            yield Finding("error", "Unreadable model", _name(mesh, survey), evidence, fix or "get the file again")
    stray = [(mesh, share) for mesh in survey.meshes if mesh.model and (share := _stray_extent(mesh)) > INFO_TOLERANCE]
    if stray:
        evidence = some([f"{_name(mesh, survey)} grows by {share:.0%} of its diameter" for mesh, share in stray])
        fix = "remove vertices that no face uses: they count in the diameter and in MSSD, but cannot be seen"
        yield Finding("warning", "Vertices without faces", f"{count_of(len(stray), 'model')}", evidence, fix)
    yield ok(
        "Model files",
        f"{sum(not mesh.problem for mesh in survey.meshes)} of {count_of(len(survey.meshes), 'file')} read",
    )


def _stray_extent(mesh: Mesh) -> float:
    """How much vertices that no face uses enlarge the bounding box, in diameters."""
    assert mesh.model
    used = mesh.model.vertices[np.unique(mesh.model.faces)]
    growth = np.ptp(mesh.model.vertices, axis=0) - np.ptp(used, axis=0)
    return float(growth.max() / max(mesh.model.diameter, 1e-12))


def check_model_units(survey: Survey) -> Iterator[Finding]:
    """Whether the models are in millimetres, judged by their size."""
    meshes = [mesh for mesh in survey.meshes if mesh.model and mesh.path.suffix.lower() == ".ply"]
    groups = defaultdict(list)
    for mesh in meshes:
        kind = "small" if mesh.diameter_mm < SMALLEST_MM else "large" if mesh.diameter_mm > LARGEST_MM else "plausible"
        groups[mesh.path.parent.name, kind].append(mesh)
    for (folder, kind), group in groups.items():
        span = _span([mesh.diameter_mm for mesh in group])
        count = sum(mesh.path.parent.name == folder for mesh in meshes)
        evidence = f"{len(group)} of {count_of(count, 'model')} have diameters of {span}"
        evidence += f" (objects {some([mesh.obj_id for mesh in group])})"
        if kind == "small":
            fix = "multiply the vertices (and models_info.json) by 1000: BOP models are in millimetres"
            yield Finding("error", "Models in metres", folder, evidence, fix)
        elif kind == "large":
            fix = "divide the vertices (and models_info.json) by the right power of ten: BOP models are in millimetres"
            yield Finding("error", "Models too large", folder, evidence, fix)
        else:
            yield ok("Model units", evidence, folder)


def check_models_info(survey: Survey) -> Iterator[Finding]:
    """Whether models_info.json lists the models and agrees with their meshes."""
    for folder in survey.model_folders:
        path = folder / "models_info.json"
        subject = f"{folder.name}/models_info.json"
        info = survey.models_info.get(path)
        meshes = [mesh for mesh in survey.meshes if mesh.path.parent == folder and mesh.model]
        fix = "compute it with bop_toolkit's scripts/calc_model_info.py; symmetries have to be entered by hand"
        if info is None:
            if folder == survey.model_folders[0]:
                yield Finding(
                    "warning", "No models_info.json", subject, "diameters are computed, symmetries unknown", fix
                )
        elif isinstance(info, str):
            yield Finding("error", "Unreadable models_info.json", subject, info.removeprefix(f"{path}: "), fix)
        else:
            yield from _compare_info(subject, info, meshes)


def _compare_info(subject: str, info: dict[int, dict[str, Any]], meshes: list[Mesh]) -> Iterator[Finding]:
    if absent := [mesh.obj_id for mesh in meshes if mesh.obj_id not in info]:
        evidence = f"{len(absent)} of {count_of(len(meshes), 'model')} have no entry: objects {some(absent)}"
        yield Finding("warning", "Models missing in models_info.json", subject, evidence, "add their entries")
    wrong = [
        (mesh, text) for mesh in meshes if mesh.obj_id in info and (text := _disagreement(info[mesh.obj_id], mesh))
    ]
    if wrong:
        evidence = f"{len(wrong)} of {count_of(len(meshes), 'model')}: " + some(
            [f"object {m.obj_id} {text}" for m, text in wrong], 3
        )
        fix = "compute diameter, min and size again from the meshes: errors are measured against the diameter"
        yield Finding("error", "models_info.json disagrees with the meshes", subject, evidence, fix)
    else:
        yield ok("models_info.json", f"agrees with {count_of(len(meshes), 'mesh').replace('meshs', 'meshes')}", subject)


def _disagreement(entry: dict[str, Any], mesh: Mesh) -> str:
    """The value that differs most from the mesh; empty if all agree."""
    assert mesh.model
    try:
        symmetry_transforms(entry)
    except InputError as error:
        return f"has a faulty symmetry: {error}"
    low, size = mesh.model.vertices.min(axis=0) * 1000.0, np.ptp(mesh.model.vertices, axis=0) * 1000.0
    actual = {"diameter": mesh.diameter_mm}
    actual |= {f"min_{axis}": value for axis, value in zip("xyz", low, strict=True)}
    actual |= {f"size_{axis}": value for axis, value in zip("xyz", size, strict=True)}
    for key in actual:
        if key in entry and not isinstance(entry[key], int | float):
            return f"{key} is {entry[key]!r} instead of {actual[key]:.4g} mm"
    off = {key: abs(entry[key] - value) for key, value in actual.items() if key in entry}
    worst = max(off, key=lambda key: off[key], default=None)
    if worst is None or off[worst] <= INFO_TOLERANCE * mesh.diameter_mm:
        return "has no diameter" if "diameter" not in entry else ""
    return f"{worst} is {entry[worst]:.4g} instead of {actual[worst]:.4g} mm"


def check_origins(survey: Survey) -> Iterator[Finding]:
    """Whether the models' origins lie in the middle of their bounding boxes."""
    for folder in survey.model_folders:
        offsets = {mesh: _offset(mesh) for mesh in survey.meshes if mesh.model and mesh.path.parent == folder}
        off = {mesh: offset for mesh, offset in offsets.items() if offset > 0.05}
        outside = any(offset > 0.5 for offset in off.values())
        shown = [f"object {m.obj_id} {offset * m.diameter_mm:.3g} mm ({offset:.0%})" for m, offset in off.items()]
        if off:
            evidence = f"{len(off)} of {count_of(len(offsets), 'model')} off the middle of their box: {some(shown)}"
            fix = "no error if the poses are for these models; else shift the vertices by s and subtract R s from t"
            yield Finding("warning" if outside else "note", "Origins off-centre", folder.name, evidence, fix)
        elif offsets:
            evidence = f"at most {max(offsets.values()):.1%} of the diameter from the middle of the box"
            yield ok("Model origins", evidence, folder.name)


def _offset(mesh: Mesh) -> float:
    """Distance of the origin from the middle of the bounding box, in diameters."""
    assert mesh.model
    middle = (mesh.model.vertices.min(axis=0) + mesh.model.vertices.max(axis=0)) / 2.0
    return float(np.linalg.norm(middle) / max(mesh.model.diameter, 1e-12))


def check_object_ids(survey: Survey) -> Iterator[Finding]:
    """Whether every annotated object has a model."""
    if not survey.model_ids:
        return
    ids, numbers = np.unique(
        np.concatenate([s.ground_truth.obj_ids for s in survey.scenes if s.ground_truth] or [[]]), return_counts=True
    )
    unknown = {int(obj_id): int(n) for obj_id, n in zip(ids, numbers, strict=True) if obj_id not in survey.model_ids}
    if unknown:
        evidence = f"{sum(unknown.values())} of {numbers.sum()} annotations: " + some(
            [f"object {i} ({n} times)" for i, n in unknown.items()]
        )
        evidence += f"; models are there for {some(sorted(survey.model_ids), 30)}"
        fix = "add the models, or correct obj_id in scene_gt.json"
        yield Finding("error", "Annotated objects without model", survey.split, evidence, fix)
    elif len(ids):
        yield ok("Object ids", f"{len(ids)} annotated objects, all with a model")


def _span(values: list[float]) -> str:
    low, high = min(values), max(values)
    return f"{low:.3g} mm" if low == high else f"{low:.3g} to {high:.3g} mm"


def _name(mesh: Mesh, survey: Survey) -> str:
    return str(mesh.path.relative_to(survey.root))
