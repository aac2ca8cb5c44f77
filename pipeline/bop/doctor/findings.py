"""What the doctor says: findings, worst first."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

Severity = Literal["error", "warning", "note", "ok"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note", "ok")


@dataclass(frozen=True)
class Finding:
    """One thing that was found, with its evidence and its fix."""

    severity: Severity
    """error: results on this data will be wrong; warning: some may be; note: worth knowing; ok: looked at and sound."""
    title: str
    """What is the matter, in a few words."""
    subject: str
    """The file, object or image that it is about."""
    evidence: str
    """One sentence with the numbers."""
    fix: str = ""
    """One sentence: the edit or command that mends it; empty for ok."""
    check: str = ""
    """Id of the check that found it."""

    def as_dict(self) -> dict[str, Any]:
        """As plain values, for JSON and for panels."""
        return asdict(self)


def ok(title: str, evidence: str, subject: str = "") -> Finding:
    """Make the finding of a check that saw nothing wrong."""
    return Finding("ok", title, subject, evidence)


def worst_first(findings: Sequence[Finding]) -> list[Finding]:
    """Findings by severity, otherwise in their order."""
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def counts(findings: Sequence[Finding]) -> dict[Severity, int]:
    """Number of findings of each severity."""
    return {severity: sum(finding.severity == severity for finding in findings) for severity in SEVERITIES}


def some(values: Sequence[object], limit: int = 4) -> str:
    """The first few values as text, and how many more there are."""
    rest = f" and {len(values) - limit} more" if len(values) > limit else ""
    return ", ".join(map(str, values[:limit])) + rest


def count_of(number: int, noun: str) -> str:
    """Number and noun in the right form, such as "1 image" and "2 images"."""
    plural = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{number} {noun if number == 1 else plural}"


def scenes_named(scene_ids: Sequence[int]) -> str:
    """Scenes as the subject of a finding."""
    return f"scene{'' if len(scene_ids) == 1 else 's'} {some(scene_ids)}"
