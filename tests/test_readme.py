"""What README.md says is true: its Python runs, its commands and their options exist, its links lead somewhere.

Blocks marked `python` are run, all as one program, in a folder that looks like the repository. Blocks marked `sh`,
`bash`, `shell` or `console` (there, what follows a `$`) are taken for commands, which are looked up, not run.
"""

import functools
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
README = (REPOSITORY / "README.md").read_text("utf-8")
FENCED = re.compile(r"^ *(```+)([^\n]*)\n(.*?)^ *\1", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"""\]\(([^)\s]+)[^)]*\)|(?:src|href)="([^"]+)\"""")
SHELL_LANGUAGES = ("sh", "bash", "shell", "console")
ELSEWHERE = ("cd", "export", "source", "apt", "apt-get", "git", "pip")
"""Commands that may be missing where the tests run, or are part of the shell."""


class Block(NamedTuple):
    """A fenced block of code."""

    language: str
    first_line: int
    """Line of README.md that the code begins at, from 1."""
    code: str


def blocks_of(markdown: str) -> list[Block]:
    """All fenced blocks."""
    return [
        Block(found[2].strip(), markdown[: found.start(3)].count("\n") + 1, found[3])
        for found in FENCED.finditer(markdown)
    ]


def commands_of(block: Block) -> list[list[str]]:
    """The words of each simple command of a block, without assignments before it, `sudo`, comments and operators."""
    code = re.sub(r"\\\n", " ", block.code)
    if block.language == "console":
        code = "\n".join(re.findall(r"^\s*\$ (.*)", code, re.MULTILINE))
    commands: list[list[str]] = []
    for line in code.splitlines():
        words = shlex.shlex(line, posix=True, punctuation_chars=True)
        commands.append([])
        for word in words:
            if re.fullmatch(r"[;&|()]+", word):
                commands.append([])
            elif commands[-1] or not re.match(r"sudo$|\w+=", word):
                commands[-1].append(word)
    return [command for command in commands if command]


def problem_of(words: list[str]) -> str | None:
    """Say what is wrong with a command, None if nothing is."""
    program, *arguments = words
    name = Path(program).name
    check = {"make": problem_of_make, "inspector": problem_of_inspector, "python": problem_of_python}.get(
        name.rstrip("3")
    )
    if check is not None:
        return check(arguments) or problem_of_paths(arguments)
    if "/" in program and not program.startswith(".venv/"):
        return problem_of_paths([program, *arguments])
    return None if name in ELSEWHERE or shutil.which(name) else f"there is no command {name}"


def problem_of_make(arguments: list[str]) -> str | None:
    targets = re.findall(r"^([\w-]+):", (REPOSITORY / "Makefile").read_text("utf-8"), re.MULTILINE)
    for argument in arguments:
        if argument.startswith("ARGS=") and "serve" in arguments:
            return problem_of_inspector(["serve", *shlex.split(argument.removeprefix("ARGS="))])
        if "=" not in argument and argument not in targets:
            return f"the Makefile has no target {argument}; it has {', '.join(targets)}"
    return None


def problem_of_inspector(arguments: list[str]) -> str | None:
    options = [argument.split("=")[0] for argument in arguments if re.match(r"-+[a-z]", argument)]
    subcommand = arguments[0] if arguments and not arguments[0].startswith("-") else ""
    if subcommand in ("run", "train"):  # of a method
        subcommand = " ".join(arguments[:2])
    shown = inspector_help(subcommand)
    if shown is None:
        return f"there is no subcommand {subcommand}"
    wrong = [option for option in options if not re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", shown)]
    return f"inspector {subcommand} has no option {', '.join(wrong)}" if wrong else None


@functools.cache
def inspector_help(subcommand: str) -> str | None:
    """The help text of a subcommand, or of the whole command if empty; None if there is no such subcommand."""
    command = [sys.executable, "-m", "inspector", *subcommand.split(), "--help"]
    wide = {**os.environ, "COLUMNS": "200"}
    done = subprocess.run(command, cwd=REPOSITORY, env=wide, capture_output=True, text=True, check=False)
    # For an unknown subcommand, tyro shows the help of the whole command.
    return done.stdout if re.match(rf"usage: inspector {subcommand}\b", done.stdout) else None


def problem_of_python(arguments: list[str]) -> str | None:
    if arguments[:1] == ["-m"]:
        return None if importlib.util.find_spec(arguments[1]) else f"there is no module {arguments[1]}"
    return None if not arguments or arguments[0].startswith("-") else problem_of_paths([f"./{arguments[0]}"])


def problem_of_paths(arguments: list[str]) -> str | None:
    """Whatever points into a folder of the repository must be there."""
    folders = {path.name for path in REPOSITORY.iterdir() if path.is_dir()} | {"."}
    for argument in arguments:
        if Path(argument).is_absolute() or argument.startswith(("-", "..")) or "/" not in argument:
            continue
        if argument.split("/")[0] in folders and not (REPOSITORY / argument).exists():
            return f"there is no {Path(argument)}"
    return None


COMMANDS = [words for block in blocks_of(README) if block.language in SHELL_LANGUAGES for words in commands_of(block)]


@pytest.mark.parametrize("words", COMMANDS, ids=shlex.join)
def test_command_exists(words):
    assert problem_of(words) is None


def test_python_runs(tmp_path):
    blocks = [block for block in blocks_of(README) if block.language == "python"]
    if not blocks:
        pytest.skip("README.md has no Python")
    program = ""
    for block in blocks:  # at its own line, so that a traceback names the line of README.md
        program += "\n" * (block.first_line - 1 - program.count("\n")) + block.code
    shared = Path(os.environ.get("INSPECTOR_SHARED_DATA", REPOSITORY.parent / "shared" / "data")).parent
    if "shared/" in program and not shared.is_dir():
        pytest.skip(f"real data absent: {shared}")
    copy = tmp_path / "repository"  # new files must not end up in the real one
    copy.mkdir()
    for path in [*REPOSITORY.iterdir()]:
        (copy / path.name).symlink_to(path)
    (tmp_path / "shared").symlink_to(shared)
    script = copy / "README.md.py"
    script.write_text(program, "utf-8")
    done = subprocess.run(
        [sys.executable, script.name], cwd=copy, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr


def test_links_lead_somewhere():
    prose = FENCED.sub("", README)
    links = [(found[1] or found[2]).split("#")[0] for found in LINK.finditer(prose)]
    inside = [link for link in links if link and not re.match(r"\w+:", link)]
    assert [link for link in inside if not (REPOSITORY / link).exists()] == []


# What the checks above notice


def test_commands_are_read_as_a_shell_reads_them():
    markdown = """
```sh
git clone URL && cd pose-inspector   # a comment
PORT=1 sudo make serve \\
    ARGS="a b"; make test
```
```console
$ inspector doctor assets/demo | head
nothing found
```
"""
    found = [words for block in blocks_of(markdown) for words in commands_of(block)]
    assert found == [
        ["git", "clone", "URL"],
        ["cd", "pose-inspector"],
        ["make", "serve", "ARGS=a b"],
        ["make", "test"],
        ["inspector", "doctor", "assets/demo"],
        ["head"],
    ]
    assert [block.first_line for block in blocks_of(markdown)] == [3, 8]


@pytest.mark.parametrize(
    ("command", "problem"),
    [
        ("make serve", None),
        ("make sreve", "no target sreve"),
        ('make serve ARGS="../data/lmo --results x.csv"', None),
        ('make serve ARGS="--result x.csv"', "serve has no option --result$"),
        ("inspector serve ../data/lmo --results=x.csv --no-browser", None),
        ("inspector serve --brow", "no option --brow$"),
        ("inspector swerve", "no subcommand swerve"),
        ("python -m pipeline.warm_up", None),
        ("python -m pipeline.cool_down", "no module pipeline.cool_down"),
        (".venv/bin/python tests/test_readme.py", None),
        ("python tests/test_nothing.py", "no tests/test_nothing.py"),
        ("inspector serve tests/nothing", "no tests/nothing"),
        ("scripts/setup.sh test", None),
        ("scripts/tear_down.sh", "no scripts/tear_down.sh"),
        ("nonsense-command --help", "no command nonsense-command"),
    ],
)
def test_wrong_commands_are_noticed(command, problem):
    found = problem_of(shlex.split(command))
    assert (found is None) if problem is None else (found and re.search(problem, found)), found
