"""`inspector download`: fetch a BOP dataset from the hub, with progress, checksums and resume."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    DownloadColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)
from rich.table import Table
from tyro.conf import Positional

from pipeline.bop.download import default_parts, download_dataset, is_complete
from pipeline.bop.hub import DEFAULT_HUB, Hub, RemoteFile, Step, list_archives


@dataclass(frozen=True)
class DownloadConfig:
    """Fetch a BOP dataset from the hub; an interrupted download continues where it stopped."""

    name: Positional[str]
    """Dataset, such as lmo, tless, ycbv."""
    to: Path = Path()
    """Folder that the dataset's folder is made in."""
    parts: str = ""
    """Comma-separated archives, such as base,models,test_bop19; empty: base, models and the usual test images."""
    list: bool = False
    """Only list the archives and their sizes."""
    overwrite: bool = False
    """Fetch again what is complete, and write over files that differ."""
    endpoint: str = field(default_factory=lambda: os.environ.get("HF_ENDPOINT") or DEFAULT_HUB.endpoint)
    """Address of the hub or of a mirror (default: HF_ENDPOINT, else huggingface.co)."""


def run(config: DownloadConfig, console: Console | None = None) -> int:
    """Download or list and return the exit code; InputError is left to the caller."""
    console = console or Console()
    hub = Hub(endpoint=config.endpoint)
    if config.list:
        console.print(_listing(config, list_archives(config.name, hub)))
        return 0
    parts = [part.strip() for part in config.parts.split(",") if part.strip()]
    try:
        with _progress(console) as progress:
            root = download_dataset(
                config.name, config.to, parts or None, hub=hub, overwrite=config.overwrite, progress=progress
            )
    except KeyboardInterrupt:
        console.print("interrupted; the same command continues where it stopped")
        return 130
    console.print(f"{escape(str(root))} is complete; see it with: inspector serve {escape(str(root))}", soft_wrap=True)
    return 0


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[Step], None]]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        DownloadColumn(),
        TransferSpeedColumn(),
        TimeRemainingColumn(),
    )
    tasks: dict[tuple[str, str], TaskID] = {}
    with Progress(*columns, console=console) as bars:

        def show(step: Step) -> None:
            key = (step.action, step.subject)
            if key not in tasks:
                name = f"{step.action:8} {escape(step.subject)}"
                tasks[key] = bars.add_task(name, total=step.total, completed=step.done)
            bars.update(tasks[key], completed=step.done)

        yield show


def _listing(config: DownloadConfig, archives: dict[str, tuple[RemoteFile, ...]]) -> Table:
    usual = default_parts(config.name, archives)
    table = Table(title=f"{config.name} on the hub")
    table.add_column("part", no_wrap=True)
    table.add_column("size", justify="right", no_wrap=True)
    table.add_column("files", justify="right")
    table.add_column("")
    for part, files in archives.items():
        complete = is_complete(config.to / config.name, part, files)
        state = "complete" if complete else "by default" if part in usual else ""
        table.add_row(escape(part), _gigabytes(sum(file.size for file in files)), str(len(files)), state)
    return table


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.2f} GB" if size >= 1e7 else f"{size / 1e6:.2f} MB"
