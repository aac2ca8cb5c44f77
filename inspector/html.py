"""Small pieces of HTML for viser's panels, in which every text from data is escaped."""

import base64
from collections.abc import Iterable
from html import escape

import cv2
import numpy as np
from jaxtyping import UInt8

Line = tuple[str, str, str, bool | None]
"""A name, a number, a remark, and whether it is good (green), bad (red) or neither."""


def block(*parts: str) -> str:
    """Wrap finished HTML into a block of a panel."""
    return f'<div class="pi-block">{"".join(parts)}</div>'


def heading(text: str) -> str:
    """A heading within a block."""
    return f"<h4>{escape(text)}</h4>"


def paragraph(text: str, *, dim: bool = False) -> str:
    """A line of text."""
    return f'<div class="{"pi-dim" if dim else ""}">{escape(text)}</div>'


def link(text: str, address: str) -> str:
    """A link that opens in a new tab."""
    return f'<a href="{escape(address, quote=True)}" target="_blank" rel="noopener">{escape(text)}</a>'


def frame(address: str, title: str) -> str:
    """Another page within ours."""
    return f'<iframe class="pi-frame" src="{escape(address, quote=True)}" title="{escape(title, quote=True)}"></iframe>'


def numbers(rows: Iterable[Line]) -> str:
    """A table of lines."""
    cells = []
    for name, number, remark, good in rows:
        mark = "" if good is None else "pi-good" if good else "pi-bad"
        cells.append(f'<span>{escape(name)}</span><b class="{mark}">{escape(number)}</b>')
        cells.append(f'<span class="pi-dim">{escape(remark)}</span>')
    return f'<div class="pi-numbers">{"".join(cells)}</div>'


def figure(title: str, caption: str, image: UInt8[np.ndarray, "h w c"]) -> str:
    """An image with a caption below it; `title` is HTML of our own, the caption is text."""
    source = f"data:image/png;base64,{base64.b64encode(png(image)).decode()}"
    text = f"<b>{title}</b> {escape(caption)}"
    return f'<figure><img alt="{escape(caption)}" src="{source}"><figcaption>{text}</figcaption></figure>'


def png(image: UInt8[np.ndarray, "h w c"]) -> bytes:
    """Encode an RGB or RGBA image as PNG."""
    order = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    done, encoded = cv2.imencode(".png", cv2.cvtColor(np.ascontiguousarray(image), order))
    assert done
    return encoded.tobytes()


def finding(severity: str, title: str, subject: str, evidence: str, fix: str) -> str:
    """One finding of the doctor as a card."""
    lines = [f"<b>{escape(title)}</b> <span class='pi-dim'>{escape(subject)}</span>", escape(evidence)]
    if fix:
        lines.append(f"<i>{escape(fix)}</i>")
    return f'<div class="pi-finding pi-{escape(severity, quote=True)}">{"<br>".join(lines)}</div>'
