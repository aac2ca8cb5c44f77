"""Background work that keeps up with a person: only the newest request matters, and faults stay where they happen."""

import logging
import threading
from collections.abc import Callable

log = logging.getLogger(__name__)


class LatestWins:
    """One daemon thread that runs submitted jobs; a job still waiting when another comes is dropped."""

    def __init__(self, name: str, on_error: Callable[[Exception], None] | None = None) -> None:
        self._condition = threading.Condition()
        self._waiting: Callable[[], None] | None = None
        self._busy = False
        self._stopped = False
        self._on_error = on_error
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def submit(self, job: Callable[[], None]) -> None:
        """Run `job` as soon as the current one ends, in place of any that is still waiting."""
        with self._condition:
            self._waiting = job
            self._condition.notify_all()

    def stop(self) -> None:
        """End the thread after the current job; later submissions do nothing."""
        with self._condition:
            self._stopped = True
            self._condition.notify_all()

    def wait_idle(self, timeout: float) -> bool:
        """Wait until nothing runs or waits; False if that takes longer than `timeout` seconds."""
        with self._condition:
            return self._condition.wait_for(lambda: self._waiting is None and not self._busy, timeout)

    def _run(self) -> None:
        while True:
            with self._condition:
                self._busy = False
                self._condition.notify_all()
                self._condition.wait_for(lambda: self._waiting is not None or self._stopped)
                if self._stopped:
                    return
                job, self._waiting = self._waiting, None
                self._busy = True
            try:
                assert job is not None
                job()
            except Exception as error:  # one browser's fault must not end its worker
                log.exception("a view could not be updated")
                self._tell(error)

    def _tell(self, error: Exception) -> None:
        if self._on_error is not None:
            try:
                self._on_error(error)
            except Exception:
                log.exception("and that could not be told")
