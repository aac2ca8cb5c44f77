"""The funnel: five small pictures of where candidates are left after each stage, and how many (thesis, fig. pipeline)."""

from html import escape
from math import log10

import numpy as np
from jaxtyping import UInt8

from inspector.hashmatch import pieces
from inspector.hashmatch.choice import HashMatchChoice, query
from inspector.hashmatch.heat import counted, thumbnail
from pipeline.hashmatch.window_report import RecordedMatching, StageCount

NAMES = {
    "windows": "windows",
    "objectness": "objectness",
    "hashing": "hashing",
    "verification": "verification",
    "nms": "suppression",
}
"""Names of the stages, in the order of the cascade."""
LEVEL_HEIGHT = 19
"""Of the largest bar of a level, CSS pixels."""
HEIGHT = 40
"""Of the funnel's drawing, in units of which a stage is 100 wide."""


def funnel(matching: RecordedMatching, rgb: UInt8[np.ndarray, "h w 3"], choice: HashMatchChoice) -> str:
    """Pictures and counts of all stages at the chosen level; a click chooses a stage, another one lets it go."""
    counts = matching.stage_counts(choice.level)
    cells = [_stage(matching, rgb, choice, stage, counts[stage]) for stage in NAMES]
    return f'<div class="pi-hm-funnel">{"".join(cells)}{_drawing([counts[stage].candidates for stage in NAMES])}</div>'


def levels(matching: RecordedMatching, choice: HashMatchChoice) -> str:
    """The levels of the pyramid with the candidates of the chosen stage as bars; a click chooses one."""
    stage = "hashing" if choice.stage == "off" else choice.stage
    counts = {level: matching.stage_counts(level)[stage].candidates for level in matching.levels}
    most = max(1, *counts.values())
    hint = "all levels of the pyramid together"
    cells = [pieces.choosing("span", query(level=None), "<em>all</em>", on=choice.level is None, hint=hint)]
    for level, count in counts.items():
        hint = f"level {level}, image scaled by {matching.scales[level]:.2f}: {count:,} candidates after {NAMES[stage]}"
        share = count / most
        inner = f'<u style="height:{LEVEL_HEIGHT * share:.0f}px"></u><em>{level}</em>'
        cells.append(pieces.choosing("span", query(level=level), inner, on=choice.level == level, hint=hint))
    return f'<div class="pi-hm-levels"><span class="pi-dim">level</span>{"".join(cells)}</div>'


def background(depth: str) -> str:
    """What the candidates are drawn over, and how to hide them."""
    cells = [
        pieces.choosing("span", f"display.depth={value}", name, on=depth == value)
        for value, name in (("off", "colour"), ("depth", "depth"))
    ]
    return f'<div class="pi-hm-over"><span class="pi-dim">drawn over</span>{"".join(cells)}</div>'


def _stage(
    matching: RecordedMatching, rgb: UInt8[np.ndarray, "h w 3"], choice: HashMatchChoice, stage: str, count: StageCount
) -> str:
    small = pieces.image(thumbnail(matching.heatmap(stage, choice.level), rgb), f"candidates after {NAMES[stage]}")
    on = choice.stage == stage
    hint = f"{count.candidates:,} candidates in {count.windows:,} windows after {NAMES[stage]}"
    inner = f"{small}<b>{counted(count.candidates)}</b><em>{escape(NAMES[stage])}</em>"
    return pieces.choosing("span", query(stage="off" if on else stage), inner, on=on, hint=hint)


def _drawing(counts: list[int]) -> str:
    """The counts as a funnel, by their logarithm, and by what each stage divides them."""
    most = max(_height(counts[0]), 1e-9)
    half = [max(_height(count) / most * (HEIGHT / 2 - 1), 0.6) for count in counts]
    x = [100 * i + 50 for i in range(len(counts))]
    above = [f"{x[i]},{HEIGHT / 2 - half[i]:.1f}" for i in range(len(counts))]
    below = [f"{x[i]},{HEIGHT / 2 + half[i]:.1f}" for i in reversed(range(len(counts)))]
    ends = [f"0,{HEIGHT / 2 - half[0]:.1f}", *above, f"500,{HEIGHT / 2 - half[-1]:.1f}"]
    back = [f"500,{HEIGHT / 2 + half[-1]:.1f}", *below, f"0,{HEIGHT / 2 + half[0]:.1f}"]
    texts = [
        f'<text x="{(x[i] + x[i + 1]) / 2}" y="{HEIGHT / 2 + 5}">{_divided(counts[i], counts[i + 1])}</text>'
        for i in range(len(counts) - 1)
    ]
    return f'<svg viewBox="0 0 500 {HEIGHT}"><polygon points="{" ".join(ends + back)}"/>{"".join(texts)}</svg>'


def _divided(before: int, after: int) -> str:
    if not before or before == after:
        return ""
    if not after:
        return "all"
    ratio = before / after
    return f"÷{ratio:.1f}" if ratio < 10 else f"÷{ratio:,.0f}"


def _height(count: int) -> float:
    return log10(1 + count)
