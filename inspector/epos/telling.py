"""What the tab says in words and numbers."""

import numpy as np

from inspector import html
from inspector.epos import figures
from inspector.epos.row import EposRow

HINT = "Choose a layer and click a pixel of the image: its fragments. Click the model: where that fragment is seen."


def header(row: EposRow) -> str:
    """Which object, how much of the image it is believed to cover, and what was not recorded."""
    recording = row.recording
    parts = [f"object {recording.obj_id}"]
    if recording.fragments is not None:
        parts += [f"{row.count} fragments", f"likely at {len(recording.fragments.cells)} cells"]
    if row.search is not None:
        final = row.search.stages.count("final")
        parts.append(f"{final} pose{'' if final == 1 else 's'} found" if final else f"{len(row.search)} hypotheses")
    lines = [f"<b>{parts[0]}</b> <span class='pi-dim'>{' · '.join(parts[1:])}</span>"]
    missing = html.paragraph(f"Not recorded: {', '.join(recording.missing)}.", dim=True) if recording.missing else ""
    return html.block(f"<div>{lines[0]}</div>", missing)


def about_cell(row: EposRow) -> str:
    """The distribution at the clicked pixel; what to do where none was clicked."""
    if row.recording.fragments is None:
        return ""
    chosen = _about_fragment(row)
    if not row.choice.has_pixel:
        return html.block(chosen or html.paragraph(HINT, dim=True))
    u, v = row.choice.pixel
    cell = row.cell
    if cell is None:
        text = f"Pixel {u:.0f}, {v:.0f}: object {row.recording.obj_id} is not likely here, so nothing was recorded."
        return html.block(chosen, html.paragraph(text, dim=True))
    b = cell.probabilities
    above = int(np.count_nonzero(b > row.thresholds.tau_b * b.max(initial=0.0)))
    worth = figures.as_many(b)
    lines: list[html.Line] = [
        (f"pixel {u:.0f}, {v:.0f}", f"a = {cell.certainty:.2f}", f"{above} of {len(b)} fragments above τb", None)
    ]
    told = html.paragraph(f"as uncertain as {worth:.1f} equally likely fragments would be", dim=True)
    return html.block(html.numbers(lines), figures.bars_html(row), told, chosen)


def _about_fragment(row: EposRow) -> str:
    """Where the chosen fragment is believed to be, in numbers."""
    fragments, certainty, fragment = row.recording.fragments, row.recording.certainty, row.fragment
    if fragment is None or fragments is None or certainty is None:
        return ""
    belief = certainty * fragments.values[:, fragment]
    if not belief.max(initial=0.0) > 0:
        return html.paragraph(f"Fragment {fragment}: believed to be nowhere in the image.")
    best = fragments.cells[belief.argmax()] * fragments.cell_px + (fragments.cell_px - 1) / 2
    text = f"Fragment {fragment}: most likely at pixel {best[0]:.0f}, {best[1]:.0f}, with {belief.max():.2f}."
    return html.paragraph(text)


def about_matches(row: EposRow) -> str:
    """Counts of correspondences, and how many pixels the pose explains."""
    matches = row.matches
    if matches is None:
        return html.block(html.paragraph("No correspondences were recorded of this object.", dim=True))
    count, pixels = len(matches.links), matches.pixels
    origin = "fitted" if matches.recorded else "anew"
    per_pixel = f"{count / pixels:.1f} a pixel, {origin}" if pixels else origin
    lines: list[html.Line] = [("pixels", str(pixels), "", None), ("correspondences", str(count), per_pixel, None)]
    if row.pose is None:
        lines.append(("inliers", "–", "no pose to hold them against", None))
    else:
        share = f", {len(matches.inliers) / pixels:.0%}" if pixels else ""
        lines.append(("inliers", str(len(matches.inliers)), f"of {row.pose.name}{share}", None))
        lines.append(("quality", f"{matches.quality:.3f}", "q of that pose", None))
    return html.block(html.numbers(lines))


def about_search(row: EposRow) -> tuple[str, str]:
    """The plot with the shown hypothesis in words, and what the search decided."""
    decisions = row.recording.decisions
    story = (
        html.block(html.heading("What it took, why it stopped"), figures.decisions_html(decisions)) if decisions else ""
    )
    search = row.search
    if search is None:
        return html.block(html.paragraph("No hypotheses were recorded of this object.", dim=True)), story
    shown = row.hypothesis
    index = None if shown is None else shown.position
    told = _about_hypothesis(row) if shown is not None else html.paragraph("A click goes to a hypothesis.", dim=True)
    return html.block(figures.search_html(search, index), figures.key_html(search), told), story


def _about_hypothesis(row: EposRow) -> str:
    shown, search = row.hypothesis, row.search
    assert shown is not None
    assert search is not None
    best = ", the best so far" if shown.best else ""
    first = f"{shown.position + 1} of {len(search)}: {shown.stage}{best}, quality {shown.quality:.3f}"
    more = []
    if shown.before is not None:
        more.append(f"local optimization: from {shown.before.quality:.3f} to {shown.quality:.3f}")
    if shown.stage == "early":
        more.append("dropped after a look at the pixels around its triplet: its quality is about these alone")
    if shown.instance >= 0:
        more.append(f"{'instance' if shown.stage == 'final' else 'proposal'} {shown.instance + 1}")
    if shown.triplet is None:
        more.append("not computed from a triplet")
    return f"<div><b>{html.escape(first)}</b></div>" + "".join(html.paragraph(line, dim=True) for line in more)
