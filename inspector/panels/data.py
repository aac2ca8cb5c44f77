"""The data that is open: dataset, methods, what could not be read, and the doctor's findings."""

from inspector import html
from inspector.frame import Frame
from inspector.selection import Selection
from inspector.views import Context
from inspector.workspace import Workspace
from pipeline.exceptions import InputError

PROBLEMS_SHOWN = 30


class DataView:
    """What is open and what is wrong with it."""

    title = "Data"

    def __init__(self, context: Context) -> None:
        self._context = context
        self._shown: object = None

    def build(self) -> None:
        """Add the lists and the doctor's button."""
        gui = self._context.gui
        self._text = gui.add_html("")
        self._button = gui.add_button(
            "Ask the doctor", hint="Check units, depth scale, intrinsics, poses, models and files"
        )
        self._button.on_click(lambda _: self._context.workspace.diagnose())
        self._findings = gui.add_html("")

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Refresh the lists when something new is known."""
        workspace = self._context.workspace
        wanted = (workspace.version, workspace.problems, workspace.findings)
        if wanted == self._shown:
            return
        self._shown = wanted
        dataset = workspace.dataset
        images = sum(len(dataset.image_ids(scene)) for scene in dataset.scene_ids)
        lines: list[html.Line] = [
            ("dataset", dataset.name, str(dataset.root), None),
            ("split", dataset.split, f"scenes: {len(dataset.scene_ids)}, images: {images}", None),
            ("objects", str(len(dataset.obj_ids)), ", ".join(map(str, dataset.obj_ids[:30])), None),
        ]
        for name, method in zip(workspace.method_names, workspace.methods, strict=True):
            lines.append(("method", name, f"{len(method.results)} estimates", None))
        parts = [html.heading("Open"), html.numbers(lines)]
        if workspace.problems:
            shown, more = workspace.problems[:PROBLEMS_SHOWN], len(workspace.problems) - PROBLEMS_SHOWN
            parts += [html.heading("Worth knowing"), *map(html.paragraph, shown)]
            if more > 0:
                parts.append(html.paragraph(f"and {more} more: ask the doctor for a summary", dim=True))
        self._text.content = html.block(*parts)
        self._findings.content = _findings(workspace)


def _findings(workspace: Workspace) -> str:
    if workspace.findings is None:
        return ""
    if isinstance(workspace.findings, InputError):
        return html.block(html.paragraph(str(workspace.findings)))
    cards = [
        html.finding(f.severity, f.title, f.subject, f.evidence, f.fix)
        for f in workspace.findings
        if f.severity != "ok"
    ]
    return html.block(html.heading("Findings"), *(cards or [html.paragraph("Nothing found: the data look healthy.")]))
