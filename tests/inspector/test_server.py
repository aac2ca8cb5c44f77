"""The guarded server, started for real on a free port."""

import asyncio
import contextlib
import http.client
import logging
import queue
import shutil
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import rich
import viser
import websockets.asyncio.server
import zstandard
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from inspector.server import InspectorServer, make_server
from pipeline.exceptions import InputError

TOKEN = "correct-horse-battery"
SCRIPT = b"window.inspectorScript = 'ran'"
HEAD = '<script src="/inspector.js" defer></script>'
STATIC = {"/inspector.js": ("text/javascript", SCRIPT)}
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 0.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 10.0,
    "image_height": 10,
    "image_width": 10,
    "look_at": (0.0, 0.0, 1.0),
    "up_direction": (0.0, -1.0, 0.0),
}
Start = Callable[..., InspectorServer]


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts servers on free ports, with our script in their page, and stops them."""
    with contextlib.ExitStack() as servers:

        def start_one(**options: Any) -> InspectorServer:
            server = make_server(**{"port": 0, "head_html": HEAD, "static": STATIC, **options})
            servers.callback(server.stop)
            return server

        yield start_one


@pytest.fixture(scope="module")
def server() -> Iterator[InspectorServer]:
    """A server on loopback without a token, for tests that change nothing."""
    made = make_server(port=0, head_html=HEAD, static=STATIC)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def guarded() -> Iterator[InspectorServer]:
    """A server on loopback that wants the token."""
    made = make_server(port=0, token=TOKEN, head_html=HEAD, static=STATIC)
    yield made
    made.stop()


def get(server: InspectorServer, path: str = "/", **headers: str) -> tuple[http.client.HTTPResponse, str]:
    """The answer and its body; headers are given as keywords, `Host` too."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in ({"Host": f"127.0.0.1:{server.port}"} | headers).items():
        connection.putheader(name, value)
    connection.endheaders()
    with contextlib.closing(connection):
        response = connection.getresponse()
        return response, response.read().decode()


def open_websocket(server: InspectorServer, host: str = "127.0.0.1", **options: Any) -> ClientConnection:
    """Connect as viser's page does; `host` is what the Host header says."""
    version: Any = f"viser-v{viser.__version__}"
    sock = socket.create_connection(("127.0.0.1", server.port))
    return connect(f"ws://{host}:{server.port}", sock=sock, subprotocols=[version], max_size=None, **options)


def read_until(client: ClientConnection, kind: str, **values: object) -> dict[str, Any]:
    """Read viser's messages up to the one of this kind with these values."""
    while True:
        data = client.recv(timeout=30)
        assert isinstance(data, bytes)
        size, packed = (int.from_bytes(data[at : at + 8], "little") for at in (0, 8))
        raw = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], max_output_size=size)
        for message in msgspec.msgpack.decode(raw)["messages"]:
            if message["type"] == kind and values.items() <= message.items():
                return message


def has_ended(server: InspectorServer) -> bool:
    """Whether `stop` was in time: viser gives up waiting for its thread after six seconds."""
    thread = server.viser._websock_server._server_thread
    return thread is not None and not thread.is_alive()


# What is served


def test_the_page_is_visers_with_our_script_in_its_head(server):
    response, body = get(server)
    original = (Path(viser.__file__).parent / "client" / "build" / "index.html").read_text()
    assert response.status == 200
    assert response.headers["Content-Type"] == "text/html; charset=utf-8"
    assert body == original.replace("</head>", f"{HEAD}</head>")


def test_static_files_are_served_fresh(server):
    response, body = get(server, "/inspector.js?v=2")
    assert (response.status, body.encode()) == (200, SCRIPT)
    assert response.headers["Content-Type"] == "text/javascript"
    assert response.headers["Cache-Control"] == "no-store"


def test_routes_make_json_from_the_parameters(start):
    async def echo(query: Mapping[str, str]) -> bytes | None:
        return msgspec.json.encode(query) if query else None

    server = start(routes={"/echo": echo})
    response, body = get(server, "/echo?name=a%26b&empty=")
    assert (response.status, response.headers["Content-Type"]) == (200, "application/json")
    assert msgspec.json.decode(body) == {"name": "a&b", "empty": ""}
    assert get(server, "/echo")[0].status == 404


def test_routes_are_guarded_too(start):
    calls = []

    async def note(query: Mapping[str, str]) -> bytes | None:
        calls.append(query)
        return b"{}"

    server = start(routes={"/note": note}, token=TOKEN)
    known = {"Cookie": f"pose_inspector_{server.port}={TOKEN}"}
    assert get(server, "/note")[0].status == 401
    assert get(server, "/note", Origin="http://evil.example", **known)[0].status == 403
    assert get(server, "/note", **known, **{"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"})[0].status == 403
    assert not calls
    assert get(server, "/note", **known)[1] == "{}"


def test_a_route_that_fails_or_waits_disturbs_nobody(start, caplog):
    entered, go_on = threading.Event(), threading.Event()

    async def fail(_: Mapping[str, str]) -> bytes | None:
        raise ValueError("no such row")

    async def wait(_: Mapping[str, str]) -> bytes | None:
        entered.set()
        await asyncio.to_thread(go_on.wait, 30)
        return b"{}"

    server = start(routes={"/fail": fail, "/wait": wait})
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(get, server, "/wait")
        assert entered.wait(10)
        response, body = get(server, "/fail")
        assert (response.status, body) == (500, "failed: see the terminal of the inspector\n")
        go_on.set()
        assert waiting.result()[0].status == 200
    assert "the answer to /fail failed" in caplog.text
    assert "no such row" in caplog.text


def test_stopping_does_not_wait_for_a_route(start):
    entered = threading.Event()

    async def wait(_: Mapping[str, str]) -> bytes | None:
        entered.set()
        await asyncio.sleep(30)
        return b"{}"

    server = start(routes={"/wait": wait})
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(get, server, "/wait")
        assert entered.wait(10)
        server.stop()
        assert isinstance(waiting.exception(), ConnectionError)
    assert has_ended(server)


@pytest.mark.parametrize("path", ["/", "/inspector.js", "/absent", "/?websocket=x"])
def test_every_answer_carries_the_security_headers(server, path):
    headers = get(server, path)[0].headers
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert "frame-ancestors 'self'" in headers["Content-Security-Policy"]
    assert headers["Server"] is None


@pytest.mark.parametrize(
    "path",
    [
        "/../_viser.py",
        "/../../_viser.py",
        "/%2e%2e/%2e%2e/_viser.py",
        "/..%2f..%2f_viser.py",
        "/..\\..\\_viser.py",
        "//etc/passwd",
        "/etc/passwd",
        "/%2fetc/passwd",
        "/./inspector.js",
        "/inspector.js/",
        "/inspector.js%00",
        "http://127.0.0.1/etc/passwd",
        "etc/passwd",
        "*",
        "/index.html/../../../_viser.py",
    ],
)
def test_no_other_path_is_served(server, path):
    response, body = get(server, path)
    assert (response.status, body) == (404, "not found\n")


def test_not_even_files_and_links_in_visers_own_folder_are_served(start, tmp_path, monkeypatch):
    build = tmp_path / "client" / "build"
    build.mkdir(parents=True)
    (build / "index.html").write_text("<head></head>")
    (build / "secret.txt").write_text("secret")
    (build / "link").symlink_to(tmp_path)
    monkeypatch.setattr(viser, "__file__", str(tmp_path / "__init__.py"))
    server = start()
    assert get(server)[1] == f"<head>{HEAD}</head>"
    assert [get(server, path)[0].status for path in ("/secret.txt", "/link/client/build/secret.txt")] == [404, 404]


def test_viser_still_ships_one_page_with_all_its_parts_inside():
    """We serve that page alone: a viser whose page loads further files needs them served, too."""
    build = Path(viser.__file__).parent / "client" / "build"
    assert [path.name for path in build.iterdir()] == ["index.html"]


# To whom


@pytest.mark.parametrize("headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}])
@pytest.mark.parametrize("path", ["/", "/inspector.js", "/absent"])
def test_foreign_requests_get_one_line(server, path, headers):
    response, body = get(server, path, **headers)
    assert response.status == 403
    assert body.count("\n") == 1
    assert "is refused" in body


def test_what_a_stranger_sends_is_cut_and_escaped_in_the_answer(server):
    response, body = get(server, Host="\xff<b>" + "x" * 1000)
    assert response.headers["Content-Type"] == "text/plain; charset=utf-8"
    assert body.startswith(r"host '\udcff<b>xxx")
    assert len(body) < 250


@pytest.mark.parametrize("options", [{"host": "evil.example"}, {"origin": "http://evil.example"}, {"origin": "null"}])
def test_foreign_websockets_are_refused(server, options):
    with pytest.raises(InvalidStatus) as error:
        open_websocket(server, **options)
    assert error.value.response.status_code == 403
    assert b"is refused" in error.value.response.body


@pytest.mark.parametrize("upgrade", ["WebSocket", "h2c, websocket"])
def test_the_checks_hold_however_the_upgrade_is_spelt(guarded, upgrade):
    assert get(guarded, Upgrade=upgrade, Connection="Upgrade")[0].status == 401
    assert get(guarded, Upgrade=upgrade, Connection="Upgrade", Origin="http://evil.example")[0].status == 403


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_own_pages_and_programs_may_connect(server, host):
    for origin in (f"http://{host}:{server.port}", None):
        with open_websocket(server, host, origin=origin) as client:
            read_until(client, "ReplayDoneMessage")


def test_without_the_token_nothing_is_served(guarded):
    for path in ("/", "/inspector.js", "/absent", "/?token=wrong"):
        response, body = get(guarded, path)
        assert response.status == 401
        assert body == "the token is missing or wrong: open the URL that the inspector printed when it started\n"
    with pytest.raises(InvalidStatus) as error:
        open_websocket(guarded, additional_headers={"Cookie": f"pose_inspector_{guarded.port}=wrong"})
    assert error.value.response.status_code == 401


def test_the_token_in_the_url_is_exchanged_for_a_cookie(guarded):
    assert guarded.url == f"http://127.0.0.1:{guarded.port}/?token={TOKEN}"
    response, body = get(guarded, f"/?token={TOKEN}")
    assert response.status == 200
    assert TOKEN not in body
    cookie = response.headers["Set-Cookie"]
    assert cookie == f"pose_inspector_{guarded.port}={TOKEN}; HttpOnly; SameSite=Strict; Path=/"
    known = {"Cookie": cookie.partition(";")[0]}
    assert get(guarded, **known)[1].startswith("<!doctype html>\n<html")
    with open_websocket(guarded, additional_headers=known) as client:
        read_until(client, "ReplayDoneMessage")


def test_all_networks_need_a_token_which_is_made(start, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "box")
    server, other = start(host="0.0.0.0"), start(host="0.0.0.0")
    assert server.token
    assert len(server.token) >= 40
    assert server.token != other.token
    assert server.url == f"http://127.0.0.1:{server.port}/?token={server.token}"
    assert server.network_url == f"http://box:{server.port}/?token={server.token}"
    assert [get(server, Host=host)[0].status for host in ("127.0.0.1", "box", "evil.example")] == [401, 401, 403]


def test_loopback_needs_no_token(server):
    assert server.token is None
    assert server.network_url is None
    assert server.url == f"http://127.0.0.1:{server.port}/"


def test_ipv6_loopback(start):
    if not socket.has_ipv6:
        pytest.skip("no IPv6 here")
    try:
        server = start(host="::1")
    except InputError as error:
        pytest.skip(f"no IPv6 here: {error}")
    assert server.url == f"http://[::1]:{server.port}/"
    connection = http.client.HTTPConnection("::1", server.port, timeout=10)
    connection.request("GET", "/inspector.js")
    assert connection.getresponse().read() == SCRIPT
    connection.close()


# Hosts and ports


@pytest.mark.parametrize("holder", ["another program", "another inspector"])
def test_a_port_in_use_is_an_error_not_the_next_port(start, holder):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1] if holder == "another program" else start().port
        with pytest.raises(
            InputError, match=rf"^port {port} is in use on 127.0.0.1; use --port N or --port 0 \(a free"
        ):
            make_server(port=port)


def test_of_two_that_want_the_same_port_one_gets_it(start):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with ThreadPoolExecutor(4) as pool:
        errors = [attempt.exception() for attempt in [pool.submit(start, port=port) for _ in range(4)]]
    assert sorted(type(error).__name__ for error in errors) == ["InputError"] * 3 + ["NoneType"]


@pytest.mark.parametrize("port", [-1, 65536, 99999])
def test_a_port_out_of_range(port):
    with pytest.raises(InputError, match=rf"^port {port} is out of range 0..65535; use --port 8080 or --port 0 \("):
        make_server(port=port)


@pytest.mark.parametrize("host", ["", "no-such-host.invalid", "300.1.1.1", "a" * 70, "a b", "x\0y"])
def test_a_host_that_is_not_known(host):
    with pytest.raises(InputError, match=r"is not known; use --host 127.0.0.1 \(this machine only\) or --host 0.0.0.0"):
        make_server(host=host, port=0)


def test_a_host_that_is_another_machine():
    with pytest.raises(InputError, match=r'^host "192.0.2.1" is not an address of this machine; use --host 127.0.0.1'):
        make_server(host="192.0.2.1", port=0)


def test_a_bad_token_leaves_no_socket_behind(start):
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(InputError, match="token of 5 characters"):
        make_server(port=port, token="short")
    assert start(port=port).port == port


def test_visers_port_override_is_not_obeyed(start, monkeypatch):
    monkeypatch.setenv("_VISER_PORT_OVERRIDE", "1")
    assert get(start())[0].status == 200


def test_stopping_frees_the_port_and_may_be_repeated(start):
    server = start()
    with open_websocket(server) as client:
        server.stop()
        server.stop()
        with pytest.raises(ConnectionClosed):
            read_until(client, "never")
    assert start(port=server.port).port == server.port


# The hook into viser


def test_servers_made_at_once_do_not_mix(start):
    original = websockets.asyncio.server.serve
    with ThreadPoolExecutor(6) as pool:
        servers = list(pool.map(lambda i: start(head_html=f"<!-- server {i} -->"), range(6)))
    assert len({server.port for server in servers}) == 6
    assert all(f"<!-- server {i} -->" in get(server)[1] for i, server in enumerate(servers))
    assert websockets.asyncio.server.serve is original


def test_a_viser_that_starts_in_another_way_is_not_served_unguarded(monkeypatch):
    stopped = []

    class OtherViser:
        def __init__(self, **_: object) -> None: ...

        def stop(self) -> None:
            stopped.append(self)

    monkeypatch.setattr(viser, "ViserServer", OtherViser)
    with pytest.raises(RuntimeError, match="starts its server in a new way: it would not be guarded"):
        make_server(port=0)
    assert stopped


def test_a_failure_inside_viser_restores_everything(start, monkeypatch):
    original = websockets.asyncio.server.serve
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with monkeypatch.context() as broken:
        broken.setattr("viser.infra.WebsockServer.start", lambda self: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            make_server(port=port)
    assert websockets.asyncio.server.serve is original
    assert start(port=port).port == port


def test_the_terminal_stays_quiet(start, capfd):
    server = start()
    with contextlib.suppress(ConnectionClosed), open_websocket(server) as client:
        client.recv(timeout=10)
    server.stop()
    rich.print("ours")
    assert capfd.readouterr() == ("ours\n", "")


def test_what_is_no_http_leaves_no_traceback(server, caplog):
    for garbage in (b"\x16\x03\x01\x00\xa5\r\n\r\n", b"POST / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.0\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", server.port), timeout=10) as sock:
            sock.sendall(garbage)
            with contextlib.suppress(ConnectionResetError):
                while sock.recv(4096):
                    pass
    assert get(server)[0].status == 200
    assert not caplog.records


# The share tunnel


def test_nobody_can_open_a_public_tunnel(start, monkeypatch):
    calls = []
    monkeypatch.setattr("viser._viser.ViserTunnel", lambda *arguments: calls.append(arguments))
    monkeypatch.setattr("viser.ViserServer.request_share_url", lambda *arguments: calls.append(arguments))
    monkeypatch.setattr("viser.ViserServer.disconnect_share_url", lambda *arguments: calls.append(arguments))
    server, connected = start(), threading.Event()
    server.viser.on_client_connect(lambda _: connected.set())
    with open_websocket(server) as client:
        for message in ({"type": "ShareUrlRequest"}, {"type": "ShareUrlDisconnect"}, CAMERA):
            client.send(msgspec.msgpack.encode(message))
        assert connected.wait(30)
    handled = {kind.__name__ for kind in server.viser._websock_server._incoming_handlers}
    server.viser._thread_executor.shutdown(wait=True)
    assert handled
    assert not {name for name in handled if "Share" in name}
    assert calls == []


def test_the_share_button_is_hidden_and_stays_hidden(start):
    server = start()
    with open_websocket(server) as client:
        assert read_until(client, "ThemeConfigurationMessage")["show_share_button"] is False
        server.viser.gui.configure_theme(dark_mode=True)
        assert read_until(client, "ThemeConfigurationMessage", dark_mode=True)["show_share_button"] is False


# One client's trouble is its own


@contextlib.contextmanager
def stalled_websocket(server: InspectorServer) -> Iterator[None]:
    """A client that shakes hands and then never reads."""
    request = (
        f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: viser-v{viser.__version__}\r\n\r\n"
    )
    with socket.socket() as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        sock.settimeout(10)
        sock.connect(("127.0.0.1", server.port))
        sock.sendall(request.encode())
        assert sock.recv(12) == b"HTTP/1.1 101"
        yield


def test_a_client_that_never_reads_delays_nobody(start):
    server = start()
    points = np.random.default_rng(0).normal(size=(100_000, 3)).astype(np.float32)
    with stalled_websocket(server), open_websocket(server) as reader:
        for k in range(20):  # 24 MB: more than the kernel takes for a client that does not read
            server.viser.scene.add_point_cloud(f"/cloud{k}", points + k, (0, 0, 0), precision="float32")
        server.viser.gui.set_panel_label("all sent")
        read_until(reader, "SetGuiPanelLabelMessage", label="all sent")
        unsent = [c.transport.get_write_buffer_size() for c in server.viser._websock_server._live_connections.values()]
        assert max(unsent) > 0, "the stalled client has to be stalled for this test to mean anything"
        with open_websocket(server) as newcomer:
            read_until(newcomer, "SetGuiPanelLabelMessage", label="all sent")
        server.stop()
        assert has_ended(server)


def test_a_client_that_sends_rubbish_loses_its_own_connection_only(server, caplog):
    with open_websocket(server) as good, open_websocket(server) as bad:
        bad.send(b"\xc1 is no message")
        with pytest.raises(ConnectionClosed):
            read_until(bad, "never")
        server.viser.gui.set_panel_label("still here")
        read_until(good, "SetGuiPanelLabelMessage", label="still here")
    assert [(r.levelno, r.getMessage()) for r in caplog.records] == [(logging.ERROR, "connection handler failed")]


# In a browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium with software WebGL."""
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install playwright"
    )
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium: apt install chromium")
    arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    arguments += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    with playwright.sync_playwright() as running:
        launched = running.chromium.launch(executable_path=chromium, args=arguments)
        yield launched
        launched.close()


def clients_of(server: InspectorServer) -> "queue.Queue[viser.ClientHandle]":
    clients: queue.Queue[viser.ClientHandle] = queue.Queue()
    server.viser.on_client_connect(clients.put)
    return clients


@pytest.mark.browser
def test_the_page_runs_our_script_and_connects(start, browser):
    server = start()
    clients, page, console = clients_of(server), browser.new_page(), []
    page.on("console", lambda message: console.append(message.text))
    page.on("pageerror", lambda error: console.append(str(error)))
    page.goto(server.url)
    clients.get(timeout=60)
    assert page.evaluate("window.inspectorScript") == "ran"
    assert page.locator(".tabler-icon-share").count() == 0
    assert not [text for text in console if "Security Policy" in text or "rror" in text]
    violated = """new Promise(resolve => {
        addEventListener("securitypolicyviolation", event => resolve(event.effectiveDirective));
        new WebSocket("ws://127.0.0.1:1"); })"""
    assert page.evaluate(violated) == "connect-src"
    page.close()


@pytest.mark.browser
def test_a_link_on_another_site_signs_in_but_its_scripts_cannot_connect(start, browser):
    server = start(token=TOKEN)
    clients, page = clients_of(server), browser.new_page()
    page.route("http://evil.example/", lambda route: route.fulfill(body="<p>", content_type="text/html"))
    page.goto("http://evil.example/")
    page.evaluate("url => { location.href = url }", f"{server.url}&target=7")
    clients.get(timeout=60)
    page.wait_for_function("window.inspectorScript === 'ran'")
    assert page.url == f"http://127.0.0.1:{server.port}/?target=7"
    cookies = [(cookie["name"], cookie["httpOnly"], cookie["sameSite"]) for cookie in page.context.cookies()]
    assert cookies == [(f"pose_inspector_{server.port}", True, "Strict")]

    page.goto("http://evil.example/")
    connect_to = """url => new Promise(resolve => {
        const socket = new WebSocket(url);
        socket.onopen = () => resolve("open");
        socket.onerror = () => resolve("refused"); })"""
    assert page.evaluate(connect_to, f"ws://127.0.0.1:{server.port}") == "refused"
    page.close()
