"""What was found and decided about the symmetries of one object."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

from pipeline.bop.models_info.model_set import ModelFile
from pipeline.bop.models_info.symmetries import group_from
from pipeline.exceptions import InputError
from pipeline.scene import Model
from pipeline.symmetry_search.closure import NoGroupError, group_of
from pipeline.symmetry_search.groups import NO_SYMMETRY, Candidate, SymmetryGroup
from pipeline.symmetry_search.search import SymmetrySearch, contains

Progress = Literal["waiting", "searching", "found", "failed"]
Verdict = Literal["accepted", "refused"]
Standing = Literal["accepted", "refused", "follows", "open"]
"""`follows`: not accepted itself, but a product of those that are."""


class Decision(NamedTuple):
    """What is decided about a candidate."""

    verdict: Verdict
    fold: int | None = None
    """Where only some turns are accepted, such as two of four because of colours: how many; None for all."""


@dataclass(frozen=True, eq=False)
class Reviewed:
    """One object: what was found, and what was decided."""

    file: ModelFile
    progress: Progress = "waiting"
    share: float = 0.0
    """Of the search, 0..1."""
    problem: str = ""
    """Why the search failed, or what is odd about the file's own symmetries."""
    model: Model | None = None
    search: SymmetrySearch | None = None
    listed: SymmetryGroup = NO_SYMMETRY
    """What `models_info.json` says."""
    verdicts: Mapping[int, Decision] = field(default_factory=dict)
    """By the candidate's position."""
    first_verdicts: Mapping[int, Decision] = field(default_factory=dict)
    """What the file's own symmetries came to."""
    group: SymmetryGroup = NO_SYMMETRY
    """The closed set of what is accepted."""

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """The candidates, best first."""
        return () if self.search is None else self.search.candidates

    @property
    def unsaved(self) -> bool:
        """Whether the file says something else than what was decided."""
        return self.search is not None and self.verdicts != self.first_verdicts and not self.as_listed

    @cached_property
    def as_listed(self) -> bool:
        """Whether what is accepted is what the file lists."""
        return self.search is not None and self.group.equals(self.listed, self.search.surface.extent)

    @cached_property
    def standings(self) -> tuple[Standing, ...]:
        """How each candidate stands."""
        return tuple(self._standing(index) for index in range(len(self.candidates)))

    def _standing(self, index: int) -> Standing:
        if index in self.verdicts:
            return self.verdicts[index].verdict
        assert self.search is not None
        return "follows" if contains(self.group, self.candidates[index], self.search.surface) else "open"

    def decided(self, verdicts: Mapping[int, Decision]) -> "Reviewed":
        """The object with other verdicts. Raises NoGroupError if those accepted cannot be together."""
        assert self.search is not None
        accepted = [part(self.candidates[i], d.fold) for i, d in sorted(verdicts.items()) if d.verdict == "accepted"]
        group = group_of(accepted, self.search.surface.extent)
        for index, decision in verdicts.items():
            if decision.verdict == "refused" and contains(group, self.candidates[index], self.search.surface):
                raise NoGroupError(
                    f"candidate {index + 1} ({self.candidates[index]}) is refused, but follows from those accepted"
                )
        return replace(self, verdicts=dict(verdicts), group=group)

    def found(self, model: Model, search: SymmetrySearch) -> "Reviewed":
        """The object when its search has ended: what the file lists counts as accepted."""
        done = replace(self, progress="found", share=1.0, model=model, search=search)
        whole = [(index, None) for index in range(len(search.candidates))]
        parts = [(index, fold) for index, c in enumerate(search.candidates) for fold in c.smaller_folds]
        for index, fold in [*whole, *parts]:
            candidate = part(search.candidates[index], fold)
            new = contains(self.listed, candidate, search.surface) and not contains(
                done.group, candidate, search.surface
            )
            if new and index not in done.verdicts:
                try:
                    done = done.decided({**done.verdicts, index: Decision("accepted", fold)})
                except NoGroupError:
                    continue
        problem = "" if done.as_listed else "models_info.json lists symmetries that are no candidates here"
        return replace(done, first_verdicts=done.verdicts, problem=problem)


def part(candidate: Candidate, fold: int | None) -> Candidate:
    """A candidate, or the part of it with a smaller fold."""
    return candidate if fold is None else candidate.with_fold(fold)


def unsearched(file: ModelFile, info: Mapping[str, Any]) -> Reviewed:
    """An object with what its entry in `models_info.json` lists (millimetres)."""
    try:
        return Reviewed(file, listed=group_from(info))
    except InputError as error:
        return Reviewed(file, problem=str(error))
