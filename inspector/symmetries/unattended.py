"""Symmetries without a browser: search all models, print and write what was found."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import orjson
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from inspector.symmetries.saving import overruled
from inspector.symmetries.texts import axis_text
from pipeline.bop.json_files import write_atomically
from pipeline.bop.models_info.model_set import ModelFile, ModelSet
from pipeline.bop.models_info.report import report
from pipeline.bop.models_info.symmetries import group_from
from pipeline.bop.models_info.writing import model_entry, write_symmetries
from pipeline.exceptions import FormatError, InputError
from pipeline.scene import Model
from pipeline.symmetry_search.groups import SymmetryGroup
from pipeline.symmetry_search.search import SymmetrySearch, find_symmetries


@dataclass(frozen=True, eq=False)
class Found:
    """One object that was searched."""

    file: ModelFile
    model: Model
    search: SymmetrySearch
    info: dict[str, Any]
    listed: SymmetryGroup

    @property
    def as_listed(self) -> bool:
        """Whether `models_info.json` lists what is suggested."""
        return self.search.group.equals(self.listed, self.search.surface.extent)


def search(models: ModelSet, epsilon: float | None, console: Console) -> list[Found]:
    """Search all; a model that cannot be searched is told and left out. `epsilon` in metres, None for the default."""
    infos = models.infos()
    found = []
    with _progress(console, len(models.files)) as progress:
        for number, file in enumerate(models.files):
            tell = partial(_tell, progress, number, file.name)
            tell(0.0)
            info = infos.get(file.obj_id, {}) if file.obj_id is not None else {}
            try:
                found.append(_find(models, file, info, epsilon, tell))
            except InputError as error:
                console.print(f"[yellow]left out:[/yellow] {escape(str(error))}", soft_wrap=True)
    return found


def _find(
    models: ModelSet, file: ModelFile, info: dict[str, Any], epsilon: float | None, tell: Callable[[float], None]
) -> Found:
    try:
        listed = group_from(info)
    except FormatError as error:
        raise FormatError(f"{models.info_path}: {file.name}: {error}") from error
    model = models.read(file, info)
    return Found(file, model, find_symmetries(model, epsilon, progress=tell), info, listed)


def write_report(path: Path, models: ModelSet, found: Sequence[Found]) -> None:
    """Write all candidates as JSON."""
    objects = {one.file.name if one.file.obj_id is None else str(one.file.obj_id): one for one in found}
    content = {name: report(one.search, one.model.diameter, one.info) for name, one in objects.items()}
    data = {"models": str(models.path), "objects": content}
    write_atomically(path, orjson.dumps(data, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))


def write_suggested(models: ModelSet, found: Sequence[Found], force: bool, console: Console) -> int:
    """Write what is suggested; returns of how many objects the file lists something else, which is kept unasked."""
    groups: dict[int, SymmetryGroup] = {}
    kept = 0
    for one in found:
        if one.as_listed or one.file.obj_id is None:
            continue
        if len(one.listed.turns()) and not force:
            kept += 1
            note = (
                f"{one.file.name}: models_info.json lists {one.listed.name}, suggested is {one.search.group.name}; kept"
            )
            console.print(f"[yellow]note:[/yellow] {escape(note)} (--force replaces it)", soft_wrap=True)
        else:
            groups[one.file.obj_id] = one.search.group
    assert models.info_path is not None
    facts = {one.file.obj_id: model_entry(one.model) for one in found if one.file.obj_id is not None}
    written = write_symmetries(models.info_path, groups, facts)
    told = f"{len(groups)} object{'' if len(groups) == 1 else 's'} changed" if written.changed else "nothing to change"
    before = f"; the file before is {written.backup.name}" if written.backup else ""
    console.print(
        f"{escape(str(written.path))}: {told}{escape(before + overruled(models))}", soft_wrap=True, highlight=False
    )
    return kept


def table(found: Sequence[Found]) -> Table:
    """A line for every object, and below it one for every candidate, the suggested ones marked."""
    lines = Table()
    for name in ("object", "⌀ mm", "ε mm"):
        lines.add_column(name, justify="right", no_wrap=True)
    lines.add_column("suggested", overflow="fold")
    for name in ("mm", "of ⌀"):
        lines.add_column(name, justify="right", no_wrap=True)
    lines.add_column("in the file", overflow="fold")
    lines.add_column("s", justify="right", no_wrap=True)
    for one in found:
        found_here, diameter = one.search, one.model.diameter
        lines.add_row(
            escape(one.file.name.removeprefix("object ")),
            f"{diameter * 1000:.1f}",
            f"{found_here.epsilon * 1000:.2f}",
            f"[bold]{found_here.group.name}[/]",
            "",
            "",
            "the same" if one.as_listed else f"[yellow]{one.listed.name}[/]",
            f"{found_here.seconds:.1f}",
        )
        for index, candidate in enumerate(found_here.candidates):
            mark = "✓" if index in found_here.suggested else " "
            cells = (f"{candidate.distance * 1000:.2f}", f"{candidate.distance / diameter:.1%}")
            lines.add_row("", "", "", f"{mark} {candidate} about {axis_text(candidate)}", *cells, style="dim")
        lines.add_section()
    return lines


def _tell(progress: Callable[[float, str], None], number: int, name: str, share: float) -> None:
    progress(number + share, name)


@contextmanager
def _progress(console: Console, total: int) -> Iterator[Callable[[float, str], None]]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=total)
        yield lambda done, title: bars.update(task, completed=done, description=escape(title))
