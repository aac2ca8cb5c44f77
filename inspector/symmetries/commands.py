"""What keys and buttons do while symmetries are reviewed, in one table; the page makes its help from it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from inspector.symmetries.app import SymmetryApp


@dataclass(frozen=True)
class Command:
    """Something that a person can ask for by key, by button or by name (Ctrl+K)."""

    name: str
    label: str
    key: str
    """As the browser names it (KeyboardEvent.key), letters in lower case; several are separated by blanks."""
    run: "Callable[[SymmetryApp], Any]"
    shown_key: str = ""
    """As the help shows it, where it differs."""


COMMANDS = (
    Command("accept", "Accept the candidate", "a", lambda app: app.review.accept(), "A"),
    Command("refuse", "Refuse the candidate", "r", lambda app: app.review.refuse(), "R"),
    Command("reopen", "Leave the candidate open again", "o", lambda app: app.review.reopen(), "O"),
    Command(
        "suggested", "Accept what is suggested for the object", "g", lambda app: app.review.accept_suggested(), "G"
    ),
    Command(
        "all_suggested",
        "Accept what is suggested for all objects not decided yet",
        "Shift+g",
        lambda app: app.review.accept_all_suggested(),
        "Shift G",
    ),
    Command("fewer", "Accept fewer of the candidate's turns", "-", lambda app: app.review.step_fold(1), "−"),
    Command("more", "Accept more of the candidate's turns", "+ Shift++", lambda app: app.review.step_fold(-1), "+"),
    Command("undo", "Undo the last decision", "u Ctrl+z", lambda app: app.review.undo(), "U"),
    Command("save", "Save to models_info.json", "s Ctrl+s", lambda app: app.save(), "S"),
    Command("next", "Next candidate", "n ArrowDown", lambda app: app.review.step(1), "N ↓"),
    Command("previous", "Previous candidate", "p ArrowUp", lambda app: app.review.step(-1), "P ↑"),
    Command("next_object", "Next object", "ArrowRight", lambda app: app.review.step_object(1), "→"),
    Command("previous_object", "Previous object", "ArrowLeft", lambda app: app.review.step_object(-1), "←"),
    Command("overlay", "Model and turned self, one over the other", "1", lambda app: app.change(mode="overlay")),
    Command("blink", "Model and turned self in turn", "2", lambda app: app.change(mode="blink")),
    Command("distance", "Distances on the surface", "3", lambda app: app.change(mode="distance")),
    Command("colors", "The model's own colours", "c", lambda app: app.change(colors=not app.picture.look.colors), "C"),
    Command(
        "play",
        "Turn about the axis, or stop",
        " ",
        lambda app: app.change(playing=not app.picture.look.playing),
        "Space",
    ),
    Command("turn_on", "To the next turn of the symmetry", "]", lambda app: app.turn_by(1)),
    Command("turn_back", "To the turn before", "[", lambda app: app.turn_by(-1)),
    Command("along", "Look along the axis", "v", lambda app: app.look_along(), "V"),
    Command("home", "Look from the front and above", "f", lambda app: app.look_home(), "F"),
    Command("theme", "Dark or light", "y", lambda app: app.change(dark=not app.picture.look.dark), "Y"),
)
