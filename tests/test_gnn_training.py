"""Training of small networks on fields with closed forms."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from gnn_decay import SMALL, config, decaying, square

from gnn.config import preset
from gnn.graph import HANDLE, NORMAL, OBSTACLE, from_cells
from gnn.rollout import evaluate
from gnn.samples import Meshes, drawn, find_trajectories, make_sample
from gnn.train import BadCheckpoint, Training, load_predictor, read_checkpoint, train
from gnn.trajectory import write_trajectory


@pytest.fixture(autouse=True)
def one_thread():
    """As in the benchmarks: sums do not depend on the number of threads."""
    torch.set_num_threads(1)


def test_targets_take_the_noise_back(tmp_path):
    """State and target add up to the true next frame; noise is on predicted nodes only, as large as asked."""
    c = config(decaying(tmp_path), noise=(0.5,))
    meshes = Meshes(find_trajectories(c.data), c)
    sample = make_sample(meshes, 0, 3, np.random.default_rng(1))
    noise = sample.state.numpy() - meshes.state(0, 3)
    np.testing.assert_allclose((sample.state + sample.target).numpy(), meshes.state(0, 4), atol=1e-6)
    learned = sample.learned.numpy()
    assert np.all(noise[~learned] == 0)
    # the deviation of n normal numbers is known to 1 / sqrt(2 n): four of these
    assert abs(noise[learned].std() / 0.5 - 1) < 4 / np.sqrt(2 * noise[learned].size)


def test_normalisation(tmp_path):
    """That of the inputs is the mean and the deviation over all frames, by NumPy."""
    c = config(decaying(tmp_path))
    training = Training(c, tmp_path / "out")
    states = np.concatenate(
        [training.meshes.state(i, k) for i in range(len(training.meshes)) for k in range(7)]
    ).astype(float)
    np.testing.assert_allclose(training.predictor.mean_in, states.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(training.predictor.deviation_in, states.std(axis=0), rtol=1e-5)


def test_drawing_by_size_leaves_the_mean_loss_and_scatters_less(tmp_path):
    """Weighted losses of what 200 epochs draw, against the mean over all samples, to four standard errors.

    A network that says "nothing changes" is off by the targets, which fall by DECAY from frame to frame.
    """
    training = Training(config(decaying(tmp_path, frames=20), noise=(1e-3,)), tmp_path / "out")
    shares, rng = training.shares, np.random.default_rng(0)
    mean, deviation = (getattr(training.predictor, f"{name}_out") for name in ("mean", "deviation"))

    def loss(i, k):
        sample = make_sample(training.meshes, int(i), int(k))
        return (((sample.target - mean) / deviation)[sample.learned] ** 2).mean().item()

    losses = np.array([loss(i, k) for i, k in training.frames])
    weighted = losses / (len(losses) * shares)
    epochs = np.array([drawn(shares, rng.random()) for _ in range(200)])
    assert epochs.shape[1] == len(losses)
    found = weighted[epochs].mean(axis=1)
    assert abs(found.mean() - losses.mean()) < 4 * found.std() / np.sqrt(len(epochs))
    scatter = np.sqrt(np.sum(shares * (weighted - losses.mean()) ** 2))
    assert scatter < 0.7 * losses.std()  # by the square root of losses alone, without a least share: 0.64
    chosen = training.sample(5)
    assert chosen.weight.unique().numel() == 1 and 0 < chosen.weight[0] < 11
    assert chosen.weight[0].item() == pytest.approx((weighted / losses)[training.order[1][5]], rel=1e-6)


def test_training_learns_a_decay(tmp_path):
    """After 300 steps a step is five times, and a rollout twice, as good as persistence on an unseen mesh.

    Persistence is off by 1 - DECAY = 20 % of the field in a step: 4 % are left.
    """
    c = config(decaying(tmp_path, 5), steps=300, latent=32, depth=1, batch=4, rate=3e-3, noise=(1e-3,))
    predictor = train(c, tmp_path / "out")
    training = Training(c, tmp_path / "other")
    found = evaluate(predictor, training.held_out)
    assert found["rmse_1"] < found["persistence_1"] / 5
    assert found["rmse_last"] < found["persistence_last"] / 2
    rows = [json.loads(line) for line in (tmp_path / "out/log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == list(range(1, 301))
    assert np.mean([r["loss"] for r in rows[-20:]]) < 0.1 * np.mean([r["loss"] for r in rows[:20]])


def test_compiled_training_is_the_same(tmp_path, monkeypatch):
    """A training step through torch.compile, which traces meshes of any size as one graph: to rounding.

    Without the last stage of the compiler, which takes a minute.
    """
    compiled = torch.nn.Module.compile
    traced = {"backend": "aot_eager", "fullgraph": True}
    monkeypatch.setattr(torch.nn.Module, "compile", lambda self, **own: compiled(self, **own, **traced))
    data, losses = decaying(tmp_path), []
    for choice in (False, True):
        training = Training(config(data, depth=1, compile=choice), tmp_path / "out")
        losses.append([training.train_step(0.5) for _ in range(3)])
    np.testing.assert_allclose(*losses, rtol=1e-5)
    counts = torch._dynamo.utils.counters
    assert counts["stats"]["unique_graphs"] == 1 and not counts["graph_break"]


def test_resumed_training_is_the_same(tmp_path):
    """Stopped after 6 of 12 steps and gone on with: the same parameters, bit by bit."""
    c = config(decaying(tmp_path), steps=12)
    whole = Training(c, tmp_path / "whole").run()
    first = Training(c, tmp_path / "parts")
    first.progress = lambda: first.step / 6
    rate = first.train_step
    first.train_step = lambda done: rate(first.step / 12)
    first.run()
    second = Training(c, tmp_path / "parts")
    second.load()
    assert second.step == 6
    for a, b in zip(whole.state_dict().values(), second.run().state_dict().values()):
        assert torch.equal(a, b)


def test_no_denormal_numbers(tmp_path):
    """What the momentum of a dead unit decays to, below the least normal number 1.2e-38, is zero."""
    torch.set_flush_denormal(False)
    assert torch.tensor(1e-38) * 0.95 > 0
    Training(config(decaying(tmp_path)), tmp_path / "out")
    assert torch.tensor(1e-38) * 0.95 == 0


def test_several_hierarchies(tmp_path):
    """Levels below a frame vary from draw to draw, as many as asked for, but not where errors are found."""
    paths = find_trajectories(decaying(tmp_path))

    def pooled(meshes, rng=None):
        return tuple(make_sample(meshes, 0, 0, rng).batch.levels[0].kept.tolist())

    for model, expected in (("bsms", 3), ("meshgraphnets", 1)):
        meshes = Meshes(paths, config(tmp_path, hierarchies=3, model=model))
        found = {pooled(meshes, np.random.default_rng(n)) for n in range(40)}
        assert len(found) == expected
        assert pooled(meshes) in found
        assert pooled(meshes) == pooled(Meshes(paths, config(tmp_path)))


WORKER = """
import os, sys, torch
torch.set_num_threads(1)
from gnn.config import Config
from gnn.train import Training
training = Training(Config(**eval(sys.argv[1])), sys.argv[2])
losses = [training.train_step(0.0)[0] for _ in range(3)]
if training.rank == 0:
    torch.save([losses, training.predictor.state_dict()], sys.argv[3])
training.close()
threads = [open(f"/proc/self/task/{i}/comm").read() for i in os.listdir("/proc/self/task")]
assert not any("gloo" in name for name in threads), threads
"""


@pytest.mark.slow
def test_two_processes_as_one(tmp_path):
    """torchrun on two processes: the losses and parameters of one with the joined batch, to round-off."""
    settings = {"data": str(decaying(tmp_path)), **SMALL, "batch": 4}
    worker = tmp_path / "worker.py"
    worker.write_text(WORKER)
    env = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1]), "OMP_NUM_THREADS": "1"}
    found = []
    for starter in ([], ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2"]):
        path = tmp_path / f"result{len(found)}.pt"
        command = [sys.executable, *starter, str(worker), repr(settings), str(tmp_path / "out"), str(path)]
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=200)
        assert done.returncode == 0, done.stderr
        found.append(torch.load(path))
    # losses of order 1 and parameters after three steps of 1e-3, in float32
    np.testing.assert_allclose(*(f[0] for f in found), rtol=1e-5)
    for a, b in zip(*(f[1].values() for f in found)):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=2e-5)


def test_bodies_that_deform(tmp_path):
    """Prescribed motion of the obstacle is an input, contact edges join the bodies, the body learns."""
    rng, frames = np.random.default_rng(2), 6
    graph = square(rng, 30)
    shift = np.array([1.02, 0.0])
    points = np.concatenate([graph.points, graph.points + shift])
    types = np.concatenate([np.full(len(graph.points), NORMAL), np.full(len(graph.points), OBSTACLE)])
    types[graph.points[:, 0].argmin()] = HANDLE
    both = from_cells(points, np.concatenate([graph.cells, graph.cells + len(graph.points)]), types)
    moved = np.where(types == OBSTACLE, -0.02, 0.0)[:, None] * [1.0, 0.0]
    x = points + np.arange(frames)[:, None, None] * moved
    for i in range(2):
        write_trajectory(tmp_path / f"{i}.xdmf", both, np.arange(frames), {"position": x})
    c = preset("plate", data=str(tmp_path), contact_radius=0.05, **{k: SMALL[k] for k in ("latent", "depth")})
    c.held_out, c.steps, c.batch = 1, 3, 2
    training = Training(c, tmp_path / "out")
    sample = training.sample(0)
    n = len(graph.points)
    np.testing.assert_allclose(sample.motion.numpy(), moved, atol=1e-6)
    senders, receivers = sample.batch.levels[0].contact
    assert len(senders) and torch.all((senders < n) != (receivers < n))
    assert len(sample.batch.levels[1].contact[0])
    assert np.isfinite(training.run().loss_terms(sample)[0].item())


def test_bad_input(tmp_path):
    """Wrong data, settings and checkpoints are named."""
    folder = decaying(tmp_path / "data", 2)
    with pytest.raises(FileNotFoundError, match="no \\*.xdmf"):
        Training(config(tmp_path / "none"), tmp_path / "out")
    with pytest.raises(ValueError, match="no field 'speed'"):
        Training(config(folder, fields=("speed",)), tmp_path / "out")
    with pytest.raises(ValueError, match="held_out 2"):
        Training(config(folder, held_out=2), tmp_path / "out")
    with pytest.raises(ValueError, match="noise"):
        config(folder, noise=(0.1, 0.2))
    with pytest.raises(ValueError, match="preset 'wing'"):
        preset("wing")
    training = Training(config(folder), tmp_path / "out")
    (tmp_path / "out").mkdir()
    training.save()
    other = Training(config(folder, latent=8), tmp_path / "out")
    with pytest.raises(BadCheckpoint, match="latent 16, not 8"):
        other.load()
    path = tmp_path / "out/checkpoint.pt"
    state = read_checkpoint(path)
    state["predictor"].popitem()
    torch.save(state, tmp_path / "partly.pt")
    with pytest.raises(BadCheckpoint, match="partly.pt: of another network"):
        load_predictor(tmp_path / "partly.pt")
    state["about"]["config"]["width"] = 3
    torch.save(state, tmp_path / "older.pt")
    with pytest.raises(BadCheckpoint, match="older.pt: of another version of gnn .*'width'"):
        load_predictor(tmp_path / "older.pt")
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(BadCheckpoint, match="cannot be read"):
        read_checkpoint(path)
    torch.save({"weights": 1}, path)
    with pytest.raises(BadCheckpoint, match="not a checkpoint"):
        load_predictor(path)


def test_memory_is_kept():
    """Arrays of 64 MB after each other: pages, 16,384 each, are mapped for the first few only."""
    program = (
        "import resource, torch; from gnn.train import keep_memory; keep_memory()\n"
        "faults = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "for _ in range(20): torch.ones(2**24)\n"
        "before = faults()\n"
        "for _ in range(20): torch.ones(2**24)\n"
        "print(faults() - before)"
    )
    done = subprocess.run([sys.executable, "-c", program], check=True, stdout=subprocess.PIPE, text=True)
    assert int(done.stdout) < 16_384


def test_mirrored_samples(tmp_path):
    """About half of the samples are mirrored, fields with them: they stay (x^2, x y) of the new positions."""
    graph = square(np.random.default_rng(3))
    x, y = graph.points.T
    field = np.stack([x**2, x * y], axis=1) * np.arange(1.0, 4)[:, None, None]
    fields = {"velocity": field, "pressure": field[:, :, 0] + 2}
    write_trajectory(tmp_path / "t.xdmf", graph, np.arange(3.0), fields)
    c = config(tmp_path, noise=(0.0,), mirror=(1,), direct=("pressure",))
    meshes, turned = Meshes(find_trajectories(c.data), c, length=0.5), 0
    for k in range(40):
        sample = make_sample(meshes, 0, 1, np.random.default_rng(k))
        x, y = 0.5 * sample.batch.material.T
        turned += bool((y <= 0).all())
        exact = torch.stack([x**2, x * y, 3 * x**2 + 2], dim=1)
        assert (sample.state - 2 * exact[:, :2]).abs().max() < 1e-6
        assert (sample.target - exact).abs().max() < 1e-6
    assert 10 < turned < 30  # 3.2 standard deviations
    with pytest.raises(ValueError, match="mirror"):
        Meshes(find_trajectories(c.data), config(tmp_path, mirror=(2,)))[0]


def test_a_loss_that_is_not_finite_ends_the_training(tmp_path):
    """With the step in the message, and without a checkpoint of what it has spoilt."""
    training = Training(config(decaying(tmp_path / "data"), rate=1e30, steps=50), tmp_path / "out")
    with pytest.raises(FloatingPointError, match="step"):
        training.run()
    assert not (tmp_path / "out/checkpoint.pt").exists()


def test_interrupt_ends_after_a_whole_step(tmp_path):
    """Ctrl-C while the matrices change: the step is finished, counted and saved."""
    training = Training(config(decaying(tmp_path / "data"), steps=50), tmp_path / "out")
    inner = training.optimizers[1].step

    def step():
        if training.step == 2:
            signal.raise_signal(signal.SIGINT)
        inner()

    training.optimizers[1].step = step
    training.run()
    state = read_checkpoint(tmp_path / "out/checkpoint.pt")
    assert training.step == state["step"] == 3
    for name, value in training.predictor.state_dict().items():
        assert torch.equal(value, state["predictor"][name])
