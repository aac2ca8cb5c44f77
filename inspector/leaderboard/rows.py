"""The table of the leaderboard, as the page draws it."""

from collections.abc import Iterable, Mapping
from typing import Any

from inspector.evaluations import Job
from inspector.leaderboard.service import LeaderboardService
from inspector.workspace import Workspace
from pipeline.bop.evaluation.scores import Scores
from pipeline.bop.facts import dataset_facts
from pipeline.bop.leaderboard.records import Submission
from pipeline.bop.leaderboard.table import AR_CORE, Board, Cell, Column, Row

NAMES = ("average", "vsd", "mssd", "mspd")


def table(service: LeaderboardService, workspace: Workspace) -> dict[str, Any]:
    """Rows and columns for a browser that looks at a workspace. Raises InputError if the store cannot be read."""
    board = service.store.board()
    here = Column(workspace.dataset.name.lower(), workspace.dataset.split)
    columns = board.columns if here in board.columns else (*board.columns, here)
    core = any(row.average.is_core for row in board.rows)
    return {
        "here": key_of(here),
        "datasets": [_column(column, board) for column in columns],
        "rows": [_row(row, service, columns) for row in board.rows],
        "average_name": AR_CORE if core else "mean",
        "average_title": "AR_Core where all seven core datasets are complete, else the mean over the datasets there are",
    }


def key_of(column: Column) -> str:
    """Name of a column on the page and in its address."""
    return f"{column.dataset_name}/{column.split}"


def _column(column: Column, board: Board) -> dict[str, Any]:
    counts = {cell.targets for row in board.rows if (cell := row.cells.get(column)) is not None}
    remark = f"{min(counts):,} instances" if len(counts) == 1 else "different data" if counts else ""
    title = dataset_facts(column.dataset_name).title
    return {"key": key_of(column), "name": column.title, "title": f"{title}, {column.split}", "remark": remark}


def _row(row: Row, service: LeaderboardService, columns: Iterable[Column]) -> dict[str, Any]:
    newest = row.submissions[0]
    cells = {key_of(column): _cell(row, column, service) for column in columns}
    reason = f": {row.average.reason}" if row.average.reason else ""
    return {
        "submission": newest.id,
        "name": row.method,
        "description": newest.description,
        "properties": newest.properties,
        "average": _means(row),
        "average_note": f"{row.average.name}{reason}",
        "seconds": row.seconds_per_image.value,
        "cells": {key: cell for key, cell in cells.items() if cell is not None},
    }


def _means(row: Row) -> dict[str, float | None]:
    """The mean of each score over the datasets of a method; None where one lacks it."""
    means: dict[str, float | None] = {"average": row.average.value}
    for name in NAMES[1:]:
        values = [getattr(cell.scores, name) for cell in row.cells.values()]
        means[name] = sum(values) / len(values) if values and None not in values else None
    return means


def _cell(row: Row, column: Column, service: LeaderboardService) -> dict[str, Any] | None:
    cell = row.cells.get(column)
    newest = next((s for s in row.submissions if (s.dataset_name, s.split) == column), None)
    if newest is None:
        return None
    waiting = newest if cell is None or cell.newer_submission_id is not None else None
    job = service.job((waiting or newest).id)
    if cell is None or (job is not None and job.is_open):
        return _pending(waiting or newest, job)
    return _evaluated(cell)


def _pending(submission: Submission, job: Job | None) -> dict[str, Any]:
    failure = job.reason if job is not None and job.state == "failed" else ""
    shown = {"id": job.id, "state": job.state, "share": job.progress, "left": job.seconds_left} if job else None
    is_open = job is not None and job.is_open
    return {"submission": submission.id, "scores": None, "job": shown if is_open else None, "failure": failure}


def _evaluated(cell: Cell) -> dict[str, Any]:
    remark = f"of the benchmark's {cell.benchmark_targets:,}" if cell.is_subset else ""
    return {
        "submission": cell.submission_id,
        "scores": named(cell.scores),
        "why_no_vsd": cell.why_no_vsd,
        "targets": cell.targets,
        "remark": remark,
        "job": None,
        "failure": "",
    }


def named(scores: Scores) -> Mapping[str, float | None]:
    """The scores by their names on the page."""
    return {"average": scores.average, **scores._asdict()}
