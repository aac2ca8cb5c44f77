"""Errors that a user can mend: one line that names the thing, its value and the fix."""

from collections.abc import Iterable


class InputError(Exception):
    """Base of all errors caused by input; the command line prints its text without a traceback."""


class MissingFileError(InputError):
    """A file or folder that is needed does not exist or cannot be read."""


class FormatError(InputError):
    """A file exists, but its content is not what its format demands."""


class UnknownIdError(InputError, KeyError):
    """An id or name that the dataset or the table does not hold; the text lists those that it does."""

    def __init__(self, kind: str, value: object, where: str, available: Iterable[object]) -> None:
        known = sorted(available, key=lambda item: (str(type(item)), item))
        shown = ", ".join(map(str, known[:20])) + (f" and {len(known) - 20} more" if len(known) > 20 else "")
        self.message = f"{kind} {value} is not in {where}; available: {shown or 'none'}"
        super().__init__(self.message)

    def __str__(self) -> str:  # KeyError would print the repr
        return self.message
