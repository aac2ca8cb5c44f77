"""Maximum flow, graph cut and alpha-expansion against SciPy, NetworkX and trying all labellings; the neighbourhood graph."""

from itertools import product

import networkx
import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_flow
from scipy.spatial import cKDTree

from pipeline.epos.fitting.progressive_x.labelling import expand, label_inliers, pair_weight
from pipeline.epos.fitting.progressive_x.max_flow import Adjacency, make_adjacency, max_flow, min_cost_labels
from pipeline.epos.fitting.progressive_x.neighbourhood import make_neighbourhood

TAU = 4.0


def random_graph(rng: np.random.Generator, nodes: int, edges: int) -> Adjacency:
    pairs = np.sort(rng.integers(0, nodes, (edges, 2)), axis=1)
    pairs = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0)
    return make_adjacency(nodes, pairs)


def edges_of(graph: Adjacency) -> list[tuple[int, int, int]]:
    """(node, neighbour, entry), each pair in both directions."""
    nodes = range(len(graph.first) - 1)
    return [(v, int(graph.node[e]), e) for v in nodes for e in range(graph.first[v], graph.first[v + 1])]


def cut_value(graph: Adjacency, balance: np.ndarray, capacity: np.ndarray, sinks: np.ndarray) -> int:
    within = sum(int(capacity[e]) for v, w, e in edges_of(graph) if not sinks[v] and sinks[w])
    return within + int(balance[(balance > 0) & sinks].sum()) - int(balance[(balance < 0) & ~sinks].sum())


@pytest.mark.parametrize("seed", range(25))
def test_the_flow_is_that_of_scipy_and_its_cut_is_as_large(seed: int):
    rng = np.random.default_rng(seed)
    nodes = int(rng.integers(2, 60))
    graph = random_graph(rng, nodes, int(rng.integers(1, 4 * nodes)))
    balance, capacity = rng.integers(-60, 60, nodes), rng.integers(0, 40, len(graph.node))
    matrix = np.zeros((nodes + 2, nodes + 2), np.int32)
    matrix[nodes, :nodes], matrix[:nodes, nodes + 1] = np.maximum(balance, 0), np.maximum(-balance, 0)
    for v, w, e in edges_of(graph):
        matrix[v, w] = capacity[e]
    wanted = maximum_flow(csr_matrix(matrix), nodes, nodes + 1).flow_value
    flow, sinks = max_flow(graph, balance.copy(), capacity.copy())
    assert flow == wanted == cut_value(graph, balance, capacity, sinks)


def test_the_flow_of_a_large_grid_is_that_of_networkx():
    """As an image has: long paths, equal capacities, many ties."""
    rng = np.random.default_rng(1)
    side = 30
    at = np.arange(side * side).reshape(side, side)
    right, down = np.stack([at[:, :-1], at[:, 1:]], -1), np.stack([at[:-1], at[1:]], -1)
    graph = make_adjacency(side * side, np.concatenate([right.reshape(-1, 2), down.reshape(-1, 2)]))
    balance, capacity = rng.integers(-9, 10, side * side), np.full(len(graph.node), 2)
    theirs = networkx.DiGraph()
    theirs.add_edges_from((v, w, {"capacity": 2}) for v, w, _ in edges_of(graph))
    for v, value in enumerate(balance.tolist()):
        theirs.add_edge(*(("source", v) if value > 0 else (v, "sink")), capacity=abs(value))
    assert max_flow(graph, balance.copy(), capacity)[0] == networkx.maximum_flow_value(theirs, "source", "sink")


@pytest.mark.parametrize("seed", range(20))
def test_binary_labels_are_the_cheapest_of_all(seed: int):
    rng = np.random.default_rng(seed)
    graph = random_graph(rng, 9, 20)
    costs, between = rng.uniform(0, 1, (2, 9)), rng.uniform(0, 0.4, len(graph.node))

    def total(labels: np.ndarray) -> float:
        pairs = sum(between[e] for v, w, e in edges_of(graph) if labels[v] == 0 and labels[w] == 1)
        return float(costs[labels.astype(int), np.arange(9)].sum() + pairs)

    least = min(total(np.array(labels)) for labels in product([0, 1], repeat=9))
    assert total(min_cost_labels(graph, costs[0], costs[1], between)) == pytest.approx(least, abs=1e-4)


@pytest.mark.parametrize("seed", range(10))
def test_inliers_have_the_least_energy_of_gc_ransac(seed: int):
    rng = np.random.default_rng(seed)
    graph, square = random_graph(rng, 9, 18), rng.uniform(0, 1.6 * TAU**2, 9)
    kernel, weight = np.maximum(0.0, 1 - square / TAU**2), pair_weight(graph, 1.0)

    def total(labels: np.ndarray) -> float:
        single = np.where(labels, 1 - kernel, kernel).sum()
        mean = {(v, w): (kernel[v] + kernel[w]) / 2 for v, w, _ in edges_of(graph) if v < w}
        pairs = (1.0 if labels[v] != labels[w] else (1 - m if labels[v] else m) for (v, w), m in mean.items())
        return float(single + weight * sum(pairs))

    least = min(total(np.array(labels)) for labels in product([False, True], repeat=9))
    assert total(label_inliers(graph, square, TAU, 1.0)) == pytest.approx(least, abs=1e-4)


def test_without_coherence_inliers_are_those_of_an_error_below_tau_over_root_two():
    """Where the kernel is above one half, an inlier is the cheaper label."""
    square = np.random.default_rng(2).uniform(0, 2 * TAU**2, 200)
    labels = label_inliers(random_graph(np.random.default_rng(3), 200, 900), square, TAU, 0.0)
    np.testing.assert_array_equal(labels, square < TAU**2 / 2)


@pytest.mark.parametrize("seed", range(10))
def test_expansion_is_within_its_bound_of_the_best_of_all_labellings(seed: int):
    rng = np.random.default_rng(seed)
    graph, costs, weight = random_graph(rng, 7, 12), rng.uniform(0, 1, (3, 7)), 0.2

    def total(labels: np.ndarray) -> float:
        pairs = sum(weight / 2 for v, w, _ in edges_of(graph) if labels[v] != labels[w])
        return float(costs[labels, np.arange(7)].sum() + pairs)

    labels = np.full(7, 2)
    energy = expand(graph, costs, labels, weight)
    best = min(total(np.array(each)) for each in product(range(3), repeat=7))
    assert energy == pytest.approx(total(labels), abs=1e-9)
    assert best - 1e-4 <= energy <= 2 * best  # Boykov, Veksler & Zabih: a factor of two for Potts
    for alpha in range(3):  # no expansion lowers it
        for change in product([False, True], repeat=7):
            assert total(np.where(change, alpha, labels)) >= energy - 1e-4


def test_expansion_of_one_pose_against_outliers_is_exact():
    rng = np.random.default_rng(4)
    graph, costs = random_graph(rng, 10, 22), rng.uniform(0, 1, (2, 10))
    labels = np.full(10, 1)
    energy = expand(graph, costs, labels, 0.3)
    pairs = [(v, w) for v, w, _ in edges_of(graph) if v < w]

    def total(each: tuple[int, ...]) -> float:
        return sum(costs[k, v] for v, k in enumerate(each)) + 0.3 * sum(each[v] != each[w] for v, w in pairs)

    assert energy == pytest.approx(min(map(total, product([0, 1], repeat=10))), abs=1e-4)


def test_neighbours_are_those_nearer_than_the_radius_in_pixels_and_centimetres():
    rng = np.random.default_rng(5)
    pixels, points = rng.uniform(0, 200, (700, 2)), rng.uniform(-0.1, 0.1, (700, 3))
    graph = make_neighbourhood(pixels, points, 20.0)
    wanted = cKDTree(np.hstack([pixels, 100 * points])).query_pairs(20.0)
    assert len(wanted) > 2000
    assert {(v, w) for v, w, _ in edges_of(graph) if v < w} == wanted


def test_a_graph_of_correspondences_in_one_place_stays_of_a_size_that_fits_in_memory():
    crowd = np.random.default_rng(6).uniform(0, 30, (6000, 2))
    for pixels in (crowd, np.zeros((6000, 2))):  # 18 million pairs
        graph = make_neighbourhood(pixels, np.zeros((6000, 3)), 20.0)
        assert 100_000 < len(graph.node) <= 8_000_000
