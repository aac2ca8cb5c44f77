"""Accepting and refusing candidates of symmetries, object by object: the state that all browsers share, and undo."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from inspector.symmetries.saving import InfoFile, told
from inspector.symmetries.verdicts import Decision, Reviewed, Verdict, part, unsearched
from pipeline.bop.models_info.model_set import ModelSet
from pipeline.bop.models_info.writing import Written
from pipeline.scene import Model
from pipeline.symmetry_search.closure import NoGroupError
from pipeline.symmetry_search.groups import Candidate
from pipeline.symmetry_search.search import SymmetrySearch


class Review:
    """The objects under review, with undo; every change is told to listeners. Callable from any thread."""

    def __init__(self, models: ModelSet) -> None:
        """Begin with nothing searched. Raises FormatError if models_info.json is damaged."""
        self.models = models
        self.message: tuple[str, str] = ("", "")
        """The last thing to tell, and its kind: info, warning or saved."""
        self._file = InfoFile(models)
        self._objects = [unsearched(file, self._file.entry(file)) for file in models.files]
        self._selected = (0, 0)
        self._folds: dict[tuple[int, int], int] = {}
        self._undo: list[tuple[int, Mapping[int, Decision]]] = []
        self._lock = threading.RLock()
        self._listeners: list[Callable[[], None]] = []

    # ------------------------------------------------------------------ what there is
    @property
    def objects(self) -> tuple[Reviewed, ...]:
        """All objects."""
        with self._lock:
            return tuple(self._objects)

    @property
    def selected(self) -> tuple[int, int]:
        """Positions of the selected object and of its selected candidate."""
        return self._selected

    @property
    def current(self) -> Reviewed:
        """The selected object."""
        with self._lock:
            return self._objects[self._selected[0]]

    @property
    def candidate(self) -> Candidate | None:
        """The selected candidate, or the part of it that is chosen; None where there is none."""
        with self._lock:
            candidates = self.current.candidates
            return part(candidates[self._selected[1]], self.fold) if self._selected[1] < len(candidates) else None

    @property
    def fold(self) -> int | None:
        """With which smaller fold the selected candidate is to be accepted, None for all its turns."""
        decision = self.current.verdicts.get(self._selected[1])
        if decision is not None and decision.verdict == "accepted":
            return decision.fold
        return self._folds.get(self._selected)

    @property
    def unsaved(self) -> tuple[Reviewed, ...]:
        """Objects of which the file says something else than what was decided."""
        return tuple(reviewed for reviewed in self.objects if reviewed.unsaved)

    def listen(self, listener: Callable[[], None]) -> None:
        """Have a function called after every change."""
        self._listeners.append(listener)

    def tell(self, text: str, kind: str) -> None:
        """Put a message on the page: info, warning or saved."""
        self.message = (text, kind)
        self._changed()

    # ------------------------------------------------------------------ what the search tells
    def waiting(self) -> int | None:
        """Position of the object to be searched next, from the selected one on; None when all are done."""
        with self._lock:
            waiting = [i for i, reviewed in enumerate(self._objects) if reviewed.progress == "waiting"]
            ahead = [i for i in waiting if i >= self._selected[0]]
            return next(iter(ahead or waiting), None)

    def read(self, index: int) -> Model:
        """The mesh of an object, metres. Raises FormatError, MissingFileError."""
        file = self._objects[index].file
        return self.models.read(file, self._file.entry(file))

    def searched(self, index: int, **fields: Any) -> None:
        """Note how the search of an object goes: `progress`, `share`, `problem`."""
        with self._lock:
            self._objects[index] = replace(self._objects[index], **fields)
        self._changed()

    def found(self, index: int, model: Model, search: SymmetrySearch) -> None:
        """Take what was found for an object; what the file lists counts as accepted."""
        with self._lock:
            self._objects[index] = self._objects[index].found(model, search)
        self._changed()

    # ------------------------------------------------------------------ selecting
    def select_object(self, index: int) -> None:
        """Look at another object, at its first candidate."""
        with self._lock:
            if 0 <= index < len(self._objects):
                self._selected = (index, 0)
                self.message = ("", "")
        self._changed()

    def select(self, candidate: int) -> None:
        """Look at another candidate."""
        with self._lock:
            if 0 <= candidate < len(self.current.candidates):
                self._selected = (self._selected[0], candidate)
        self._changed()

    def step_object(self, by: int) -> None:
        """Go to the next object, from the last one to the first."""
        self.select_object((self._selected[0] + by) % len(self._objects))

    def step(self, by: int) -> None:
        """Go to the next candidate of the object, from the last one to the first."""
        count = len(self.current.candidates)
        self.select((self._selected[1] + by) % count if count else 0)

    # ------------------------------------------------------------------ deciding
    def accept(self) -> None:
        """Accept the selected candidate, and go on to the next open one."""
        self._decide("accepted")

    def refuse(self) -> None:
        """Refuse the selected candidate, and go on to the next open one."""
        self._decide("refused")

    def reopen(self) -> None:
        """Take back what was decided about the selected candidate."""
        self._decide(None)

    def choose_fold(self, fold: int | None) -> None:
        """Accept only so many turns of the selected candidate, now or when it is accepted; None for all."""
        with self._lock:
            index, candidate = self._selected
            candidates = self.current.candidates
            if candidate < len(candidates) and (fold is None or fold in candidates[candidate].smaller_folds):
                self._folds = {key: value for key, value in self._folds.items() if key != self._selected}
                if fold is not None:
                    self._folds[self._selected] = fold
                if self.current.standings[candidate] == "accepted":
                    self._take(index, {**self.current.verdicts, candidate: Decision("accepted", fold)})
        self._changed()

    def step_fold(self, by: int) -> None:
        """To the next smaller or larger fold that the selected candidate has."""
        candidates = self.current.candidates
        if self._selected[1] < len(candidates):
            folds = (None, *candidates[self._selected[1]].smaller_folds)
            position = folds.index(self.fold) if self.fold in folds else 0
            self.choose_fold(folds[min(max(position + by, 0), len(folds) - 1)])

    def accept_suggested(self) -> None:
        """Accept what is suggested for the selected object, in place of what was decided before."""
        with self._lock:
            self._accept_suggested(self._selected[0])
        self._changed()

    def accept_all_suggested(self) -> None:
        """Accept what is suggested for every object of which nothing has been decided yet."""
        with self._lock:
            open_ones = [i for i, r in enumerate(self._objects) if r.search is not None and not r.verdicts]
            for index in open_ones:
                self._accept_suggested(index)
            self.message = (f"accepted the suggestions for {len(open_ones)} objects", "info")
        self._changed()

    def undo(self) -> None:
        """Take back the last decision, and look at its object."""
        with self._lock:
            if not self._undo:
                self.message = ("nothing to undo", "info")
            else:
                index, verdicts = self._undo.pop()
                self._objects[index] = self._objects[index].decided(verdicts)
                self._selected = (index, self._selected[1] if index == self._selected[0] else 0)
                self.message = (f"undone: {self._objects[index].file.name}", "info")
        self._changed()

    def _accept_suggested(self, index: int) -> None:
        search = self._objects[index].search
        if search is not None:
            self._take(index, {i: Decision("accepted") for i in search.suggested})

    def _decide(self, verdict: Verdict | None) -> None:
        with self._lock:
            index, candidate = self._selected
            if self.candidate is not None:
                fold = self.fold
                verdicts = {i: v for i, v in self.current.verdicts.items() if i != candidate}
                if verdict is not None:
                    verdicts[candidate] = Decision(verdict, fold if verdict == "accepted" else None)
                if self._take(index, verdicts) and verdict is not None:
                    self._go_to_open()
        self._changed()

    def _take(self, index: int, verdicts: Mapping[int, Decision]) -> bool:
        """Put verdicts in force unless they contradict each other, which is told."""
        before = self._objects[index]
        try:
            self._objects[index] = before.decided(verdicts)
        except NoGroupError as error:
            self.message = (str(error), "warning")
            return False
        if dict(before.verdicts) != dict(verdicts):
            self._undo.append((index, before.verdicts))
        self.message = ("", "")
        return True

    def _go_to_open(self) -> None:
        """Select the next candidate that nothing is decided about; stay if there is none."""
        current = self.current
        count = len(current.candidates)
        around = [(self._selected[1] + k) % count for k in range(1, count)]
        following = [i for i in around if current.standings[i] == "open"]
        if following:
            self._selected = (self._selected[0], following[0])

    # ------------------------------------------------------------------ saving
    def save(self) -> Written | None:
        """Write what is unsaved to `models_info.json`; None if there is nothing to write.

        Raises InputError if it cannot be written.
        """
        with self._lock:
            unsaved = self.unsaved
            if not unsaved and self._file.exists:
                self.message = ("nothing to save: models_info.json says what was decided", "info")
                written = None
            else:
                written = self._file.write(self._objects)
                for index, reviewed in enumerate(self._objects):
                    if reviewed.unsaved:
                        self._objects[index] = replace(
                            reviewed, listed=reviewed.group, first_verdicts=reviewed.verdicts
                        )
                self.message = (told(written, len(unsaved), self.models), "saved")
        self._changed()
        return written

    def _changed(self) -> None:
        for listener in list(self._listeners):
            listener()
