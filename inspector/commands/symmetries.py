"""`inspector symmetries`: which symmetries the models of objects have, looked at and written to models_info.json."""

import signal
import threading
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import orjson
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from tyro.conf import Positional

from pipeline.exceptions import InputError, UnknownIdError

if TYPE_CHECKING:
    from pipeline.scene import Model
    from pipeline.symmetry_search.search import SymmetrySearch


@dataclass(frozen=True)
class SymmetriesConfig:
    """Find candidates of global symmetries, accept or refuse them in the browser, and write models_info.json.

    Without a browser: --write takes what is suggested, --json tells all that was found.
    """

    models: Positional[Path]
    """Folder of models (obj_000001.ply, ...), such as models_eval of a dataset; or one model."""
    objects: tuple[int, ...] = ()
    """Ids of the objects to look at; by default all."""
    epsilon_mm: float | None = None
    """Suggest symmetries up to this Hausdorff distance; by default a small share of the diameter that depends on how
    well the best one fits. Candidates are found up to max(15 mm, 0.1 diameters), or up to this if it is larger."""
    write: bool = False
    """Write what is suggested to models_info.json, without a browser."""
    json: Path | None = None
    """File to write all candidates to, without a browser."""
    host: str = "127.0.0.1"
    """Address to listen on; anything but this machine needs a token, which is made and printed."""
    port: int = 8080
    """Port to listen on; 0 takes a free one."""
    browser: bool = True
    """Open the page in a browser."""


def run(config: SymmetriesConfig, console: Console | None = None) -> int:
    """Search, and serve, write or print; returns the exit code. InputError is left to the caller."""
    from pipeline.bop.symmetry_files import model_paths, read_models

    console = console or Console()
    if config.epsilon_mm is not None and not 0 < config.epsilon_mm < 1e6:
        raise InputError(f"--epsilon-mm is {config.epsilon_mm:g}; give a length above 0, such as 1.5")
    paths = model_paths(config.models)
    for obj_id in config.objects:
        if obj_id not in paths:
            raise UnknownIdError("object", obj_id, str(config.models), paths.keys())
    chosen = {obj_id: path for obj_id, path in paths.items() if not config.objects or obj_id in config.objects}
    models = read_models(chosen)
    if config.write or config.json:
        return _search(config, models, console)
    return _serve(config, models, console)


def _find(config: SymmetriesConfig, model: "Model") -> "SymmetrySearch":
    from pipeline.symmetry_search.search import find_symmetries

    return find_symmetries(model, None if config.epsilon_mm is None else config.epsilon_mm / 1000)


def _search(config: SymmetriesConfig, models: "dict[int, Model]", console: Console) -> int:
    from pipeline.bop.symmetry_files import write_symmetries

    found: dict[int, SymmetrySearch] = {}
    failures = 0
    with _progress(console, len(models)) as progress:
        for obj_id, model in models.items():
            try:
                found[obj_id] = _find(config, model)
            except InputError as error:
                failures += 1
                console.print(f"[yellow]left out:[/yellow] {escape(str(error))}", soft_wrap=True)
            progress()
    console.print(_table(found, models))
    if config.json:
        _write_json(config.json, found, models)
    if config.write:
        folder = config.models if config.models.is_dir() else config.models.parent
        groups = {obj_id: search.group for obj_id, search in found.items()}
        backup = write_symmetries(folder, groups, models)
        kept = f"; the earlier file is {backup.name}" if backup else ""
        console.print(f"wrote the suggested symmetries of {len(groups)} objects to models_info.json{kept}")
    return 1 if failures else 0


def _serve(config: SymmetriesConfig, models: "dict[int, Model]", console: Console) -> int:
    from inspector.symmetries.app import SymmetryApp, search_all
    from inspector.symmetries.review import Review

    review = Review(config.models if config.models.is_dir() else config.models.parent, models)
    app = SymmetryApp(review, config.host, config.port)
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        console.print(f"[bold]inspector[/bold] {escape(app.server.url)}  (Ctrl+C ends it)")
        if app.server.network_url is not None:
            console.print(f"from other machines: {escape(app.server.network_url)}")
        if config.browser:
            webbrowser.open(app.server.url)
        arguments = (review, lambda model: _find(config, model))
        threading.Thread(target=search_all, args=arguments, name="symmetries", daemon=True).start()
        app.wait()
    except KeyboardInterrupt:
        console.print("ended; decisions that were not saved are lost" if review.unsaved else "ended")
    finally:
        app.stop()
    return 0


def _table(found: "dict[int, SymmetrySearch]", models: "dict[int, Model]") -> Table:
    table = Table(title="candidates of symmetries")
    for name in ("object", "suggested", "symmetry", "axis", "mm", "of ⌀", "seconds"):
        table.add_column(name, justify="left" if name in ("suggested", "symmetry", "axis") else "right", no_wrap=True)
    for obj_id, search in found.items():
        table.add_row(str(obj_id), search.group.name, "", "", "", "", f"{search.seconds:.1f}", style="bold")
        for position, candidate in enumerate(search.candidates):
            axis = " ".join(f"{value:+.3f}" for value in candidate.axis.direction)
            table.add_row(
                "",
                "yes" if position in search.suggested else "",
                str(candidate),
                "" if candidate.kind == "sphere" else axis,
                f"{candidate.distance * 1000:.2f}",
                f"{candidate.distance / models[obj_id].diameter:.1%}",
                "",
            )
        table.add_section()
    return table


def _write_json(path: Path, found: "dict[int, SymmetrySearch]", models: "dict[int, Model]") -> None:
    from pipeline.bop.json_files import write_atomically
    from pipeline.bop.symmetry_files import symmetry_entry

    content: dict[str, Any] = {}
    for obj_id, search in found.items():
        candidates = [
            {
                "kind": candidate.kind,
                "fold": candidate.fold,
                "axis": candidate.axis.direction.tolist(),
                "offset_mm": (candidate.axis.through * 1000).tolist(),
                "distance_mm": candidate.distance * 1000,
                "distance_share_of_diameter": candidate.distance / models[obj_id].diameter,
                "suggested": position in search.suggested,
            }
            for position, candidate in enumerate(search.candidates)
        ]
        content[str(obj_id)] = {
            "suggested": search.group.name,
            **symmetry_entry(search.group),
            "epsilon_mm": search.epsilon * 1000,
            "bound_mm": search.bound * 1000,
            "seconds": search.seconds,
            "candidates": candidates,
        }
    write_atomically(path, orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))


@contextmanager
def _progress(console: Console, count: int) -> Iterator[Callable[[], None]]:
    columns = (TextColumn("searching"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=count)
        yield lambda: bars.advance(task)
