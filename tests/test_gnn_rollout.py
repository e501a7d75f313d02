"""Rollouts and errors of small networks on fields with closed forms."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from benchmarks.gnn_accuracy import trained
from gnn_decay import DECAY, config, decaying, exact, square

from gnn.rollout import evaluate, rollout, write_rollout
from gnn.samples import Meshes, find_trajectories
from gnn.train import Training, load_predictor, train
from gnn.trajectory import Trajectory, write_trajectory


@pytest.fixture(autouse=True)
def one_thread():
    """As in the benchmarks: sums do not depend on the number of threads."""
    torch.set_num_threads(1)


def test_rollout_with_the_exact_step(tmp_path):
    """The closed form leaves no error; frozen walls are off by what they should have changed by."""
    c = config(decaying(tmp_path))
    training = Training(c, tmp_path / "out")
    predictor, meshes = exact(training.predictor), training.held_out
    states, _, _ = rollout(predictor, meshes, 0)
    truth = np.array([meshes.state(0, k) for k in range(8)])
    np.testing.assert_allclose(states, truth, atol=1e-6)
    found = evaluate(predictor, meshes)
    assert found["rmse_1"] < 1e-6 and found["rmse_all"] < 1e-6
    learned = meshes.learned(0)
    # after k steps persistence is off by (1 - DECAY^k) of the start
    size = np.sqrt(np.mean(truth[0][learned].astype(float) ** 2))
    np.testing.assert_allclose(found["persistence_last"], size * (1 - DECAY**7), rtol=1e-5)
    frozen, _, _ = rollout(predictor, meshes, 0, boundary="frozen")
    np.testing.assert_array_equal(frozen[-1][~learned], truth[0][~learned])
    with pytest.raises(ValueError, match="boundary 'open'"):
        rollout(predictor, meshes, 0, boundary="open")


def test_row_of_the_benchmark(tmp_path):
    """Training in a process of its own ends with the errors of the checkpoint that it leaves."""
    folder, out = decaying(tmp_path / "data"), tmp_path / "out"
    row = trained(folder, out, 0.01, latent=8, depth=2, held_out=1)
    predictor = load_predictor(out)
    meshes = Meshes(find_trajectories(folder)[-1:], predictor.config, predictor.length)
    found = evaluate(predictor, meshes, every=10)
    assert row["steps"] > 0 and row["parameters"] == sum(p.numel() for p in predictor.parameters())
    for name in ("rmse_1", "rmse_all", "persistence_50"):
        assert row[name] == pytest.approx(found[name], rel=1e-4)


def test_direct_fields_are_scored_and_written(tmp_path):
    """A pressure of three times the first component, predicted off by 0.1: so say the errors and the file."""
    graph = square(np.random.default_rng(4))
    values = graph.points * DECAY ** np.arange(5)[:, None, None]
    fields = {"velocity": values, "pressure": 3 * values[:, :, 0]}
    for i in range(2):
        write_trajectory(tmp_path / f"{i}.xdmf", graph, np.arange(5.0), fields)
    c = config(tmp_path, direct=("pressure",), held_out=1)
    training = Training(c, tmp_path / "out")
    predictor, meshes, learned = training.predictor, training.held_out, training.held_out.learned(0)
    predictor.step = lambda batch, state, motion=None: (DECAY * state, 3 * DECAY * state[:, :1] + 0.1)
    found = evaluate(predictor, meshes)
    assert found["rmse_1"] < 1e-6 and found["rmse_pressure"] == pytest.approx(0.1, abs=1e-6)
    assert found["rmse_velocity"] < 1e-6
    for name, value in fields.items():
        changes = np.diff(value, axis=0)[:, learned]
        assert found[f"persistence_{name}"] == pytest.approx(np.sqrt(np.mean(changes**2)), rel=1e-5)
    states, directs, _ = rollout(predictor, meshes, 0, 3, start=1)
    written = Trajectory(write_rollout(tmp_path / "rollout.xdmf", meshes, 0, states, directs, start=1))
    for k, error in enumerate([0.0, 0.1, 0.1, 0.1]):
        np.testing.assert_allclose(written.read("pressure_error", k), error, atol=1e-6)
        np.testing.assert_allclose(written.read("pressure_truth", k), 3 * values[1 + k, :, 0], atol=1e-6)


def test_command_line(tmp_path, capsys):
    """Train, evaluate and roll out by the commands of the README; the files are read by other programs."""
    meshio = pytest.importorskip("meshio")
    from matplotlib.image import imread

    from gnn.__main__ import main

    folder, out = decaying(tmp_path / "data"), str(tmp_path / "out")
    options = ["--latent", "8", "--depth", "2", "--steps", "4", "--batch", "1", "--held-out", "1"]
    main(["train", "--data", str(folder), "--out", out, *options])
    main(["evaluate", out, str(folder), "--steps", "3"])
    found = json.loads("{" + capsys.readouterr().out.split("{")[1])
    assert {"rmse_1", "rmse_50", "rmse_all", "persistence_1"} <= set(found)
    main(["rollout", out, str(folder), "--out", out, "--gif"])
    with meshio.xdmf.TimeSeriesReader(Path(out) / "rollout.xdmf") as reader:
        reader.read_points_cells()
        assert reader.num_steps == 8
        _, fields, _ = reader.read_data(7)
    error = fields["velocity"] - fields["velocity_truth"]
    np.testing.assert_allclose(fields["velocity_error"], error, atol=1e-6)
    assert imread(Path(out) / "rollout_velocity.png").std() > 0.05  # not one colour
    assert (Path(out) / "rollout_velocity.gif").stat().st_size > 1000


def test_evaluate_leaves_out_what_was_trained_on(tmp_path, capsys):
    """Of the data of the training only the last trajectories count, of other data all do."""
    from gnn.__main__ import main

    data, out = decaying(tmp_path / "data"), tmp_path / "out"
    train(config(data, steps=2), out)
    main(["evaluate", str(out), str(data)])
    assert "not trained on" in capsys.readouterr().err
    main(["evaluate", str(out), str(data), "--all"])
    assert capsys.readouterr().err == ""
