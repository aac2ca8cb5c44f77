"""A worker process as it is seen from the process that started it."""

import os
import pickle
import signal
import subprocess
import sys
from multiprocessing.connection import Pipe
from pathlib import Path

from pipeline.parallel.outcome import Outcome
from pipeline.parallel.threads import VARIABLES
from pipeline.parallel.worker import GRACE_SECONDS, READY


class WorkerProcess:
    """A process that runs `pipeline.parallel.worker`.

    It is a program of its own, not a fork, as there may be threads here; and it does not import `__main__`.
    """

    def __init__(self, threads: int) -> None:
        """Start it; its libraries use so many threads each."""
        self.connection, theirs = Pipe()
        self.ready = False
        """Whether it has ever worked."""
        self._task: bytes | None = None
        self._message: bytes | None = None
        number = str(theirs.fileno())
        # In a session of its own, Ctrl-C in the terminal reaches this process only, which then ends the others. The
        # standard input is never written to: its end tells the worker that this process is gone.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "pipeline.parallel.worker", number, str(threads)],
            stdin=subprocess.PIPE,
            pass_fds=[theirs.fileno()],
            env=_environment(threads),
            start_new_session=True,
        )
        theirs.close()

    def give(self, task: bytes, item: bytes) -> None:
        """Have an item done, now or when the process is ready; the task is sent where it is another than before."""
        self._message = pickle.dumps((None if task is self._task else task, item), pickle.HIGHEST_PROTOCOL)
        self._task = task
        if self.ready:
            self._send()

    def take(self) -> Outcome | None:
        """What has arrived; None if that was no outcome. Raises OSError if the process is gone."""
        try:
            message = self.connection.recv_bytes()
        except EOFError as error:
            raise ConnectionResetError from error
        if message != READY:
            return pickle.loads(message)
        self.ready = True
        self._send()
        return None

    def stop(self) -> None:
        """Ask it to end."""
        self._process.terminate()

    def end(self) -> str:
        """Wait for its end, force it if need be, and say how it came about."""
        self.connection.close()
        try:
            code = self._process.wait(GRACE_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        if self._process.stdin is not None:
            self._process.stdin.close()
        return f"signal {-code}, {signal.strsignal(-code)}" if code < 0 else f"exit code {code}"

    def _send(self) -> None:
        """Send what waits; a process that is gone meanwhile is noticed when its answer is waited for."""
        message, self._message = self._message, None
        if message is not None:
            try:
                self.connection.send_bytes(message)
            except OSError:
                return


def _environment(threads: int) -> dict[str, str]:
    """Variables of a worker: it imports what this process can, and its libraries use few threads."""
    path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
    return {**dict.fromkeys(VARIABLES, str(threads)), **os.environ, "PYTHONPATH": path}
