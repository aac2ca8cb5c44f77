"""A worker process: `python -m pipeline.parallel.worker CONNECTION THREADS`, started by `pipeline.parallel.local`.

It says that it is ready, then answers each message (what to do, where that is new, and an item) with an outcome.
"""

import contextlib
import os
import pickle
import signal
import sys
import threading
import time
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, NoReturn

from pipeline.parallel.outcome import attempt, packed
from pipeline.parallel.threads import limit_threads

READY = b"ready"

GRACE_SECONDS = 2.0
"""For an item that is ended to clear up after itself."""


def main() -> None:
    """Work until the process that started this one closes the connection, or ends."""
    number, threads = map(int, sys.argv[1:])
    os.set_inheritable(number, False)
    signal.signal(signal.SIGTERM, _stop)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        limit_threads(threads)
        _serve(Connection(number))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass  # nobody is interested any more
    except SystemExit:
        pass  # told to stop
    finally:
        _leave()


def _serve(connection: Connection) -> NoReturn:
    connection.send_bytes(READY)
    worker = _Worker()
    while True:
        connection.send_bytes(packed(attempt(partial(worker.answer, connection.recv_bytes()))))


class _Worker:
    """Keeps what all items of a task share, so what is found out for one item is there for the next."""

    def __init__(self) -> None:
        self._task: Any = None

    def answer(self, message: bytes) -> Any:
        task, item = pickle.loads(message)
        if task is not None:
            self._task = None  # so that there are never two in memory
            self._task = pickle.loads(task)
        function, shared = self._task
        return function(shared, pickle.loads(item))


def _end_with_parent() -> None:
    """Wait until the parent's end of the standard input is closed, which its death does, too."""
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_SECONDS)
    os._exit(1)


def _stop(*_: Any) -> NoReturn:
    """Leave from where it is, so that what is half-written is removed."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit


def _leave() -> None:
    """End at once: taking the libraries down in order takes long."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
