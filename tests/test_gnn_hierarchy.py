"""Bi-stride hierarchies: the claims of thesis 4.2 and 4.3.2, against dense matrices and brute force."""

from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.gnn_hierarchy import AUTHORS, channel, hierarchy_table
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, shortest_path
from scipy.spatial import Delaunay
from scipy.spatial.distance import cdist

from gnn.contact import contact_edges
from gnn.hierarchy import build_hierarchy, cached_hierarchy, contact_levels
from gnn.seeding import adjacency, close_center, find_clusters, min_average, random_seeds


def unique_edges(pairs):
    pairs = np.sort(np.reshape(pairs, (-1, 2)), axis=1)
    return np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0).astype(np.int32)


def random_graph(n, ne, seed):
    """ne random pairs: few are several clusters with lone nodes, many are one dense one."""
    rng = np.random.default_rng(seed)
    return rng.uniform(size=(n, 2)), unique_edges(rng.integers(n, size=(ne, 2)))


def mesh(n, d, seed):
    x = np.random.default_rng(seed).uniform(size=(n, d))
    cells = Delaunay(x).simplices
    return x, unique_edges([(c[i], c[j]) for c in cells for i in range(d + 1) for j in range(i)])


def union(*graphs):
    """Disjoint union."""
    starts = np.cumsum([0] + [len(x) for x, _ in graphs[:-1]])
    edges = np.concatenate([e + s for (_, e), s in zip(graphs, starts)]).astype(np.int32)
    return np.concatenate([x for x, _ in graphs]), edges


def shuffled(graph, seed=0):
    """With its nodes renumbered at random, so that clusters are not contiguous."""
    x, edges = graph
    place = np.random.default_rng(seed).permutation(len(x))
    return x[np.argsort(place)], unique_edges(place[edges])


def star(leaves):
    angle = 2 * np.pi * np.arange(leaves) / leaves
    x = np.append([[0.0, 0.0]], np.stack([np.cos(angle), np.sin(angle)], axis=1), axis=0)
    return x, unique_edges([(0, i + 1) for i in range(leaves)])


GRAPHS = {
    "mesh 2D": mesh(300, 2, 0),
    "mesh 3D": mesh(120, 3, 1),
    "path": (np.arange(41.0)[:, None], unique_edges([(i, i + 1) for i in range(40)])),
    "star": star(9),
    "random, dense": random_graph(70, 400, 2),
    "random, sparse": random_graph(200, 190, 3),
    "letters": shuffled(union(mesh(150, 2, 4), mesh(40, 2, 5), star(4), star(1), star(0), mesh(90, 2, 6))),
}
any_graph = pytest.mark.parametrize("name", GRAPHS)
top_up_or_not = pytest.mark.parametrize("top_up", [True, False])


def dense(edges, n):
    """(n, n) bool A."""
    A = np.zeros((n, n), bool)
    A[edges[:, 0], edges[:, 1]] = A[edges[:, 1], edges[:, 0]] = True
    return A


def components(edges, n):
    return connected_components(csr_matrix(dense(edges, n)), directed=False)


def pooled_pairs(hierarchy):
    """(level, next level) of a hierarchy that has some."""
    assert len(hierarchy.levels) > 1 or hierarchy.levels[0].num_nodes <= 10
    return list(zip(hierarchy.levels[:-1], hierarchy.levels[1:]))


def pooled_nodes(level):
    """(n,) bool, nodes of clusters that lose some."""
    count, label = components(level.edges, level.num_nodes)
    stay = np.bincount(label[level.kept], minlength=count)
    return (stay < np.bincount(label, minlength=count))[label]


@top_up_or_not
@any_graph
def test_connections_are_conserved(name, top_up):
    """Removed nodes have a kept neighbour (2-CC), clusters neither break nor meet nor end, A' is (4.1)."""
    points, edges = GRAPHS[name]
    hierarchy = build_hierarchy(edges, points, 9, top_up=top_up)
    for level, coarse in pooled_pairs(hierarchy):
        A = dense(level.edges, level.num_nodes)
        removed = np.setdiff1d(np.arange(level.num_nodes), level.kept)
        assert len(removed) and len(level.kept) == coarse.num_nodes
        assert A[np.ix_(removed, level.kept)].any(axis=1).all()
        count, label = components(level.edges, level.num_nodes)
        coarse_count, coarse_label = components(coarse.edges, coarse.num_nodes)
        assert coarse_count == count
        np.testing.assert_array_equal(
            coarse_label[np.unique(coarse_label, return_index=True)[1]], range(count)
        )
        assert len(set(zip(label[level.kept], coarse_label))) == count
        pooled = pooled_nodes(level)
        assert np.bincount(label)[np.unique(label[pooled])].min() > 2
        square = np.where(pooled[:, None], np.linalg.matrix_power(A + np.eye(len(A)), 2) > 0, A)
        square = square[np.ix_(level.kept, level.kept)] & ~np.eye(coarse.num_nodes, dtype=bool)
        np.testing.assert_array_equal(np.stack(np.nonzero(np.triu(square)), axis=1), coarse.edges)


@any_graph
def test_every_other_depth(name):
    """Of each cluster the parity with fewer nodes, even ones if equal; topped up half of all, with these."""
    points, edges = GRAPHS[name]
    n = len(points)
    distance = shortest_path(csr_matrix(dense(edges, n)), unweighted=True)
    start, adjacent = adjacency(edges, n)
    cluster, count = find_clusters(start, adjacent)
    seeds = min_average(cluster, count, start, adjacent)
    bare, full = (build_hierarchy(edges, points, 1, top_up=t).levels[0].kept for t in (False, True))
    every = np.arange(n)
    bare, full = (every if kept is None else kept for kept in (bare, full))
    for c, seed in enumerate(seeds):
        nodes = np.flatnonzero(cluster == c)
        odd = distance[seed, nodes] % 2 == 1
        fewer = nodes[odd] if 0 < odd.sum() < (~odd).sum() else nodes[~odd]
        expected = fewer if len(fewer) > 1 else nodes
        np.testing.assert_array_equal(np.intersect1d(bare, nodes), expected)
        topped = np.intersect1d(full, nodes)
        assert len(topped) == (len(nodes) // 2 if len(nodes) > 3 else len(nodes))
        assert np.isin(fewer, topped).all()


@top_up_or_not
@any_graph
def test_contribution_table(name, top_up):
    """Thesis 4.3.2 as it is written, with full matrices, weights and zeros at unpooled nodes.

    Tolerance: sums of at most a few hundred terms near one, in double precision.
    """
    points, edges = GRAPHS[name]
    rng, w = np.random.default_rng(0), np.ones(len(points))
    for level, coarse in pooled_pairs(build_hierarchy(edges, points, 9, top_up=top_up)):
        A = dense(level.edges, level.num_nodes).astype(float)
        A[~pooled_nodes(level)] = np.eye(len(A))[~pooled_nodes(level)]
        what = w[:, None] * A / A.sum(axis=1, keepdims=True)
        C = what / what.sum(axis=0)
        w = what.sum(axis=0)[level.kept]
        v, coarse_v = rng.normal(size=(len(A), 3)), rng.normal(size=(coarse.num_nodes, 3))
        unpooled = np.zeros_like(v)
        unpooled[level.kept] = coarse_v
        np.testing.assert_allclose(level.transfer.T @ v, (C.T @ v)[level.kept], atol=1e-12)
        np.testing.assert_allclose(level.transfer @ coarse_v, C @ unpooled, atol=1e-12)
        np.testing.assert_allclose(level.transfer.sum(axis=0), 1.0, rtol=1e-13)


@any_graph
def test_contact_is_conserved(name):
    """All four cases of the thesis' proof: ends of a contact edge have kept neighbours in contact, or one."""
    points, edges = GRAPHS[name]
    n, cases = len(points), set()
    contact = unique_edges(np.random.default_rng(7).integers(n, size=(n // 4, 2)))
    hierarchy = build_hierarchy(edges, points, 4)
    levels = contact_levels(hierarchy, contact)
    assert len(levels) == len(hierarchy.levels)
    np.testing.assert_array_equal(levels[0], contact)
    for (level, coarse), fine_c, coarse_c in zip(pooled_pairs(hierarchy), levels[:-1], levels[1:]):
        A = dense(level.edges, level.num_nodes) & pooled_nodes(level)
        near = (A | np.eye(len(A), dtype=bool))[:, level.kept]
        AC, ACc = dense(fine_c, len(A)), dense(coarse_c, coarse.num_nodes)
        for i, j in fine_c:
            ends = np.ix_(near[i], near[j])
            assert ACc[ends].any() or (near[i] == near[j]).all() and near[i].sum() == 1
            cases.add((i in level.kept, j in level.kept))
        spread = near.astype(int)
        expected = (spread.T @ AC @ spread > 0) & ~np.eye(coarse.num_nodes, dtype=bool)
        np.testing.assert_array_equal(ACc, expected)
        np.testing.assert_array_equal(coarse_c, unique_edges(coarse_c))
    assert len(cases) == 4 or name == "star"  # the star has ten nodes


def test_clusters_do_not_see_each_other():
    """The hierarchy of a union is the union of the hierarchies, small clusters handed on as they are."""
    parts = [mesh(150, 2, 4), star(3), mesh(40, 2, 5), star(0)]
    whole = build_hierarchy(union(*parts)[1], union(*parts)[0], 3).levels
    alone = [build_hierarchy(e, x, 3).levels for x, e in parts]
    for l, level in enumerate(whole):
        own = [levels[min(l, len(levels) - 1)] for levels in alone]
        edges = union(*[(np.zeros((a.num_nodes, 2)), a.edges) for a in own])[1]
        np.testing.assert_array_equal(level.edges, edges)


@any_graph
def test_seeds(name):
    """Against all distances of scipy: the least sum, and the least distance from the cluster's mean."""
    points, edges = GRAPHS[name]
    start, adjacent = adjacency(edges, len(points))
    cluster, count = find_clusters(start, adjacent)
    assert count == components(edges, len(points))[0]
    distance = shortest_path(csr_matrix(dense(edges, len(points))), unweighted=True)
    np.testing.assert_array_equal(np.isfinite(distance), cluster[:, None] == cluster)
    least = min_average(cluster, count, start, adjacent)
    centre = close_center(cluster, count, points)
    drawn = random_seeds(cluster, count, np.random.default_rng(1))
    for c in range(count):
        nodes = np.flatnonzero(cluster == c)
        assert least[c] == nodes[np.argmin(distance[np.ix_(nodes, nodes)].sum(axis=1))]
        far = np.linalg.norm(points[nodes] - points[nodes].mean(axis=0), axis=1)
        assert far[nodes == centre[c]] <= far.min() + 1e-14
        assert cluster[drawn[c]] == c


def test_least_sum_on_many_patches():
    """A channel with a hole of 1,900 nodes, 30 patches of searches; and its nodes at random."""
    points, edges = channel(0.019)
    for x, e in ((points, edges), shuffled((points, edges))):
        start, adjacent = adjacency(e, len(x))
        seed = min_average(*find_clusters(start, adjacent), start, adjacent)
        ones = csr_matrix((np.ones(len(e)), e.T), (len(x), len(x)))
        assert seed == np.argmin(shortest_path(ones, directed=False, unweighted=True).sum(axis=1))


def test_equal_sums():
    """On a ring all sums are equal, and the lowest node is taken however its nodes are numbered."""
    n = 300
    ring = np.zeros((n, 1)), unique_edges([(i, (i + 1) % n) for i in range(n)])
    for seed in range(3):
        start, adjacent = adjacency(shuffled(ring, seed)[1], n)
        assert min_average(*find_clusters(start, adjacent), start, adjacent) == [0]


def test_centres_of_coarse_levels():
    """Coarse levels are seeded where their own nodes are: as if a hierarchy began with them."""
    points, edges = GRAPHS["mesh 2D"]
    first, second, *_ = build_hierarchy(edges, points, 2, "close_center").levels
    again = build_hierarchy(second.edges, points[first.kept], 1, "close_center").levels[0]
    np.testing.assert_array_equal(again.kept, second.kept)


def test_sizes_of_a_mesh():
    """Half of the nodes to the end; without topping up the last levels collapse, as the design note says."""
    points, edges = channel(0.019)
    assert 1850 < len(points) < 1950
    sizes = [level.num_nodes for level in build_hierarchy(edges, points, 20).levels]
    np.testing.assert_array_equal(sizes[1:], np.array(sizes[:-1]) // 2)
    assert sizes[-1] in (2, 3)
    bare = [level.num_nodes for level in build_hierarchy(edges, points, 20, top_up=False).levels]
    np.testing.assert_allclose(np.divide(bare[1:4], bare[:3]), 0.5, atol=0.03)
    assert bare[-1] > 10 and len(bare) < len(sizes)
    assert len(build_hierarchy(edges, points, 2).levels) == 3
    assert build_hierarchy(edges, points, 0).levels[0].kept is None


def assert_equal(a, b):
    assert len(a.levels) == len(b.levels)
    for one, other in zip(a.levels, b.levels):
        assert one.num_nodes == other.num_nodes
        np.testing.assert_array_equal(one.edges, other.edges)
        assert (one.kept is None) == (other.kept is None)
        if one.kept is not None:
            np.testing.assert_array_equal(one.kept, other.kept)
            np.testing.assert_array_equal(one.transfer.toarray(), other.transfer.toarray())


@pytest.mark.parametrize("seeding", ["min_average", "close_center", "random"])
def test_same_again(seeding):
    points, edges = GRAPHS["letters"]
    one, two = (build_hierarchy(edges, points, 5, seeding, rng=np.random.default_rng(3)) for _ in range(2))
    assert_equal(one, two)


def test_cache(tmp_path):
    """The file is read, not made again, and belongs to one mesh and one choice of options."""
    points, edges = GRAPHS["letters"]
    graph = SimpleNamespace(points=points, edges=edges)
    made = cached_hierarchy(graph, 4, tmp_path / "new")
    assert_equal(made, build_hierarchy(edges, points, 4))
    (file,) = (tmp_path / "new").iterdir()
    before = file.stat().st_mtime_ns
    assert_equal(cached_hierarchy(graph, 4, tmp_path / "new", seeding="min_average"), made)
    assert file.stat().st_mtime_ns == before
    assert_equal(cached_hierarchy(graph, 4), made)
    cached_hierarchy(graph, 3, tmp_path / "new")
    cached_hierarchy(graph, 4, tmp_path / "new", top_up=False)
    graph.points = points + 1.0
    cached_hierarchy(graph, 4, tmp_path / "new")
    assert len(list((tmp_path / "new").iterdir())) == 4
    with pytest.raises(ValueError, match="random seeds"):
        cached_hierarchy(graph, 4, tmp_path, seeding="random", rng=np.random.default_rng(0))


def test_contact_edges():
    points, edges = GRAPHS["mesh 2D"]
    near = np.triu(cdist(points, points) <= 0.07, 1) & ~dense(edges, len(points))
    found = contact_edges(points, edges, 0.07)
    assert len(found) > 100 and found.dtype == np.int32
    np.testing.assert_array_equal(found, np.stack(np.nonzero(near), axis=1))
    assert contact_edges(points, edges, 1e-9).shape == (0, 2)
    none = build_hierarchy(edges, points, 2)
    assert [len(c) for c in contact_levels(none, np.empty((0, 2), np.int32))] == [0, 0, 0]
    with pytest.raises(ValueError, match="radius 0"):
        contact_edges(points, edges, 0)
    points = points.copy()
    points[7] = np.nan
    with pytest.raises(ValueError, match="node 7"):
        contact_edges(points, edges, 0.1)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"edges": np.array([[1, 0]])}, "lower node first"),
        ({"edges": np.array([[0, 1], [0, 1]])}, "occur once"),
        ({"edges": np.array([[0, 2], [0, 1]])}, "sorted"),
        ({"edges": np.array([[1, 1]])}, "lower node first"),
        ({"edges": np.array([[0, 9]])}, "there are 3"),
        ({"edges": np.array([[-1, 2]])}, "nodes -1"),
        ({"edges": np.array([[0.0, 1.0]])}, "integers"),
        ({"points": np.array([[0.0], [np.nan], [1.0]])}, "finite"),
        ({"points": np.empty((0, 2))}, "one row or more"),
        ({"seeding": "centre"}, "'centre'"),
        ({"seeding": "random"}, "default_rng"),
        ({"depth": -1}, "depth -1"),
    ],
)
def test_bad_input(change, message):
    good = {"edges": np.array([[0, 1], [1, 2]]), "points": np.arange(3.0)[:, None], "depth": 2}
    build_hierarchy(**good)
    with pytest.raises(ValueError, match=message):
        build_hierarchy(**good | change)


def test_table():
    """The benchmark runs, and its smallest mesh is the authors'."""
    rows = hierarchy_table(quick=True)
    assert [row["seeding"] for row in rows] == ["close_center", "min_average"]
    for row in rows:
        assert abs(row["nodes"] / next(iter(AUTHORS)) - 1) < 0.03
        assert row["cpu_s"] > 0 and row["peak_MB"] > 0 and row["coarsest"] < 30
