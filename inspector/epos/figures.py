"""The tab's own pictures as HTML and SVG: the model's two sides, the bars of a pixel, the search over its steps."""

import base64
from html import escape
from urllib.parse import urlencode

import numpy as np
from jaxtyping import Float, UInt8

from inspector import html
from inspector.epos.choice import EposLayer
from inspector.epos.row import EposRow
from inspector.epos.search import Search

SIDES = "epos/sides/"
"""Names of the pictures of the model begin with this; 0 or 1 follows."""
PLOT = "epos/search"
"""Name of the plot of the search."""
MOST_BARS = 64
"""Bars drawn for a pixel: of more fragments the most likely ones."""
FEWEST_BARS = 16
"""Bars for which there is room, so that a single one is not as wide as the tab."""
NEGLIGIBLE = 0.01
"""Share of the highest bar from which a bar is drawn."""
MOST_DOTS = 500
"""Hypotheses drawn as dots; more are thinned out, but never those that were the best so far."""
WIDTH, BARS_HEIGHT, PLOT_HEIGHT = 340.0, 96.0, 120.0
"""Of the drawings, in their own units: about CSS pixels."""
_LEFT, _BOTTOM = 26.0, 16.0
_STAGE_CLASSES = {"final": "final", "optimized": "optimized", "refined": "refined", "early": "early"}


def sides_html(pictures: tuple[UInt8[np.ndarray, "s s 4"], ...], captions: tuple[str, ...]) -> str:
    """The model from its sides, one beside the other; a click on one tells where."""
    figures = []
    for index, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        source = f"data:image/png;base64,{base64.b64encode(html.png(picture)).decode()}"
        image = f'<img alt="{escape(caption)}" src="{source}" data-touch="{SIDES}{index}" draggable="false">'
        figures.append(f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>")
    return f'<div class="pi-epos-sides">{"".join(figures)}</div>'


def bars_html(row: EposRow) -> str:
    """The fragment distribution at the clicked pixel, sorted, in the fragments' colours; a click chooses a fragment."""
    assert row.cell is not None
    b = row.cell.probabilities.astype(np.float64)
    highest = max(float(b.max(initial=0.0)), 1e-9)
    order = np.argsort(-b, kind="stable")[: min(np.count_nonzero(b > NEGLIGIBLE * highest), MOST_BARS)]
    step = (WIDTH - _LEFT) / max(len(order), FEWEST_BARS)
    height = BARS_HEIGHT - 6
    bars = []
    for place, fragment in enumerate(order.tolist()):
        tall = max(b[fragment] / highest * height, 0.8)
        x, dim = _LEFT + place * step, "" if b[fragment] > row.thresholds.tau_b * highest else " pi-epos-dim"
        chosen = " pi-epos-chosen" if fragment == row.fragment else ""
        tip = f"fragment {fragment}: {b[fragment]:.3f}"
        bars.append(
            f'<g class="pi-epos-bar{dim}{chosen}" {_choose(fragment, row)}><title>{tip}</title>'
            f'<rect class="pi-epos-hit" x="{x:.1f}" y="0" width="{step:.2f}" height="{BARS_HEIGHT}"/>'
            f'<rect x="{x:.1f}" y="{BARS_HEIGHT - tall:.1f}" width="{max(step - 1, 1):.2f}" height="{tall:.1f}"'
            f' fill="{_css(row.colors[fragment])}"/></g>'
        )
    limit = BARS_HEIGHT - row.thresholds.tau_b * height
    drawn = _line(_LEFT, WIDTH, limit, "pi-epos-limit") + _text(_LEFT - 3, limit + 3, "τb") + "".join(bars)
    drawn += _text(_LEFT - 3, BARS_HEIGHT - height + 3, f"{highest:.2f}") + _text(_LEFT - 3, BARS_HEIGHT, "0")
    return _svg(BARS_HEIGHT + 1, drawn, "probability of each fragment at the pixel")


def as_many(b: Float[np.ndarray, "n"]) -> float:
    """How many equally likely fragments a distribution is worth: the exponential of its entropy."""
    p = b.astype(np.float64)
    p = p[p > 0] / max(float(p.sum()), 1e-12)
    return float(np.exp(-(p * np.log(p)).sum())) if len(p) else 0.0


def search_html(search: Search, shown: int | None) -> str:
    """Quality over the search: dots by stage, the best so far as a line, the shown hypothesis marked."""
    steps, quality = len(search), np.clip(search.quality, 0, max(1.0, float(search.quality.max(initial=0.0))))
    top = max(1.0, float(quality.max(initial=0.0)))
    bottom = PLOT_HEIGHT - _BOTTOM

    def at(index: float, value: float) -> tuple[float, float]:
        share = index / max(steps - 1, 1)
        return _LEFT + 4 + share * (WIDTH - _LEFT - 10), 5 + (1 - value / top) * (bottom - 5)

    drawn = "".join(_line(_LEFT, WIDTH, at(0, level)[1], "pi-epos-grid") for level in (0, top / 2, top))
    drawn += "".join(_text(_LEFT - 3, at(0, level)[1] + 3, f"{level:.1f}") for level in (0, top / 2, top))
    if shown is not None:
        x = at(shown, 0)[0]
        drawn += f'<line class="pi-epos-now" x1="{x:.1f}" x2="{x:.1f}" y1="2" y2="{bottom}"/>'
    drawn += f'<path class="pi-epos-best" d="{_staircase(search, at)}"/>'
    drawn += "".join(
        f'<circle class="pi-epos-{_STAGE_CLASSES.get(search.stages[i], "sample")}"'
        f' cx="{at(i, 0)[0]:.1f}" cy="{at(0, quality[i])[1]:.1f}" r="{2.8 if search.best[i] else 1.7}"/>'
        for i in _dots(search)
    )
    if shown is not None:
        x, y = at(shown, quality[shown])
        drawn += f'<circle class="pi-epos-shown" cx="{x:.1f}" cy="{y:.1f}" r="5"/>'
    drawn += f'<text x="{_LEFT + 4}" y="{PLOT_HEIGHT - 3}">1</text>'
    drawn += _text(WIDTH - 4, PLOT_HEIGHT - 3, f"{steps} hypotheses")
    return _svg(PLOT_HEIGHT, drawn, "quality of the hypotheses in the order of the search", PLOT)


def step_at(search: Search, x: float) -> int:
    """Hypothesis at a share of the plot's width."""
    share = (x * WIDTH - _LEFT - 4) / (WIDTH - _LEFT - 10)
    return round(min(max(share, 0.0), 1.0) * (len(search) - 1))


def key_html(search: Search) -> str:
    """What the dots stand for, of the stages that there are."""
    present = dict.fromkeys(search.stages)
    dots = [
        f'<span><i class="pi-epos-{_STAGE_CLASSES.get(stage, "sample")}"></i>{escape(stage)}</span>'
        for stage in list(present)[:5]
    ]
    return f'<div class="pi-epos-key">{"".join(dots)}<span><i class="pi-epos-best"></i>best so far</span></div>'


def decisions_html(decisions: tuple[str, ...]) -> str:
    """What the search took and why it stopped, one line each."""
    lines = []
    for text in decisions:
        kind, colon, rest = text.partition(": ")
        known = bool(colon) and kind.isalpha()
        word, told = (kind, rest) if known else ("found", text)
        lines.append(f"<li><b>{escape(word)}</b> {escape(told)}</li>")
    return f'<ul class="pi-epos-list">{"".join(lines)}</ul>' if lines else ""


def _dots(search: Search) -> list[int]:
    every = max(1, -(-len(search) // MOST_DOTS))
    best = np.flatnonzero(search.best)
    kept = np.union1d(np.arange(0, len(search), every), best[:: max(1, -(-len(best) // MOST_DOTS))])
    return kept.tolist()


def _staircase(search: Search, at) -> str:
    """The best quality so far as a path, with a step where it rises."""
    rises = np.flatnonzero(np.diff(search.best_quality, prepend=-1.0) > 0)[-MOST_DOTS:]
    x, y = at(int(rises[0]), search.best_quality[rises[0]])
    parts = [f"M{x:.1f} {y:.1f}"]
    for i in rises[1:].tolist():
        x, y = at(i, search.best_quality[i])
        parts.append(f"H{x:.1f}V{y:.1f}")
    return "".join(parts) + f"H{at(len(search) - 1, 0)[0]:.1f}"


def _choose(fragment: int, row: EposRow) -> str:
    """Attributes that make a bar choose its fragment, or none again."""
    layer: EposLayer = row.choice.layer
    wanted = "none" if fragment == row.fragment else fragment
    query = urlencode({"epos.fragment": wanted, "epos.layer": layer})
    return f'data-choose="{escape(query, quote=True)}" role="button" tabindex="-1"'


def _svg(height: float, content: str, label: str, touch: str = "") -> str:
    touched = f' data-touch="{touch}"' if touch else ""
    return (
        f'<svg class="pi-epos-plot" viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{escape(label)}"{touched}>'
        f"{content}</svg>"
    )


def _line(x1: float, x2: float, y: float, name: str) -> str:
    return f'<line class="{name}" x1="{x1:g}" x2="{x2:g}" y1="{y:.1f}" y2="{y:.1f}"/>'


def _text(x: float, y: float, text: str) -> str:
    """Text that ends at x."""
    return f'<text x="{x:g}" y="{y:.1f}" text-anchor="end">{escape(text)}</text>'


def _css(color: np.ndarray) -> str:
    return f"rgb({color[0]},{color[1]},{color[2]})"
