"""Everything that a key or the command palette (Ctrl+K) does, in one table; the help is made from it."""

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, get_args

from inspector.selection import DepthLayer, Style

if TYPE_CHECKING:
    from inspector.session import Session


@dataclass(frozen=True)
class Command:
    """Something that a person can ask for by key or by name."""

    name: str
    label: str
    run: "Callable[[Session], Any]"
    hotkey: Any = None
    """Key in viser's words, without modifiers; W A S D Q E and the arrows move viser's camera and are not used here."""
    shown_key: str | None = None
    """Key as the help shows it where the page handles it itself."""
    on_board: bool = False
    """Whether it is of use while the leaderboard covers the picture."""


def _toggle(field: str) -> "Callable[[Session], Any]":
    return lambda session: session.change(display={field: not getattr(session.selection.display, field)})


def _cycle(field: str, choices: tuple[str, ...]) -> "Callable[[Session], Any]":
    def run(session: "Session") -> None:
        now = choices.index(getattr(session.selection.display, field))
        session.change(display={field: choices[(now + 1) % len(choices)]})

    return run


def _swap(session: "Session") -> None:
    selection = session.selection
    if selection.compare is not None:
        session.change(method=selection.compare, compare=selection.method)


COMMANDS = (
    Command("next", "Next target", lambda s: s.steering.step(1), "N", "N ↓"),
    Command("previous", "Previous target", lambda s: s.steering.step(-1), "P", "P ↑"),
    Command("next_image", "Next image", lambda s: s.steering.step_image(1), None, "→"),
    Command("previous_image", "Previous image", lambda s: s.steering.step_image(-1), None, "←"),
    Command("image_view", "Image view", lambda s: s.change(view="image"), "1"),
    Command("scene_view", "3D scene view", lambda s: s.change(view="scene"), "2"),
    Command(
        "leaderboard", "Leaderboard", lambda s: s.change(board={"open": not s.selection.board.open}), "3", None, True
    ),
    Command("add_results", "Add results to the leaderboard", lambda s: s.leaderboard.add(), None, None, True),
    Command("fit", "Fit the image into the window", lambda s: s.fit(), "F"),
    Command("zoom_to_object", "Zoom to the object", lambda s: s.zoom_to_object(), "Z"),
    Command("ground_truth", "Show or hide the ground truth", _toggle("ground_truth"), "G"),
    Command("estimate", "Show or hide the estimate", _toggle("estimate"), "T"),
    Command("others", "Show or hide other instances", _toggle("others"), "O"),
    Command("style", "Models as contour, fill, wireframe, shaded", _cycle("style", get_args(Style)), "C"),
    Command("blink", "Blink between ground truth and estimate", _toggle("blink"), "B"),
    Command("wipe", "Wipe between estimate and ground truth", _toggle("wipe"), "X"),
    Command("image", "Show or hide the image", _toggle("image"), "I"),
    Command("depth", "Depth layer: off, depth, difference", _cycle("depth", get_args(DepthLayer)), "H"),
    Command("masks", "Show or hide the visible masks", _toggle("masks"), "M"),
    Command("witness", "Show or hide the witness of MSSD and MSPD", _toggle("witness"), "V"),
    Command("points", "Show or hide the point cloud (3D)", _toggle("points"), "U"),
    Command("rerun", "Open the recording in Rerun", lambda s: s.rerun.open(), "L"),
    Command("swap", "Swap the inspected and the compared method", _swap, "R"),
    Command("theme", "Dark or light", lambda s: s.change(dark=not s.selection.dark), "Y", None, True),
    Command("save", "Save a picture of the view (PNG)", lambda s: s.save_picture(), "K"),
    Command("help", "Keys and commands", lambda s: s.help(), None, "?", True),
)


def help_html() -> str:
    """All commands with their keys, and what the mouse does."""
    mouse = (
        ("wheel", "zoom at the mouse (image view)"),
        ("drag", "move the image; turn the scene in 3D"),
        ("click", "select the object under the mouse"),
        ("double click", "fit the image into the window"),
        ("Ctrl K", "find a command by name"),
    )
    pairs = [(c.shown_key or c.hotkey or "", c.label) for c in COMMANDS] + list(mouse)
    cells = "".join(f"<kbd>{escape(str(key))}</kbd><span>{escape(text)}</span>" for key, text in pairs)
    return f'<div class="pi-block pi-keys">{cells}</div>'
