"""The application that shows candidates of symmetries: one state for all browsers, drawn by one worker."""

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from jaxtyping import Float

from inspector.page import PageChannel, PageChannels
from inspector.server import InspectorServer, make_server
from inspector.symmetries.commands import COMMANDS
from inspector.symmetries.page import HEAD, page_state, static_files
from inspector.symmetries.picture import Picture
from inspector.symmetries.review import Review
from inspector.symmetries.searching import BackgroundSearch
from pipeline.bop.models_info.model_set import ModelSet
from pipeline.exceptions import InputError

PANEL_WIDTH = 430
"""CSS pixels."""
EYE = (0.85, -1.15, 0.65)
"""Where browsers look from at first, in scene units."""


class SymmetryApp:
    """Serves the review of a set of models to any number of browsers, which all see and change the same state."""

    def __init__(
        self, models: ModelSet, epsilon: float | None = None, host: str = "127.0.0.1", port: int = 8080
    ) -> None:
        """Open the page; nothing is searched before `start`. `epsilon` in metres. Raises InputError."""
        self.review = Review(models)
        self._stopped = threading.Event()
        self._search = BackgroundSearch(self.review, epsilon)
        self._channels = PageChannels()
        routes = {"/inspector/call": self._channels.answer_call, "/inspector/state": self._channels.answer_state}
        self.server: InspectorServer = make_server(host, port, head_html=HEAD, static=static_files(), routes=routes)
        server = self.server.viser
        self.channel = PageChannel(server.get_event_loop(), self._methods())
        self._channels.add(self.channel)
        self.picture = Picture(server.scene, self.review, self._publish)
        self._build(server)
        self.review.listen(self._changed)
        self._changed()

    def start(self) -> None:
        """Begin to search."""
        self._search.start()

    def wait(self, until: Callable[[], bool] = lambda: False) -> None:
        """Serve until interrupted, or until a condition holds (looked at a few times a second)."""
        while not until():
            time.sleep(0.3)

    def stop(self) -> None:
        """End all work and free the port."""
        self._stopped.set()
        self._search.stop()
        self.picture.stop()
        self._channels.remove(self.channel)
        self.server.stop()

    # ------------------------------------------------------------------ what the page and the commands ask for
    def _methods(self) -> dict[str, Callable[..., Any]]:
        return {
            "command": self.command,
            "select": lambda index: self.review.select(int(index)),
            "select_object": lambda index: self.review.select_object(int(index)),
            "fold": lambda fold: self.review.choose_fold(int(fold) or None),
            "angle": lambda degrees: self.change(angle=float(degrees) % 360.0, playing=False),
        }

    def command(self, name: str) -> None:
        """Run a command of the table."""
        found = next((command for command in COMMANDS if command.name == name), None)
        if found is not None:
            found.run(self)

    def change(self, **fields: Any) -> None:
        """Change how candidates are shown."""
        self.picture.change(**fields)
        if "dark" in fields:
            self._theme()
        self._changed()

    def turn_by(self, by: int) -> None:
        """Go to the next turn of the candidate's fold, by 15 degrees where it is continuous."""
        candidate = self.review.candidate
        if candidate is not None:
            step = 360.0 / candidate.fold if candidate.fold else 15.0
            self.change(angle=(round(self.picture.look.angle / step) + by) * step % 360.0, playing=False)

    def save(self) -> None:
        """Write what is unsaved; what goes wrong is told."""
        try:
            self.review.save()
        except InputError as error:
            self.review.tell(str(error), "warning")

    def look_home(self) -> None:
        """Turn every browser's camera to where it was at first."""
        self._look_from(np.array(EYE), np.eye(3)[2])

    def look_along(self) -> None:
        """Turn every browser's camera into the candidate's axis."""
        candidate = self.review.candidate
        if candidate is None:
            return
        direction = candidate.axis.direction
        up = np.eye(3)[2] if abs(direction[2]) < 0.9 else np.eye(3)[1]
        self._look_from(1.7 * direction, up)

    def _look_from(self, eye: Float[np.ndarray, "3"], up: Float[np.ndarray, "3"]) -> None:
        for client in self.server.viser.get_clients().values():
            with client.atomic():
                client.camera.up_direction = up
                client.camera.position = eye
                client.camera.look_at = np.zeros(3)  # after the position, which moves it along

    # ------------------------------------------------------------------ showing
    def _changed(self) -> None:
        """Something is different now: draw and publish."""
        self.picture.draw()
        self._publish()

    def _publish(self) -> None:
        if not self._stopped.is_set():  # a search that is under way goes on telling
            self.channel.publish(**page_state(self.review, self.picture.look, self.picture.measured_mm))

    # ------------------------------------------------------------------ building
    def _build(self, server: viser.ViserServer) -> None:
        self._theme()
        server.scene.set_up_direction("+z")
        server.initial_camera.position = EYE
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.initial_camera.near = 0.01
        panel = server.gui.add_panel()
        with panel.add_tab("Symmetries"):
            server.gui.add_html(f'<div id="ps-root" data-key="{self.channel.key}"></div>')
        panel.dock_left()
        panel.set_width(PANEL_WIDTH)
        server.gui.main_panel.float(x=-10, y=10, width=170)
        server.gui.main_panel.minimize()
        for command in COMMANDS:
            handle = server.gui.add_command(command.label, description=command.shown_key or command.key)
            handle.on_trigger(lambda _, name=command.name: self.command(name))

    def _theme(self) -> None:
        dark = self.picture.look.dark
        self.server.viser.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)
