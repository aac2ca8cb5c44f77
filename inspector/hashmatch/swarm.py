"""The part of the tab about refinement: scores of the particles over iterations, and both poses in numbers."""

from html import escape

import numpy as np

from inspector import html
from inspector.frame import Frame
from inspector.hashmatch import pieces
from inspector.hashmatch.choice import query, window_query
from inspector.hashmatch.heat import colors_of
from inspector.hashmatch.refinement import Refinement
from inspector.selection import View
from pipeline.bop.errors import mssd
from pipeline.scene import ImageKey, PoseEstimate

WIDTH, HEIGHT = 330, 130
NEARBY = np.array([-1.4, -1.3, -2.1])
"""From where a swarm is looked at in 3D: diameters from the refined pose, camera frame."""
LEFT, BOTTOM, TOP = 34, 18, 6
"""Margins of the plot."""


def estimates_part(key: ImageKey, estimates: dict[int, PoseEstimate], chosen: int | None) -> str:
    """All estimates of the image, to choose from."""
    cells = [
        pieces.choosing(
            "span",
            query(key, instance=number, iteration=None),
            f"object {estimate.obj_id}<em>{estimate.score:.2f}</em>",
            on=number == chosen,
            hint=f"estimate {number}, score {estimate.score:.4g}",
        )
        for number, estimate in estimates.items()
    ]
    return f'<div class="pi-hm-chips">{"".join(cells)}</div>'


def swarm_part(frame: Frame, found: Refinement, iteration: int, view: View) -> str:
    """Plot and numbers of a refinement; `view` is the one that is open."""
    parts = []
    if found.swarm is None:
        parts.append(
            html.paragraph("No swarm was recorded of this estimate (refinement off, or recording was).", dim=True)
        )
    else:
        parts += [_heading(found, iteration), plot(found, iteration)]
    parts.append(html.heading("Rough → refined") + html.numbers(_numbers(frame, found)))
    parts.append(f"<div>{_other_view(frame, found, view)}</div>")
    if found.detection is not None:
        link = pieces.choosing(
            "span", window_query(frame.key, detection=found.detection, level=None, part="window"),
            f"its window and template (detection {found.detection})", classes="pi-hm-link",
        )  # fmt: skip
        parts.append(f"<div>It began with {link}.</div>")
    return "".join(parts)


def plot(found: Refinement, iteration: int) -> str:
    """Scores of all particles (dots) and the best so far (line) over the iterations; a click goes to one."""
    assert found.swarm is not None
    low, high = _limits(found)
    columns = max(found.last, 1)

    def at(step: np.ndarray | float, score: np.ndarray | float) -> tuple:
        x = LEFT + 8 + (WIDTH - LEFT - 16) * np.asarray(step) / columns
        share = np.clip((np.asarray(score) - low) / (high - low), 0, 1)
        return x, TOP + (HEIGHT - TOP - BOTTOM) * (1 - share)

    dots_x, dots_y = at(found.steps, found.swarm.quality)
    colors = colors_of(found.swarm.quality, *found.scores)
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{3 if step == iteration else 1.8}" fill="rgb({r},{g},{b})"'
        f' opacity="{1 if step == iteration else 0.55}"/>'
        for x, y, step, (r, g, b) in zip(dots_x, dots_y, found.steps, colors, strict=True)
    )
    line_x, line_y = at(np.arange(len(found.best_scores)), found.best_scores)
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(line_x, line_y, strict=True))
    here, _ = at(iteration, low)
    half = (WIDTH - LEFT - 16) / columns / 2
    columns_to_click = "".join(_column(float(at(step, low)[0]), half, step) for step in range(found.last + 1))
    texts = (
        f'<text x="{LEFT}" y="{TOP + 8}" class="pi-hm-y">{high:.2f}</text>'
        f'<text x="{LEFT}" y="{HEIGHT - BOTTOM}" class="pi-hm-y">{low:.2f}</text>'
        f'<text x="{LEFT + 8}" y="{HEIGHT - 4}">0</text><text x="{WIDTH - 8}" y="{HEIGHT - 4}">{found.last}</text>'
        f'<text x="{(LEFT + WIDTH) / 2}" y="{HEIGHT - 4}">iteration</text>'
    )
    return (
        f'<svg class="pi-hm-plot" viewBox="0 0 {WIDTH} {HEIGHT}">'
        f'<line x1="{here:.1f}" x2="{here:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>{dots}'
        f'<polyline points="{line}"/>{texts}{columns_to_click}</svg>'
    )


def _column(x: float, half: float, step: int) -> str:
    return (
        f'<rect class="pi-hm-choice" data-choose="{escape(query(iteration=step), quote=True)}" x="{x - half:.1f}"'
        f' y="0" width="{2 * half:.1f}" height="{HEIGHT}"><title>iteration {step}</title></rect>'
    )


def _limits(found: Refinement) -> tuple[float, float]:
    low, high = found.scores
    if len(found.best_scores):
        low, high = min(low, float(found.best_scores.min())), max(high, float(found.best_scores.max()))
    room = 0.05 * (high - low)
    return low - room, high + room


def _heading(found: Refinement, iteration: int) -> str:
    assert found.swarm is not None
    score = found.best_scores[iteration] if iteration < len(found.best_scores) else found.swarm.quality.max()
    count = int(found.particles(iteration).sum())
    said = f"iteration {iteration} of {found.last}: {count} particles, best score so far {score:.3f}"
    return html.heading("Particle swarm") + f'<div class="pi-dim pi-hm-small">{escape(said)}</div>'


def _other_view(frame: Frame, found: Refinement, view: View) -> str:
    """A link to the particles in 3D, seen from nearby; or back to the image."""
    if view == "scene" or not frame.has_model(found.estimate.obj_id):
        return pieces.choosing("span", "view=image", "Outlines over the image", classes="pi-hm-link")
    center = found.estimate.camera_from_model[:3, 3]
    eye = center + NEARBY * frame.workspace.dataset.model(found.estimate.obj_id).diameter
    place = ",".join(f"{number:.4f}" for number in (*eye, *center))
    return pieces.choosing("span", f"view=scene&eye={place}", "Particles in 3D, from nearby", classes="pi-hm-link")


def _numbers(frame: Frame, found: Refinement) -> list[html.Line]:
    lines: list[html.Line] = []
    if len(found.best_scores):
        first, last = float(found.best_scores[0]), float(found.best_scores[-1])
        lines.append(("score", f"{first:.3f} → {last:.3f}", f"{last - first:+.3f}", None))
    moved = found.moved
    if moved is not None:
        lines.append(("moved by", f"{moved[0] * 1000:.1f} mm, {moved[1]:.1f}°", "", None))
    truth = frame.ground_truth
    if truth is None or truth.obj_id != found.estimate.obj_id or found.rough is None:
        return lines
    before, after = (
        mssd(frame.model, pose, truth.camera_from_model).value
        for pose in (found.rough, found.estimate.camera_from_model)
    )
    lines.append(("MSSD", f"{before * 1000:.1f} → {after * 1000:.1f} mm", "", after <= before))
    return lines
