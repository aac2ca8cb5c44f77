"""Which requests the access policy refuses, and why."""

import pytest
from websockets import Headers

from inspector.access import AccessPolicy
from pipeline.exceptions import InputError

TOKEN = "correct-horse-battery"
LOOPBACK = AccessPolicy("127.0.0.1", "127.0.0.1", 8080, None)
NETWORK = AccessPolicy("0.0.0.0", "0.0.0.0", 8080, TOKEN)


def refusal(policy: AccessPolicy, path: str = "/", **headers: str) -> str | None:
    return policy.refusal(path, Headers(headers))


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "LocalHost:8080", "[::1]:8080", "localhost"])
def test_loopback_names_are_served(host):
    assert refusal(LOOPBACK, Host=host) is None


def test_a_tunnel_may_map_the_port():
    assert refusal(LOOPBACK, Host="localhost:9000", Origin="http://localhost:9000") is None


@pytest.mark.parametrize(
    "host",
    [
        "evil.example:8080",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "192.168.1.5:8080",
        "0.0.0.0:8080",
        "",
        "localhost:8080:1",
        "me@localhost",
        "localhost/x",
        "local host",
        "[::1",
        "[::2]:8080",
    ],
)
def test_other_hosts_are_refused_on_loopback(host):
    text = refusal(LOOPBACK, Host=host)
    assert text is not None
    assert text.startswith(f"host '{host}' is refused: use this machine's address or one of 127.0.0.1")
    assert "\n" not in text


def test_a_missing_or_double_host_is_refused():
    twice = Headers([("Host", "127.0.0.1:8080"), ("Host", "evil.example")])
    assert "is refused" in (LOOPBACK.refusal("/", Headers()) or "")
    assert "is refused" in (LOOPBACK.refusal("/", twice) or "")


@pytest.mark.parametrize("host", ["192.168.1.5:8080", "[2001:db8::1]:8080", "127.0.0.1:80", "box", "box.local:8080"])
def test_addresses_and_own_names_are_served_on_a_network(host, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "Box")
    assert refusal(AccessPolicy("0.0.0.0", "0.0.0.0", 8080, TOKEN), Host=host) is None


@pytest.mark.parametrize("host", ["evil.example", "box.evil.example", "999.1.1.1", "3232235777"])
def test_names_that_others_control_are_refused_on_a_network(host, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "box")
    assert refusal(AccessPolicy("0.0.0.0", "0.0.0.0", 8080, TOKEN), Host=host) is not None


def test_the_name_that_was_asked_for_is_served():
    assert refusal(AccessPolicy("pc.lab.example", "10.0.0.7", 8080, TOKEN), Host="pc.lab.example:8080") is None


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "null", "http://127.0.0.1:3000", "http://localhost:8080", "https://127.0.0.1:8080", ""],
)
def test_foreign_origins_are_refused(origin):
    text = refusal(LOOPBACK, Host="127.0.0.1:8080", Origin=origin)
    assert text == f"origin '{origin}' is refused: only this server's own pages may connect"


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_other_sites_may_link_here_but_not_load(site):
    headers = {"Host": "127.0.0.1:8080", "Sec-Fetch-Site": site}
    assert refusal(LOOPBACK, **headers, **{"Sec-Fetch-Mode": "navigate"}) is None
    text = refusal(LOOPBACK, **headers, **{"Sec-Fetch-Mode": "no-cors"})
    assert text == "a request by a page of another site is refused: open this server's own page"


@pytest.mark.parametrize("name", ["websocket", "playbackPath", "web%73ocket"])
def test_links_that_point_the_page_at_another_server_are_refused(name):
    text = refusal(LOOPBACK, path=f"/?a=1&{name}=ws://evil.example", Host="127.0.0.1:8080")
    assert text is not None
    assert text.endswith("is refused: remove it from the URL")


def test_the_token_comes_by_url_or_cookie():
    assert NETWORK.admits(f"/?x=1&token={TOKEN}")
    assert not NETWORK.admits("/?token=wrong")
    assert not NETWORK.admits("/?token=")
    assert not NETWORK.admits("/?token=%ff\udcff")
    cookie = NETWORK.cookie.partition(";")[0]
    assert NETWORK.knows(Headers(Cookie=f"broken; {{json: 1}}=2; {cookie}; other=1"))
    assert NETWORK.knows(Headers([("Cookie", "pose_inspector_8080=old"), ("Cookie", cookie)]))
    assert not NETWORK.knows(Headers(Cookie="pose_inspector_8080=wrong"))
    assert not NETWORK.knows(Headers(Cookie=f"pose_inspector_9999={TOKEN}"))
    assert not NETWORK.knows(Headers())


def test_without_a_token_everybody_on_this_machine_is_known():
    assert LOOPBACK.knows(Headers())
    assert not LOOPBACK.admits("/?token=")


@pytest.mark.parametrize(
    "token", ["", "short", "with spaces in the middle", "semicolon;in;the;cookie", "ünïcödé-tokens-here"]
)
def test_tokens_that_can_be_guessed_or_need_quoting_are_refused(token):
    with pytest.raises(
        InputError, match=f"token of {len(token)} characters cannot be used; use 16 or more of"
    ) as error:
        AccessPolicy("127.0.0.1", "127.0.0.1", 8080, token)
    assert not token or token not in str(error.value)
