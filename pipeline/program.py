"""Which program this is: what it computes may change with every line of it."""

import hashlib
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np


@cache
def program() -> str:
    """Versions of this program, NumPy and Python, and a digest of the sources of `pipeline`, as one short text."""
    digest = hashlib.sha256()
    root = Path(__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root).as_posix()}\n{path.stat().st_size}\n".encode() + path.read_bytes())
    try:
        number = version("pose-inspector")
    except PackageNotFoundError:
        number = "unknown"
    return f"{number} {digest.hexdigest()[:12]}, numpy {np.__version__}, python {platform.python_version()}"
