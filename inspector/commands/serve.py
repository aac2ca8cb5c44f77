"""`inspector serve`: open a dataset and methods' results in the browser."""

import signal
import threading
import time
import webbrowser
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional, UseAppendAction

from pipeline.exceptions import MissingFileError

DEMO = Path(__file__).resolve().parent.parent.parent / "assets" / "demo"


@dataclass(frozen=True)
class ServeConfig:
    """Open a BOP dataset and methods' results in the browser; without arguments, the demo."""

    dataset: Positional[Path | None] = None
    """Folder of a BOP dataset, or of a run."""
    results: UseAppendAction[tuple[Path, ...]] = ()
    """BOP results file (CSV); repeat to compare methods."""
    split: str | None = None
    """Folder of the split, such as test_primesense; by default the official test split."""
    leaderboard: Path | None = None
    """Folder that keeps the leaderboard; by default one of your own."""
    host: str = "127.0.0.1"
    """Address to listen on; anything but this machine needs a token, which is made and printed."""
    port: int = 8080
    """Port to listen on; 0 takes a free one."""
    browser: bool = True
    """Open the page in a browser."""


def run(config: ServeConfig, console: Console | None = None) -> int:
    """Serve until interrupted and return the exit code; InputError is left to the caller."""
    console = console or Console()
    begun = time.perf_counter()
    from inspector.app import App
    from inspector.opening import open_workspace

    dataset, results = config.dataset, config.results
    if dataset is None:
        dataset, results = _demo(results)
    workspace = open_workspace(dataset, results, config.split)
    app = App(workspace, config.host, config.port, config.leaderboard)
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        seconds = time.perf_counter() - begun
        console.print(f"[bold]inspector[/bold] {escape(app.server.url)}  (ready after {seconds:.1f} s; Ctrl+C ends it)")
        if app.server.network_url is not None:
            console.print(f"from other machines: {escape(app.server.network_url)}")
        if config.browser:
            webbrowser.open(app.server.url)
        threading.Thread(target=_load_ray_caster, name="warm-up", daemon=True).start()
        app.wait()
    except KeyboardInterrupt:
        console.print("ended")
    finally:
        app.stop()
    return 0


def _load_ray_caster() -> None:
    """Import what the first picture needs, now that the address is out and while the browser loads the page."""
    import open3d  # noqa: F401


def _demo(results: tuple[Path, ...]) -> tuple[Path, tuple[Path, ...]]:
    if not DEMO.is_dir():
        raise MissingFileError(f"{DEMO}: the demo is not installed here; name a dataset: inspector serve DATASET")
    return DEMO, results or tuple(sorted((DEMO / "results").glob("*.csv")))
