"""The tab of HashMatch: how candidates thin out, why an instance was found or lost, windows, swarms."""

from functools import lru_cache

import viser

from inspector import html
from inspector.frame import Frame
from inspector.hashmatch import drawing, pieces
from inspector.hashmatch.chain import trace_part, verdict_line, warning
from inspector.hashmatch.choice import HashMatchChoice
from inspector.hashmatch.funnel import background, funnel, levels
from inspector.hashmatch.image_record import ImageRecord
from inspector.hashmatch.refinement import Refinement
from inspector.hashmatch.swarm import estimates_part, swarm_part
from inspector.hashmatch.window import HOW_TO_BEGIN, window_part
from inspector.nodes import NOTHING, Drawing
from inspector.selection import Selection
from inspector.views import Click, Context
from pipeline.exceptions import InputError
from pipeline.explaining import Explanation

NO_TRACE = "This run recorded no trace of its instances; `inspector trace` computes them."
NOT_RECORDED = "Stages of HashMatch were not recorded for this image."


class HashMatchView:
    """What HashMatch saw of the image."""

    title = "HashMatch"

    def __init__(self, context: Context) -> None:
        self._context = context
        self._record: ImageRecord | None = None
        self._funnel = lru_cache(4)(self._make_funnel)

    def build(self) -> None:
        """Add the controls."""
        gui = self._context.gui
        self._head = gui.add_html("")
        self._slider = gui.add_slider("iteration", 0, 1, 1, 0, visible=False, hint="Of the swarm; or click in the plot")
        self._slider.on_update(self._slid)
        self._body = gui.add_html("")

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Show the recording of another image, or another choice; what cannot be read is said in the tab."""
        try:
            record, why_not = self._record_of(frame)
            if frame is None or record is None:
                self._put(html.paragraph(why_not, dim=True), "")
            else:
                self._show(frame, record, selection)
        except InputError as error:
            self._put(warning(str(error)), "")

    def _show(self, frame: Frame, record: ImageRecord, selection: Selection) -> None:
        choice = selection.hashmatch
        explanation = _explanation(frame, record)
        parts = [verdict_line(explanation, _no_verdict(frame, record), brief=choice.part != "trace")]
        if record.matching is None:
            parts.append(html.paragraph(NOT_RECORDED, dim=True))
        else:
            level = choice.level if choice.level in record.matching.scales else None
            funnel_and_levels = self._funnel(record, choice.stage, level)
            parts += [funnel_and_levels, background(selection.display.depth), pieces.parts(choice.part)]
        found = self._refinement(frame, record, choice) if choice.part == "swarm" else None
        self._put("".join(parts), self._part(frame, record, selection, found), found, choice)

    def draw(self, frame: Frame, selection: Selection) -> Drawing:
        """The heatmap of the stage, the chosen window, and the swarm."""
        choice = selection.hashmatch
        if choice.stage == "off" and choice.part != "swarm" and not choice.has_window:
            return NOTHING
        record = self._record_of(frame)[0]
        if record is None:
            return NOTHING
        drawn = drawing.heat(frame, selection, record)
        window = record.window(choice, frame.row.gt_index)
        if window is not None and choice.part != "swarm":
            drawn = drawn.with_more(drawing.window(frame, selection, record, window))
        found = self._refinement(frame, record, choice) if choice.part == "swarm" else None
        return drawn if found is None else drawn.with_more(drawing.swarm(frame, selection, found))

    def clicked(self, frame: Frame, click: Click) -> bool:
        """Choose the window at a pixel, while a stage or a window is shown; with Shift the click is left to others."""
        choice = self._context.selection().hashmatch
        record = self._record_of(frame)[0]
        if click.pixel is None or click.shift or record is None or record.matching is None:
            return False
        if choice.stage == "off" and choice.part != "window":
            return False
        (u, v), camera = click.pixel, frame.camera
        if not (-0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5):
            return False
        chosen = {"pixel": (float(u), float(v)), "detection": None, "template": None, "test": 0, "part": "window"}
        self._context.change(hashmatch={**chosen, "scene_id": frame.key.scene_id, "im_id": frame.key.im_id})
        return True

    def _record_of(self, frame: Frame | None) -> tuple[ImageRecord | None, str]:
        """The recording of the row's image, or why there is none."""
        recordings = self._context.workspace.recordings
        if frame is None or recordings is None:
            return None, "Click a row of the table."
        reader = recordings.reader(frame.key)
        if reader is None:
            return None, "The run has no recording of this image (it is not finished, or recording was off)."
        record = self._record
        if record is None or record.reader is not reader:
            record = self._record = ImageRecord(reader, frame.workspace.dataset)
        return record, ""

    def _make_funnel(self, record: ImageRecord, stage: str, level: int | None) -> str:
        assert record.matching is not None
        choice = HashMatchChoice(stage=stage, level=level)  # type: ignore[arg-type]
        return funnel(record.matching, record.rgb, choice) + levels(record.matching, choice)

    def _refinement(self, frame: Frame, record: ImageRecord, choice: HashMatchChoice) -> Refinement | None:
        number = choice.instance if choice.is_of(frame.key) else None
        return record.refinement(record.number_of(frame.estimate) if number is None else number)

    def _part(self, frame: Frame, record: ImageRecord, selection: Selection, found: Refinement | None) -> str:
        """The chosen part of the tab."""
        choice = selection.hashmatch
        if choice.part == "swarm":
            chips = estimates_part(frame.key, record.estimates, None if found is None else found.number)
            if found is None:
                return chips + html.paragraph("This row has no estimate: choose one.", dim=True)
            return chips + swarm_part(frame, found, found.iteration(choice.iteration), selection.view)
        if choice.part == "trace":
            explanation = _explanation(frame, record)
            return "" if explanation is None else trace_part(frame.key, explanation)
        if record.matching is None:
            return ""
        window = record.window(choice, frame.row.gt_index)
        return html.paragraph(HOW_TO_BEGIN, dim=True) if window is None else window_part(record, window, choice.test)

    def _put(
        self, head: str, body: str, found: Refinement | None = None, choice: HashMatchChoice | None = None
    ) -> None:
        """Write the tab; what did not change is not sent."""
        self._slider.visible = found is not None and found.last > 0
        if found is not None and choice is not None and found.last > 0:
            if self._slider.max != found.last:
                self._slider.max = found.last
            if self._slider.value != found.iteration(choice.iteration):
                self._slider.value = found.iteration(choice.iteration)
        for part, content in ((self._head, head), (self._body, body)):
            wrapped = html.block(content) if content else ""
            if part.content != wrapped:
                part.content = wrapped

    def _slid(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._context.change(hashmatch={"iteration": int(event.target.value)})


def _explanation(frame: Frame, record: ImageRecord) -> Explanation | None:
    """That of the row's instance."""
    found = record.explanation(frame.row.gt_index)
    return found if found is not None and found.obj_id == frame.row.obj_id else None


def _no_verdict(frame: Frame, record: ImageRecord) -> str:
    """Why there is no verdict on the row."""
    if frame.row.gt_index < 0:
        return "This row is an estimate without an annotated instance: nothing to trace."
    if not record.explanations:
        return NO_TRACE
    return "This instance is not among the targets that the run looked for."
