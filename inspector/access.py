"""Who may talk to the server: checks on the headers of every HTTP request and WebSocket handshake, free of any I/O.

What each check is against:

* **Host**: DNS rebinding. A page of evil.example whose name is re-pointed to 127.0.0.1 is same-origin with us in the
  browser's eyes, but still sends `Host: evil.example`. On loopback only loopback names pass. On other addresses any
  IP literal passes too (nobody can re-point one) and so does this machine's own name. The port in `Host` may differ
  from ours: SSH tunnels and containers map it, and it proves nothing.
* **Origin**: pages of other sites, which may open WebSockets to any address. Where sent it must be `http://` + `Host`.
  Browsers always send it with a WebSocket; a handshake without it comes from a program, which could forge it anyway,
  so it goes on to the other checks.
* **Sec-Fetch-Site**: pages of other sites that load ours as an image or a script, which sends no Origin. They may link
  here, no more.
* **Token**: other people, on other machines or in other accounts of this one. It comes once in `?token=` and from then
  on in an HttpOnly, SameSite=Strict cookie. All is plain HTTP: on a network that is not trusted use an SSH tunnel.
* **Query**: viser's page obeys `?websocket=` and `?playbackPath=`; a link with one of them would make our page run
  whatever a stranger's server sends, with all rights of our page.
"""

import hmac
import ipaddress
import re
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable
from urllib.parse import parse_qs

from pipeline.exceptions import InputError

_HOST = re.compile(r"(?:\[([0-9a-f:.]+)\]|([a-z0-9._-]+))(?::\d{1,5})?", re.ASCII)
_TOKEN = re.compile(r"[A-Za-z0-9_-]{16,}", re.ASCII)  # goes unquoted into a URL and a cookie
_FOREIGN_SOURCES = ("websocket", "playbackPath")


@runtime_checkable
class Headers(Protocol):
    """What is used of `websockets.Headers`: names are case-insensitive and may repeat."""

    def get_all(self, key: str) -> Iterable[str]:
        """All values of a header, none when absent."""
        ...


@dataclass(frozen=True)
class AccessPolicy:
    """The rules of one server; raises InputError for a token that could be guessed or would need quoting."""

    host: str
    """As the user asked for it: a name or an address."""
    address: str
    """The IP address that the server is bound to."""
    port: int
    token: str | None

    def __post_init__(self) -> None:
        if self.token is not None and not _TOKEN.fullmatch(self.token):
            raise InputError(
                f"token of {len(self.token)} characters cannot be used; "
                "use 16 or more of A-Z a-z 0-9 _ - or leave it out (one is made where needed)"
            )

    @property
    def loopback(self) -> bool:
        """Whether only this machine can connect."""
        return is_loopback(self.address)

    @cached_property
    def names(self) -> frozenset[str]:
        """The host names, lower case and without brackets, under which the server may be opened."""
        own = {"127.0.0.1", "::1", "localhost", self.host.lower(), self.address.lower()}
        if not self.loopback:
            machine = socket.gethostname().lower()
            own |= {machine, machine.partition(".")[0] + ".local"}
        return frozenset(own)

    def refusal(self, path: str, headers: Headers) -> str | None:
        """One line for a request that must be answered with 403, None for one that may go on to the token's check."""
        hosts, origins = list(headers.get_all("Host")), list(headers.get_all("Origin"))
        if len(hosts) != 1 or not self._is_own(hosts[0]):
            shown = ascii(", ".join(hosts))[:100]
            return f"host {shown} is refused: use this machine's address or one of {', '.join(sorted(self.names))}"
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return f"origin {ascii(', '.join(origins))[:100]} is refused: only this server's own pages may connect"
        sites, modes = set(headers.get_all("Sec-Fetch-Site")), set(headers.get_all("Sec-Fetch-Mode"))
        if sites - {"same-origin", "none"} and modes != {"navigate"}:
            return "a request by a page of another site is refused: open this server's own page"
        foreign = [name for name in _FOREIGN_SOURCES if name in _query(path)]
        return f"the parameter {foreign[0]} is refused: remove it from the URL" if foreign else None

    def admits(self, path: str) -> bool:
        """Whether the URL brings the right token."""
        return self.token is not None and any(self._matches(given) for given in _query(path).get("token", ()))

    def knows(self, headers: Headers) -> bool:
        """Whether the cookie holds the right token, or no token is needed."""
        if self.token is None:
            return True
        pairs = (pair.strip().partition("=") for header in headers.get_all("Cookie") for pair in header.split(";"))
        return any([self._matches(value) for name, _, value in pairs if name == self.cookie_name])

    @property
    def cookie_name(self) -> str:
        """Names the port, because the cookies of all servers on a host share one jar."""
        return f"pose_inspector_{self.port}"

    @property
    def cookie(self) -> str:
        """Value of the Set-Cookie header that makes a browser known."""
        return f"{self.cookie_name}={self.token}; HttpOnly; SameSite=Strict; Path=/"

    def _is_own(self, host_header: str) -> bool:
        match = _HOST.fullmatch(host_header.lower())
        if match is None:
            return False
        name = match[1] or match[2]
        return name in self.names or (not self.loopback and _is_address(name))

    def _matches(self, given: str) -> bool:
        assert self.token is not None
        return hmac.compare_digest(given.encode(errors="replace"), self.token.encode())


def is_loopback(address: str) -> bool:
    """Whether an IP address is reachable from this machine only."""
    return ipaddress.ip_address(address).is_loopback


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _query(path: str) -> dict[str, list[str]]:
    return parse_qs(path.partition("?")[2], keep_blank_values=True)
