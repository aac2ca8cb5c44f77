"""The channel between one browser's page (`web/inspector.js`) and its session.

The page calls methods (`GET /inspector/call`) and asks for the state to show (`GET /inspector/state`, answered when
there is news or after a few seconds). Every browser has an unguessable key, so that no other page can speak for it.
"""

import asyncio
import contextlib
import json
import logging
import math
import secrets
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from typing import Any

from pipeline.exceptions import InputError

log = logging.getLogger(__name__)

_FILES = {
    "/inspector.css": "text/css; charset=utf-8",
    "/leaderboard.css": "text/css; charset=utf-8",
    "/inspector.js": "text/javascript; charset=utf-8",
    "/leaderboard.js": "text/javascript; charset=utf-8",
}
HEAD = "".join(
    f'<link rel="stylesheet" href="{path}">' if path.endswith("css") else f'<script src="{path}"></script>'
    for path in _FILES
)
"""Goes into the page's head."""


PATIENCE = 6.0
"""Seconds after which a request for news is answered though there is none (websockets gives up after 10)."""


def static_files() -> dict[str, tuple[str, bytes]]:
    """Return our files for the page: content type and content by path."""
    web = resources.files("inspector") / "web"
    return {path: (kind, (web / path[1:]).read_bytes()) for path, kind in _FILES.items()}


class PageChannel:
    """Runs the calls of one page one after the other in a thread of its own, and tells it of new state."""

    def __init__(self, loop: asyncio.AbstractEventLoop, methods: Mapping[str, Callable[..., Any]]) -> None:
        self.key = secrets.token_urlsafe(18)
        self._loop = loop
        self._methods = methods
        self._state: dict[str, Any] = {}
        self._version = 1
        self._news = asyncio.Event()
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="page")

    def publish(self, **state: Any) -> None:
        """Change parts of the state; the page hears of it at once. Callable from any thread."""
        self._loop.call_soon_threadsafe(self._change, state)

    async def call(self, method: str, arguments: list[Any]) -> Any:
        """Run a method; an unknown one or wrong arguments give None, an error is logged and gives None."""
        if method not in self._methods:
            return None
        try:
            return await self._loop.run_in_executor(self._executor, lambda: self._methods[method](*arguments))
        except (TypeError, ValueError, OverflowError) as error:  # arguments that our script would not send
            log.info("the call %s%s of a page: %s", method, tuple(arguments), error)
            return None
        except InputError as error:  # what cannot be shown says so in the picture already
            log.info("the call %s of a page: %s", method, error)
            return None
        except Exception:
            log.exception("the call %s%s of a page failed", method, tuple(arguments))
            return None

    async def news(self, since: int) -> dict[str, Any]:
        """Return the state as soon as it is newer than `since`, or as it is after a while."""
        if since >= self._version:
            self._news.clear()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._news.wait(), PATIENCE)
        return {**self._state, "version": self._version}

    def close(self) -> None:
        """End the thread; calls still waiting are dropped."""
        self._executor.shutdown(wait=False, cancel_futures=True)

    def _change(self, state: dict[str, Any]) -> None:
        changed = {name: value for name, value in state.items() if self._state.get(name) != value}
        if changed:
            self._state.update(changed)
            self._version += 1
            self._news.set()


class PageChannels:
    """Finds the channel that a request is for."""

    def __init__(self) -> None:
        self._channels: dict[str, PageChannel] = {}

    def add(self, channel: PageChannel) -> None:
        """Let a page's requests through."""
        self._channels[channel.key] = channel

    def remove(self, channel: PageChannel) -> None:
        """Forget a page that went away."""
        self._channels.pop(channel.key, None)
        channel.close()

    async def answer_call(self, query: Mapping[str, str]) -> bytes | None:
        """Answer `/inspector/call?key=&method=&args=[...]` with JSON; None for a key that is not known."""
        channel = self._channels.get(query.get("key", ""))
        if channel is None:
            return None
        try:
            arguments = json.loads(query.get("args", "[]"), parse_constant=_refuse, parse_float=_finite)
        except (ValueError, RecursionError):
            return None
        if not isinstance(arguments, list):
            return None
        return json.dumps(await channel.call(query.get("method", ""), arguments)).encode()

    async def answer_state(self, query: Mapping[str, str]) -> bytes | None:
        """Answer `/inspector/state?key=&since=` with JSON; None for a key that is not known."""
        channel = self._channels.get(query.get("key", ""))
        if channel is None:
            return None
        since = query.get("since", "0")
        return json.dumps(await channel.news(int(since) if since.isdecimal() else 0)).encode()


def _refuse(text: str) -> float:
    raise ValueError(text)


def _finite(text: str) -> float:
    number = float(text)
    return number if math.isfinite(number) else _refuse(text)
