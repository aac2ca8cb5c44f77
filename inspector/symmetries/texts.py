"""What the page of symmetries says, as HTML in which every text from data is escaped."""

from html import escape

from inspector import html
from inspector.symmetries.review import Review
from pipeline.exceptions import InputError
from pipeline.symmetry_search.groups import Candidate
from pipeline.symmetry_search.search import SymmetrySearch

_MARKS = {"accepted": ("✓", "pi-good"), "refused": ("✗", "pi-bad"), "open": ("?", "pi-dim")}
_COMMANDS = (
    ("N P", "next, previous candidate"),
    ("Y X", "accept, refuse"),
    ("O I", "next, previous object"),
    ("V", "both, blink, distance"),
    ("G", "decide all as suggested"),
    ("U", "undo"),
    ("K", "save"),
)
KEYS = html.block(
    '<div class="pi-keys pi-narrow">'
    + "".join(f"<kbd>{key}</kbd><span>{escape(text)}</span>" for key, text in _COMMANDS)
    + "</div>"
)


def heading(review: Review) -> str:
    """The object, what is accepted of it, and whether it is saved."""
    obj_id = review.state.obj_id
    parts = [f"<h4>Object {obj_id}</h4>"]
    search = review.searches.get(obj_id)
    if search is None:
        parts.append(html.paragraph(f"searching … {100 * review.progress:.0f} % of the objects are done", dim=True))
    elif isinstance(search, InputError):
        parts.append(html.finding("error", "Not searched", "", str(search), ""))
    else:
        group = review.group(obj_id)
        parts.append(html.paragraph(f"accepted: {group.name}"))
        parts.append(html.paragraph(_bounds(search), dim=True))
    if len(review.searches) < len(review.models) and search is not None:
        parts.append(html.paragraph(f"searching: {len(review.searches)} of {len(review.models)} objects", dim=True))
    if review.unsaved:
        parts.append('<div class="pi-bad">not saved yet</div>')
    if review.message:
        parts.append(f"<div><i>{escape(review.message)}</i></div>")
    return html.block(*parts)


def list_of_candidates(review: Review) -> str:
    """The candidates of the object, the one looked at marked."""
    obj_id = review.state.obj_id
    search = review.searches.get(obj_id)
    if not isinstance(search, SymmetrySearch):
        return ""
    if not search.candidates:
        return html.block(html.paragraph("No candidates: no symmetry is nearer than the bound."))
    rows = [_row(review, position, candidate) for position, candidate in enumerate(search.candidates)]
    head = "<tr><th></th><th>symmetry</th><th>axis</th><th>distance</th><th>of ⌀</th></tr>"
    return html.block(f'<table class="pi-candidates">{head}{"".join(rows)}</table>')


def scale(largest: float, bound: float) -> str:
    """Legend of the colours of the distance, metres."""
    stops = "rgb(40,60,150),rgb(40,170,140),rgb(250,220,60),rgb(230,50,40)"
    bar = f'<span class="pi-scale" style="display:inline-block;background:linear-gradient(to right,{stops})"></span>'
    return html.block(f"0 {bar} {bound * 1000:.1f} mm or more<br>largest distance here: <b>{largest * 1000:.2f} mm</b>")


def _bounds(search: SymmetrySearch) -> str:
    bound, epsilon = search.bound * 1000, search.epsilon * 1000
    return f"suggested up to ε = {epsilon:.2f} mm, candidates up to {bound:.1f} mm; {search.seconds:.1f} s"


def _row(review: Review, position: int, candidate: Candidate) -> str:
    obj_id = review.state.obj_id
    mark, look = _MARKS[review.decision(obj_id, position)]
    diameter = review.models[obj_id].diameter
    direction = "any" if candidate.kind == "sphere" else " ".join(f"{value:+.2f}" for value in candidate.axis.direction)
    suggested = " suggested" if review.is_suggested(obj_id, position) else ""
    chosen = ' class="pi-chosen"' if position == review.state.position else ""
    cells = [
        f'<td class="{look}"><b>{mark}</b></td>',
        f"<td>{escape(str(candidate))}<span class='pi-dim'>{suggested}</span></td>",
        f"<td>{direction}</td>",
        f"<td>{candidate.distance * 1000:.2f} mm</td>",
        f"<td>{candidate.distance / diameter:.1%}</td>",
    ]
    return f"<tr{chosen}>{''.join(cells)}</tr>"
