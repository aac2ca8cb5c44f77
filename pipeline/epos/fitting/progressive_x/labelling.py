"""Inliers by energies that know about neighbours: graph cut for one pose, alpha-expansion for several (compiled).

With K = max(0, 1 - e^2 / tau_r^2) the kernel of the re-projection error, a label costs 1 - K for an inlier and K for an
outlier, and a pair of neighbours costs lambda for different labels, lambda times the mean of these costs for equal ones
(GC-RANSAC, Barath & Matas 2018). lambda is a given weight over the mean number of neighbours: with the thesis's graph
they are a hundred and more, most of them alternatives that the pose does not explain, and outvote any inlier otherwise.
"""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import compiled
from pipeline.epos.fitting.progressive_x.max_flow import min_cost_labels

_MOST_CYCLES = 20
"""Rounds over all labels; two to four are usual until the energy falls no more."""


@compiled()
@no_type_check
def pair_weight(adjacency, coherence):
    """Weight of one pair of neighbours."""
    directed = len(adjacency.node)
    return coherence * (len(adjacency.first) - 1) / directed if directed > 0 else 0.0


@compiled()
@no_type_check
def label_inliers(adjacency, square, tau, coherence):
    """Inliers of one pose by graph cut.

    Args:
        adjacency: the neighbours.
        square: (n,) squared re-projection errors.
        tau: inlier threshold, pixels.
        coherence: weight of all neighbours together.

    Returns:
        (n,) bool.

    """
    kernel = np.maximum(0.0, 1.0 - square / (tau * tau))
    weight = pair_weight(adjacency, coherence)
    cost_out, cost_in = kernel.copy(), 1.0 - kernel
    for v in range(len(square)):
        for e in range(adjacency.first[v], adjacency.first[v + 1]):
            # A pair costs E00, E11 for equal labels and E01, E10 for different ones. That is (E10 - E01 - E00 + E11) / 2
            # for label 1 at one end, the like at the other, and (E01 + E10 - E00 - E11) / 2 if the labels differ.
            cost_in[v] += 0.5 * weight * (1.0 - kernel[v] - kernel[adjacency.node[e]])
    between = np.full(len(adjacency.node), 0.5 * weight)
    return min_cost_labels(adjacency, cost_out, cost_in, between)


@compiled()
@no_type_check
def expand(adjacency, costs, labels, weight):
    """Lower the energy of labels by alpha-expansion until no expansion does (PEARL: Isack & Boykov 2012).

    Args:
        adjacency: the neighbours.
        costs: (labels, n) cost of each label at each correspondence.
        labels: (n,) int64, changed.
        weight: cost of a pair of neighbours with different labels.

    Returns:
        The energy.

    """
    energy = _energy(adjacency, costs, labels, weight)
    for _ in range(_MOST_CYCLES):
        before = energy
        for alpha in range(len(costs)):
            trial = _expanded(adjacency, costs, labels, weight, alpha)
            value = _energy(adjacency, costs, trial, weight)
            if value < energy - 1e-6:
                labels[:] = trial
                energy = value
        if energy >= before:
            break
    return energy


@compiled()
@no_type_check
def _energy(adjacency, costs, labels, weight):
    total = 0.0
    for v in range(len(labels)):
        total += costs[labels[v], v]
        for e in range(adjacency.first[v], adjacency.first[v + 1]):
            if labels[adjacency.node[e]] != labels[v]:
                total += 0.5 * weight
    return total


@compiled()
@no_type_check
def _expanded(adjacency, costs, labels, weight, alpha):
    """Labels of least energy of those in which each is kept or becomes alpha."""
    keep, change = np.empty(len(labels)), np.empty(len(labels))
    between = np.empty(len(adjacency.node))
    for v in range(len(labels)):
        keep[v], change[v] = costs[labels[v], v], costs[alpha, v]
        for e in range(adjacency.first[v], adjacency.first[v + 1]):
            other = labels[adjacency.node[e]]
            both = weight if labels[v] != other else 0.0
            mine = weight if labels[v] != alpha else 0.0
            theirs = weight if other != alpha else 0.0
            change[v] += 0.5 * (theirs - mine - both)  # as in label_inliers, with label 1 for changed
            between[e] = 0.5 * (mine + theirs - both)
    changed = min_cost_labels(adjacency, keep, change, between)
    return np.where(changed, alpha, labels)
