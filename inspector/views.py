"""Views: the small classes that fill the tabs of the window; a new one is written here once and listed in one place.

A view gets a browser's context when it is made, builds its controls once, and is told of every new frame. It must not
keep a thread of its own; long work belongs into the frame (kept for the next time) or into a workspace job.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import viser
from jaxtyping import Float

from inspector.frame import Frame
from inspector.nodes import Drawing
from inspector.selection import Selection
from inspector.workspace import Workspace


@dataclass(frozen=True)
class Context:
    """What a view may use of its browser."""

    client: viser.ClientHandle
    workspace: Workspace
    selection: Callable[[], Selection]
    """Returns the selection in force."""
    change: Callable[..., None]
    """Changes fields of the selection, or of its display or filter: `change(method=1)`, `change(display={...})`."""
    command: Callable[[str], None]
    """Runs a command by name, as its key would."""

    @property
    def gui(self) -> viser.GuiApi:
        """The browser's controls; what is added goes into the tab that is being built."""
        return self.client.gui


@runtime_checkable
class View(Protocol):
    """One tab: built once per browser, updated with every change of what is looked at."""

    title: str
    """Label of the tab."""

    def __init__(self, context: Context) -> None: ...

    def build(self) -> None:
        """Add the controls of the tab; called once, inside the tab."""
        ...

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Show a row (None: nothing is selected); called from the browser's worker thread.

        InputError says that something of this row cannot be shown; the window reports it and stays usable.
        """
        ...


class Click(NamedTuple):
    """A click into the picture."""

    pixel: tuple[float, float] | None
    """(u, v) of the image, possibly beyond its border; None in 3D."""
    origin: Float[np.ndarray, "3"]
    """Where the mouse's ray begins, camera frame, metres."""
    direction: Float[np.ndarray, "3"]
    """Of the ray."""
    shift: bool
    """Whether the Shift key was down."""


@runtime_checkable
class PictureView(View, Protocol):
    """A tab that also adds to the picture, while the selection asks for it, and may take clicks into it."""

    def draw(self, frame: Frame, selection: Selection) -> Drawing:
        """What to add to the picture of the row; names of nodes begin with the view's own. InputError as in `update`."""
        ...

    def clicked(self, frame: Frame, click: Click) -> bool:
        """Take a click; False leaves it to the others (at last, it selects the instance under the mouse)."""
        ...


@runtime_checkable
class TouchedView(PictureView, Protocol):
    """A tab with pictures of its own that take clicks: elements with `data-touch="NAME"`."""

    def touched(self, frame: Frame, name: str, x: float, y: float) -> None:
        """Take a click on a picture, at shares 0..1 of its width and height; names begin with the view's own."""
        ...
