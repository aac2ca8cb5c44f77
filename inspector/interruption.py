"""Ctrl-C that is never lost."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def interruptible() -> Iterator[Callable[[], None]]:
    """Give a function that raises KeyboardInterrupt if one was raised in the block before, and swallowed.

    Libraries do swallow it: pyarrow when it is just looking whether there is pandas, some thousand times in a run.
    """
    happened = threading.Event()

    def interrupt(*_: object) -> None:
        happened.set()
        raise KeyboardInterrupt

    def check() -> None:
        if happened.is_set():
            raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler or not _in_main_thread():
        yield check  # nobody is to be interrupted, or somebody else looks after it
        return
    signal.signal(signal.SIGINT, interrupt)
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
