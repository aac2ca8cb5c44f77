"""What comes back of an item from another process: its result, or the exception that the function raised."""

import pickle
import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NoReturn


class RemoteTracebackError(Exception):
    """Where in another process an exception was raised; the cause of that exception here."""

    def __str__(self) -> str:
        return f"\n\nin a worker process:\n{self.args[0]}"


@dataclass(frozen=True)
class Success:
    """What the function returned."""

    value: Any

    def result(self) -> Any:
        """The value."""
        return self.value


@dataclass(frozen=True)
class Failure:
    """The exception that the function raised, in parts: many exceptions cannot be pickled as they are."""

    kind: type[Exception]
    arguments: tuple[Any, ...]
    state: dict[str, Any]
    text: str
    trace: str

    def result(self) -> NoReturn:
        """Raise it."""
        raise self.error() from RemoteTracebackError(self.trace)

    def error(self) -> Exception:
        """The exception, with its type, arguments, attributes and text."""
        with suppress(Exception):
            error = self.kind(*self.arguments)
            error.__dict__.update(self.state)
            if str(error) == self.text:
                return error
        # Its __init__ takes other arguments than those it has kept.
        error = self.kind.__new__(self.kind, *self.arguments)
        error.__dict__.update(self.state)
        return error


Outcome = Success | Failure


def attempt(call: Callable[[], Any]) -> Outcome:
    """Do something, and keep what it raises."""
    try:
        return Success(call())
    except Exception as error:
        return failure(error)


def packed(outcome: Outcome) -> bytes:
    """An outcome to send; that of a value which cannot be sent is a failure that says so."""
    try:
        return pickle.dumps(outcome, pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        return pickle.dumps(failure(error), pickle.HIGHEST_PROTOCOL)


def failure(error: Exception) -> Failure:
    """An exception as it can be sent; one that holds what cannot be becomes a RuntimeError with its text."""
    trace = "".join(traceback.format_exception(error))
    try:
        arguments = error.__reduce__()[1] if isinstance(error, OSError) else error.args  # with the file's name
        found = Failure(type(error), tuple(arguments), dict(error.__dict__), str(error), trace)
        pickle.dumps(found)
    except Exception:
        text = f"{type(error).__name__}: {error}"
        return Failure(RuntimeError, (text,), {}, text, trace)
    return found
