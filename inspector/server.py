"""viser's server behind our own door: our checks on every request, our script in the page, no public tunnel.

viser offers no hook for any of this. It starts its server through `websockets.asyncio.server.serve`, so that function
is replaced for the moment of construction: it is given a socket that is already bound (viser itself would silently try
the next 1000 ports when one is in use) and our own answers to HTTP requests (viser's read files by the path in the
URL). If a later viser starts in another way, `make_server` raises instead of serving unguarded.
"""

import atexit
import contextlib
import errno
import functools
import logging
import secrets
import socket
import sys
import threading
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, no_type_check

import rich
import viser
import websockets.asyncio.server
from viser import _messages

from inspector.access import AccessPolicy, is_loopback
from inspector.site import Page, Route, Site
from pipeline.exceptions import InputError

_WILDCARDS = {"0.0.0.0": "127.0.0.1", "::": "::1"}
_SAFE_HOSTS = "use --host 127.0.0.1 (this machine only) or --host 0.0.0.0 (all networks, with a token)"
_construction = threading.Lock()
_log = logging.getLogger("inspector.server.websockets")
_log.setLevel(logging.WARNING)


def _worth_logging(record: logging.LogRecord) -> bool:
    """False for what visitors cause that are no browsers or that leave before they are answered."""
    if record.getMessage() == "opening handshake failed":  # port scanners: a traceback each
        return False
    # websockets takes it for a fault of its own when a page is closed while it waits for an answer.
    gone = record.exc_info is not None and record.exc_info[0] is AssertionError
    return not (gone and record.getMessage() == "unexpected internal error")


_log.addFilter(_worth_logging)
# Whoever closes a page while it is being drawn need not hear of it on the terminal.
warnings.filterwarnings("ignore", message="Queued a .* on a closed connection")


@dataclass(frozen=True, eq=False)
class InspectorServer:
    """A running server; `make_server` makes it."""

    viser: viser.ViserServer
    host: str
    """As asked for."""
    address: str
    """The IP address that it is bound to."""
    port: int
    """The port that it is bound to, never 0."""
    token: str | None
    """None where none is needed."""
    _site: Site

    @property
    def url(self) -> str:
        """What to open on this machine, with the token where one is needed."""
        return self._url_at(_WILDCARDS.get(self.address, self.host))

    @property
    def network_url(self) -> str | None:
        """What to open on another machine; None when bound to loopback."""
        if is_loopback(self.address):
            return None
        return self._url_at(socket.gethostname() if self.address in _WILDCARDS else self.host)

    def stop(self) -> None:
        """Disconnect every browser and free the port; harmless when repeated."""
        atexit.unregister(self.stop)
        with contextlib.suppress(RuntimeError):  # the loop is closed: stopped before
            self.viser.get_event_loop().call_soon_threadsafe(self._site.hang_up)
        self.viser.stop()

    def _url_at(self, host: str) -> str:
        query = f"?token={self.token}" if self.token else ""
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/{query}"


def make_server(
    host: str = "127.0.0.1",
    port: int = 8080,
    token: str | None = None,
    head_html: str = "",
    static: Mapping[str, Page] | None = None,
    routes: Mapping[str, Route] | None = None,
) -> InspectorServer:
    """Start viser's server behind the checks of `inspector.access`; ready when this returns.

    Args:
        host: Name or address of this machine; anything but loopback needs a token, which is made where none is given.
        port: 0 takes a free one.
        token: 16 or more of A-Z a-z 0-9 _ - that a browser must bring once, in `?token=`.
        head_html: Put into the page before `</head>`.
        static: Further paths that are served, such as `{"/inspector.js": ("text/javascript", b"...")}`.
        routes: Further paths that are answered with JSON, behind the same checks.

    Raises:
        InputError: The host is not ours, the port is out of range, taken or forbidden, or the token cannot be used.

    """
    pages = {"/": ("text/html; charset=utf-8", _index_html(head_html)), **(static or {})}
    listener = _listen(host, port)
    try:
        address, port = listener.getsockname()[:2]
        if token is None and not is_loopback(address):
            token = secrets.token_urlsafe(32)
        site = Site(AccessPolicy(host, address, port, token), pages, routes or {})
        server = InspectorServer(_start_viser(listener, site), host, address, port, token, site)
        _close_share_tunnel(server.viser)
    except BaseException:
        listener.close()
        raise
    atexit.register(server.stop)
    site.open()
    return server


def _index_html(head_html: str) -> bytes:
    html = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_text(encoding="utf-8")
    if "</head>" not in html:
        raise RuntimeError(f"viser {viser.__version__}: its page has no </head> to put our script before")
    return html.replace("</head>", f"{head_html}</head>", 1).encode()


def _listen(host: str, port: int) -> socket.socket:
    if not 0 <= port <= 65535:
        raise InputError(f"port {port} is out of range 0..65535; use --port 8080 or --port 0 (a free one)")
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM) if host else []
    except (OSError, ValueError):
        found = []
    if not found:
        raise InputError(f'host "{host}" is not known; {_SAFE_HOSTS}')
    # Where a name has several addresses, as localhost has, take IPv4.
    family, _, _, _, (address, *_) = min(found, key=lambda entry: entry[0] != socket.AF_INET)
    dual = address == "::" and socket.has_dualstack_ipv6()
    try:
        return socket.create_server((str(address), port), family=family, backlog=100, dualstack_ipv6=dual)
    except OSError as error:
        raise InputError(_why_not(error, host, port)) from None


def _why_not(error: OSError, host: str, port: int) -> str:
    match error.errno:
        case errno.EADDRINUSE:
            return f"port {port} is in use on {host}; use --port N or --port 0 (a free one)"
        case errno.EACCES:
            return f"port {port} is reserved for the administrator; use --port N above 1023 or --port 0 (a free one)"
        case errno.EADDRNOTAVAIL:
            return f'host "{host}" is not an address of this machine; {_SAFE_HOSTS}'
    return f'cannot listen on host "{host}", port {port} ({error.strerror}); {_SAFE_HOSTS}'


def _start_viser(listener: socket.socket, site: Site) -> viser.ViserServer:
    """Construct viser's server on our socket with our answers, by way of `serve`, which is restored at once."""
    module: Any = websockets.asyncio.server
    hooked = threading.Event()
    with _construction:
        _silence_viser()
        serve = module.serve

        def serve_guarded(handler: Any, *address: Any, **options: Any) -> Any:
            if not handler.__module__.startswith("viser."):  # some other server that starts at this very moment
                return serve(handler, *address, **options)
            hooked.set()
            ours = {"process_request": site.respond, "server_header": None, "logger": _log}
            return serve(handler, sock=listener, **(options | ours))

        module.serve = serve_guarded
        try:
            # The address is not used; should the hook ever fail, it is the least harmful one.
            server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        finally:
            module.serve = serve
    if not hooked.is_set():
        server.stop()
        raise RuntimeError(f"viser {viser.__version__} starts its server in a new way: it would not be guarded")
    return server


def _close_share_tunnel(server: viser.ViserServer) -> None:
    """Any browser could otherwise ask viser to publish the server on the internet."""
    server._websock_server.unregister_handler(_messages.ShareUrlRequest)
    server._websock_server.unregister_handler(_messages.ShareUrlDisconnect)
    gui: Any = server.gui
    gui.configure_theme = functools.partial(gui.configure_theme, show_share_button=False)
    gui.configure_theme()


@functools.cache
def _silence_viser() -> None:
    """Drop what viser prints, whatever its `verbose`; everybody else's `rich.print` works as before."""
    original = rich.print

    @no_type_check  # a checker's wrapper would be one more frame between the caller and us
    def print_unless_viser(*objects: Any, **options: Any) -> None:
        if not sys._getframe(1).f_globals.get("__name__", "").startswith("viser."):
            original(*objects, **options)

    rich.print = print_unless_viser
