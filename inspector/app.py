"""The application: a server for browsers, a workspace that they share, and a session for each of them."""

import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path

import viser

from inspector.leaderboard.service import LeaderboardService
from inspector.page import HEAD, PageChannels, static_files
from inspector.selection import Selection
from inspector.server import InspectorServer, make_server
from inspector.session import Session
from inspector.workspace import Workspace
from inspector.workspaces import Workspaces

log = logging.getLogger(__name__)


class App:
    """Serves a workspace, and datasets that browsers go to from there, to any number of browsers."""

    def __init__(
        self, workspace: Workspace, host: str = "127.0.0.1", port: int = 8080, leaderboard: Path | None = None
    ) -> None:
        """Serve a workspace; `leaderboard` is the folder of the leaderboard, by default the user's own."""
        self.workspaces = Workspaces(workspace)
        self.leaderboard = LeaderboardService(leaderboard)
        self._channels = PageChannels()
        self._sessions: dict[int, Session] = {}
        routes = {"/inspector/call": self._channels.answer_call, "/inspector/state": self._channels.answer_state}
        self.server: InspectorServer = make_server(host, port, head_html=HEAD, static=static_files(), routes=routes)
        if workspace.recordings is not None:
            workspace.recordings.allow_origins(
                {f"http://{name}:{self.server.port}" for name in ("127.0.0.1", "localhost")}
            )
        server = self.server.viser
        server.scene.set_up_direction("-y")
        server.initial_camera.up = (0.0, -1.0, 0.0)
        server.initial_camera.position = (0.0, 0.0, 0.0)
        server.initial_camera.look_at = (0.0, 0.0, 1e-3)
        server.initial_camera.near = 0.01
        server.on_client_connect(lambda client: self._begin(client, workspace))
        server.on_client_disconnect(self._end)
        workspace.start()

    def wait(self, until: Callable[[], bool] = lambda: False) -> None:
        """Serve until interrupted, or until a condition holds (looked at a few times a second)."""
        import time

        while not until():
            time.sleep(0.3)

    def stop(self) -> None:
        """End all sessions and free the port."""
        for session in list(self._sessions.values()):
            session.close()
        self.workspaces.stop()
        self.leaderboard.stop()
        self.server.stop()

    def _begin(self, client: viser.ClientHandle, workspace: Workspace, selection: Selection | None = None) -> None:
        loop = self.server.viser.get_event_loop()
        go_to_dataset = partial(self._go_to_dataset, client)
        session = Session(client, workspace, loop, self.workspaces, self.leaderboard, go_to_dataset, selection)
        self._channels.add(session.channel)
        self._sessions[client.client_id] = session
        session.refresh()

    def _end(self, client: viser.ClientHandle) -> None:
        session = self._sessions.pop(client.client_id, None)
        if session is not None:
            self._channels.remove(session.channel)
            session.close()

    def _go_to_dataset(self, client: viser.ClientHandle, selection: Selection) -> None:
        """Begin anew in a browser with the dataset of a selection; InputError if it cannot be opened."""
        name, _, split = selection.dataset.partition("/")
        workspace = self.workspaces.of(name, split) if name else self.workspaces.first
        self._end(client)
        client.gui.reset()
        client.scene.reset()
        self._begin(client, workspace, workspace.within(selection))
