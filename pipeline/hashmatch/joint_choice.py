"""Which of the proposed poses explain the depth image best together.

Poses compete for pixels: near twins fit each other's places nearly as well as their own, and a part may fit where
another part shows half of it. Taking the best pose first would let one wrong pose displace several right ones, so that
sets are compared instead, as in global hypothesis verification (Aldoma et al., ECCV 2012).
"""

from collections.abc import Mapping, Sequence
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Integer

from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.evidence import Evidence

TWICE = 0.6
"""What a pixel costs that a further pose explains, too: two surfaces are not at one place."""

_ROUNDS = 6
"""Passes over all proposals, at most."""


def choose_jointly(evidence: Sequence[Evidence], groups: Sequence[int], counts: Mapping[int, int]) -> list[int]:
    """Rows of the set of poses with the largest sum of gains less costs that a local search finds, in order.

    Args:
        evidence: Of all poses.
        groups: Object of each.
        counts: How many of each object to take at most.

    """
    if not evidence:
        return []
    pixels = np.concatenate([one.pixels for one in evidence])
    _, places = np.unique(pixels, return_inverse=True)
    search = _Search(
        starts=np.concatenate([[0], np.cumsum([len(one.pixels) for one in evidence])]).astype(np.int64),
        places=places.astype(np.int64),
        gains=np.concatenate([one.gains * one.quality for one in evidence]).astype(np.float32),
        costs=np.array([one.cost * one.quality for one in evidence]),
        groups=np.array(groups),
        counts=counts,
    )
    return sorted(search.best())


class _Search:
    """Local search over sets of poses."""

    def __init__(
        self, starts: Integer[np.ndarray, "k"], places: Integer[np.ndarray, "n"], gains: Float[np.ndarray, "n"],
        costs: Float[np.ndarray, "p"], groups: Integer[np.ndarray, "p"], counts: Mapping[int, int],
    ) -> None:  # fmt: skip
        self.arrays = (starts, places, gains, costs)
        self.groups, self.counts = groups, counts
        size = int(places.max(initial=-1)) + 1
        self.best_gain, self.uses = np.zeros(size, np.float32), np.zeros(size, np.int32)

    def best(self) -> list[int]:
        """Fill greedily, then let each proposal replace those that it competes with as long as that is better."""
        chosen = self._filled([])
        value = self._value(chosen)
        for _ in range(_ROUNDS):
            before = value
            for row in np.argsort(-self._marginals([]), kind="stable"):
                if row in chosen:
                    continue
                for rivals in self._rivals(int(row), chosen):
                    trial = self._filled([*(one for one in chosen if one not in rivals), int(row)])
                    reached = self._value(trial)
                    if reached > value + 1e-3:
                        chosen, value = trial, reached
                        break
            if value <= before:
                break
        return chosen

    def _filled(self, chosen: list[int]) -> list[int]:
        """Add the proposal that adds most, again and again."""
        chosen = list(chosen)
        while True:
            marginal = self._marginals(chosen)
            full = [
                group for group in set(self.groups.tolist()) if self._used(group, chosen) >= self.counts.get(group, 0)
            ]
            marginal[np.isin(self.groups, full)] = -np.inf
            marginal[chosen] = -np.inf
            best = int(marginal.argmax())
            if not marginal[best] > 0:
                return chosen
            chosen.append(best)

    def _rivals(self, row: int, chosen: list[int]) -> list[list[int]]:
        """Sets of the chosen ones that may have to go if a proposal is added."""
        starts, places, _, _ = self.arrays
        own = places[starts[row] : starts[row + 1]]
        overlapping = [
            one for one in chosen if np.isin(places[starts[one] : starts[one + 1]], own, assume_unique=True).sum()
            > 0.15 * min(len(own), starts[one + 1] - starts[one])
        ]  # fmt: skip
        group = int(self.groups[row])
        if self._used(group, chosen) - self._used(group, overlapping) < self.counts.get(group, 0):
            return [overlapping] if overlapping else []
        return [[*overlapping, one] for one in chosen if self.groups[one] == group]

    def _used(self, group: int, chosen: list[int]) -> int:
        return sum(int(self.groups[one]) == group for one in chosen)

    def _value(self, chosen: list[int]) -> float:
        return _value(np.array(chosen, np.int64), *self.arrays, self.best_gain, self.uses, TWICE)

    def _marginals(self, chosen: list[int]) -> Float[np.ndarray, "p"]:
        return _marginals(np.array(chosen, np.int64), *self.arrays, self.best_gain, self.uses, TWICE)


@compiled
@no_type_check
def _value(chosen, starts, places, gains, costs, best_gain, uses, twice):
    total = 0.0
    for row in chosen:
        total -= costs[row]
        for i in range(starts[row], starts[row + 1]):
            p, gain = places[i], gains[i]
            if uses[p] == 0:
                total += gain
                best_gain[p] = gain
            else:
                total -= twice
                if gain > best_gain[p]:
                    total += gain - best_gain[p]
                    best_gain[p] = gain
            uses[p] += 1
    for row in chosen:
        for i in range(starts[row], starts[row + 1]):
            uses[places[i]] = 0
    return total


@compiled
@no_type_check
def _marginals(chosen, starts, places, gains, costs, best_gain, uses, twice):
    for row in chosen:
        for i in range(starts[row], starts[row + 1]):
            p = places[i]
            best_gain[p] = gains[i] if uses[p] == 0 else max(best_gain[p], gains[i])
            uses[p] += 1
    result = np.empty(len(costs))
    for row in range(len(costs)):
        total = -costs[row]
        for i in range(starts[row], starts[row + 1]):
            p, gain = places[i], gains[i]
            if uses[p] == 0:
                total += gain
            else:
                total += max(gain - best_gain[p], 0.0) - twice
        result[row] = total
    for row in chosen:
        for i in range(starts[row], starts[row + 1]):
            uses[places[i]] = 0
    return result
