"""What the 3D picture shows of a review: drawn by one worker, blinking and turning by a thread of its own."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import viser

from inspector.symmetries.meshes import ShownModel, shown_model
from inspector.symmetries.review import Review
from inspector.symmetries.scene import STANDING_COLORS, Look, SymmetryScene
from inspector.symmetries.verdicts import Reviewed
from inspector.worker import LatestWins
from pipeline.bop.models_info.model_set import ModelFile
from pipeline.exceptions import InputError
from pipeline.symmetry_search.groups import Axis, Candidate, axis_of

BLINK_SECONDS, PLAY_SECONDS = 0.6, 0.05
DEGREES_PER_SECOND = 40.0
BETWEEN_FOLDS = 75.0
"""Degrees: a turn of no small fold, at which a continuous symmetry is shown first."""


class Picture:
    """Keeps the scene as the review and the look say; `changed` is called when there is more to tell the page."""

    def __init__(self, scene: viser.SceneApi, review: Review, changed: Callable[[], None]) -> None:
        self.look = Look()
        self.measured_mm: float | None = None
        """Hausdorff distance at the angle that is shown; None as long as it is not known."""
        self._review, self._changed = review, changed
        self._scene = SymmetryScene(scene)
        self._lock = threading.RLock()
        self._drawn: object = None
        self._begun: object = None
        self._shown_now: ShownModel | None = None
        self._stopped = threading.Event()
        self._shown = lru_cache(maxsize=4)(self._prepared)
        self._worker = LatestWins("symmetry scene", self._failed)
        threading.Thread(target=self._animate, name="animation", daemon=True).start()

    def stop(self) -> None:
        """Draw no more."""
        self._stopped.set()
        self.settle(1.0)
        self._worker.stop()

    def settle(self, timeout: float) -> bool:
        """Wait until all is drawn; False if that takes longer than `timeout` seconds."""
        return self._worker.wait_idle(timeout)

    def change(self, **fields: Any) -> None:
        """Change how candidates are shown; `draw` shows it."""
        with self._lock:
            self.look = replace(self.look, **fields)

    def draw(self) -> None:
        """Draw soon; a candidate that is new begins at its first turn."""
        review = self._review
        with self._lock:
            candidate = review.candidate
            begun = (review.selected, review.fold, candidate is None)
            if begun != self._begun:
                self._begun = begun
                self.measured_mm = None
                if candidate is not None:
                    angle = 360.0 / candidate.fold if candidate.fold else BETWEEN_FOLDS
                    self.look = replace(self.look, angle=angle, playing=False)
        if not self._stopped.is_set():
            self._worker.submit(self._draw)

    # ------------------------------------------------------------------ drawing
    def _draw(self) -> None:
        review, look = self._review, self.look
        current, candidate = review.current, review.candidate
        wanted = (review.selected, review.fold, candidate is None, current.verdicts, current.group, look)
        if wanted == self._drawn:
            return
        self._drawn = wanted  # even if it fails: what cannot be drawn is not tried again and again
        self._shown_now = None
        try:
            self._shown_now = shown = self._shown(current.file)
        except InputError as error:
            self._failed(error)
            return
        turn = np.eye(4) if candidate is None else candidate.axis.turn(float(np.radians(look.angle)))
        if current.search is not None and candidate is not None and look.mode == "distance":
            self._scene.show_distances(shown, current.search.surface, turn, current.search.epsilon)
        else:
            self._scene.show_models(shown, turn, look if candidate is not None else replace(look, mode="blink"))
        self._draw_axes(current, candidate, shown)
        if current.search is not None and candidate is not None and not look.playing:
            self.measured_mm = current.search.distance(turn) * 1000
            self._changed()

    def _draw_axes(self, current: Reviewed, candidate: Candidate | None, shown: ShownModel) -> None:
        if candidate is None:
            self._scene.show_axes(shown, None, 0, STANDING_COLORS["open"], ())
            return
        color = STANDING_COLORS[current.standings[self._review.selected[1]]]
        self._scene.show_axes(shown, candidate.axis, candidate.fold, color, _axes(current))

    def _prepared(self, file: ModelFile) -> ShownModel:
        return shown_model(self._review.models.read_for_display(file))

    def _failed(self, error: Exception) -> None:
        self._scene.clear()
        self._review.tell(f"this cannot be shown: {error}", "warning")

    # ------------------------------------------------------------------ blinking and turning
    def _animate(self) -> None:
        """What needs no drawing anew."""
        last_blink, on, begun = 0.0, True, time.monotonic()
        while not self._stopped.wait(PLAY_SECONDS):
            now, look = time.monotonic(), self.look
            elapsed, begun = now - begun, now
            candidate = self._review.candidate
            if look.playing and candidate is not None:
                self._play(candidate, look, DEGREES_PER_SECOND * elapsed)
            if look.mode == "blink" and candidate is not None and now - last_blink > BLINK_SECONDS:
                last_blink, on = now, not on
                self._scene.blink(on)

    def _play(self, candidate: Candidate, look: Look, degrees: float) -> None:
        with self._lock:
            if self.look is not look:
                return  # somebody has just chosen something else
            self.look = replace(look, angle=(look.angle + degrees) % 360.0)
            self.measured_mm = None
        self._changed()
        if look.mode == "distance":
            self._worker.submit(self._draw)
        elif self._shown_now is not None:
            self._scene.place(self._shown_now, candidate.axis.turn(float(np.radians(self.look.angle))))


def _axes(reviewed: Reviewed) -> list[Axis]:
    """The axes of what is accepted."""
    return [*reviewed.group.continuous, *(axis_of(turn) for turn in reviewed.group.discrete)]
