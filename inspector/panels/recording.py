"""What the run recorded of an image: every entity, any of them as a layer, and rerun's own viewer on the same file."""

from collections import Counter

import viser

from inspector import html
from inspector.frame import Frame
from inspector.recorded import DRAWABLE
from inspector.selection import Selection
from inspector.views import Context
from pipeline.exceptions import InputError
from pipeline.recording import RecordingReader, find_entity

_OFF = "off"


class RecordingView:
    """The entities of the recording of the image, and the way into rerun."""

    title = "Run"

    def __init__(self, context: Context) -> None:
        self._context = context
        self._shown: object = None

    def build(self) -> None:
        """Add the layer choice, the button and the list."""
        gui = self._context.gui
        self._note = gui.add_html("")
        options: list[str] = [_OFF]
        hint = "Draw a recorded map over the image"
        self._layer = gui.add_dropdown("As a layer", options, initial_value=options[0], hint=hint, visible=False)
        self._layer.on_update(self._chosen)
        self._button = gui.add_button(
            "Open in Rerun (L)", hint="Rerun's own viewer on the same recording", visible=False
        )
        self._button.on_click(lambda _: self._context.command("rerun"))
        self._list = gui.add_html("")

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Show the recording of another image."""
        recordings = self._context.workspace.recordings
        reader, note = self._reader(frame)
        self._note.content = html.block(html.paragraph(note, dim=True)) if note else ""
        self._button.visible = reader is not None
        self._layer.visible = reader is not None
        if reader is None or recordings is None:
            self._list.content = ""
            self._shown = None
            return
        if self._shown is not reader:
            self._shown = reader
            self._fill(reader, recordings.rerun_url(reader.key))
        wanted = self._context.selection().display.recorded or _OFF
        if wanted in self._layer.options and self._layer.value != wanted:
            self._layer.value = wanted

    def _reader(self, frame: Frame | None) -> tuple[RecordingReader | None, str]:
        recordings = self._context.workspace.recordings
        if recordings is None:
            return None, "No run is open. `inspector record DATASET RESULTS --out RUN` makes one from a results file."
        if frame is None:
            return None, "Click a row of the table."
        try:
            reader = recordings.reader(frame.key)
        except InputError as error:
            return None, str(error)
        if reader is None:
            return None, "The run has no recording of this image (it is not finished, or recording was off)."
        return reader, "" if reader.verified else "This recording has no checksum beside it; damage may go unnoticed."

    def _fill(self, reader: RecordingReader, rerun_url: str) -> None:
        kinds = reader.kinds()
        self._layer.options = (_OFF, *(path for path, kind in kinds.items() if kind in DRAWABLE))
        groups = Counter((_pattern(path), kind) for path, kind in kinds.items())
        lines: list[html.Line] = [(path, kind, f"x {n}" if n > 1 else "", None) for (path, kind), n in groups.items()]
        self._list.content = html.block(
            html.link("Rerun's viewer in a new tab", rerun_url),
            html.heading(f"{len(kinds)} recorded entities"),
            html.numbers(lines),
        )

    def _chosen(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._context.change(display={"recorded": "" if event.target.value == _OFF else event.target.value})


def _pattern(path: str) -> str:
    """The row of the table of entities that a path belongs to, such as `estimates/{instance}`; else the path."""
    entity = find_entity(path)
    return path if entity is None else entity.path
