"""What the leaderboard keeps: submissions and evaluations, from and to the rows of its database."""

import contextlib
import io
import json
import sqlite3
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pipeline.bop.evaluation.evaluate import Evaluation
from pipeline.bop.evaluation.scores import FoundInstances, Scores
from pipeline.bop.leaderboard.database import DamagedRowError
from pipeline.exceptions import FormatError, InputError


@dataclass(frozen=True)
class Submission:
    """A results file that was handed in, and what its owner says of it."""

    id: int
    """Never used again for another one."""
    method: str
    dataset_name: str
    """Name of the dataset's folder, in lower case."""
    split: str
    """Name of the split's folder, such as `test_primesense`."""
    description: str
    properties: dict[str, str]
    """Whatever the owner wants to tell, in order, such as `{"image type": "RGB", "GPU": "none"}`."""
    sha256: str
    """Of the file's bytes."""
    file_name: str
    """As it was uploaded, without folders."""
    rows: int
    """Number of estimates."""
    time_per_image: float | None
    """Mean seconds over the images with estimates (BOP); None where one estimate reports no time."""
    added: str
    """UTC, ISO 8601."""
    path: Path
    """The kept file."""


class Added(NamedTuple):
    """What became of a file that was handed in."""

    submission: Submission
    is_new: bool
    """False where the same file was there already for this dataset and method: that submission is given, unchanged."""


@dataclass(frozen=True)
class KeptEvaluation:
    """The numbers of an evaluation, without the instances behind them."""

    submission_id: int
    fingerprint: str
    """Of the dataset that it was computed on."""
    task: str
    with_vsd: bool
    """Whether VSD was asked for; where there is no depth, `scores.vsd` is None all the same."""
    scores: Scores
    per_object: dict[int, Scores]
    targets: int
    """Number of instances asked for."""
    why_no_vsd: str
    """Empty where there is VSD."""
    seconds: float
    """Spent on the evaluation."""
    added: str
    """UTC, ISO 8601."""


def now() -> str:
    """The present time as it is kept."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def submission_of(row: sqlite3.Row, path: Path) -> Submission:
    """The submission of a row of the database."""
    columns = {name: row[name] for name in row.keys()}  # noqa: SIM118 (iterating over a row gives its values)
    with _intact():
        return Submission(**columns | {"properties": json.loads(row["properties"]), "path": path})


def summary_of(row: sqlite3.Row) -> KeptEvaluation:
    """The numbers of an evaluation from a row of the database."""
    names = {field.name for field in fields(KeptEvaluation)} - {"scores", "per_object", "with_vsd"}
    with _intact():
        columns = {name: row[name] for name in names}
        per_object = {int(obj_id): Scores(*values) for obj_id, values in json.loads(row["per_object"]).items()}
        scores = Scores(row["vsd"], row["mssd"], row["mspd"])
        return KeptEvaluation(**columns, scores=scores, per_object=per_object, with_vsd=bool(row["with_vsd"]))


def evaluation_of(row: sqlite3.Row) -> Evaluation:
    """The whole evaluation of a row of the database; a field that was not there yet when it was kept has its default.

    Raises FormatError if the instances are damaged.
    """
    with _intact():
        about = json.loads(row["about"]) | {"method": row["method"]}
        known = {field.name for field in fields(Evaluation)} & about.keys()
        values: dict[str, Any] = {name: about[name] for name in known}
        values |= {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
        return Evaluation(**values, instances=unpacked(row["instances"]))


@contextlib.contextmanager
def _intact() -> Iterator[None]:
    try:
        yield
    except (TypeError, ValueError, LookupError, AttributeError) as error:
        raise DamagedRowError("a row is not what was written") from error


def about_as_text(evaluation: Evaluation) -> str:
    """All of an evaluation but its instances, whatever fields there are."""
    values = {field.name: getattr(evaluation, field.name) for field in fields(evaluation)}
    return json.dumps({name: value for name, value in values.items() if name != "instances"})


def packed(instances: FoundInstances) -> bytes:
    """The instances as compressed bytes; `unpacked` gives the very same arrays."""
    arrays: dict[str, Any] = {}
    for field in fields(instances):
        array = getattr(instances, field.name)
        if array is not None and array.dtype == bool:
            arrays[f"{field.name} shape"] = np.array(array.shape)
            array = np.packbits(array)
        if array is not None:
            arrays[field.name] = array
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def unpacked(data: bytes) -> FoundInstances:
    """The instances of `packed` bytes. Raises FormatError if they are damaged."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return FoundInstances(**{field.name: _array(arrays, field.name) for field in fields(FoundInstances)})
    except Exception as error:  # zipfile, zlib and NumPy have many ways to say it
        raise FormatError(
            f"the instances of a kept evaluation are damaged ({type(error).__name__}); evaluate it again"
        ) from error


def _array(arrays: Mapping[str, np.ndarray], name: str) -> Any:
    if f"{name} shape" not in arrays:
        return arrays.get(name)
    shape = arrays[f"{name} shape"]
    return np.unpackbits(arrays[name], count=int(shape.prod())).reshape(shape).astype(bool)


def checked_text(name: str, value: str, *, lines: bool = False, longest: int = 200) -> str:
    """A text of the user without blanks around it. Raises InputError if it is too long or cannot be shown."""
    value = value.strip()
    shown = value if len(value) <= 40 else f"{value[:40]}..."
    if len(value) > longest:
        raise InputError(f"{name} {shown!r}: has {len(value)} characters; at most {longest} are kept")
    if not all(character.isprintable() or (lines and character in "\n\t") for character in value):
        raise InputError(f"{name} {shown!r}: holds a character that cannot be shown; type it again")
    return value


def checked_method(method: str) -> str:
    """The name of a method. Raises InputError if it is none."""
    method = checked_text("method", method)
    if not method:
        raise InputError("method: has no name; give the name that it shall have on the leaderboard")
    return method


def checked_description(description: str) -> str:
    """A description of any number of lines. Raises InputError if it cannot be kept."""
    return checked_text("description", description.replace("\r\n", "\n"), lines=True, longest=10_000)


def checked_properties(properties: Mapping[str, str]) -> str:
    """Properties as they are kept. Raises InputError if one has no name."""
    kept = {checked_text("property", key): checked_text(key, value, longest=1000) for key, value in properties.items()}
    if "" in kept:
        raise InputError(f"property {kept['']!r}: has no name; give it one, such as GPU")
    return json.dumps(kept, ensure_ascii=False)
