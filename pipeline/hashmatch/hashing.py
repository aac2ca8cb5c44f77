"""Hypothesis generation by hashing-based voting (thesis sec. Hypothesis Generation by Hashing-Based Voting)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.channels import NONE
from pipeline.hashmatch.config import NORMAL_BINS, HashMatchConfig
from pipeline.hashmatch.templates import DISTANCE_UNIT, NO_DISTANCE, Templates

ENOUGH_BITS = 10.0
"""A template of which the chosen tables know so many bits counts half when the next one is chosen."""

MOST_USES = 6
"""How many times as often as on average a reference point may be used by the tables."""

_SAMPLE = 4000
"""Templates from which boundaries and triplets are chosen, evenly spread over all."""


@dataclass(frozen=True, eq=False)
class HashTables:
    """|H| tables over the templates of some objects; templates are numbered through, object after object."""

    triplets: Integer[np.ndarray, "h 3"]
    """Reference points of each table."""
    boundaries: Float[np.ndarray, "b"]
    """Metres; between the bins of depth differences."""
    starts: Integer[np.ndarray, "k"]
    """Where the identifiers of each table, key and object begin in `ids`, in this order; one more than there are."""
    ids: Integer[np.ndarray, "n"]
    """Templates."""
    objects: Integer[np.ndarray, "t"]
    """Position of each template's object in the list that the tables were made from."""
    firsts: Integer[np.ndarray, "o"]
    """First template of each object, and the number of all."""
    entropies: Float[np.ndarray, "h"]
    """Bits; of the quantized measurements of each table."""

    def nbytes(self) -> int:
        """Memory of the arrays."""
        return sum(value.nbytes for value in vars(self).values())


def build_tables(objects: Sequence[Templates], config: HashMatchConfig) -> HashTables:
    """Choose the reference points and fill the tables."""
    distances = np.concatenate([own.grid_distances for own in objects])
    bins = np.concatenate([own.grid_normals for own in objects])
    sample = np.linspace(0, len(bins) - 1, min(_SAMPLE, len(bins))).astype(int)
    rng = np.random.default_rng(config.seed)
    triplets = random_triplets(bins[sample] != NONE, config.triplets, rng)
    boundaries = equal_frequency_boundaries(distances[sample], triplets, config.depth_bins)
    chosen, entropies = most_informative(distances[sample], bins[sample], triplets, boundaries, config.tables)
    counts = [len(own) for own in objects]
    of_objects = np.repeat(np.arange(len(objects), dtype=np.int32), counts)
    starts, ids = _filled(distances, bins, of_objects, chosen, boundaries)
    return HashTables(
        triplets=chosen,
        boundaries=boundaries,
        starts=starts,
        ids=ids,
        objects=of_objects,
        firsts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        entropies=entropies,
    )


def random_triplets(valid: Bool[np.ndarray, "t g"], count: int, rng: np.random.Generator) -> Integer[np.ndarray, "q 3"]:
    """Different triplets of reference points, each drawn from those that some template drawn at random covers.

    Drawn from the whole grid, hardly any would lie on thin objects.
    """
    drawn = rng.integers(len(valid), size=4 * count)
    ranks = np.where(valid[drawn], rng.random((len(drawn), valid.shape[1])), 2.0).argpartition(2, axis=1)[:, :3]
    ranks = ranks[np.take_along_axis(valid[drawn], ranks, axis=1).all(axis=1)]
    ranks = rng.permuted(ranks, axis=1)
    _, first = np.unique(np.sort(ranks, axis=1), axis=0, return_index=True)
    found = ranks[np.sort(first)][:count]
    if not len(found):  # nothing to tell apart
        found = np.array([[0, 1, 2]])
    return np.ascontiguousarray(found, np.int32)


def equal_frequency_boundaries(
    distances: Integer[np.ndarray, "t g"], triplets: Integer[np.ndarray, "q 3"], bins: int
) -> Float[np.ndarray, "b"]:
    """Boundaries (metres) between which the templates' depth differences d_i - d_1 fall equally often."""
    differences = []
    for first, *others in triplets[:500]:
        a = distances[:, first]
        for other in others:
            b = distances[:, other]
            both = (a != NO_DISTANCE) & (b != NO_DISTANCE)
            differences.append(b[both].astype(np.int32) - a[both])
    found = np.concatenate(differences) * DISTANCE_UNIT
    if not len(found):
        return np.zeros(bins - 1)
    return np.quantile(found, np.arange(1, bins) / bins)


def keys_of(
    distances: Integer[np.ndarray, "t g"],
    bins: Integer[np.ndarray, "t g"],
    triplet: Integer[np.ndarray, "3"],
    boundaries: Float[np.ndarray, "b"],
) -> Integer[np.ndarray, "t"]:
    """Hash key of each template in the table of a triplet, -1 where the feature vector is not valid."""
    depth = distances[:, triplet]
    normal = bins[:, triplet].astype(np.int64)
    valid = (depth != NO_DISTANCE).all(axis=1) & (normal != NONE).all(axis=1)
    differences = (depth[:, 1:].astype(np.int32) - depth[:, :1]) * DISTANCE_UNIT
    quantized = np.searchsorted(boundaries, differences, side="right")
    count = len(boundaries) + 1
    key = (((quantized[:, 0] * count + quantized[:, 1]) * NORMAL_BINS + normal[:, 0]) * NORMAL_BINS + normal[:, 1]) * (
        NORMAL_BINS
    ) + normal[:, 2]
    return np.where(valid, key, -1)


def surprisal(keys: Integer[np.ndarray, "t"]) -> Float[np.ndarray, "t"]:
    """Bits that a table tells about each template: -log2 of the share of its key, 0 without valid features.

    Their mean is the entropy of the quantized measurements, where invalid ones tell nothing.
    """
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    return np.where(keys >= 0, -np.log2(counts[inverse] / len(keys)), 0.0)


def most_informative(
    distances: Integer[np.ndarray, "t g"],
    bins: Integer[np.ndarray, "t g"],
    triplets: Integer[np.ndarray, "q 3"],
    boundaries: Float[np.ndarray, "b"],
    count: int,
) -> tuple[Integer[np.ndarray, "h 3"], Float[np.ndarray, "h"]]:
    """The triplets with large joint entropy of their quantized measurements, and these entropies (bits), best first.

    The first has the largest entropy. For each next one, a template counts the less the more bits the tables before
    have about it, so that all templates are told apart, also those that cover few reference points. No reference point
    is used much more often than others as long as there is a choice, or an occluder in the middle would hide all.
    """
    bits = np.array([surprisal(keys_of(distances, bins, triplet, boundaries)) for triplet in triplets], np.float32)
    entropies = bits.mean(axis=1)
    most = -(-MOST_USES * 3 * count // distances.shape[1])
    uses = np.zeros(distances.shape[1], int)
    known = np.zeros(bits.shape[1], np.float32)
    chosen: list[int] = []
    for _ in range(min(count, len(triplets))):
        gains = bits @ (1 / (1 + known / ENOUGH_BITS)) if chosen else entropies.copy()
        gains[(uses[triplets] >= most).any(axis=1)] -= 100.0 * bits.shape[1]
        gains[chosen] = -np.inf
        chosen.append(int(gains.argmax()))
        uses[triplets[chosen[-1]]] += 1
        known += bits[chosen[-1]]
    return triplets[chosen], entropies[chosen].astype(float)


def _filled(
    distances: np.ndarray, bins: np.ndarray, objects: np.ndarray, triplets: np.ndarray, boundaries: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The tables as lists of templates, one after the other: (starts, ids).

    With a list per object, voting passes over the objects that are not looked for.
    """
    count = int(objects.max(initial=0)) + 1
    keys = (len(boundaries) + 1) ** 2 * NORMAL_BINS**3
    starts = np.zeros(len(triplets) * keys * count + 1, np.int32 if bins.size < 2**31 else np.int64)
    ids, filled = [], 0
    for h, triplet in enumerate(triplets):
        key = keys_of(distances, bins, triplet, boundaries)
        valid = np.flatnonzero(key >= 0)
        in_list = key[valid] * count + objects[valid]
        ids.append(valid[np.argsort(in_list, kind="stable")].astype(np.uint16 if len(bins) <= 2**16 else np.int32))
        ends = np.cumsum(np.bincount(in_list, minlength=keys * count))
        starts[1 + h * keys * count : 1 + (h + 1) * keys * count] = filled + ends
        filled += len(valid)
    return starts, np.concatenate(ids)
