"""The tab of EPOS."""

from inspector.frame import Frame
from inspector.nodes import NOTHING, Drawing
from inspector.selection import Selection
from inspector.views import Click, Context


class EposView:
    """What EPOS saw of the image."""

    title = "EPOS"

    def __init__(self, context: Context) -> None:
        self._context = context

    def build(self) -> None:
        """Add the controls."""

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Show the recording of another image."""

    def draw(self, frame: Frame, selection: Selection) -> Drawing:
        """What is drawn over the image."""
        return NOTHING

    def clicked(self, frame: Frame, click: Click) -> bool:
        """Take a click into the picture."""
        return False
