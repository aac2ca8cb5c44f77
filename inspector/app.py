"""The application: a server for browsers, a workspace that they share, and a session for each of them."""

import logging
from collections.abc import Callable

import viser

from inspector.page import HEAD, PageChannels, static_files
from inspector.selection import Selection
from inspector.server import InspectorServer, make_server
from inspector.session import Session
from inspector.workspace import Workspace

log = logging.getLogger(__name__)


class App:
    """Serves a workspace to any number of browsers."""

    def __init__(self, workspace: Workspace, host: str = "127.0.0.1", port: int = 8080) -> None:
        self.workspace = workspace
        self._channels = PageChannels()
        self._sessions: dict[int, Session] = {}
        self._first = Selection(delta_mm=workspace.delta * 1000, compare=1 if len(workspace.methods) > 1 else None)
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
        server.on_client_connect(self._connected)
        server.on_client_disconnect(self._disconnected)
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
        self.workspace.stop()
        self.server.stop()

    def _connected(self, client: viser.ClientHandle) -> None:
        session = Session(client, self.workspace, self.server.viser.get_event_loop(), self._first)
        self._channels.add(session.channel)
        self._sessions[client.client_id] = session
        session.refresh()

    def _disconnected(self, client: viser.ClientHandle) -> None:
        session = self._sessions.pop(client.client_id, None)
        if session is not None:
            self._channels.remove(session.channel)
            session.close()
