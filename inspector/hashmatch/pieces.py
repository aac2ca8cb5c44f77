"""Small pieces of HTML of the tab: what can be clicked, pictures, bars. All text from data is escaped."""

import base64
from html import escape
from typing import get_args

from jaxtyping import UInt8
from numpy import ndarray

from inspector import html
from inspector.hashmatch.choice import Part, query
from pipeline.hashmatch.verification import TESTS

NAMES_OF_PARTS: dict[Part, str] = {"trace": "Why", "window": "Window", "swarm": "Refinement"}


def choosing(tag: str, choose: str, inner: str, *, classes: str = "", on: bool = False, hint: str = "") -> str:
    """An element that changes the selection when it is clicked; `inner` is finished HTML.

    Args:
        tag: Of HTML (or of SVG).
        choose: Part of an address.
        inner: What is in it.
        classes: Its CSS classes.
        on: Whether it is what is chosen now.
        hint: Shown when the mouse rests on it.

    """
    marks = f"{classes} pi-hm-choice{' pi-hm-on' if on else ''}".strip()
    pressed = "true" if on else "false"
    title = f' title="{escape(hint, quote=True)}"' if hint else ""
    return (
        f'<{tag} class="{marks}" role="button" tabindex="0" aria-pressed="{pressed}"{title}'
        f' data-choose="{escape(choose, quote=True)}">{inner}</{tag}>'
    )


def image(pixels: UInt8[ndarray, "h w c"], about: str) -> str:
    """A picture within the text."""
    source = base64.b64encode(html.png(pixels)).decode()
    return f'<img alt="{escape(about, quote=True)}" src="data:image/png;base64,{source}">'


def bar(share: float, *, good: bool | None = None, mark: float | None = None) -> str:
    """A bar of 0 to 1, with a tick where it has to reach."""
    color = {True: "pi-hm-good", False: "pi-hm-bad", None: ""}[good]
    tick = "" if mark is None else f'<i style="left:{100 * mark:.1f}%"></i>'
    width = 100 * min(max(share, 0.0), 1.0)
    return f'<span class="pi-hm-bar {color}"><span style="width:{width:.1f}%"></span>{tick}</span>'


def mark(passed: bool | None) -> str:
    """Whether a check was passed; None for one that was not made."""
    sign, name = {True: ("✓", "pi-good"), False: ("✗", "pi-bad"), None: ("–", "pi-dim")}[passed]
    return f'<b class="{name}">{sign}</b>'


def name_of_test(number: int) -> str:
    """T1 to T5, in words."""
    return TESTS[number - 1]


def parts(chosen: Part) -> str:
    """The choice between the parts of the tab."""
    cells = [
        choosing("span", query(part=part), escape(NAMES_OF_PARTS[part]), on=part == chosen) for part in get_args(Part)
    ]
    return f'<div class="pi-hm-parts">{"".join(cells)}</div>'
