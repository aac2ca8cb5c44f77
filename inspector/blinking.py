"""Showing ground truth and estimate in turn, so that the eye sees what moves."""

import threading
from collections.abc import Callable

from inspector.canvas import Canvas

PERIOD_SECONDS = 0.5
_GROUND_TRUTH = ("ground_truth", "models/ground_truth")
_ESTIMATE = ("estimate", "models/estimate")


class Blinker:
    """Hides the one and the other in turn while it is wanted; a thread of its own until `stop`."""

    def __init__(self, canvas: Canvas, wanted: Callable[[], bool]) -> None:
        self._canvas = canvas
        self._wanted = wanted
        self._stopped = threading.Event()
        threading.Thread(target=self._run, name="blinking", daemon=True).start()

    def stop(self) -> None:
        """End the thread."""
        self._stopped.set()

    def _run(self) -> None:
        phase: int | None = None
        while not self._stopped.wait(PERIOD_SECONDS):
            if self._wanted():
                phase = 0 if phase is None else 1 - phase
                self._show(ground_truth=phase == 0, estimate=phase == 1)
            elif phase is not None:
                phase = None
                self._show(ground_truth=True, estimate=True)

    def _show(self, *, ground_truth: bool, estimate: bool) -> None:
        for names, visible in ((_GROUND_TRUTH, ground_truth), (_ESTIMATE, estimate)):
            for name in names:
                self._canvas.set_visible(name, visible)
