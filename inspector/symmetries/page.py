"""What the page shows while symmetries are reviewed, as one JSON object that the script draws."""

from importlib import resources
from typing import Any

from inspector.symmetries.commands import COMMANDS
from inspector.symmetries.review import Review
from inspector.symmetries.scene import MODEL_COLOR, SCALE_STOPS, TURNED_COLOR, Look
from inspector.symmetries.texts import axis_text, offset_text
from inspector.symmetries.verdicts import Reviewed
from pipeline.symmetry_search.groups import SymmetryGroup

FILES = {
    "/inspector.css": "text/css; charset=utf-8",
    "/symmetries.css": "text/css; charset=utf-8",
    "/symmetries.js": "text/javascript; charset=utf-8",
}
HEAD = "".join(
    f'<link rel="stylesheet" href="{path}">' if path.endswith("css") else f'<script src="{path}"></script>'
    for path in FILES
)
"""Goes into the page's head."""


def static_files() -> dict[str, tuple[str, bytes]]:
    """Return our files for the page: content type and content by path."""
    web = resources.files("inspector") / "web"
    return {path: (kind, (web / path[1:]).read_bytes()) for path, kind in FILES.items()}


def page_state(review: Review, look: Look, measured_mm: float | None) -> dict[str, Any]:
    """All that the page shows; `measured_mm` is the Hausdorff distance at the angle that is shown."""
    index, chosen = review.selected
    current = review.objects[index]
    return {
        "folder": str(review.models.path),
        "objects": [_object(reviewed, i == index) for i, reviewed in enumerate(review.objects)],
        "current": _current(current),
        "candidates": [_candidate(current, i) for i in range(len(current.candidates))],
        "selected": chosen if current.candidates else -1,
        "fold": review.fold or 0,
        "look": look_state(look, measured_mm),
        "message": {"text": review.message[0], "kind": review.message[1]},
        "unsaved": len(review.unsaved),
        "can_save": review.models.info_path is not None,
        "palette": {
            "model": _css(MODEL_COLOR),
            "turned": _css(TURNED_COLOR),
            "stops": [_css(stop) for stop in SCALE_STOPS],
        },
        "commands": [
            {
                "name": c.name,
                "label": c.label,
                "keys": c.key.split(" ") if c.key != " " else [" "],
                "shown": c.shown_key or c.key,
            }
            for c in COMMANDS
        ],
    }


def look_state(look: Look, measured_mm: float | None) -> dict[str, Any]:
    """How the candidate is shown."""
    return {
        "mode": look.mode,
        "colors": look.colors,
        "angle": round(look.angle, 2),
        "playing": look.playing,
        "measured_mm": None if measured_mm is None else round(measured_mm, 3),
    }


def _object(reviewed: Reviewed, selected: bool) -> dict[str, Any]:
    accepted = reviewed.group.name.partition(":")[0]
    suggested = 0 if reviewed.search is None else len(reviewed.search.suggested)
    open_ones = 0 if reviewed.verdicts else suggested
    return {
        "name": reviewed.file.name,
        "progress": reviewed.progress,
        "share": round(reviewed.share, 2),
        "problem": reviewed.problem,
        "accepted": "" if reviewed.group.name == "no symmetry" else accepted,
        "count": len(reviewed.candidates),
        "suggested": open_ones,
        "decided": bool(reviewed.verdicts),
        "unsaved": reviewed.unsaved,
        "selected": selected,
    }


def _current(reviewed: Reviewed) -> dict[str, Any]:
    search, model = reviewed.search, reviewed.model
    return {
        "name": reviewed.file.name,
        "file": reviewed.file.path.name,
        "progress": reviewed.progress,
        "problem": reviewed.problem,
        "diameter_mm": None if model is None else model.diameter * 1000,
        "epsilon_mm": None if search is None else search.epsilon * 1000,
        "bound_mm": None if search is None else search.bound * 1000,
        "group": reviewed.group.name,
        "written": _written(reviewed.group),
        "listed": reviewed.listed.name,
        "as_listed": reviewed.as_listed,
        "unsaved": reviewed.unsaved,
    }


def _candidate(reviewed: Reviewed, index: int) -> dict[str, Any]:
    candidate, search, model = reviewed.candidates[index], reviewed.search, reviewed.model
    assert search is not None
    assert model is not None
    return {
        "kind": str(candidate),
        "fold": candidate.fold,
        "axis": axis_text(candidate),
        "offset": offset_text(candidate.axis),
        "distance_mm": candidate.distance * 1000,
        "at_axis_mm": candidate.distance_at_axis * 1000,
        "mean_mm": candidate.mean_distance * 1000,
        "share": candidate.distance / model.diameter,
        "within": candidate.distance <= search.epsilon,
        "suggested": index in search.suggested,
        "standing": reviewed.standings[index],
        "folds": list(candidate.smaller_folds),
        "accepted_fold": 0 if index not in reviewed.verdicts else reviewed.verdicts[index].fold or 0,
    }


def _written(group: SymmetryGroup) -> str:
    """What models_info.json will list."""
    parts = []
    if len(group.discrete):
        parts.append(f"{len(group.discrete)} discrete")
    if group.continuous:
        parts.append(f"{len(group.continuous)} continuous")
    return " and ".join(parts) or "none"


def _css(color: tuple[int, int, int]) -> str:
    return f"rgb({color[0]}, {color[1]}, {color[2]})"
