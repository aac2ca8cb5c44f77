"""One browser: what it looks at, its picture, its tabs and its keys. Browsers share data, never state."""

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import viser

from inspector import html
from inspector.address import from_query, to_query
from inspector.blinking import Blinker
from inspector.canvas import Canvas
from inspector.controls import TableControls
from inspector.drawing import draw
from inspector.frame import ROLES, Frame, frame_of
from inspector.keys import COMMANDS, help_html
from inspector.leaderboard.page import LeaderboardPage
from inspector.leaderboard.service import LeaderboardService
from inspector.legend import legend, warning
from inspector.navigation import Navigation
from inspector.nodes import Drawing
from inspector.page import PageChannel
from inspector.panels import views_for
from inspector.rerun_panel import RerunPanel
from inspector.selection import NO_EYE, RowKey, Selection
from inspector.snapshot import snapshot
from inspector.steering import Steering
from inspector.table import COLUMNS, Table, make_table
from inspector.views import Context, PictureView
from inspector.worker import LatestWins
from inspector.workspace import Workspace
from inspector.workspaces import Workspaces
from pipeline.exceptions import InputError

log = logging.getLogger(__name__)

WHOLE_IMAGE: dict[str, Any] = {"zoom": 1.0, "center_u": 0.5, "center_v": 0.5}
LEFT_WIDTH, RIGHT_WIDTH = 460, 400
"""CSS pixels of the docked panels when they open on a wide screen."""


class Session:
    """Everything about one connected browser; its methods may be called from any thread."""

    def __init__(
        self,
        client: viser.ClientHandle,
        workspace: Workspace,
        loop: asyncio.AbstractEventLoop,
        workspaces: Workspaces,
        leaderboard: LeaderboardService,
        go_to_dataset: Callable[[Selection], None],
        begin: Selection | None = None,
    ) -> None:
        """Serve a browser.

        Args:
            client: The browser.
            workspace: What it looks at.
            loop: The server's event loop.
            workspaces: All datasets that are open.
            leaderboard: What all browsers share of the leaderboard.
            go_to_dataset: Ends this session and begins one for another dataset.
            begin: What to look at first; None for what the page's address says.

        """
        self.client = client
        self.workspace = workspace
        self.workspaces = workspaces
        several = 1 if len(workspace.methods) > 1 else None
        self._first = Selection(delta_mm=workspace.delta * 1000, compare=several)
        self._go_to_dataset = go_to_dataset
        self._begin = begin
        self.selection = self._first if begin is None else begin
        self.frame: Frame | None = None
        """What is shown now."""
        self.table: Table | None = None
        """The rows of the table, as filtered and sorted now."""
        self.navigation = Navigation(client)
        self.rerun = RerunPanel(client, workspace)
        self.steering = Steering(self)
        self.leaderboard = LeaderboardPage(self, leaderboard)
        self.channel = PageChannel(loop, self.steering.methods() | self.leaderboard.methods())
        self._lock = threading.RLock()
        self._canvas = Canvas(client, self.steering.look_at_image)
        self._worker = LatestWins(f"browser {client.client_id}", self._failed)
        self._table_made_from: object = None
        self._chosen = begin is not None and begin.row is not None
        self._seen_from: object = None
        context = Context(client, workspace, lambda: self.selection, self.change, self.command)
        self._controls = TableControls(context)
        self._views = [view(context) for view in views_for(workspace)]
        self.picture_views = [view for view in self._views if isinstance(view, PictureView)]
        """The tabs that add to the picture, in order."""
        self._closed = False
        self._build()
        self._stop_listening = workspace.listen(self.refresh)
        self._blinker = Blinker(self._canvas, lambda: self.selection.display.blink)
        client.camera.on_update(lambda _: self._camera_moved())

    def close(self) -> None:
        """End all work for this browser."""
        self._closed = True
        self._stop_listening()
        self.leaderboard.close()
        self._blinker.stop()
        self._worker.stop()

    # ------------------------------------------------------------------ the selection
    def change(self, **fields: Any) -> None:
        """Change fields of the selection and show the result; a dict changes fields of a part, such as the display."""
        with self._lock:
            for name, value in fields.items():
                if isinstance(value, dict):
                    fields[name] = replace(getattr(self.selection, name), **value)
            self._chosen |= "row" in fields
            fields = self._of_another_row(fields.get("row")) | fields
            self.update(replace(self.selection, **fields))

    def _of_another_row(self, row: RowKey | None) -> dict[str, Any]:
        """What else changes with the row: the point of view in 3D, what a stage points at, and the zoom with the image."""
        old = self.selection.row
        if row is None or row == old:
            return {}
        other_image = old is not None and row[:2] != old[:2]
        changes = {"eye": NO_EYE, "epos": self.selection.epos.elsewhere(same_image=not other_image)}
        return changes | WHOLE_IMAGE if other_image and not self.selection.follow else changes

    def update(self, selection: Selection) -> None:
        """Look at something else."""
        with self._lock:
            if selection == self.selection:
                return
            old, self.selection = self.selection, selection
        if selection.dark != old.dark:
            self._theme()
        if selection.same_picture(old):
            self.aim()
            self.publish()
        else:
            self.refresh()

    def begin_anew(self, selection: Selection) -> None:
        """Look at other rows, beginning with the first of the table."""
        with self._lock:
            self._chosen = False
            self.update(selection)

    def hello(self, query: str, width: float) -> None:
        """Begin: fit the panels to the width of the page (CSS pixels), and open its address."""
        self._left.set_width(float(np.clip(0.31 * width, 440, LEFT_WIDTH)))
        self._right.set_width(float(np.clip(0.27 * width, 345, RIGHT_WIDTH)))
        if self._begin is None:
            self.open_address(query)
        self._begin = None

    def open_address(self, query: str) -> None:
        """Look at what an address names; what it leaves open is as at the start, but a row stays."""
        asked = from_query(str(query), self._first)
        if asked.dataset != self.selection.dataset:
            self.go_to_dataset(asked)
            return
        asked = self.workspace.within(asked)
        self._chosen |= asked.row is not None
        self.update(replace(asked, row=asked.row or self.selection.row))
        self.refresh()

    def choose(self, query: str) -> None:
        """Look at what a part of an address names; all that it does not name stays, and the dataset does."""
        with self._lock:
            asked = replace(from_query(str(query), self.selection), dataset=self.selection.dataset)
            self.update(self.workspace.within(asked))

    def go_to_dataset(self, selection: Selection) -> None:
        """Look at another dataset, which ends this session; a notification says why if it cannot be opened."""
        try:
            self._go_to_dataset(selection)
        except InputError as error:
            self.notify("The dataset cannot be opened", error)
            self.refresh()

    def refresh(self) -> None:
        """Bring everything up to date with the selection and the data."""
        self._worker.submit(self._show)

    # ------------------------------------------------------------------ commands
    def command(self, name: str) -> None:
        """Run a command of the table in `keys`, as its key or the palette does."""
        found = next((command for command in COMMANDS if command.name == name), None)
        try:
            if found is not None and (not self.selection.board.open or found.on_board):
                found.run(self)
        except InputError as error:
            self.notify("This cannot be done", error)

    def notify(self, title: str, error: InputError) -> None:
        """Tell a person that something cannot be done, and why."""
        self.client.add_notification(title, str(error), color="orange")

    def fit(self) -> None:
        """Show the whole image."""
        self.change(follow=False, **WHOLE_IMAGE)

    def zoom_to_object(self) -> None:
        """Show the object of the row as large as fits, and from now on that of every row gone to."""
        self.change(follow=True, view="image")
        self._follow()

    def _follow(self) -> None:
        frame = self.frame
        shown = [] if frame is None else [r for role in ROLES if (r := frame.silhouette(role)) is not None]
        boxes = [frame.edges(r.box) for r in shown if r.mask_crop.any()] if frame is not None else []
        if frame is None or not boxes:
            return
        corners = np.array(boxes)
        left, top, right, bottom = *corners[:, :2].min(axis=0), *corners[:, 2:].max(axis=0)
        zoom, (center_u, center_v) = self.navigation.around(frame.camera, (left, top, right, bottom))
        self.change(zoom=zoom, center_u=center_u, center_v=center_v)

    def help(self) -> None:
        """Show all commands and keys."""
        with self.client.gui.add_modal("Keys and commands") as modal:
            self.client.gui.add_html(help_html())
            close = self.client.gui.add_button("Close")
            close.on_click(lambda _: modal.close())

    def save_picture(self) -> None:
        """Send the current view to the browser as a PNG file."""
        frame = self.frame
        if frame is not None:
            row = frame.row
            name = (
                f"{self.workspace.dataset.name}_{row.scene_id}_{row.im_id}_object{row.obj_id}_{self.selection.view}.png"
            )
            picture = html.png(snapshot(self.client, frame, self.selection, self._drawing(frame, self.selection)))
            self.client.send_file_download(name, picture, save_immediately=True)

    def aim(self) -> None:
        """Turn the camera to what the selection says."""
        frame, selection = self.frame, self.selection
        try:
            camera = None if frame is None else frame.camera
        except InputError:  # the legend says it
            camera = None
        if frame is None or camera is None:
            return
        if selection.view == "image":
            self.navigation.show_image(camera, selection.zoom, (selection.center_u, selection.center_v))
            self._seen_from = None
        elif self._seen_from != frame.row:  # moving about in 3D is the person's own from here on
            self._seen_from = frame.row
            pose = next((p for role in ROLES if (p := frame.pose(role)) is not None), None)
            self.navigation.show_scene(np.array([0, 0, 1.0]) if pose is None else pose[:3, 3], selection.eye)

    def _camera_moved(self) -> None:
        if self._closed:
            return
        eye = self.navigation.eye()
        if eye is None:
            self.navigation.hold()
        elif self.selection.view == "scene":
            self.change(eye=eye)

    # ------------------------------------------------------------------ showing, on the worker thread
    def _show(self) -> None:
        begun = time.perf_counter()
        self.channel.publish(busy=True)
        self._make_table()
        self._begin_with_the_worst()
        selection = self.selection
        wanted = frame_of(self.workspace, selection)
        if wanted != self.frame:  # else the old one is as good, and knows more
            elsewhere = self.frame is None or wanted is None or wanted.row != self.frame.row
            self.frame = wanted
            if elsewhere and selection.follow:
                self._follow()
        lines = self._draw(self.frame, selection) + self._problems()
        self.publish(legend=lines)
        unseen = self._update_views(self.frame, selection)
        self.publish(legend=lines + [warning(text) for text in unseen if warning(text) not in lines], busy=False)
        log.debug("shown in %.0f ms", (time.perf_counter() - begun) * 1000)

    def _problems(self) -> list[dict[str, Any]]:
        number = len(self.workspace.problems)
        return (
            [warning(f"{number} problem{'s' if number > 1 else ''} with the data: see the tab Data")] if number else []
        )

    def _draw(self, frame: Frame | None, selection: Selection) -> list[dict[str, Any]]:
        """Draw the picture and return its legend."""
        names = self.workspace.method_names
        if frame is None:
            return legend(frame, selection, names)
        try:
            drawing = self._drawing(frame, selection)
            self.aim()
            self._canvas.show(drawing.nodes)
            return legend(frame, selection, names, drawing)
        except InputError as error:
            self._canvas.show({})
            return [warning(str(error))]

    def _drawing(self, frame: Frame, selection: Selection) -> Drawing:
        """The picture of a row with what the views add; what is damaged is missing, the rest is shown."""
        drawing = draw(frame, selection)
        for view in self.picture_views:
            try:
                drawing = drawing.with_more(view.draw(frame, selection))
            except InputError as error:
                drawing = drawing.with_more(Drawing({}, warnings=(str(error),)))
        return drawing

    def _update_views(self, frame: Frame | None, selection: Selection) -> list[str]:
        """Update all tabs; those that cannot show the row show none, and the reasons are returned."""
        reasons: dict[str, None] = {}
        self._controls.update(self.table)
        self.rerun.follow(None if frame is None else frame.key)
        for view in self._views:
            try:
                view.update(frame, selection)
            except InputError as error:
                view.update(None, selection)
                reasons[str(error)] = None
        return list(reasons)

    def _make_table(self) -> None:
        selection, workspace = self.selection, self.workspace
        assessment = workspace.assessment(selection.method)
        made_from = (workspace.version, selection.table_key)
        if made_from == self._table_made_from or assessment is None:
            return
        compared = None if selection.compare is None else workspace.assessment(selection.compare)
        self.table = make_table(assessment, compared, selection)
        self._table_made_from = made_from

    def _begin_with_the_worst(self) -> None:
        """Look at the first row of the table as long as nobody has chosen one: it may yet fill and be sorted anew."""
        with self._lock:
            if not self._chosen and self.table is not None and len(self.table):
                self.selection = replace(self.selection, row=self.table.key(0))

    def _failed(self, error: Exception) -> None:
        self.publish(legend=[warning(f"this could not be shown: {error}")], busy=False)

    def publish(self, **more: Any) -> None:
        """Tell the page what it needs to know; callable from any thread."""
        table, selection, row = self.table, self.selection, self.selection.row
        name = self.workspace.dataset.name
        self.channel.publish(
            address=to_query(selection, self._first),
            title=name if row is None else f"{name} {row.scene_id}/{row.im_id}",
            view=selection.view,
            sort=selection.sort,
            descending=selection.descending,
            columns=[column._asdict() for column in COLUMNS],
            rows=0 if table is None else len(table),
            rows_version=hash(self._table_made_from),
            selected=-1 if table is None else table.position(row),
            board=self.leaderboard.state(),
            progress=[{"text": text, "share": share} for text, share in list(self.workspace.jobs.items())],
            **more,
        )

    # ------------------------------------------------------------------ building
    def _build(self) -> None:
        gui = self.client.gui
        self._theme()
        self._left, self._right = left, right = gui.add_panel(), gui.add_panel()
        with left.add_tab("Targets"):
            self._controls.build()
            gui.add_html(f'<div id="pi-targets" data-key="{self.channel.key}"></div>')
        for view in self._views:
            with right.add_tab(view.title):
                view.build()
        left.dock_left()
        left.set_width(LEFT_WIDTH)
        right.dock_right()
        right.set_width(RIGHT_WIDTH)
        gui.main_panel.float(x=-10, y=-10, width=170)
        gui.main_panel.minimize()
        for command in COMMANDS:
            handle = gui.add_command(command.label, hotkey=command.hotkey)
            handle.on_trigger(lambda _, name=command.name: self.command(name))

    def _theme(self) -> None:
        self.client.gui.configure_theme(dark_mode=self.selection.dark, show_logo=False, show_share_button=False)
