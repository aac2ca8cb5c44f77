"""What stands over the picture: what is looked at, what the colours mean, and what cannot be shown."""

from typing import Any

from inspector.drawing import COLORS, WITNESS_COLORS
from inspector.frame import Frame, Role
from inspector.nodes import NOTHING, Drawing
from inspector.selection import Selection
from pipeline.bop.assessment import NO_OBJECT

LegendLine = dict[str, Any]
"""As the page draws it: `text`, and where wanted `color`, `class`, or `low`, `high` and `stops` of a colour bar."""


def legend(
    frame: Frame | None,
    selection: Selection,
    methods: tuple[str, ...],
    drawing: Drawing = NOTHING,
) -> list[LegendLine]:
    """Return the lines over the picture of a row."""
    lines = (
        [{"text": "nothing is selected", "class": "pi-title"}] if frame is None else _models(frame, selection, methods)
    )
    lines += [
        {"text": scale.label, "low": scale.low, "high": scale.high, "stops": [_css(stop) for stop in scale.stops]}
        for scale in drawing.scales
    ]
    lines += [
        {"text": text} if color is None else {"text": text, "color": _css(color)} for text, color in drawing.notes
    ]
    return lines + [warning(text) for text in drawing.warnings]


def warning(text: str) -> LegendLine:
    """A line that stands out."""
    return {"text": text, "class": "pi-warning"}


def _models(frame: Frame, selection: Selection, methods: tuple[str, ...]) -> list[LegendLine]:
    row, display = frame.row, selection.display
    title = f"scene {row.scene_id} · image {row.im_id}" + (f" · object {row.obj_id}" if row.obj_id != NO_OBJECT else "")
    lines: list[LegendLine] = [{"text": title, "class": "pi-title"}]
    if display.ground_truth and frame.ground_truth is not None:
        lines.append({"text": "ground truth", "color": _css(COLORS["ground_truth"])})
    roles: tuple[tuple[Role, int | None], ...] = (("estimate", frame.method), ("compared", frame.compare))
    for role, method in roles:
        if method is not None and getattr(display, role) and getattr(frame, role) is not None:
            lines.append({"text": methods[method] + _off_by(frame, role), "color": _css(COLORS[role])})
    if display.witness and frame.witnesses("estimate") is not None:
        names = ("vertex that decides MSSD", "vertex that decides MSPD")
        lines += [
            {"text": n, "color": _css(c), "class": "pi-minor"} for n, c in zip(names, WITNESS_COLORS, strict=True)
        ]
    return lines


def _off_by(frame: Frame, role: Role) -> str:
    witnesses = frame.witnesses(role)
    if witnesses is None:
        return ""
    mssd, mspd = witnesses
    return f": MSSD {mssd.value * 1000:.1f} mm, MSPD {mspd.value:.1f} px"


def _css(color: tuple[int, int, int]) -> str:
    return f"rgb{color}"
