"""Real Chromium on the real command: a server and a browser per module, because both take seconds to start."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from opened_page import OpenedPage

if TYPE_CHECKING:
    from playwright.sync_api import Browser

REPOSITORY = Path(__file__).resolve().parent.parent.parent
DEMO = REPOSITORY / "assets" / "demo"
SECONDS_TO_START = 60
SOFTWARE_WEBGL = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents:
            item.add_marker(pytest.mark.browser)
            # Software WebGL on two busy cores now and then draws later than any test waits; reruns are reported.
            item.add_marker(pytest.mark.flaky(reruns=2))


class Server:
    """The command `inspector serve` in a process of its own."""

    def __init__(self, *arguments: str | Path) -> None:
        command = [sys.executable, "-m", "inspector", "serve", *map(str, arguments), "--port", "0", "--no-browser"]
        environment = os.environ | {"PYTHONUNBUFFERED": "1", "COLUMNS": "500"}
        self._process = subprocess.Popen(
            command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
        )
        self.log: list[str] = []
        self.url = ""
        self._started = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if not self._started.wait(SECONDS_TO_START) or not self.url:
            self.stop()
            pytest.fail(f"the server printed no address:\n{''.join(self.log)}")

    def stop(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join(10)

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.log.append(line)
            if not self.url and (found := re.search(r"http://\S+", line)):
                self.url = found[0]
                self._started.set()
        self._started.set()


@pytest.fixture(scope="module")
def serve() -> Iterator[Callable[..., Server]]:
    """Starts `inspector serve ARGUMENTS`; at the end none of the servers may have printed a traceback."""
    servers: list[Server] = []

    def start(*arguments: str | Path) -> Server:
        servers.append(Server(*arguments))
        return servers[-1]

    yield start
    for server in servers:
        server.stop()
    printed = [line for server in servers for line in server.log]
    causes = [line for line in printed if re.match(r"[\w.]+(Error|Exception)\b|.* failed$", line)]
    assert not any("Traceback" in line for line in printed), "".join(dict.fromkeys(causes)) or "".join(printed)


@pytest.fixture(scope="module")
def chromium() -> "Iterator[Browser]":
    if importlib.util.find_spec("playwright") is None:
        pytest.skip("playwright is not installed (pip install playwright)")
    executable = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if executable is None:
        pytest.skip("no Chromium in PATH (apt install chromium)")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(SOFTWARE_WEBGL))
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def open_page(chromium: "Browser") -> Iterator[Callable[..., OpenedPage]]:
    """Opens an address in a browser window of its own, as another person would."""
    opened: list[OpenedPage] = []

    def open_one(url: str, query: str = "", size: tuple[int, int] = (1300, 720)) -> OpenedPage:
        context = chromium.new_context(viewport={"width": size[0], "height": size[1]})
        opened.append(OpenedPage(context.new_page(), url))
        opened[-1].open(query)
        return opened[-1]

    yield open_one
    for one in opened:
        one.close()
    errors = [error for one in opened for error in one.errors]
    assert not errors, errors


@pytest.fixture(scope="module")
def demo() -> Path:
    """The demo that comes with the program."""
    if not list((DEMO / "results").glob("*.csv")):
        pytest.skip(f"the demo is not installed: {DEMO}")
    return DEMO
