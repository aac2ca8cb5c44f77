"""What the page asks of its session: rows of the table, the mouse in the picture, keys, the address bar."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from inspector.pointing import click_at, hit, readout
from inspector.table import COLUMNS
from inspector.views import TouchedView
from pipeline.scene import ImageKey

if TYPE_CHECKING:
    from inspector.session import Session

MOST_ROWS = 500
"""Rows handed out in one answer."""


class Steering:
    """Turns calls of the page into changes of one session's selection; arguments come from the browser, unchecked."""

    def __init__(self, session: "Session") -> None:
        self._session = session

    def methods(self) -> dict[str, Callable[..., Any]]:
        """The calls by name, as the page knows them."""
        session = self._session
        return {
            "hello": session.hello,
            "open": session.open_address,
            "choose": session.choose,
            "command": session.command,
            "rows": self.rows,
            "select": self.select,
            "sort": self.sort,
            "zoom": self.zoom,
            "pan": self.pan,
            "resize": self.resize,
            "hover": self.hover,
            "click": self.click,
            "touch": self.touch,
        }

    def rows(self, first: int, count: int) -> dict[str, Any]:
        """A window of the table."""
        table = self._session.table
        first = max(int(first), 0)
        last = min(first + min(int(count), MOST_ROWS), len(table) if table is not None else 0)
        return {"first": first, "rows": [table.cells(i) for i in range(first, last)] if table is not None else []}

    def select(self, position: int) -> None:
        """Look at the row at a position of the table."""
        table = self._session.table
        if table is not None and 0 <= int(position) < len(table):
            self._session.change(row=table.key(int(position)))

    def step(self, by: int) -> None:
        """Go to another row of the table."""
        table = self._session.table
        if table is not None and len(table):
            position = table.position(self._session.selection.row)
            self.select(int(np.clip(position + by, 0, len(table) - 1)) if position >= 0 else 0)

    def step_image(self, by: int) -> None:
        """Go to the next image (in the order of images) that has a row in the table."""
        table, row = self._session.table, self._session.selection.row
        if table is None or not len(table):
            return
        a, rows = table.assessment, table.order
        images = sorted(set(zip(a.scene_id[rows].tolist(), a.im_id[rows].tolist(), strict=True)))
        here = (row.scene_id, row.im_id) if row is not None else images[0]
        beyond = [image for image in images if (image > here if by > 0 else image < here)]
        if beyond:
            self.look_at_image(ImageKey(*(beyond[0] if by > 0 else beyond[-1])))

    def look_at_image(self, image: ImageKey) -> None:
        """Go to an image: to the row of the same object there, else to its first row."""
        table, row = self._session.table, self._session.selection.row
        if table is None:
            return
        a, rows = table.assessment, table.order
        found = np.flatnonzero((a.scene_id[rows] == image.scene_id) & (a.im_id[rows] == image.im_id))
        same = [i for i in found if row is not None and a.obj_id[rows[i]] == row.obj_id]
        if len(found):
            self.select(int((same or found)[0]))

    def sort(self, column: str) -> None:
        """Sort by a column; by the same one again in the other direction."""
        selection = self._session.selection
        if column in {c.id for c in COLUMNS}:
            descending = not selection.descending if column == selection.sort else column not in ("image", "object")
            self._session.change(sort=column, descending=descending)

    def zoom(self, x: float, y: float, factor: float) -> None:
        """Zoom about a point of the window (shares 0..1)."""
        navigation = self._session.navigation
        if navigation.viewport is not None:
            zoom, (u, v) = navigation.zoomed(float(x), float(y), float(factor))
            self._session.change(zoom=zoom, center_u=u, center_v=v, follow=False)

    def pan(self, dx: float, dy: float) -> None:
        """Drag the image by CSS pixels."""
        navigation = self._session.navigation
        if navigation.viewport is not None:
            u, v = navigation.panned(float(dx), float(dy))
            self._session.change(center_u=u, center_v=v, follow=False)

    def resize(self, width: int, height: int) -> None:
        """Take note of the window's size in CSS pixels."""
        self._session.navigation.resize(int(width), int(height))
        self._session.aim()

    def hover(self, x: float, y: float) -> dict[str, str]:
        """What is under the mouse."""
        frame = self._session.frame
        return {"text": "" if frame is None else readout(frame, self._session.navigation, float(x), float(y))}

    def touch(self, name: str, x: float, y: float) -> None:
        """Hand a click on a named picture within a tab (at shares 0..1 of its width and height) to the tab's view."""
        frame = self._session.frame
        if frame is None:
            return
        for view in self._session.picture_views:
            if isinstance(view, TouchedView):
                view.touched(frame, str(name), float(x), float(y))

    def click(self, x: float, y: float, shift: bool = False) -> None:
        """Hand a click to the views that want it; else select the annotated instance under it, if the table has it."""
        frame, table = self._session.frame, self._session.table
        if frame is None or table is None:
            return
        navigation = self._session.navigation
        at = click_at(navigation, float(x), float(y), bool(shift))
        if any(view.clicked(frame, at) for view in self._session.picture_views):
            return
        index = hit(frame, navigation, float(x), float(y))
        if index is not None:
            position = table.instance(frame.key, index)
            if position >= 0:
                self.select(position)
