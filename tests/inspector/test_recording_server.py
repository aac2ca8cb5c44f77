"""The recording server: gives a run's recordings to those who know the token, and nothing else to anybody."""

import html
import http.client
import http.server
import shutil
import socket
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from inspector import rerun_viewer
from inspector.recording_server import RecordingServer
from pipeline.exceptions import InputError, MissingFileError
from pipeline.recording import Recorder, recording_name, save_blueprint, save_models
from pipeline.scene import Camera, ImageKey, Model, PoseEstimate

KEY = ImageKey(2, 3)
NAME = recording_name(KEY)
TOKEN = "a-token_of.tests"
INSPECTOR = "http://127.0.0.1:8080"


class Answer(NamedTuple):
    """What the server said."""

    status: int
    headers: Mapping[str, str]
    body: bytes


def ask(server: RecordingServer, path: str, method: str = "GET", **headers: str) -> Answer:
    """Send a request as it is, without tidying its path."""
    connection = http.client.HTTPConnection("127.0.0.1", urlsplit(server.address).port or 0, timeout=20)
    connection.putrequest(method, path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    answer = Answer(response.status, {k.lower(): v for k, v in response.getheaders()}, response.read())
    connection.close()
    return answer


@pytest.fixture
def run_root(tmp_path: Path) -> Path:
    """A run folder with one recording, the models, the layout, and files that nobody shall see."""
    folder = tmp_path / "run" / "recordings"
    with Recorder(folder / NAME, "run", KEY, Camera(np.diag([100.0, 100, 1]), 64, 48), model_ids=(5,)) as recorder:
        recorder.image("image/rgb", np.full((48, 64, 3), 200, np.uint8))
        recorder.poses("estimates", [PoseEstimate(2, 3, 5, 1.0, np.eye(4))])
        recorder.text("log", "seen by the viewer")
    corners = np.array([[0, 0, 1], [0.1, 0, 1], [0, 0.1, 1]])
    save_models(folder, "run", [Model(5, corners, np.array([[0, 1, 2]], np.int32), 0.14)])
    save_blueprint(folder / "layout.rbl")
    (folder / "notes.txt").write_text("secret")
    (folder / "000009_000009.rrd").symlink_to("/etc/hostname")
    (tmp_path / "run" / "run.json").write_text("secret")
    return tmp_path / "run"


@pytest.fixture
def server(run_root: Path) -> Iterator[RecordingServer]:
    """A running server."""
    server = RecordingServer(run_root, TOKEN, {INSPECTOR})
    server.start()
    yield server
    server.stop()


def test_recordings_models_and_layout_are_served(server: RecordingServer, run_root: Path) -> None:
    for name in (NAME, "models.rrd", "layout.rbl"):
        answer = ask(server, f"/{TOKEN}/recordings/{name}")
        assert answer.status == 200
        assert answer.body == (run_root / "recordings" / name).read_bytes()
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        (f"/recordings/{NAME}?token={TOKEN}", {}),
        (f"/recordings/{NAME}", {"Cookie": f"other=1; inspector={TOKEN}"}),
    ],
)
def test_other_ways_to_show_the_token(server: RecordingServer, path: str, headers: dict[str, str]) -> None:
    assert ask(server, path, **headers).status == 200


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        (f"/recordings/{NAME}", {}),
        (f"/recordings/{NAME}?token={TOKEN}x", {}),
        (f"/recordings/{NAME}?token=", {}),
        (f"/{TOKEN[:-1]}/recordings/{NAME}", {}),
        (f"/recordings/{NAME}", {"Cookie": "inspector=wrong"}),
        ("/", {}),
        ("/viewer/re_viewer.js", {}),
        (f"/{TOKEN}/recordings/{NAME}", {"Host": "evil.example"}),
        (f"/{TOKEN}/recordings/{NAME}", {"Host": "127.0.0.1"}),
        (f"/{TOKEN}/recordings/{NAME}", {"Origin": "http://evil.example"}),
        (f"/{TOKEN}/recordings/{NAME}", {"Origin": "null"}),
    ],
)
def test_strangers_are_refused(server: RecordingServer, path: str, headers: dict[str, str]) -> None:
    for method in ("GET", "HEAD"):
        answer = ask(server, path, method, **headers)
        assert answer.status == 403
        assert "access-control-allow-origin" not in answer.headers


def test_a_request_without_host_is_refused(server: RecordingServer) -> None:
    with socket.create_connection(("127.0.0.1", urlsplit(server.address).port or 0), timeout=20) as connection:
        connection.sendall(f"GET /{TOKEN}/recordings/{NAME} HTTP/1.0\r\n\r\n".encode())
        assert connection.recv(12) == b"HTTP/1.1 403"


@pytest.mark.parametrize(
    "path",
    [
        "recordings/",
        "recordings",
        "recordings/notes.txt",
        f"recordings/{NAME}.sha256",
        "recordings/000002_000099.rrd",
        "recordings/0000002_000003.rrd",
        "recordings/000009_000009.rrd",
        "recordings/../run.json",
        "recordings/%2e%2e/run.json",
        "recordings//etc/hostname",
        "run.json",
        "viewer/../recordings/notes.txt",
        "viewer/sw.js",
        f"recordings/{NAME}%00",
        f"recordings/{NAME}/",
        "",
    ],
)
def test_nothing_else_is_served(server: RecordingServer, path: str) -> None:
    answer = ask(server, f"/{TOKEN}/{path}")
    assert answer.status == 404
    assert b"secret" not in answer.body


def test_only_reading_is_possible(server: RecordingServer, run_root: Path) -> None:
    for method in ("POST", "PUT", "DELETE"):
        assert ask(server, f"/{TOKEN}/recordings/{NAME}", method).status == 501
    assert (run_root / "recordings" / NAME).exists()


@pytest.mark.parametrize(
    ("asked", "first", "last"),
    [("bytes=0-3", 0, 3), ("bytes=10-", 10, -1), ("bytes=-12", -12, -1), ("bytes=5-99999999", 5, -1)],
)
def test_ranges(server: RecordingServer, run_root: Path, asked: str, first: int, last: int) -> None:
    content = (run_root / "recordings" / NAME).read_bytes()
    first, last = first % len(content), last % len(content)
    answer = ask(server, f"/{TOKEN}/recordings/{NAME}", Range=asked)
    assert answer.status == 206
    assert answer.body == content[first : last + 1]
    assert answer.headers["content-range"] == f"bytes {first}-{last}/{len(content)}"


def test_ranges_outside_and_odd_ones(server: RecordingServer) -> None:
    assert ask(server, f"/{TOKEN}/recordings/{NAME}", Range="bytes=99999999-").status == 416
    assert ask(server, f"/{TOKEN}/recordings/{NAME}", Range="bytes=0-1,4-5").status == 200
    assert ask(server, f"/{TOKEN}/recordings/{NAME}", Range="lines=1-2").status == 200


def test_head_has_the_length_and_no_body(server: RecordingServer, run_root: Path) -> None:
    answer = ask(server, f"/{TOKEN}/recordings/{NAME}", "HEAD")
    assert answer.headers["content-length"] == str((run_root / "recordings" / NAME).stat().st_size)
    assert answer.body == b""


def test_the_inspector_may_read_from_scripts(server: RecordingServer) -> None:
    for origin in (INSPECTOR, server.address):
        answer = ask(server, f"/{TOKEN}/recordings/{NAME}", Origin=origin)
        assert answer.status == 200
        assert answer.headers["access-control-allow-origin"] == origin
        preflight = ask(server, f"/{TOKEN}/recordings/{NAME}", "OPTIONS", Origin=origin)
        assert preflight.status == 204
        assert preflight.headers["access-control-allow-headers"] == "Range"
    assert ask(server, f"/{TOKEN}/recordings/{NAME}", "OPTIONS", Origin="http://evil.example").status == 403


def test_viewer_url_has_layout_first_and_recording_last(server: RecordingServer) -> None:
    parts = urlsplit(server.viewer_url(KEY))
    query = parse_qs(parts.query, keep_blank_values=True)
    base = f"{server.address}/{TOKEN}/recordings"
    assert f"{parts.scheme}://{parts.netloc}{parts.path}" == f"{server.address}/{TOKEN}/viewer/"
    assert query["url"] == [f"{base}/layout.rbl", f"{base}/models.rrd", f"{base}/{NAME}"]
    assert query["renderer"] == ["webgl"]
    assert "hide_welcome_screen" in query
    with pytest.raises(MissingFileError, match=r"000002_000004.rrd: no such recording; run the method"):
        server.viewer_url(ImageKey(2, 4))


def test_the_viewer_page_may_reach_nothing_outside(server: RecordingServer) -> None:
    answer = ask(server, f"/{TOKEN}/viewer/")
    assert answer.status == 200
    assert b"re_viewer.js" in answer.body
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("default-src 'self' data: blob:;")
    assert f"frame-ancestors 'self' {INSPECTOR}" in policy
    assert "evil" not in policy
    wasm = ask(server, f"/{TOKEN}/viewer/re_viewer_bg.wasm", Range="bytes=0-3")
    assert wasm.body == b"\0asm"
    assert wasm.headers["content-type"] == "application/wasm"


def test_a_rerun_without_viewer_is_told(
    server: RecordingServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rerun_viewer._extracted.cache_clear()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(rerun_viewer, "_program", lambda: tmp_path / "rerun")
    answer = ask(server, f"/{TOKEN}/viewer/")
    rerun_viewer._extracted.cache_clear()
    assert answer.status == 503
    assert b"cannot be started: No such file or directory; install rerun-sdk again" in answer.body
    assert list((tmp_path / "cache" / "pose-inspector").iterdir()) == []


def test_slow_readers_stall_nobody(server: RecordingServer, run_root: Path) -> None:
    (run_root / "recordings" / NAME).write_bytes(bytes(30_000_000))
    port = urlsplit(server.address).port
    stalled = [socket.create_connection(("127.0.0.1", port or 0)) for _ in range(8)]
    for number, connection in enumerate(stalled):
        request = f"GET /{TOKEN}/recordings/{NAME} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()
        connection.sendall(request if number % 2 else request[:20])
    assert ask(server, f"/{TOKEN}/recordings/models.rrd").status == 200
    for connection in stalled:
        connection.close()


def test_start_and_stop(run_root: Path) -> None:
    server = RecordingServer(run_root, TOKEN, set())
    with pytest.raises(RuntimeError, match="call start"):
        server.viewer_url(KEY)
    server.start()
    port = urlsplit(server.address).port or 0
    other = RecordingServer(run_root, TOKEN, set(), port=port)
    with pytest.raises(InputError, match=f"port {port}: Address already in use; choose another"):
        other.start()
    server.stop()
    server.stop()
    other.start()
    other.stop()
    assert not any(thread.name == "recording-server" and thread.is_alive() for thread in threading.enumerate())


def test_tokens_must_fit_into_addresses(run_root: Path) -> None:
    for token in ("", "a/b", "a b", "ä"):
        with pytest.raises(ValueError, match="needs no escaping"):
            RecordingServer(run_root, token, set())


@pytest.fixture
def chromium() -> str:
    """Debian's Chromium; the test is skipped where it is absent."""
    found = shutil.which("chromium")
    if found is None:
        pytest.skip("no chromium: install Debian's package chromium")
    return found


@pytest.fixture
def framing_page() -> Iterator[tuple[str, list[str]]]:
    """Origin of a page that shows the addresses in a list in frames, in place of the inspector."""
    addresses: list[str] = []

    class Page(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            frames = "".join(f'<iframe src="{html.escape(a)}" width=780 height=580></iframe>' for a in addresses)
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(frames.encode())

        def log_message(self, format: str, *args: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Page) as page_server:
        threading.Thread(target=page_server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{page_server.server_port}", addresses
        page_server.shutdown()


@pytest.mark.browser
@pytest.mark.parametrize("allowed", [True, False])
def test_real_chromium_shows_the_recording_in_a_frame_of_the_inspector_only(
    run_root: Path, chromium: str, framing_page: tuple[str, list[str]], allowed: bool
) -> None:
    from playwright.sync_api import sync_playwright

    origin, frames = framing_page
    server = RecordingServer(run_root, TOKEN, {origin} if allowed else {INSPECTOR})
    server.start()
    frames.append(server.viewer_url(KEY))
    loaded: set[str] = set()
    lines: list[str] = []
    awaited = f"{NAME} has finished" if allowed else "frame-ancestors"
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=flags)
        page = browser.new_page(viewport={"width": 800, "height": 600})
        page.on("response", lambda response: loaded.add(f"{response.status} {Path(urlsplit(response.url).path).name}"))
        page.on("console", lambda message: lines.append(message.text))
        with page.expect_console_message(lambda message: awaited in message.text, timeout=90_000):
            page.goto(f"{origin}/")
        browser.close()
    server.stop()
    assert not [line for line in lines if "panicked" in line or "crashed" in line]
    fetched = {f"200 {name}" for name in ("re_viewer_bg.wasm", "layout.rbl", "models.rrd", NAME)}
    assert fetched <= loaded if allowed else not fetched & loaded
