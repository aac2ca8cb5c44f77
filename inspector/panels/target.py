"""The numbers of one row: what is looked at, and how far the estimate is off by every measure."""

import numpy as np

from inspector import html
from inspector.frame import Frame
from inspector.selection import DEFAULT_THRESHOLDS, Selection
from inspector.views import Context
from pipeline.bop import errors
from pipeline.bop.assessment import MOST_ADI_VERTICES, NO_OBJECT


class TargetView:
    """Errors of the selected estimate, and of the compared one beside it."""

    title = "Target"

    def __init__(self, context: Context) -> None:
        self._context = context

    def build(self) -> None:
        """Add the text."""
        self._text = self._context.gui.add_html(html.block(html.paragraph("Click a row of the table.", dim=True)))

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Show the numbers of a row."""
        if frame is None:
            self._text.content = html.block(html.paragraph("Click a row of the table.", dim=True))
            return
        parts = [self._about(frame)]
        names = self._context.workspace.method_names
        if names:
            parts += [html.heading(f"Estimate of {names[frame.method]}"), _estimate_lines(frame, "estimate", selection)]
        if frame.compare is not None:
            parts += [html.heading(f"Compared: {names[frame.compare]}"), _estimate_lines(frame, "compared", selection)]
        self._text.content = html.block(*parts)

    def _about(self, frame: Frame) -> str:
        workspace, row, truth = self._context.workspace, frame.row, frame.ground_truth
        size = f"{frame.camera.width} x {frame.camera.height} px"
        lines: list[html.Line] = [("scene / image", f"{row.scene_id} / {row.im_id}", size, None)]
        if row.obj_id != NO_OBJECT:
            about = f"diameter {frame.model.diameter * 1000:.1f} mm, {_symmetry(len(frame.model.symmetries))}"
            lines.append(("object", str(row.obj_id), about, None))
        if truth is None:
            lines.append(("ground truth", "none", "no annotated instance for this row", None))
        else:
            distance = np.linalg.norm(truth.camera_from_model[:3, 3])
            lines.append(("ground truth", f"instance {truth.index}", f"{distance:.3f} m away", None))
            if truth.visible_fraction is not None:
                lines.append(("visible", f"{truth.visible_fraction:.0%}", f"{truth.visible_pixels} px", None))
        depth = "measured" if workspace.dataset.depth_path(frame.key) is not None else "none: no VSD, no point cloud"
        lines.append(("depth", "yes" if depth == "measured" else "no", depth, None))
        return html.heading("What is looked at") + html.numbers(lines)


def _estimate_lines(frame: Frame, role: str, selection: Selection) -> str:
    holder = frame.estimate if role == "estimate" else frame.compared
    if holder is None:
        return html.paragraph("The method gave no estimate for this instance.", dim=True)
    lines: list[html.Line] = [("score", f"{holder.score:.4g}", _time(holder.time_s), None)]
    truth = frame.pose("ground_truth")
    if truth is None:
        x, y, z = holder.camera_from_model[:3, 3] * 1000
        return html.numbers([*lines, ("translation", f"{x:.1f} {y:.1f} {z:.1f}", "mm, camera frame", None)])
    return html.numbers(lines + _error_lines(frame, holder.camera_from_model, truth, selection))


def _error_lines(frame: Frame, found: np.ndarray, truth: np.ndarray, selection: Selection) -> list[html.Line]:
    model, camera = frame.model, frame.camera
    limits = dict(zip(DEFAULT_THRESHOLDS, selection.thresholds, strict=True))
    mssd, mspd = errors.mssd(model, found, truth), errors.mspd(model, camera.K, found, truth)
    symmetric = len(model.symmetries) > 1
    slow = symmetric and len(model.vertices) > MOST_ADI_VERTICES
    average = np.nan if slow else (errors.adi if symmetric else errors.add)(model, found, truth)
    scaled = mspd.value * 640 / camera.width
    along = found[2, 3] - truth[2, 3]
    across = np.linalg.norm((found - truth)[:2, 3])
    best = truth @ model.symmetries[max(mssd.symmetry, 0)]
    return [
        ("MSSD", f"{mssd.value * 1000:.1f} mm", f"{mssd.value / model.diameter:.3f} of the diameter{_of(mssd.symmetry)}",
         mssd.value / model.diameter < limits["mssd"]),
        ("MSPD", f"{scaled:.1f} px", f"at 640 px width{_of(mspd.symmetry)}", scaled < limits["mspd"]),
        ("ADI" if symmetric else "ADD", f"{average * 1000:.1f} mm", f"{average / model.diameter:.3f} of the diameter",
         average / model.diameter < limits["add"]),
        ("rotation", f"{np.degrees(errors.rotation_error(found, best)):.1f}°", "modulo symmetry", None),
        ("translation", f"{errors.translation_error(found, best) * 1000:.1f} mm",
         f"{along * 1000:+.1f} mm along the view, {across * 1000:.1f} mm across", None),
    ]  # fmt: skip


def _of(symmetry: int) -> str:
    return f", by symmetry {symmetry}" if symmetry > 0 else ""


def _symmetry(count: int) -> str:
    return "no symmetry" if count == 1 else f"{count} symmetry transforms"


def _time(seconds: float) -> str:
    return f"{seconds:.2f} s for the image" if seconds >= 0 else "no time reported"
