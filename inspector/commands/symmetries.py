"""`inspector symmetries`: find the symmetries of object models, accept or refuse them in the browser, write them."""

import signal
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import orjson
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from tyro.conf import Positional

from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from pipeline.bop.model_set import ModelFile, ModelSet
    from pipeline.scene import Model
    from pipeline.symmetry_search.groups import SymmetryGroup
    from pipeline.symmetry_search.search import SymmetrySearch


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


@dataclass(frozen=True, eq=False)
class _Found:
    """One object without a browser."""

    file: "ModelFile"
    model: "Model"
    search: "SymmetrySearch"
    info: dict[str, Any]


def run(config: SymmetriesConfig, console: Console | None = None) -> int:
    """Serve until interrupted, or with --json or --write search all and return; 1 if something was left as it was.

    InputError is left to the caller.
    """
    from pipeline.bop.model_set import open_models

    console = console or Console()
    if config.epsilon_mm is not None and not 0 < config.epsilon_mm < float("inf"):
        raise InputError(f"--epsilon-mm is {config.epsilon_mm}; give millimetres above 0, such as --epsilon-mm 5")
    if config.force and not config.write:
        raise InputError("--force goes with --write; without --write nothing is replaced unasked")
    models = open_models(config.models, config.objects)
    if config.json is None and not config.write:
        return _serve(config, models, console)
    return _search(config, models, console)


# ---------------------------------------------------------------------- without a browser
def _search(config: SymmetriesConfig, models: "ModelSet", console: Console) -> int:
    from pipeline.bop.json_files import write_atomically
    from pipeline.bop.symmetry_report import report

    if config.write and models.info_path is None:
        raise InputError(
            f"{models.path}: is not named obj_ID.ply, so no entry is its own; rename it, or use --json FILE"
        )
    infos = models.infos()
    found = _found(config, models, infos, console)
    console.print(_table(found))
    if config.json is not None:
        objects = {one.file.name if one.file.obj_id is None else str(one.file.obj_id): one for one in found}
        content = {name: report(one.search, one.model.diameter, one.info) for name, one in objects.items()}
        data = {"models": str(models.path), "objects": content}
        write_atomically(config.json, orjson.dumps(data, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
    return _write(config, models, found, console) if config.write else 0


def _found(
    config: SymmetriesConfig, models: "ModelSet", infos: dict[int, dict[str, Any]], console: Console
) -> list[_Found]:
    from pipeline.symmetry_search.search import find_symmetries

    epsilon = None if config.epsilon_mm is None else config.epsilon_mm / 1000.0
    found = []
    with _progress(console, len(models.files)) as progress:
        for number, file in enumerate(models.files):
            progress(number, file.name)
            info = infos.get(file.obj_id, {}) if file.obj_id is not None else {}
            model = models.read(file, info)
            search = find_symmetries(
                model, epsilon, progress=lambda share, n=number, f=file: progress(n + share, f.name)
            )
            found.append(_Found(file, model, search, info))
    return found


def _write(config: SymmetriesConfig, models: "ModelSet", found: list[_Found], console: Console) -> int:
    """Write what is suggested; what the file lists already is replaced by something else only if that is asked for."""
    from pipeline.bop.models_info import model_entry, write_symmetries
    from pipeline.bop.symmetry_entries import group_from

    groups: dict[int, SymmetryGroup] = {}
    kept = 0
    for one in found:
        listed, suggested = group_from(one.info), one.search.group
        if suggested.equals(listed, one.search.surface.extent) or one.file.obj_id is None:
            continue
        if len(listed.turns()) and not config.force:
            kept += 1
            note = f"{one.file.name}: models_info.json lists {listed.name}, suggested is {suggested.name}; kept"
            console.print(f"[yellow]note:[/yellow] {escape(note)} (--force replaces it)", soft_wrap=True)
        else:
            groups[one.file.obj_id] = suggested
    assert models.info_path is not None
    facts = {one.file.obj_id: model_entry(one.model) for one in found if one.file.obj_id is not None}
    written = write_symmetries(models.info_path, groups, facts)
    told = f"{len(groups)} objects changed" if written.changed else "nothing to change"
    before = f"; the file before is {written.backup.name}" if written.backup else ""
    console.print(f"{escape(str(written.path))}: {told}{escape(before)}", soft_wrap=True, highlight=False)
    return 1 if kept else 0


def _table(found: list[_Found]) -> Table:
    from pipeline.bop.symmetry_entries import group_from

    table = Table()
    for name in ("object", "diameter", "epsilon", "candidates", "best", "suggested", "in models_info.json", "seconds"):
        numeric = name in ("diameter", "epsilon", "candidates", "best", "seconds")
        table.add_column(name, justify="right" if numeric else "left", overflow="fold")
    for one in found:
        search, listed = one.search, group_from(one.info)
        best = f"{search.candidates[0].distance * 1000:.2f} mm" if search.candidates else "-"
        same = search.group.equals(listed, search.surface.extent)
        table.add_row(
            escape(one.file.name.removeprefix("object ")),
            f"{one.model.diameter * 1000:.1f} mm",
            f"{search.epsilon * 1000:.2f} mm",
            str(len(search.candidates)),
            best,
            search.group.name,
            "the same" if same else f"[yellow]{listed.name}[/]",
            f"{search.seconds:.1f}",
        )
    return table


@contextmanager
def _progress(console: Console, total: int) -> Iterator[Callable[[float, str], None]]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=total)
        yield lambda done, title: bars.update(task, completed=done, description=escape(title))


# ---------------------------------------------------------------------- in the browser
def _serve(config: SymmetriesConfig, models: "ModelSet", console: Console) -> int:
    from inspector.symmetry_app import SymmetryApp

    epsilon = None if config.epsilon_mm is None else config.epsilon_mm / 1000.0
    app = SymmetryApp(models, epsilon, config.host, config.port)
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
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
        console.print(f"ended{f'; {unsaved} objects with unsaved decisions' if unsaved else ''}")
    finally:
        app.stop()
    return 0
