"""Message passing, transitions, BSMS-GNN and the networks it is compared with."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import Delaunay
from torch.nn import functional as F

from gnn import message_passing
from gnn.batch import LevelGraph, join, single
from gnn.contact import contact_edges
from gnn.edge_sum import EdgeSum
from gnn.graph import from_cells
from gnn.hierarchy import build_hierarchy
from gnn.message_passing import MessagePassing, edge_set, edge_sums
from gnn.models import MODELS, make_model
from gnn.transitions import TABLES

ROUND = 2e-5  # float32 sums in another order, through about ten normalised layers
DEPTH = 3
# grids so fine that the last one of a small mesh has edges too
CASES = [(name, {"dx": 1.0} if name == "ms_gnn_grid" else {}) for name in MODELS]
CASES += [("bsms", {"transition": t}) for t in TABLES if t != "contribution"]
CASES += [("bsms", {"edge_latents": True, "repeats": 2, "correction": True})]
LABELS = [" ".join([n, *map(str, o.values())]) for n, o in CASES]


@pytest.fixture(autouse=True)
def one_thread_and_seed():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    yield
    torch.set_num_threads(before)


def mesh(n=60, seed=0, aspect=2.0):
    """Delaunay mesh of random points, edges of about length one."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, np.sqrt([n * aspect, n / aspect]), (n, 2))
    return from_cells(points, Delaunay(points).simplices)


def batch_of(graph, depth=DEPTH, deformed=False, radius=0.0):
    """GraphBatch; deformed: bent so far that some nodes come close to others."""
    hierarchy = build_hierarchy(graph.edges, graph.points, depth)
    world = contact = None
    if deformed:
        x, y = graph.points.T
        world = np.stack([np.abs(x - x.mean()), y], axis=1)
        contact = contact_edges(world, graph.edges, radius)
        assert len(contact) > 5
    return single(graph, hierarchy, world=world, contact=contact)


def features_of(batch, columns=5, seed=1):
    return torch.randn(len(batch.node_type), columns, generator=torch.Generator().manual_seed(seed))


def model_of(name, **options):
    return make_model(
        name, **({"num_inputs": 5, "num_outputs": 2, "dim": 2, "depth": DEPTH, "latent": 32} | options)
    )


def gradients(model, batch, x):
    """Output, and gradients with respect to the features and all parameters."""
    x = x.clone().requires_grad_()
    model.zero_grad()
    out = model(batch, x)
    (out * torch.linspace(-1, 1, out.numel()).reshape(out.shape)).sum().backward()
    return [out.detach(), x.grad] + [p.grad.clone() for p in model.parameters() if p.grad is not None]


def assert_close(a, b, tolerance=ROUND):
    """Differences below a tolerance relative to the largest entry."""
    assert torch.isfinite(a).all() and (a - b).abs().max() <= tolerance * b.abs().max().clamp_min(1e-3)


def test_published_number_of_parameters():
    """1,785,730 with three scalar inputs, as published; a one-hot type changes the encoder only."""

    def count(inputs):
        model = make_model("bsms", num_inputs=inputs, num_outputs=2, dim=2, depth=6)
        return sum(p.numel() for p in model.parameters())

    assert count(3) == 1_785_730
    assert count(2 + 9) == 1_785_730 + 8 * 128


def test_split_first_layer_is_the_whole_network():
    """Sum over edges against the MLP of [offsets, receiver, sender] edge by edge, to rounding (1e-5)."""
    batch = batch_of(mesh())
    level, v = batch.levels[0], features_of(batch, 32)
    edges = edge_set(level.senders, level.receivers, batch.material)
    mlp = MessagePassing(32, (3,)).edges[0]
    rows = torch.cat([edges.offsets, v[level.receivers], v[level.senders]], dim=1)
    whole = torch.stack([mlp(rows[level.receivers == i]).sum(0) for i in range(len(v))])
    assert_close(edge_sums(mlp, v, edges)[0], whole, 1e-5)
    with pytest.raises(ValueError, match=f"features of 3 nodes for a graph of {len(v)}"):
        edge_sums(mlp, v[:3], edges)
    parts = v[:, :10], v[:, 10:15], v[:, 15:]
    nodes = message_passing.MLP(32, 7, 32, normalised=False)
    assert_close(nodes.after_first(nodes.split(*parts)), nodes(v), 1e-5)


@pytest.mark.parametrize("fused", [True, False])
def test_messages_stay_on_the_edges(fused, monkeypatch):
    """Pfaff et al. 2020: e' = e + mlp([e, v_i, v_j]), terms of a sum; without e yet, they alone."""
    batch = batch_of(mesh())
    v, level = features_of(batch, 32), batch.levels[0]
    edges = edge_set(level.senders, level.receivers, batch.material)
    if not fused:
        monkeypatch.setattr(message_passing, "fused", lambda v: False)
    for width, latents in (3, None), (32, torch.randn(len(level.senders), 32)):
        mlp = MessagePassing(32, (width,)).edges[0]
        own = edges.offsets if latents is None else latents
        terms = mlp(torch.cat([own, v[level.receivers], v[level.senders]], dim=1))
        sums, kept = edge_sums(mlp, v, edges, latents, keep=True)
        assert_close(kept, terms if latents is None else latents + terms, 1e-5)
        assert_close(sums, torch.zeros_like(v).index_add_(0, level.receivers, terms), 1e-5)


def test_offsets_point_to_the_sender():
    x = torch.tensor([[0.0, 0.0], [3.0, 4.0]])
    edges = edge_set(torch.tensor([1]), torch.tensor([0]), x)
    assert edges.offsets.tolist() == [[3.0, 4.0, 5.0]]


def test_gradients_of_the_edge_sum(monkeypatch):
    """Against differences, in several chunks, with a node that receives nothing at the start and the end."""
    monkeypatch.setattr(message_passing, "CHUNK", 4)
    senders, receivers = torch.tensor([[2, 0, 3, 1, 0, 1, 2, 4, 0, 3], [1, 1, 1, 2, 2, 3, 3, 3, 3, 3]])
    edges = edge_set(senders, receivers, torch.rand(5, 2, dtype=torch.float64))
    assert len(edges.chunks) > 1
    shapes = (10, 3), (5, 4), (5, 4), (4, 3), (4, 4), (4,), (3, 4), (3,)
    inputs = [torch.randn(s, dtype=torch.float64, requires_grad=True) for s in shapes]
    assert torch.autograd.gradcheck(lambda *x: EdgeSum.apply(edges, True, False, *x)[0], inputs)
    assert torch.autograd.gradcheck(lambda *x: EdgeSum.apply(edges, True, True, *x), inputs)
    assert torch.autograd.gradcheck(lambda *x: EdgeSum.apply(edges, True, True, *x)[1], inputs)


@pytest.mark.parametrize("name, own", CASES, ids=LABELS)
def test_fused_and_plain_sums_agree(name, own, monkeypatch):
    """The same model through EdgeSum and through torch's own layers, to rounding; also without gradients.

    In float64: in float32 rounding turns a ReLU or two on or off.
    """
    batch, model = batch_of(mesh()), model_of(name, **own).double()
    monkeypatch.setattr(message_passing, "CHUNK", 50)
    batch, x = replace(batch, material=batch.material.double()), features_of(batch).double()
    fused = gradients(model, batch, x)
    with torch.no_grad():
        assert_close(model(batch, x), fused[0], 1e-12)
        assert torch.isnan(model(batch, torch.full_like(x, torch.nan))).all()
    monkeypatch.setattr(message_passing, "fused", lambda v: False)
    for a, b in zip(fused, gradients(model, batch, x)):
        assert_close(a, b, 1e-12)


@pytest.mark.parametrize("edge_latents", [False, True])
def test_checkpointing_gives_the_same_gradients(edge_latents):
    own = {"transition": "learnable", "edge_latents": edge_latents}
    batch, model = batch_of(mesh()), model_of("bsms", **own)
    again = model_of("bsms", checkpointing=True, **own)
    again.load_state_dict(model.state_dict())
    x = features_of(batch)
    for a, b in zip(gradients(model, batch, x), gradients(again, batch, x)):
        assert torch.equal(a, b)


@pytest.mark.parametrize("deformed", [False, True], ids=["rest", "contact"])
@pytest.mark.parametrize("name, own", CASES, ids=LABELS)
def test_every_parameter_and_feature_counts(name, own, deformed):
    """Forward and backward: all gradients are there and finite, and no layer's is zero all over."""
    batch = batch_of(mesh(), deformed=deformed, radius=0.8)
    model = model_of(name, contact=deformed, world=deformed, **own)
    out, *grads = gradients(model, batch, features_of(batch))
    assert out.shape == (60, 2) and torch.isfinite(out).all()
    assert len(grads) == 1 + len(list(model.parameters()))
    for g, (label, _) in zip(grads, [("features", None), *model.named_parameters()]):
        assert torch.isfinite(g).all() and g.any(), label


@pytest.mark.parametrize("name, own", CASES, ids=LABELS)
def test_two_meshes_at_once(name, own):
    """Meshes of different sizes, one of which cannot be pooled as often, one by one and in one batch."""
    batches = [batch_of(mesh(60, 0), 5), batch_of(mesh(9, 3), 5)]
    assert len(batches[1].levels) < len(batches[0].levels)
    model = model_of(name, depth=5, **own)
    apart = torch.cat([model(b, features_of(b)) for b in batches])
    x = torch.cat([features_of(b) for b in batches])
    assert_close(model(join(batches), x), apart)


def permuted(batch, order):
    """A batch whose finest level has its nodes in another order: node k is `order[k]` of the old one."""
    new = torch.argsort(order)
    fine = batch.levels[0]

    def ends(senders, receivers):
        senders, receivers = new[senders], new[receivers]
        by = torch.argsort(receivers * len(order) + senders)
        return senders[by], receivers[by]

    down = new[fine.down[0]], *fine.down[1:]
    contact = None if fine.contact is None else ends(*fine.contact)
    level = LevelGraph(*ends(fine.senders, fine.receivers), fine.num_nodes, down, new[fine.kept], contact)
    moved = {k: v[order] for k, v in vars(batch).items() if isinstance(v, torch.Tensor)}
    return replace(batch, levels=[level, *batch.levels[1:]], **moved)


@pytest.mark.parametrize("name", MODELS)
def test_order_of_nodes_does_not_matter(name):
    batch = batch_of(mesh(), deformed=True, radius=0.8)
    model = model_of(name, contact=True, world=True)
    x, order = features_of(batch), torch.randperm(60)
    assert_close(model(permuted(batch, order), x[order]), model(batch, x)[order])


@pytest.mark.parametrize("name", MODELS)
def test_translation_changes_nothing(name):
    """By numbers that float32 adds to the positions without rounding: multiples of 2^-10."""
    batch = batch_of(mesh(), deformed=True, radius=0.8)
    batch = replace(batch, material=(batch.material * 1024).round() / 1024)
    moved = replace(batch, material=batch.material + torch.tensor([8.0, -4.0]), world=batch.world + 16.0)
    model, x = model_of(name, contact=True, world=True), features_of(batch)
    assert_close(model(moved, x), model(batch, x), 10 * ROUND)


def test_offsets_in_space_matter():
    """Not only their lengths: a mesh and its mirror image differ."""
    batch = batch_of(mesh())
    mirrored = replace(batch, material=batch.material * torch.tensor([-1.0, 1.0]))
    model, x = model_of("bsms"), features_of(batch)
    assert (model(mirrored, x) - model(batch, x)).abs().max() > 1e-2


def test_components_do_not_see_each_other():
    """One mesh of two bodies a hair apart; MS-GNN-Grid, whose cells hold both, is the counterexample."""
    left, right = mesh(40, 0), mesh(40, 1)
    shift = [left.points[:, 0].max() - right.points[:, 0].min() + 0.01, 0.0]
    graph = from_cells(
        np.concatenate([left.points, right.points + shift]), np.concatenate([left.cells, right.cells + 40])
    )
    batch = batch_of(graph)
    x = features_of(batch)
    other = x.clone()
    other[40:] += 1.0
    for name in ("bsms", "meshgraphnets", "ms_gnn_grid"):
        model = model_of(name)
        change = (model(batch, other) - model(batch, x))[:40].abs().max()
        assert change > 1e-4 if name == "ms_gnn_grid" else change == 0


def test_information_crosses_the_mesh_with_the_levels():
    """A change at one end reaches the other through coarse levels, but not through as many flat steps."""
    graph = from_cells(np.arange(64.0)[:, None], np.stack([np.arange(63), np.arange(1, 64)], axis=1))
    batch = batch_of(graph, 5)
    x = features_of(batch)
    other = x.clone()
    other[0] += 1.0
    for name, own, far in (("bsms", {}, True), ("meshgraphnets", {"steps": 11}, False)):
        model = model_of(name, dim=1, depth=5, **own)
        assert bool((model(batch, other) - model(batch, x))[-1].any()) is far


@pytest.mark.parametrize("kind", ["contribution", "graph_conv", "position_kernel"])
def test_tables_keep_constants_downwards(kind):
    """Columns of weights sum to one (1e-6: rounding), and up is the transpose of down."""
    batch = batch_of(mesh())
    level = batch.levels[0]
    table = TABLES[kind](level, batch.material)
    assert_close(table.down(torch.ones(60, 1)), torch.ones(len(level.kept), 1), 1e-6)
    a, b = torch.randn(60, 3), torch.randn(len(level.kept), 3)
    assert_close((table.down(a) * b).sum(), (a * table.up(b)).sum(), 1e-5)


def test_position_kernel_prefers_what_is_close():
    """Two neighbours of a kept node at distances 1 and 3: weights 3/4 and 1/4."""
    down = torch.tensor([0, 2]), torch.tensor([0, 0]), torch.tensor([0.5, 0.5])
    ends = torch.tensor([1, 0, 2, 1]), torch.tensor([0, 1, 1, 2])
    level = LevelGraph(*ends, 3, down, torch.tensor([1]))
    x = torch.tensor([[0.0], [1.0], [4.0]])
    table = TABLES["position_kernel"](level, x)
    assert torch.allclose(table.values, torch.tensor([0.75, 0.25]))
    assert TABLES["none"](level, x).up(torch.ones(1, 1))[:, 0].tolist() == [0.0, 1.0, 0.0]


def test_repeats():
    """Three message passings more, two on the finest level and one on the coarsest, all of them in use."""
    batch = batch_of(mesh())
    once, twice = model_of("bsms"), model_of("bsms", repeats=2)
    sizes = [sum(p.numel() for p in model.parameters()) for model in (once, twice, once.bottom)]
    assert sizes[1] == sizes[0] + 3 * sizes[2]
    twice(batch, features_of(batch)).square().sum().backward()
    assert all(p.grad is not None and p.grad.abs().max() > 0 for p in twice.parameters())


@pytest.mark.parametrize("correction", [False, True])
def test_what_comes_up_from_the_coarser_level(correction):
    """What the first message passing on the way up and the decoder are given, from what the others return."""
    batch, model = batch_of(mesh(), depth=1), model_of("bsms", depth=1, correction=correction)
    given, returned = {}, {}
    parts = {"down": model.down[0][0], "bottom": model.bottom[0], "up": model.up[0][0], "out": model.decoder}
    for name, part in parts.items():

        def note(_, args, result, name=name):
            given[name], returned[name] = args[0], result[0]

        part.register_forward_hook(note)
    model(batch, features_of(batch))
    level, skip = batch.levels[0], returned["down"]
    change = returned["bottom"] - given["bottom"] if correction else returned["bottom"]
    below = TABLES["contribution"](level, batch.material).up(change)
    assert torch.equal(given["up"], skip + below if correction else below)
    assert torch.equal(given["out"], returned["up"] if correction else skip + returned["up"])


def test_coarser_levels_that_change_nothing_correct_nothing():
    """With their message passings turned off, all levels below the finest leave its latents as they were."""
    batch, model = batch_of(mesh()), model_of("bsms", edge_latents=True, correction=True)
    off = [passing for way in (model.down, model.up) for level in way[1:] for passing in level]
    for passing in [*off, *model.bottom]:
        torch.nn.init.zeros_(passing.nodes.last.weight)
        torch.nn.init.zeros_(passing.nodes.last.bias)
    seen = {}
    model.down[0][0].register_forward_hook(lambda _, args, result: seen.update(before=result[0]))
    model.up[0][0].register_forward_hook(lambda _, args, result: seen.update(after=args[0]))
    model(batch, features_of(batch))
    assert torch.equal(seen["before"], seen["after"])


def test_autocast():
    """bfloat16 has 8 bits: outputs stay within a few percent of float32's."""
    batch, model = batch_of(mesh()), model_of("bsms")
    x = features_of(batch)
    with torch.autocast("cpu", torch.bfloat16):
        low = model(batch, x)
        F.mse_loss(low.float(), torch.zeros_like(low, dtype=torch.float32)).backward()
    assert_close(low.float(), model(batch, x), 0.05)
    assert all(torch.isfinite(p.grad).all() for p in model.parameters())


def test_top_scores_of_each_graph():
    from gnn.graph_unets import highest

    score = torch.tensor([0.1, 0.9, 0.5, 0.3, 0.2, 0.8])
    assert highest(score, torch.tensor([0, 0, 0, 0, 1, 1]), 0.5).tolist() == [1, 2, 5]


@pytest.mark.parametrize(
    "what, words",
    [
        (lambda: make_model("cnn"), "model 'cnn'"),
        (lambda: model_of("bsms", transition="magic"), "transition 'magic'"),
        (lambda: model_of("ms_gnn_grid", dx=0.0), "dx > 0"),
        (lambda: model_of("graph_unets", ratio=1.5), "ratio 1.5"),
        (lambda: model_of("bsms", world=True)(batch_of(mesh()), torch.zeros(60, 5)), "positions `world`"),
        (lambda: model_of("bsms", contact=True)(batch_of(mesh()), torch.zeros(60, 5)), "contact=True"),
    ],
)
def test_errors(what, words):
    with pytest.raises(ValueError, match=words):
        what()
