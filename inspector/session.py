"""One browser: what it looks at, its picture, its tabs and its keys. Browsers share data, never state."""

import logging
import threading
import time
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from inspector import html
from inspector.canvas import Canvas
from inspector.controls import TableControls
from inspector.drawing import COLORS, draw
from inspector.frame import Frame, Role, frame_of
from inspector.keys import COMMANDS, help_html
from inspector.navigation import Navigation
from inspector.page import PageChannel
from inspector.panels import VIEWS
from inspector.pointing import hit, readout
from inspector.rerun_panel import RerunPanel
from inspector.selection import Selection, from_query, to_query
from inspector.snapshot import snapshot
from inspector.table import COLUMNS, Table, make_table
from inspector.views import Context
from inspector.worker import LatestWins
from inspector.workspace import Workspace
from pipeline.exceptions import InputError

log = logging.getLogger(__name__)

BLINK_SECONDS = 0.5


class Session:
    """Everything about one connected browser; `update` may be called from any thread."""

    def __init__(self, client: viser.ClientHandle, workspace: Workspace, loop: Any, first: Selection) -> None:
        self.client = client
        self.workspace = workspace
        self.selection = first
        self._first = first
        self.channel = PageChannel(
            loop,
            {
                "hello": self._hello,
                "open": self._open,
                "rows": self._rows,
                "select": self._select,
                "sort": self._sort,
                "command": self.command,
                "zoom": self._zoom,
                "pan": self._pan,
                "resize": self._resize,
                "hover": self._hover,
                "click": self._click,
            },
        )
        self._lock = threading.RLock()
        self._canvas = Canvas(client)
        self._navigation = Navigation(client)
        self.rerun = RerunPanel(client, workspace)
        self._worker = LatestWins(f"browser {client.client_id}", self._failed)
        self._frame: Frame | None = None
        self._table: Table | None = None
        self._table_made_from: object = None
        self._seen_view: object = None
        self._closed = threading.Event()
        context = Context(client, workspace, lambda: self.selection, self.change, self.command)
        self._controls = TableControls(context)
        self._views = [view(context) for view in VIEWS]
        self._build()
        self._stop_listening = workspace.listen(self.refresh)
        client.camera.on_update(lambda _: self._navigation.hold())
        threading.Thread(target=self._blink, name="blink", daemon=True).start()

    def close(self) -> None:
        """End all work for this browser."""
        self._closed.set()
        self._stop_listening()
        self._worker.stop()

    # ------------------------------------------------------------------ the selection
    def change(
        self, display: dict[str, Any] | None = None, filter: dict[str, Any] | None = None, **fields: Any
    ) -> None:
        """Change fields of the selection, of its display or of its filter, and show the result."""
        with self._lock:
            if display:
                fields["display"] = replace(self.selection.display, **display)
            if filter:
                fields["filter"] = replace(self.selection.filter, **filter)
            self.update(replace(self.selection, **fields))

    def update(self, selection: Selection) -> None:
        """Look at something else."""
        with self._lock:
            if selection == self.selection:
                return
            old, self.selection = self.selection, selection
        if selection.dark != old.dark:
            self._theme()
        if replace(selection, zoom=old.zoom, center_u=old.center_u, center_v=old.center_v) == old:
            self._aim()
            self._publish()
        else:
            self.refresh()

    def refresh(self) -> None:
        """Bring everything up to date with the selection and the data."""
        self._worker.submit(self._show)

    def command(self, name: str) -> None:
        """Run a command of the table in `commands`, as its key or the palette does."""
        found = next((command for command in COMMANDS if command.name == name), None)
        if found is not None:
            found.run(self)

    def step(self, by: int) -> None:
        """Go to another row of the table."""
        table = self._table
        if table is None or not len(table):
            return
        position = table.position(self.selection.row)
        self._select(int(np.clip(position + by, 0, len(table) - 1)) if position >= 0 else 0)

    def step_image(self, by: int) -> None:
        """Go to the first row of the next image (in the order of images) that has one in the table."""
        table, row = self._table, self.selection.row
        if table is None or not len(table):
            return
        a, rows = table.assessment, table.order
        images = sorted(set(zip(a.scene_id[rows].tolist(), a.im_id[rows].tolist(), strict=True)))
        here = (row.scene_id, row.im_id) if row is not None else images[0]
        later = [image for image in images if (image > here if by > 0 else image < here)]
        if later:
            wanted = later[0] if by > 0 else later[-1]
            found = np.flatnonzero((a.scene_id[rows] == wanted[0]) & (a.im_id[rows] == wanted[1]))
            self._select(int(found[0]))

    def fit(self) -> None:
        """Show the whole image."""
        self.change(zoom=1.0, center_u=0.5, center_v=0.5)

    def zoom_to_object(self) -> None:
        """Show the object of the row as large as fits."""
        frame = self._frame
        masks = [] if frame is None else [m for role in COLORS if (m := frame.silhouette(role)) is not None and m.any()]
        if frame is None or not masks:
            return
        v, u = np.nonzero(np.logical_or.reduce(masks))
        box = np.array([u.min(), v.min(), u.max(), v.max()]) / frame.fineness
        zoom, (center_u, center_v) = self._navigation.around(frame.camera, tuple(box))
        self.change(zoom=zoom, center_u=center_u, center_v=center_v, view="image")

    def help(self) -> None:
        """Show all commands and keys."""
        with self.client.gui.add_modal("Keys and commands") as modal:
            self.client.gui.add_html(help_html())
            close = self.client.gui.add_button("Close")
            close.on_click(lambda _: modal.close())

    def save_picture(self) -> None:
        """Send the current view to the browser as a PNG file."""
        frame = self._frame
        if frame is not None:
            name = (
                f"scene{frame.row.scene_id}_image{frame.row.im_id}_object{frame.row.obj_id}_{self.selection.view}.png"
            )
            self.client.send_file_download(name, html.png(snapshot(self.client, frame, self.selection)))

    # ------------------------------------------------------------------ what the page calls
    def _hello(self, query: str) -> None:
        if query:
            self._open(query)
        self.refresh()

    def _open(self, query: str) -> None:
        self.update(from_query(query, self._first))

    def _rows(self, first: int, count: int) -> dict[str, Any]:
        table = self._table
        first = max(int(first), 0)
        last = min(first + min(int(count), 500), len(table) if table is not None else 0)
        return {"first": first, "rows": [table.cells(i) for i in range(first, last)] if table is not None else []}

    def _select(self, position: int) -> None:
        table = self._table
        if table is not None and 0 <= position < len(table):
            self.change(row=table.key(int(position)))

    def _sort(self, column: str) -> None:
        if column in {c.id for c in COLUMNS}:
            same = column == self.selection.sort
            self.change(
                sort=column, descending=not self.selection.descending if same else column not in ("image", "object")
            )

    def _zoom(self, x: float, y: float, factor: float) -> None:
        if self._navigation.viewport is not None:
            zoom, (u, v) = self._navigation.zoomed(x, y, float(factor))
            self.change(zoom=zoom, center_u=u, center_v=v)

    def _pan(self, dx: float, dy: float) -> None:
        if self._navigation.viewport is not None:
            u, v = self._navigation.panned(dx, dy)
            self.change(center_u=u, center_v=v)

    def _resize(self, width: int, height: int) -> None:
        self._navigation.resize(int(width), int(height))
        self._aim()

    def _hover(self, x: float, y: float) -> dict[str, str]:
        frame = self._frame
        return {"text": "" if frame is None else readout(frame, self._navigation, x, y)}

    def _click(self, x: float, y: float, _shift: bool) -> None:
        """Select the instance under the mouse, if the table has it."""
        frame, table = self._frame, self._table
        if frame is None or table is None:
            return
        index = hit(frame, self._navigation, x, y)
        found = [
            i
            for i in range(len(table))
            if index is not None and table.key(i)[:2] == frame.key and table.key(i).gt_index == index
        ]
        if found:
            self._select(found[0])

    # ------------------------------------------------------------------ showing, on the worker thread
    def _show(self) -> None:
        begun = time.perf_counter()
        self.channel.publish(busy=True)
        self._make_table()
        selection = self.selection
        wanted = frame_of(self.workspace, selection)
        if wanted != self._frame or self._frame is None:
            self._frame = wanted
        frame = self._frame
        warnings: list[str] = []
        legend: list[dict[str, Any]] = []
        if frame is not None:
            try:
                drawing = draw(frame, selection)
                self._aim()
                self._canvas.show(drawing.nodes)
                warnings += drawing.warnings
                legend = [_scale_line(scale) for scale in drawing.scales]
            except InputError as error:
                self._canvas.show({})
                warnings.append(str(error))
        self._publish(self._legend(frame) + legend + [{"text": text, "class": "pi-warning"} for text in warnings])
        self._update_views(frame, selection)
        self.rerun.follow(None if frame is None else frame.key)
        self.channel.publish(busy=False)
        log.debug("shown in %.0f ms", (time.perf_counter() - begun) * 1000)

    def _update_views(self, frame: Frame | None, selection: Selection) -> None:
        self._controls.update(selection, self._table)
        for view in self._views:
            try:
                view.update(frame, selection)
            except InputError as error:
                log.info("%s: %s", view.title, error)

    def _make_table(self) -> None:
        selection, workspace = self.selection, self.workspace
        wanted = (
            workspace.version, selection.method, selection.compare, selection.criterion, selection.thresholds,
            selection.sort, selection.descending, selection.filter,
        )  # fmt: skip
        assessment = workspace.assessment(selection.method)
        if wanted == self._table_made_from or assessment is None:
            return
        compared = None if selection.compare is None else workspace.assessment(selection.compare)
        self._table = make_table(assessment, compared, selection)
        self._table_made_from = wanted
        if selection.row is None and len(self._table):
            with self._lock:  # begin with the worst
                self.selection = replace(self.selection, row=self._table.key(0))

    def _aim(self) -> None:
        """Turn the camera to what the selection says."""
        frame, selection = self._frame, self.selection
        if frame is None:
            return
        if selection.view == "image":
            self._navigation.show_image(frame.camera, selection.zoom, (selection.center_u, selection.center_v))
            self._seen_view = "image"
        elif self._seen_view != frame.row:  # moving about in 3D is the person's own from here on
            pose = next((p for role in COLORS if (p := frame.pose(role)) is not None), None)
            self._navigation.show_scene(frame.camera, np.array([0, 0, 1.0]) if pose is None else pose[:3, 3])
            self._seen_view = frame.row

    def _publish(self, legend: list[dict[str, Any]] | None = None) -> None:
        table, selection = self._table, self.selection
        state: dict[str, Any] = {
            "address": to_query(selection, self._first),
            "title": self._title(),
            "view": selection.view,
            "sort": selection.sort,
            "descending": selection.descending,
            "columns": [column._asdict() for column in COLUMNS],
            "rows": 0 if table is None else len(table),
            "rows_version": hash(self._table_made_from),
            "selected": -1 if table is None else table.position(selection.row),
            "progress": [{"text": text, "share": share} for text, share in list(self.workspace.jobs.items())],
        }
        if legend is not None:
            state["legend"] = legend
        self.channel.publish(**state)

    def _title(self) -> str:
        row, name = self.selection.row, self.workspace.dataset.name
        return f"{name} {row.scene_id}/{row.im_id} object {row.obj_id}" if row is not None else name

    def _legend(self, frame: Frame | None) -> list[dict[str, Any]]:
        if frame is None:
            return [{"text": "nothing is selected", "class": "pi-title"}]
        display, names = self.selection.display, self.workspace.method_names
        title = f"scene {frame.row.scene_id} · image {frame.row.im_id} · object {frame.row.obj_id}"
        lines: list[dict[str, Any]] = [{"text": title, "class": "pi-title"}]
        if display.ground_truth and frame.ground_truth is not None:
            lines.append({"text": "ground truth", "color": _css(COLORS["ground_truth"])})
        roles: tuple[tuple[Role, int | None], ...] = (("estimate", frame.method), ("compared", frame.compare))
        for role, method in roles:
            if method is not None and getattr(display, role) and getattr(frame, role) is not None:
                lines.append({"text": names[method] + _off_by(frame, role), "color": _css(COLORS[role])})
        return lines

    def _failed(self, error: Exception) -> None:
        self._publish([{"text": f"this could not be shown: {error}", "class": "pi-warning"}])
        self.channel.publish(busy=False)

    def _blink(self) -> None:
        """While blinking is on, hide ground truth and estimates in turn."""
        phase = 0
        while not self._closed.wait(BLINK_SECONDS):
            if not self.selection.display.blink:
                if phase >= 0:
                    self._set_phase(None)
                phase = -1
                continue
            phase = (phase + 1) % 2
            self._set_phase(phase)

    def _set_phase(self, phase: int | None) -> None:
        for name in ("ground_truth", "models/ground_truth"):
            self._canvas.set_visible(name, phase in (None, 0))
        for name in ("estimate", "models/estimate"):
            self._canvas.set_visible(name, phase in (None, 1))

    # ------------------------------------------------------------------ building
    def _build(self) -> None:
        gui = self.client.gui
        self._theme()
        left, right = gui.add_panel(), gui.add_panel()
        with left.add_tab("Targets"):
            self._controls.build()
            gui.add_html(f'<div id="pi-targets" data-key="{self.channel.key}"></div>')
        for view in self._views:
            with right.add_tab(view.title):
                view.build()
        left.dock_left()
        left.set_width(460)
        right.dock_right()
        right.set_width(400)
        gui.main_panel.float(x=-10, y=10, width=170)
        gui.main_panel.minimize()
        for command in COMMANDS:
            handle = gui.add_command(command.label, hotkey=command.hotkey)
            handle.on_trigger(lambda _, name=command.name: self.command(name))

    def _theme(self) -> None:
        self.client.gui.configure_theme(dark_mode=self.selection.dark, show_logo=False, show_share_button=False)


def _off_by(frame: Frame, role: Role) -> str:
    witnesses = frame.witnesses(role)
    if witnesses is None:
        return ""
    mssd, mspd = witnesses
    return f": MSSD {mssd.value * 1000:.1f} mm, MSPD {mspd.value:.1f} px"


def _css(color: tuple[int, int, int]) -> str:
    return f"rgb{color}"


def _scale_line(scale: Any) -> dict[str, Any]:
    return {"text": scale.label, "low": scale.low, "high": scale.high, "stops": [_css(stop) for stop in scale.stops]}
