"""What the check of a submission says."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool

from pipeline.bop.results_csv import Scan

Severity = Literal["error", "warning"]
Task = Literal["localization", "siso", "detection"]
"""6D localization (BOP since 2019), its variant of one instance of one object (BOP 2017), 6D detection (BOP 2024)."""


@dataclass(frozen=True)
class Finding:
    """One kind of fault in a results file."""

    severity: Severity
    """error: BOP would refuse the file, or it cannot be evaluated; warning: it is evaluated, but looks wrong."""
    kind: str
    """Short fixed name, such as `other dataset`; a check has at most one finding of a kind."""
    message: str
    """What is wrong, with column and value."""
    fix: str
    line: int | None = None
    """Line of the file, from 1, that has it first; None where it is about the whole file."""
    column: str = ""
    value: str = ""
    """As far as it is one value."""
    count: int = 1
    """How many have it."""
    of: Literal["row", "image", "target"] = "row"
    """What is counted."""

    @property
    def text(self) -> str:
        """One line for people."""
        where = f"line {self.line}, " if self.line else ""
        more = self.count - 1
        others = f" ({more:,} more {self.of}{'s' if more > 1 else ''})" if more and self.line else ""
        return f"{where}{self.message}{others}; {self.fix}"

    def as_dict(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Given:
    """The rows of a file that could be read, for checks to look at."""

    scan: Scan

    def __len__(self) -> int:
        return len(self.scan.columns["score"])

    def __getitem__(self, column: str) -> np.ndarray:
        """Give a column by BOP's name: ids, score and time (n,), R (n, 9), t (n, 3) in millimetres."""
        return self.scan.columns[column]

    def place(self, row: int) -> str:
        """Scene and image of a row, for people."""
        return f"scene {self['scene_id'][row]}, image {self['im_id'][row]}"

    def warn(
        self, kind: str, rows: Bool[np.ndarray, " n"], message: Callable[[int], str], fix: str, column: str = ""
    ) -> Iterator[Finding]:
        """Give the warning that some rows deserve, if any does; `message` is given the first of them."""
        if not rows.any():
            return
        first = int(np.argmax(rows))
        value = "" if column in ("", "R", "t") else str(self[column][first])
        line, count = self.scan.lines.of(first), int(rows.sum())
        yield Finding("warning", kind, message(first), fix, line, column, value, count)
