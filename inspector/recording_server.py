"""Serves a run's recordings, and rerun's web viewer for them, to browsers on this machine.

viser's own file server keeps in memory whatever it has served, and rerun's servers listen on all interfaces
or know no token; hence this one. Every address starts with the token (`/TOKEN/recordings/000002_000003.rrd`), so that
the viewer, which fetches by address, needs no cookie; `?token=` and a cookie with the token work too.
"""

import hmac
import logging
import os
import re
import threading
from collections.abc import Mapping
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, quote, urlsplit

from inspector.rerun_viewer import VIEWER_FILES, viewer_folder
from pipeline.exceptions import InputError, MissingFileError
from pipeline.recording import BLUEPRINT_FILE, MODELS_FILE, recorded_image, recording_name
from pipeline.run import RECORDINGS_FOLDER
from pipeline.scene import ImageKey

_VIEWER_POLICY = (  # the page asks for fonts elsewhere: nothing leaves this machine
    "default-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
    "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; frame-ancestors 'self' "
)
_STOP_POLL_S = 0.1
_BLOCK_BYTES = 1 << 18
_RANGE = re.compile(r"bytes=(\d*)-(\d*)")
_log = logging.getLogger(__name__)


class RecordingServer:
    """Serves the `.rrd` files and the layout of one run folder on 127.0.0.1, and nothing else.

    Args:
        run_root: The run folder.
        token: What a request must know.
        allowed_origins: Pages that may read the files from scripts and show the viewer, such as
            `http://127.0.0.1:8080`.
        port: 0 takes a free one.

    """

    def __init__(self, run_root: Path, token: str, allowed_origins: set[str], *, port: int = 0) -> None:
        if not token or quote(token, safe="") != token:
            raise ValueError("the token must be a text that needs no escaping in an address")
        self._folder = run_root / RECORDINGS_FOLDER
        self._token = token
        self._origins = frozenset(allowed_origins)
        self._port = port
        self._server: _Server | None = None

    def start(self) -> None:
        """Begin to serve, in a thread of its own.

        Raises:
            InputError: the port is in use.

        """
        try:
            self._server = _Server(self._port, self._folder, self._token, self._origins)
        except OSError as error:
            raise InputError(f"port {self._port}: {error.strerror}; choose another") from error
        threading.Thread(
            target=self._server.serve_forever, args=(_STOP_POLL_S,), name="recording-server", daemon=True
        ).start()

    def stop(self) -> None:
        """Stop serving and free the port."""
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    @property
    def address(self) -> str:
        """Where the server is, such as `http://127.0.0.1:40001`, without the token."""
        if self._server is None:
            raise RuntimeError("the recording server is not running; call start() first")
        return f"http://127.0.0.1:{self._server.server_port}"

    def recording_url(self, name: str) -> str:
        """Address of a file in the folder of recordings."""
        return f"{self.address}/{self._token}/{RECORDINGS_FOLDER}/{name}"

    def viewer_url(self, key: ImageKey) -> str:
        """Address of rerun's web viewer with the layout, the models and the recording of an image.

        Raises:
            MissingFileError: there is no recording of the image.

        """
        name = recording_name(key)
        if not (self._folder / name).is_file():
            text = "run the method on this image with recording on"
            raise MissingFileError(f"{self._folder / name}: no such recording; {text}")
        names = [item for item in (BLUEPRINT_FILE, MODELS_FILE) if (self._folder / item).is_file()]  # layout first
        urls = "&".join(f"url={quote(self.recording_url(item), safe='')}" for item in [*names, name])
        options = "hide_welcome_screen&theme=dark&persist=0&renderer=webgl"
        return f"{self.address}/{self._token}/viewer/?{urls}&{options}"


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, port: int, folder: Path, token: str, origins: frozenset[str]) -> None:
        super().__init__(("127.0.0.1", port), _Handler)
        self.folder = folder
        self.token = token
        self.origins = origins
        self.hosts = {f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost")}
        own = {f"http://{host}" for host in self.hosts}
        self.readers = origins | own


class _Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD; everything that is not expressly served is refused."""

    protocol_version = "HTTP/1.1"
    server_version = "pose-inspector"
    sys_version = ""
    timeout = 60
    server: _Server  # pyright: ignore[reportIncompatibleVariableOverride]

    def do_GET(self) -> None:
        """Send a file."""
        self._answer(send_body=True)

    def do_HEAD(self) -> None:
        """Send the headers of a file."""
        self._answer(send_body=False)

    def do_OPTIONS(self) -> None:
        """Answer a browser that asks whether it may send a Range."""
        if self._refusal() is not None:
            return self._fail(HTTPStatus.FORBIDDEN)
        self._head(HTTPStatus.NO_CONTENT, {"Content-Length": "0"})

    def log_message(self, format: str, *args: object) -> None:
        """Requests go to the program's log, without the token."""
        _log.debug("%s", (format % args).replace(self.server.token, "TOKEN"))

    def _answer(self, send_body: bool) -> None:
        path = self._authorized_path()
        if self._refusal() is not None or path is None:
            return self._fail(HTTPStatus.FORBIDDEN)
        try:
            found = self._find(path)
        except InputError as error:
            return self._fail(HTTPStatus.SERVICE_UNAVAILABLE, str(error))
        if found is None:
            return self._fail(HTTPStatus.NOT_FOUND)
        file, content_type = found
        try:
            self._send_file(file, content_type, send_body)
        except FileNotFoundError:
            self._fail(HTTPStatus.NOT_FOUND)
        except (BrokenPipeError, ConnectionResetError, TimeoutError):
            self.close_connection = True

    def _refusal(self) -> str | None:
        """Why a request is refused whatever its token: another name for this machine (DNS rebinding), a foreign page."""
        if self.headers.get("Host", "").lower() not in self.server.hosts:
            return "host"
        origin = self.headers.get("Origin")
        return "origin" if origin is not None and origin not in self.server.readers else None

    def _authorized_path(self) -> str | None:
        """The path behind the token; None where no valid token came with the request."""
        parts = urlsplit(self.path)
        first, _, rest = parts.path.lstrip("/").partition("/")
        if self._is_token(first):
            return rest
        given = parse_qs(parts.query).get("token", []) + self._cookie_values()
        return parts.path.lstrip("/") if any(map(self._is_token, given)) else None

    def _cookie_values(self) -> list[str]:
        try:
            return [morsel.value for morsel in SimpleCookie(self.headers.get("Cookie", "")).values()]
        except CookieError:
            return []

    def _is_token(self, text: str) -> bool:
        return hmac.compare_digest(text.encode(), self.server.token.encode())

    def _find(self, path: str) -> tuple[Path, str] | None:
        """The file for a path: names are compared with what may be served, never joined from what was asked."""
        folder, _, name = path.partition("/")
        if folder == RECORDINGS_FOLDER:
            key = recorded_image(name)
            if name in (BLUEPRINT_FILE, MODELS_FILE) or (key is not None and name == recording_name(key)):
                file = self.server.folder / name
                return (file, "application/octet-stream") if file.is_file() and not file.is_symlink() else None
        elif folder == "viewer" and (name or "index.html") in VIEWER_FILES:
            name = name or "index.html"
            return viewer_folder() / name, VIEWER_FILES[name]
        return None

    def _send_file(self, path: Path, content_type: str, send_body: bool) -> None:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            span = _requested_range(self.headers.get("Range"), size)
            if span is None:
                return self._fail(
                    HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, headers={"Content-Range": f"bytes */{size}"}
                )
            start, stop = span
            headers = {"Content-Type": content_type, "Content-Length": str(stop - start), "Accept-Ranges": "bytes"}
            if content_type.startswith("text/html"):
                headers["Content-Security-Policy"] = _VIEWER_POLICY + " ".join(sorted(self.server.origins))
            partial = (start, stop) != (0, size)
            if partial:
                headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
            self._head(HTTPStatus.PARTIAL_CONTENT if partial else HTTPStatus.OK, headers)
            file.seek(start)
            while send_body and start < stop:
                block = file.read(min(_BLOCK_BYTES, stop - start))
                if not block:
                    self.close_connection = True
                    return
                self.wfile.write(block)
                start += len(block)

    def _fail(self, status: HTTPStatus, text: str = "", headers: Mapping[str, str] | None = None) -> None:
        body = f"{text or status.phrase}\n".encode()
        self._head(
            status, {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body)), **(headers or {})}
        )
        if self.command != "HEAD":
            self.wfile.write(body)

    def _head(self, status: HTTPStatus, headers: Mapping[str, str]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")  # the address holds the token
        self.send_header("Cache-Control", "no-store" if RECORDINGS_FOLDER in self.path else "private, max-age=86400")
        self.send_header("Vary", "Origin")
        origin = self.headers.get("Origin")
        if origin in self.server.readers:
            self.send_header("Access-Control-Allow-Origin", origin)
            self.send_header("Access-Control-Allow-Headers", "Range")
            self.send_header("Access-Control-Expose-Headers", "Content-Range, Content-Length, Accept-Ranges")
        self.end_headers()


def _requested_range(header: str | None, size: int) -> tuple[int, int] | None:
    """First and last-plus-one byte of a Range header (all without one or for several ranges); None if outside."""
    match = _RANGE.fullmatch(header or "")
    if match is None or match.groups() == ("", ""):
        return 0, size
    first, last = match.groups()
    if not first:
        start, stop = max(size - int(last), 0), size
    else:
        start, stop = int(first), min(int(last) + 1, size) if last else size
    return (start, stop) if start < stop else None
