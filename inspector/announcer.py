"""News for listeners, a few times a second at most, from a thread of its own."""

import logging
import threading
from collections.abc import Callable

log = logging.getLogger(__name__)

INTERVAL_SECONDS = 0.25


class Announcer:
    """Tells listeners that something has changed: the first change at once, the last one for certain.

    A listener that is slow or fails holds up and hinders nobody but other listeners, and those only by its slowness.
    """

    def __init__(self, name: str, interval: float = INTERVAL_SECONDS) -> None:
        """Name the thread, which starts with the first listener; `interval` is the least time between two calls, s."""
        self._condition = threading.Condition()
        self._interval = interval
        self._listeners: set[Callable[[], None]] = set()
        self._news = False
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have `listener` called after changes, in the announcer's thread; returns what ends that."""
        with self._condition:
            self._listeners.add(listener)
            if self._thread.ident is None:
                self._thread.start()

        def end() -> None:
            with self._condition:
                self._listeners.discard(listener)

        return end

    def changed(self) -> None:
        """Something has changed; returns at once, whatever the thread."""
        with self._condition:
            self._news = True
            self._condition.notify_all()

    def stop(self) -> None:
        """Tell nothing any more."""
        self._stopped.set()
        self.changed()

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._news)
                self._news = False
                listeners = tuple(self._listeners)
            if self._stopped.is_set():
                return
            for listener in listeners:
                try:
                    listener()
                except Exception:
                    log.exception("a listener could not be told of a change")
            self._stopped.wait(self._interval)
