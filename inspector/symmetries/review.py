"""What is decided about the candidates of all objects; shared by all browsers, undone step by step."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from pipeline.bop.symmetry_files import write_symmetries
from pipeline.exceptions import InputError
from pipeline.scene import Model
from pipeline.symmetry_search.closure import NoGroupError, group_of
from pipeline.symmetry_search.groups import NO_SYMMETRY, Candidate, SymmetryGroup
from pipeline.symmetry_search.search import SymmetrySearch

Decision = Literal["open", "accepted", "refused"]


@dataclass(frozen=True)
class State:
    """What is looked at and decided; a new one is made with every change."""

    obj_id: int
    position: int = 0
    """Of the candidate among those of the object."""
    decisions: Mapping[tuple[int, int], Decision] = field(default_factory=dict)
    """By object id and position; open where absent."""


class Review:
    """Decisions about the symmetries of a folder of models; every method may be called from any thread."""

    def __init__(self, folder: Path, models: Mapping[int, Model]) -> None:
        self.folder = folder
        self.models = models
        self.searches: dict[int, SymmetrySearch | InputError] = {}
        """What was found, object by object as it comes."""
        self.progress = 0.0
        """Share of the search that is done, 0..1."""
        self.message = ""
        """What happened last, for people."""
        self.state = State(next(iter(models)))
        self._past: list[State] = []
        self._saved: Mapping[tuple[int, int], Decision] = {}
        self._listeners: list[Callable[[], None]] = []
        self._lock = threading.RLock()

    def listen(self, listener: Callable[[], None]) -> None:
        """Have `listener` called after every change, from any thread."""
        self._listeners.append(listener)

    def add(self, obj_id: int, search: SymmetrySearch | InputError, progress: float) -> None:
        """Take what was found for an object."""
        with self._lock:
            self.searches[obj_id] = search
            self.progress = progress
        self._changed()

    def candidates(self, obj_id: int) -> tuple[Candidate, ...]:
        """Candidates of an object, best first; none as long as they are not known."""
        search = self.searches.get(obj_id)
        return search.candidates if isinstance(search, SymmetrySearch) else ()

    @property
    def candidate(self) -> Candidate | None:
        """The one that is looked at."""
        found = self.candidates(self.state.obj_id)
        return found[self.state.position] if self.state.position < len(found) else None

    def decision(self, obj_id: int, position: int) -> Decision:
        """What was decided about a candidate."""
        return self.state.decisions.get((obj_id, position), "open")

    def is_suggested(self, obj_id: int, position: int) -> bool:
        """Whether the search suggests to accept a candidate."""
        search = self.searches.get(obj_id)
        return isinstance(search, SymmetrySearch) and position in search.suggested

    def group(self, obj_id: int) -> SymmetryGroup:
        """The closed set that the accepted candidates of an object generate."""
        return self._group(obj_id, self.state)

    @property
    def unsaved(self) -> bool:
        """Whether there are decisions that are not in the file."""
        return dict(self.state.decisions) != dict(self._saved)

    def step(self, by: int) -> None:
        """Look at another candidate of the object."""
        count = len(self.candidates(self.state.obj_id))
        if count:
            self.state = replace(self.state, position=(self.state.position + by) % count)
            self._changed()

    def step_object(self, by: int) -> None:
        """Look at another object."""
        ids = list(self.models)
        self.look_at(ids[(ids.index(self.state.obj_id) + by) % len(ids)])

    def look_at(self, obj_id: int, position: int = 0) -> None:
        """Look at a candidate of an object."""
        if obj_id in self.models and position >= 0:
            self.state = replace(self.state, obj_id=obj_id, position=position)
            self._changed()

    def decide(self, decision: Decision) -> None:
        """Accept or refuse the candidate that is looked at, and go on to the next that is open.

        One that cannot be a symmetry beside those accepted is not taken; `message` says why.
        """
        with self._lock:
            if self.candidate is not None:
                self._take({(self.state.obj_id, self.state.position): decision})
        self._changed()

    def decide_as_suggested(self) -> None:
        """Accept what is suggested for the object, and refuse all else."""
        obj_id = self.state.obj_id
        with self._lock:
            count = len(self.candidates(obj_id))
            self._take({(obj_id, i): "accepted" if self.is_suggested(obj_id, i) else "refused" for i in range(count)})
        self._changed()

    def undo(self) -> None:
        """Take the last decision back."""
        with self._lock:
            if self._past:
                self.state = self._past.pop()
                self.message = "taken back"
        self._changed()

    def save(self) -> None:
        """Write the sets of all objects of which something was decided."""
        with self._lock:
            groups = {obj_id: self.group(obj_id) for obj_id in sorted({o for o, _ in self.state.decisions})}
            try:
                backup = write_symmetries(self.folder, groups, self.models)
                self._saved = dict(self.state.decisions)
                kept = f"; the earlier file is {backup.name}" if backup else ""
                self.message = f"saved symmetries of {len(groups)} objects to {self.folder / 'models_info.json'}{kept}"
            except InputError as error:
                self.message = str(error)
        self._changed()

    def _take(self, decided: Mapping[tuple[int, int], Decision]) -> None:
        decisions = {key: value for key, value in {**self.state.decisions, **decided}.items() if value != "open"}
        new = replace(self.state, decisions=decisions)
        try:
            self._group(new.obj_id, new)
        except NoGroupError as error:
            self.message = f"not accepted: {error}"
            return
        self._past.append(self.state)
        self.message = ""
        self.state = replace(new, position=self._next_open(new))

    def _next_open(self, state: State) -> int:
        count = len(self.candidates(state.obj_id))
        following = [(state.position + i) % count for i in range(1, count)] if count else []
        return next((i for i in following if (state.obj_id, i) not in state.decisions), state.position)

    def _group(self, obj_id: int, state: State) -> SymmetryGroup:
        search = self.searches.get(obj_id)
        if not isinstance(search, SymmetrySearch):
            return NO_SYMMETRY
        accepted = [c for i, c in enumerate(search.candidates) if state.decisions.get((obj_id, i)) == "accepted"]
        return group_of(accepted, search.surface.extent)

    def _changed(self) -> None:
        for listener in tuple(self._listeners):
            listener()
