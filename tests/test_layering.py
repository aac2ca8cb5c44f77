"""Imports point one way, and what is slow to import is imported where it is used."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
PACKAGES = ("pipeline", "annotate", "inspector")

NOT_ALLOWED = [("pipeline", "annotate"), ("pipeline", "inspector"), ("annotate", "inspector")]
"""Importing package, imported package."""

HOMES = {
    "rerun": ("pipeline/recording/",),
    "rerun_bindings": ("pipeline/recording/",),
    "viser": ("inspector/", "annotate/controls.py"),
}
"""The only places that may import these at all."""

OWNERS = {
    "distributed": (),
    "mitsuba": ("pipeline/synth/",),
    "mujoco": ("pipeline/synth/",),
    "open3d": (),
    "plotly": (),
    "pyrender": (),
    "rerun": HOMES["rerun"],
    "torch": ("pipeline/epos/",),
}
"""Where these, of which each takes 0.3 to 3 s to import, may be imported at the head of a module."""

ENTRANCES = [
    "annotate",
    "annotate.depth",
    "annotate.quality",
    "inspector.__main__",
    "inspector.app",
    "inspector.commands.calibrate",
    "inspector.commands.depth_correct",
    "inspector.commands.doctor",
    "inspector.commands.evaluate",
    "inspector.commands.gt_info",
    "inspector.commands.gt_quality",
    "inspector.commands.run",
    "inspector.commands.serve",
    "inspector.commands.trace",
    "inspector.commands.train",
    "pipeline.bop.assessment",
    "pipeline.bop.dataset",
    "pipeline.bop.errors",
    "pipeline.epos.config",
    "pipeline.epos.training.config",
    "pipeline.run",
]
"""Modules that must load none of `OWNERS`."""


class Import(NamedTuple):
    """An import of `module` at a line of a file (path in the repository)."""

    file: str
    line: int
    module: str
    at_head: bool
    """Executed when the file itself is imported."""

    def is_of(self, package: str) -> bool:
        """Tell whether the package or something in it is imported."""
        return self.module == package or self.module.startswith(f"{package}.")

    def is_in(self, places: tuple[str, ...]) -> bool:
        """Tell whether the file is one of the places or in one of them."""
        return self.file.startswith(places)

    def __str__(self) -> str:
        """Return what a failed test shows."""
        return f"{self.file}:{self.line} imports {self.module}"


def imports_of(file: str, source: str) -> Iterator[Import]:
    """All imports in a file; relative ones become absolute."""
    package = file.split("/")[:-1]

    def visit(node: ast.AST, at_head: bool) -> Iterator[Import]:
        match node:
            case ast.Import(names=names):
                yield from (Import(file, node.lineno, alias.name, at_head) for alias in names)
            case ast.ImportFrom(module=module, names=names, level=level):
                base = [*package[: len(package) + 1 - level], *([module] if module else [])] if level else [module]
                # What follows `from package import` may be a module too.
                yield from (Import(file, node.lineno, ".".join([*base, alias.name]), at_head) for alias in names)
            case ast.If(test=test, body=body, orelse=others) if ast.unparse(test).endswith("TYPE_CHECKING"):
                for child in body:
                    yield from visit(child, False)
                for child in others:
                    yield from visit(child, at_head)
            case _:
                inside = at_head and not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
                for child in ast.iter_child_nodes(node):
                    yield from visit(child, inside)

    yield from visit(ast.parse(source), True)


@pytest.fixture(scope="module")
def imports() -> list[Import]:
    """All imports in the three packages."""
    files = [path for package in PACKAGES for path in sorted((REPOSITORY / package).rglob("*.py"))]
    names = [path.relative_to(REPOSITORY).as_posix() for path in files]
    return [
        found for name, path in zip(names, files, strict=True) for found in imports_of(name, path.read_text("utf-8"))
    ]


def test_packages_point_one_way(imports):
    wrong = [str(i) for i in imports for importer, of in NOT_ALLOWED if i.is_in((f"{importer}/",)) and i.is_of(of)]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("library", HOMES)
def test_library_is_imported_only_at_home(imports, library):
    wrong = [str(i) for i in imports if i.is_of(library) and not i.is_in(HOMES[library])]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("library", OWNERS)
def test_heavy_library_is_imported_where_it_is_used(imports, library):
    wrong = [str(i) for i in imports if i.at_head and i.is_of(library) and not i.is_in(OWNERS[library])]
    assert not wrong, "\n".join([*wrong, "move the import into the function that needs it"])


@pytest.mark.parametrize("module", ENTRANCES)
def test_entrance_loads_nothing_heavy(module):
    # What other libraries import in turn shows only when the module is really imported, in a process of its own.
    code = f"import sys, {module}; print(*sorted(sys.modules.keys() & {set(OWNERS)!r}))"
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


def test_all_ways_to_import_are_seen():
    source = """
import a.b, c as d
from e import f
from . import g
from .h import i
from .. import j
if TYPE_CHECKING:
    import o
class K:
    import k
def l():
    import m
try:
    import n
except ImportError:
    pass
"""
    found = list(imports_of("top/sub/file.py", source))
    at_head = ["a.b", "c", "e.f", "top.sub.g", "top.sub.h.i", "top.j", "k", "n"]
    assert [i.module for i in found if i.at_head] == at_head
    assert [str(i) for i in found if not i.at_head] == ["top/sub/file.py:8 imports o", "top/sub/file.py:12 imports m"]
