"""A small cache for values that are read from files once, shared by threads."""

import threading
from collections.abc import Callable
from typing import Any


class Memo:
    """Keeps values by key and computes each once, also when several threads ask for it at the same time."""

    def __init__(self) -> None:
        self._values: dict[Any, Any] = {}
        self._locks: dict[Any, threading.Lock] = {}

    def get(self, key: Any, compute: Callable[[], Any]) -> Any:
        """The value of a key; one computation does not hold up those of other keys, and errors are not kept."""
        if key not in self._values:
            with self._locks.setdefault(key, threading.Lock()):
                if key not in self._values:
                    self._values[key] = compute()
        return self._values[key]
