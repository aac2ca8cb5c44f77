"""Rerun's own viewer in a window of the inspector, on the recording of the image that is looked at."""

import viser

from inspector import html
from inspector.workspace import Workspace
from pipeline.exceptions import InputError
from pipeline.scene import ImageKey

SIZE = (960, 720)
"""Width and height of the window when it opens, CSS pixels."""


class RerunPanel:
    """One browser's window with rerun's viewer; follows the image once it is open."""

    def __init__(self, client: viser.ClientHandle, workspace: Workspace) -> None:
        self._client = client
        self._workspace = workspace
        self._key: ImageKey | None = None
        self._shown: ImageKey | None = None
        self._panel: viser.PanelHandle | None = None

    def open(self) -> None:
        """Open the window; a notification says why if there is nothing to show."""
        if self._panel is not None:
            self.close()
        try:
            address = self._address()
        except InputError as error:
            self._client.add_notification("Rerun", str(error), color="orange")
            return
        gui = self._client.gui
        self._panel = gui.add_panel()
        with self._panel.add_tab("Rerun"):
            close = gui.add_button("Close")
            close.on_click(lambda _: self.close())
            self._html = gui.add_html(html.frame(address, "Rerun"))
        self._panel.float(x=20, y=20, width=SIZE[0], height=SIZE[1])
        self._shown = self._key

    def close(self) -> None:
        """Close the window."""
        if self._panel is not None:
            self._panel.remove()
            self._panel = None

    def follow(self, key: ImageKey | None) -> None:
        """Take note of the image looked at, and show its recording if the window is open."""
        self._key = key
        if self._panel is None or key == self._shown:
            return
        self._shown = key
        try:
            self._html.content = html.frame(self._address(), "Rerun")
        except InputError as error:
            self._html.content = html.block(html.paragraph(str(error)))

    def _address(self) -> str:
        recordings = self._workspace.recordings
        if recordings is None or self._key is None:
            raise InputError("no run is open: make one with inspector record DATASET RESULTS --out RUN")
        return recordings.rerun_url(self._key)
