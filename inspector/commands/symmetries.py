"""`inspector symmetries`: find the symmetries of object models, accept or refuse them in the browser, write them."""

import signal
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional

from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from pipeline.bop.models_info.model_set import ModelSet


@dataclass(frozen=True)
class SymmetriesConfig:
    """Find the global symmetries of object models; accept or refuse them in the browser; write models_info.json."""

    models: Positional[Path]
    """Folder of models (obj_000001.ply ..., models_info.json), or a single mesh (in millimetres)."""
    epsilon_mm: float | None = None
    """Suggest candidates up to this Hausdorff distance; by default up to 3.75 % of the diameter, and up to 1 % where
    one symmetry fits exactly. Candidates as such go up to max(15 mm, 10 % of the diameter), as in BOP."""
    objects: tuple[int, ...] = ()
    """Ids of the objects to look at; by default all."""
    json: Path | None = None
    """File to write all candidates to, without a browser."""
    write: bool = False
    """Accept what is suggested and write models_info.json, without a browser."""
    force: bool = False
    """With --write: replace symmetries that the file already lists and that are others than those suggested."""
    host: str = "127.0.0.1"
    """Address to listen on; anything but this machine needs a token, which is made and printed."""
    port: int = 8080
    """Port to listen on; 0 takes a free one."""
    browser: bool = True
    """Open the page in a browser."""


def run(config: SymmetriesConfig, console: Console | None = None) -> int:
    """Serve until interrupted, or with --json or --write search all and return; 1 if something was left as it was.

    InputError is left to the caller.
    """
    from pipeline.bop.models_info.model_set import open_models

    console = console or Console()
    if config.epsilon_mm is not None and not 0 < config.epsilon_mm < float("inf"):
        raise InputError(f"--epsilon-mm is {config.epsilon_mm}; give millimetres above 0, such as --epsilon-mm 5")
    if config.force and not config.write:
        raise InputError("--force goes with --write; without --write nothing is replaced unasked")
    models = open_models(config.models, config.objects)
    if config.json is None and not config.write:
        return _serve(config, models, console)
    return _search(config, models, console)


def _search(config: SymmetriesConfig, models: "ModelSet", console: Console) -> int:
    from inspector.symmetries.unattended import search, table, write_report, write_suggested

    if config.write and models.info_path is None:
        raise InputError(
            f"{models.path}: is not named obj_ID.ply, so no entry is its own; rename it, or use --json FILE"
        )
    found = search(models, _metres(config.epsilon_mm), console)
    console.print(table(found))
    if config.json is not None:
        write_report(config.json, models, found)
    kept = write_suggested(models, found, config.force, console) if config.write and found else 0
    return 1 if kept or len(found) < len(models.files) else 0


def _serve(config: SymmetriesConfig, models: "ModelSet", console: Console) -> int:
    from inspector.symmetries.app import SymmetryApp

    app = SymmetryApp(models, _metres(config.epsilon_mm), config.host, config.port)
    # Not by raising SIGINT: that is ignored in what a script has started with &.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        console.print(f"[bold]inspector symmetries[/bold] {escape(app.server.url)}  (Ctrl+C ends it)")
        if app.server.network_url is not None:
            console.print(f"from other machines: {escape(app.server.network_url)}")
        if config.browser:
            webbrowser.open(app.server.url)
        app.start()
        app.wait()
    except KeyboardInterrupt:
        unsaved = len(app.review.unsaved)
        lost = f"; what was decided about {unsaved} object{'' if unsaved == 1 else 's'} is not saved" if unsaved else ""
        console.print(f"ended{lost}")
    finally:
        app.stop()
    return 0


def _metres(millimetres: float | None) -> float | None:
    return None if millimetres is None else millimetres / 1000.0
