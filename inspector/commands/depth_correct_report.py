"""Estimates of a depth correction in words."""

from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

if TYPE_CHECKING:
    from annotate.depth import DepthEstimate, UnknownSizeEstimate


def show_estimate(found: "DepthEstimate", console: Console) -> None:
    """Print a correction, how sure it is, and what it is worth."""
    from annotate.depth.models import TEXTS

    content = found.as_dict()
    low, high = content["depth_range"]
    lines = [
        f"d_c = a d + b from {content['samples']} samples in {content['images']} images, {low:.3f} to {high:.3f} m"
    ]
    lines.append(f"  a = {found.a:.4f}{_sure(content['std_a'], content['interval_a'], 1, 4)}")
    lines.append(f"  b = {1000 * found.b:.2f} mm{_sure(content['std_b'], content['interval_b'], 1000, 2)}")
    before, after = 1000 * found.before, 1000 * found.held_out.mean_abs
    lines.append(f"  mean absolute difference: {before:.2f} mm before, {after:.2f} mm after (held out)")
    lines += [f"  better: {TEXTS[one.kind]}, {1000 * one.mean_abs:.2f} mm (held out)" for one in found.offered]
    tell(console, lines, found.notes)


def show_unknown_size(found: "UnknownSizeEstimate", console: Console) -> None:
    """Print what markers of unknown size tell."""
    content = found.as_dict()
    low, high = content["depth_range"]
    lines = [
        f"markers of unknown size: {content['samples']} corners in {content['images']} images, {low:.2f} to {high:.2f} m"
    ]
    lines.append(f"  side / a = {1000 * found.side:.2f} mm{_sure(found.side_std, None, 1000, 2)}")
    lines.append(f"  b / a = {1000 * found.b:.2f} mm{_sure(found.b_std, None, 1000, 2)}")
    lines.append(f"  with b = 0: side / a = {1000 * found.side_without_offset:.2f} mm")
    lines.append(f"  corners fit the learned layout to {found.rms_px:.2f} px (RMS)")
    tell(console, lines, found.notes)


def tell(console: Console, lines: list[str], notes: tuple[str, ...]) -> None:
    """Print lines as they are, then notes."""
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    for note in notes:
        console.print(f"[yellow]note:[/yellow] {escape(note)}", highlight=False, soft_wrap=True)


def _sure(std: float | None, interval: tuple[float, float] | None, scale: float, digits: int) -> str:
    if std is None:
        return ""
    text = f" +- {scale * std:.{digits}f}"
    if interval is not None:
        text += f" (95 % by bootstrap: {scale * interval[0]:.{digits}f} to {scale * interval[1]:.{digits}f})"
    return text
