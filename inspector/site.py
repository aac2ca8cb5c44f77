"""What the server answers to a request: its few pages, to those whom the access policy lets in, and nothing else."""

import asyncio
import logging
import weakref
from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus
from urllib.parse import parse_qsl

from websockets import Headers, Request, Response
from websockets.asyncio.server import ServerConnection

from inspector.access import AccessPolicy

_SECURITY_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}
# The page reloads itself without the token. A 303 would not do: after a click in web mail, say, the whole chain of
# redirects counts as cross-site, and the browser would withhold the Strict cookie that it was just given.
_SIGN_IN = b"""<!doctype html><meta charset="utf-8"><title>Pose inspector</title><script>
const url = new URL(location.href); url.searchParams.delete("token"); location.replace(url);
</script><noscript>Signed in. The inspector needs JavaScript.</noscript>
"""
_NO_TOKEN = "the token is missing or wrong: open the URL that the inspector printed when it started"

_log = logging.getLogger(__name__)

Page = tuple[str, bytes]
"""Content type and body."""
Route = Callable[[Mapping[str, str]], Awaitable[bytes | None]]
"""Answers the query of a request with JSON; None for "not found". Runs on the server's event loop: must not block.
websockets drops the connection after 10 s."""


class Site:
    """Answers the requests of one server: its few pages and viser's WebSocket to those whom the policy lets in."""

    def __init__(self, policy: AccessPolicy, pages: Mapping[str, Page], routes: Mapping[str, Route]) -> None:
        self._policy = policy
        self._pages = pages
        self._routes = routes
        self._open = False
        self._connections: weakref.WeakSet[ServerConnection] = weakref.WeakSet()
        self._answering: weakref.WeakSet[asyncio.Task[object]] = weakref.WeakSet()

    def open(self) -> None:
        """Begin to answer; until then everybody is asked to come back."""
        self._open = True

    def respond(self, connection: ServerConnection, request: Request) -> Response | Awaitable[Response] | None:
        """`process_request` of websockets: an answer, or None to go on with the WebSocket handshake."""
        headers = request.headers
        websocket = any("websocket" in value.lower() for value in headers.get_all("Upgrade"))
        if not self._open:
            return _line(HTTPStatus.SERVICE_UNAVAILABLE, "starting: try again")
        if (refusal := self._policy.refusal(request.path, headers)) is not None:
            return _line(HTTPStatus.FORBIDDEN, refusal)
        if not websocket and self._policy.admits(request.path):
            return _response(HTTPStatus.OK, "text/html; charset=utf-8", _SIGN_IN, {"Set-Cookie": self._policy.cookie})
        if not self._policy.knows(headers):
            return _line(HTTPStatus.UNAUTHORIZED, _NO_TOKEN)
        if websocket:
            self._connections.add(connection)
            return None
        path, _, query = request.path.partition("?")
        if path in self._routes:
            return self._routed(path, dict(parse_qsl(query, keep_blank_values=True)))
        return self._page(path, headers["Host"])

    async def _routed(self, path: str, query: Mapping[str, str]) -> Response:
        if (task := asyncio.current_task()) is not None:
            self._answering.add(task)
        try:
            body = await self._routes[path](query)
        except Exception:  # a fault of ours, which websockets would take for one of the handshake
            _log.exception("the answer to %s failed", path)
            return _line(HTTPStatus.INTERNAL_SERVER_ERROR, "failed: see the terminal of the inspector")
        if body is None:
            return _line(HTTPStatus.NOT_FOUND, "not found")
        return _response(HTTPStatus.OK, "application/json", body, {})

    def hang_up(self) -> None:
        """Cut all connections (on the event loop): viser would wait seconds for browsers that no longer read."""
        self._open = False
        for connection in list(self._connections):
            connection.transport.abort()
        for task in list(self._answering):
            task.cancel()

    def _page(self, path: str, host: str) -> Response:
        if path not in self._pages:  # an exact name or nothing: no path from a URL ever reaches the file system
            return _line(HTTPStatus.NOT_FOUND, "not found")
        content_type, body = self._pages[path]
        # The page may talk to this server only. In browsers of some years ago 'self' does not include ws://.
        sources = f"connect-src 'self' ws://{host} data: blob:; frame-ancestors 'self'"
        return _response(HTTPStatus.OK, content_type, body, {"Content-Security-Policy": sources})


def _line(status: HTTPStatus, text: str) -> Response:
    return _response(status, "text/plain; charset=utf-8", f"{text}\n".encode(), {})


def _response(status: HTTPStatus, content_type: str, body: bytes, extra: Mapping[str, str]) -> Response:
    frames = {"Content-Security-Policy": "frame-ancestors 'self'"}
    length = {"Content-Type": content_type, "Content-Length": str(len(body))}
    return Response(status.value, status.phrase, Headers(_SECURITY_HEADERS | frames | length | dict(extra)), body)
