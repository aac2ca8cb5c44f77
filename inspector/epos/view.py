"""The tab of EPOS: what the network believed, which correspondences that gave, and how the search made poses of them."""

from inspector import html
from inspector.epos import figures
from inspector.epos.colors import lit
from inspector.epos.controls import EposControls, block
from inspector.epos.drawing import draw
from inspector.epos.matches import can_recompute
from inspector.epos.picking import picked
from inspector.epos.placing import eye_beside, rotation_of
from inspector.epos.recording import EposRecording
from inspector.epos.row import EposRow
from inspector.epos.sides import Side, sides_of, with_points, with_triplet
from inspector.epos.telling import about_cell, about_matches, about_search, header
from inspector.epos.thresholds import thresholds_of
from inspector.frame import Frame
from inspector.nodes import NOTHING, Drawing
from inspector.selection import Selection
from inspector.views import Click, Context
from pipeline.recording import RecordingReader

NOT_RECORDED = "The run has no recording of this image (it is not finished, or recording was off)."


class EposView:
    """Shows EPOS, or any method that has logged probabilities, correspondences or hypotheses where EPOS does."""

    title = "EPOS"

    def __init__(self, context: Context) -> None:
        self._context = context
        self._controls = EposControls(context)
        self._row: EposRow | None = None
        self._of_run = thresholds_of(context.workspace)

    def build(self) -> None:
        """Add the controls: the important thing first."""
        gui = self._context.gui
        self._header = gui.add_html(block("Click a row of the table.", dim=True))
        self._controls.build_layer()
        self._sides = gui.add_html("")
        self._bars = gui.add_html("")
        self._clear = gui.add_button("Show all fragments", visible=False, color="gray")
        self._clear.on_click(lambda _: self._controls.clear())
        with gui.add_folder("Correspondences") as self._links_folder:
            self._controls.build_links()
        with gui.add_folder("Search for poses") as self._search_folder:
            self._controls.build_search()
        self._controls.on_beside(self._look_beside)

    # ------------------------------------------------------------------ the picture
    def draw(self, frame: Frame, selection: Selection) -> Drawing:
        """What is drawn over the image, and in 3D beside it."""
        if not selection.epos.drawn:
            return NOTHING
        row = self._row_of(frame, selection)
        return Drawing({}, warnings=(f"EPOS: {NOT_RECORDED}",)) if row is None else draw(row, selection)

    def clicked(self, frame: Frame, click: Click) -> bool:
        """Take a click into the picture while something of EPOS is drawn; with Shift it selects the instance instead."""
        selection = self._context.selection()
        if click.shift or not selection.epos.drawn:
            return False
        row = self._row_of(frame, selection)
        found = None if row is None else picked(row, selection, click)
        if found is None:
            return False
        self._context.change(epos=found)
        return True

    def touched(self, frame: Frame, name: str, x: float, y: float) -> None:
        """Take a click on a picture of the model or on the plot of the search."""
        row = self._row_of(frame, self._context.selection())
        if row is None:
            return
        if name == figures.PLOT and row.search is not None:
            self._controls.show(figures.step_at(row.search, x))
        sides = self._sides_of(row) if name.startswith(figures.SIDES) else ()
        for index, side in enumerate(sides):
            if name == f"{figures.SIDES}{index}":
                fragment = side.fragment_at(x, y) if row.count else None
                self._context.change(epos={"fragment": None if fragment == row.fragment else fragment})

    def _look_beside(self) -> None:
        row = self._row
        if row is None:
            return
        selection = self._context.selection()
        camera = self._context.client.camera
        window = max(camera.image_width, 1), max(camera.image_height, 1)
        links = "inliers" if selection.epos.links == "off" else selection.epos.links
        if (
            selection.view == "scene"
        ):  # from the image one goes to where the eye is; within the scene one has to be taken
            self._context.change(view="image")
        eye = eye_beside(row, window)
        self._context.change(view="scene", eye=eye, epos={"links": links}, display={"points": False})

    # ------------------------------------------------------------------ the tab
    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Show what was recorded of another row, or under another choice."""
        row = None if frame is None else self._row_of(frame, selection)
        self._row = row
        self._links_folder.visible = self._search_folder.visible = row is not None
        if row is None:
            self._header.content = block("Click a row of the table." if frame is None else NOT_RECORDED, dim=True)
            self._sides.content = self._bars.content = ""
            self._clear.visible = False
            return
        self._header.content = header(row)
        self._sides.content = self._sides_html(row)
        self._bars.content = about_cell(row)
        self._clear.visible = selection.epos.has_pixel or row.fragment is not None
        self._controls.update(row)
        self._controls.can_move(maps=can_recompute(row.recording), links=row.matches is not None)
        self._controls.counts.content = about_matches(row)
        self._controls.plot.content, self._controls.story.content = about_search(row)

    def _sides_html(self, row: EposRow) -> str:
        sides = self._sides_of(row)
        if not sides:
            return block("No model of this object: its fragments cannot be shown on it.", dim=True)
        shown = lit(row.colors, row.weights)
        pictures = [side.painted(shown) for side in sides]
        if row.candidates is not None and row.fragment is None:
            pictures = [with_points(s, p, *row.candidates) for s, p in zip(sides, pictures, strict=True)]
        triplet = None if row.hypothesis is None else row.hypothesis.triplet
        links = row.recording.correspondences
        if triplet is not None and links is not None:
            points = links.points_in_model[triplet]
            pictures = [with_triplet(s, p, points) for s, p in zip(sides, pictures, strict=True)]
        return html.block(figures.sides_html(tuple(pictures), ("the side that is seen", "the side that is hidden")))

    def _sides_of(self, row: EposRow) -> tuple[Side, ...]:
        return () if row.model is None else sides_of(row.model, row.recording.centers, rotation_of(row))

    # ------------------------------------------------------------------ what is known
    def _row_of(self, frame: Frame, selection: Selection) -> EposRow | None:
        """The row with its recording; the same one as long as nothing has changed. InputError if it is damaged."""
        reader = self._reader(frame)
        if reader is None:
            return None
        known = self._row
        same = known is not None and known.recording.reader is reader
        recording = (
            known.recording
            if known is not None and same and known.recording.obj_id == frame.row.obj_id
            else EposRecording(reader, frame.row.obj_id)
        )
        if (
            known is None
            or known.recording is not recording
            or known.frame is not frame
            or known.choice != selection.epos
        ):
            self._row = known = EposRow(frame, recording, selection.epos, self._of_run)
        return known

    def _reader(self, frame: Frame) -> RecordingReader | None:
        recordings = self._context.workspace.recordings
        return None if recordings is None else recordings.reader(frame.key)
