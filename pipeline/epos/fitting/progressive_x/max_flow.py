"""Binary labelling of a graph at least cost by maximum flow (Dinic's algorithm, compiled).

Each edge joins two nodes; its reverse is the entry `Adjacency.reverse`. Capacities are integers, so the flow is exact;
`min_cost_labels` scales costs to them.
"""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import compiled

_SCALE = 1_000_000
"""Integer units in a cost of 1."""


class Adjacency(NamedTuple):
    """A graph of n nodes and m pairs of neighbours, each pair stored in both directions."""

    first: np.ndarray
    """(n + 1,) where the neighbours of each node begin."""
    node: np.ndarray
    """(2m,) neighbours."""
    reverse: np.ndarray
    """(2m,) where the same pair stands in the other direction."""


@compiled()
@no_type_check
def make_adjacency(count, pairs):
    """Adjacency of `count` nodes from (m, 2) pairs of neighbours."""
    first = np.zeros(count + 1, np.int64)
    for e in range(len(pairs)):
        first[pairs[e, 0] + 1] += 1
        first[pairs[e, 1] + 1] += 1
    for v in range(count):
        first[v + 1] += first[v]
    node, reverse = np.empty(2 * len(pairs), np.int64), np.empty(2 * len(pairs), np.int64)
    at = first[:-1].copy()
    for e in range(len(pairs)):
        a, b = pairs[e, 0], pairs[e, 1]
        node[at[a]], node[at[b]] = b, a
        reverse[at[a]], reverse[at[b]] = at[b], at[a]
        at[a] += 1
        at[b] += 1
    return Adjacency(first, node, reverse)


@compiled()
@no_type_check
def min_cost_labels(adjacency, cost_0, cost_1, cost):
    """Labels 0 or 1 of nodes at least total cost.

    Args:
        adjacency: the graph.
        cost_0: (n,) cost of label 0.
        cost_1: (n,) cost of label 1.
        cost: (2m,) cost of label 0 at the node and 1 at its neighbour, not negative.

    Returns:
        (n,) bool.

    """
    capacity = np.empty(len(cost), np.int64)
    for e in range(len(cost)):
        capacity[e] = np.int64(np.rint(cost[e] * _SCALE))
    balance = np.empty(len(cost_0), np.int64)
    for v in range(len(cost_0)):
        # Label 1 is the side of the sink: what flows from the source through v into the sink is spent either way.
        balance[v] = np.int64(np.rint((cost_1[v] - cost_0[v]) * _SCALE))
    return max_flow(adjacency, balance, capacity)[1]


@compiled()
@no_type_check
def max_flow(adjacency, balance, capacity):
    """Push as much as possible from nodes of positive balance, the sources, to nodes of negative balance, the sinks.

    Args:
        adjacency: the graph.
        balance: (n,) int64, changed to what is left.
        capacity: (2m,) int64, changed to what is left.

    Returns:
        The flow, and (n,) bool: True for nodes that no source reaches any more, the side of the sinks.

    """
    first, count = adjacency.first, len(balance)
    level, next_edge, stack = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    path = np.empty(count, np.int64)
    total = np.int64(0)
    while _levels(adjacency, balance, capacity, level, stack):
        for v in range(count):
            next_edge[v] = first[v]
        for v in range(count):
            if balance[v] > 0:
                total += _push(adjacency, balance, capacity, level, next_edge, path, v)
    return total, level < 0


@compiled()
@no_type_check
def _levels(adjacency, balance, capacity, level, queue):
    """Steps of each node from the sources (-1: not reached); True if a sink is reached."""
    first, node = adjacency.first, adjacency.node
    head, tail, reached = 0, 0, False
    for v in range(len(balance)):
        level[v] = -1
        if balance[v] > 0:
            level[v] = 0
            queue[tail] = v
            tail += 1
    while head < tail:
        v = queue[head]
        head += 1
        reached |= balance[v] < 0
        for e in range(first[v], first[v + 1]):
            if capacity[e] > 0 and level[node[e]] < 0:
                level[node[e]] = level[v] + 1
                queue[tail] = node[e]
                tail += 1
    return reached


@compiled()
@no_type_check
def _push(adjacency, balance, capacity, level, next_edge, path, source):
    """Push what a source has along paths of rising level; return how much reached sinks."""
    first, node, reverse = adjacency.first, adjacency.node, adjacency.reverse
    pushed, depth, v = np.int64(0), 0, source
    while balance[source] > 0:
        if balance[v] < 0:
            flow = min(balance[source], -balance[v])
            for i in range(depth):
                flow = min(flow, capacity[path[i]])
            balance[source] -= flow
            balance[v] += flow
            pushed += flow
            for i in range(depth):
                capacity[path[i]] -= flow
                capacity[reverse[path[i]]] += flow
            depth, v = 0, source
            continue
        e = next_edge[v]
        while e < first[v + 1] and not (capacity[e] > 0 and level[node[e]] == level[v] + 1):
            e += 1
        next_edge[v] = e
        if e < first[v + 1]:
            path[depth] = e
            depth += 1
            v = node[e]
        elif v == source:
            break
        else:
            level[v] = -2  # a dead end until the next levels
            depth -= 1
            v = node[reverse[path[depth]]]
    return pushed
