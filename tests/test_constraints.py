"""constraints.txt pins every package that an installation takes, so that tomorrow's is the same as today's."""

import tomllib
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

REPOSITORY = Path(__file__).resolve().parent.parent


def pinned() -> dict[str, str]:
    """Version of each package in constraints.txt."""
    lines = (REPOSITORY / "constraints.txt").read_text("utf-8").splitlines()
    pins = [Requirement(line) for line in lines if not line.startswith("#")]
    assert all(str(pin.specifier).startswith("==") for pin in pins)
    return {canonicalize_name(pin.name): str(pin.specifier).removeprefix("==") for pin in pins}


def needed() -> dict[str, str]:
    """Each package that pyproject.toml asks for, with any extra, directly or through another; and what needs it."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))["project"]
    groups = [project["dependencies"], *project["optional-dependencies"].values()]
    waiting = [(Requirement(line), "pyproject.toml") for group in groups for line in group]
    found: dict[str, str] = {}
    seen = set()
    while waiting:
        requirement, needed_by = waiting.pop()
        name = canonicalize_name(requirement.name)
        found.setdefault(name, needed_by)
        for extra in ["", *requirement.extras]:
            if (name, extra) not in seen:
                seen.add((name, extra))
                waiting += [(child, name) for child in children(name, extra)]
    return found


def children(name: str, extra: str) -> list[Requirement]:
    """What an installed package needs here; nothing for one that is not installed."""
    try:
        lines = requires(name) or []
    except PackageNotFoundError:
        return []
    parsed = [Requirement(line) for line in lines]
    return [child for child in parsed if child.marker is None or child.marker.evaluate({"extra": extra})]


def test_every_needed_package_is_pinned():
    pins = pinned()
    loose = [f"{name}, needed by {by}" for name, by in needed().items() if name not in pins]
    assert not loose, f"add to constraints.txt: {'; '.join(loose)}"


def test_every_pin_is_needed():
    absent = [name for name in ("mitsuba", "mujoco", "distributed") if not installed(name)]
    if absent:
        pytest.skip(f"not all extras are installed: {', '.join(absent)}")
    assert sorted(pinned().keys() - needed().keys()) == []


def installed(name: str) -> bool:
    try:
        requires(name)
    except PackageNotFoundError:
        return False
    return True
