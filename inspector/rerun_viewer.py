"""The files of rerun's web viewer, taken out of the installed rerun program.

They are embedded in its binary (43 MB of WebAssembly); only its own web server hands them out. It is started
once on 127.0.0.1, asked for the files, and stopped; they stay in the user's cache folder, by rerun's version.
"""

import os
import shutil
import socket
import subprocess
import tempfile
import threading
import time
import urllib.error
import urllib.request
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from pipeline.exceptions import InputError

VIEWER_FILES = {
    "index.html": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "favicon.ico": "image/x-icon",
}
"""Files of the viewer and their types."""

_TIMEOUT_S = 30.0
_POLL_S = 0.05
_NOTHING = "http://127.0.0.1:9/none.rrd"  # given something to show, the program starts no server for recordings
_lock = threading.Lock()


def viewer_folder() -> Path:
    """The folder with the viewer's files; the first call for a version of rerun takes a second or two.

    Raises:
        InputError: the installed rerun does not serve its viewer.

    """
    with _lock:
        return _extracted(_cache_folder() / f"rerun-web-viewer-{version('rerun-sdk')}")


@cache
def _extracted(folder: Path) -> Path:
    if all((folder / name).is_file() for name in VIEWER_FILES):
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
        made = Path(temporary) / "viewer"
        made.mkdir()
        _extract(made)
        shutil.rmtree(folder, ignore_errors=True)
        made.rename(folder)
    return folder


def _cache_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pose-inspector"


def _extract(folder: Path) -> None:
    port = _free_port()
    process = _start_rerun(port, home=folder.parent)
    try:
        for name in VIEWER_FILES:
            (folder / name).write_bytes(
                _fetch(f"http://127.0.0.1:{port}/{'' if name == 'index.html' else name}", process)
            )
    finally:
        process.kill()
        process.wait()


def _start_rerun(port: int, home: Path) -> "subprocess.Popen[bytes]":
    program = _program()
    arguments = ["--serve-web", "--bind", "127.0.0.1", "--port", "auto", "--web-viewer-port", str(port), _NOTHING]
    # A home of its own: rerun reports usage to its makers from the second start in a home folder on.
    environment = {"PATH": os.environ.get("PATH", ""), "HOME": str(home)}
    quiet = subprocess.DEVNULL
    try:
        return subprocess.Popen([program, *arguments], env=environment, stdin=quiet, stdout=quiet, stderr=quiet)
    except OSError as error:
        raise InputError(f"{program}: cannot be started: {error.strerror}; install rerun-sdk again") from error


def _program() -> Path:
    """Rerun's program, as its package installs it."""
    package = find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise InputError("rerun's program is not installed; install rerun-sdk again")
    return Path(package.origin).parent / "rerun"


def _fetch(url: str, process: "subprocess.Popen[bytes]") -> bytes:
    """Get a file, waiting until the server is up."""
    deadline = time.monotonic() + _TIMEOUT_S
    while True:
        try:
            with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(url, timeout=_TIMEOUT_S) as response:
                return response.read()
        except urllib.error.HTTPError as error:
            raise InputError(f"rerun {version('rerun-sdk')}: its viewer lacks {url} ({error.code})") from error
        except OSError as error:
            if process.poll() is not None or time.monotonic() > deadline:
                raise InputError(f"rerun {version('rerun-sdk')}: its web viewer does not start") from error
            time.sleep(_POLL_S)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
