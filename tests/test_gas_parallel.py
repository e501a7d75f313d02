"""Gas on many ranks: the fields, totals, logs and errors of one rank."""

import subprocess

import numpy as np
import pytest
from gas_scenes import AIR, PAIRS, SIDES, advance, blast, box, even_box, jump, totals, walls
from small_scene import Alone, command

import fempm
from coupling import Flow, Inflow, Outflow, Periodic, SlipWall, SubsonicInflow, flow, pressure
from fempm import SimulationError
from fempm.parallel import Ranks, RemoteError

# isort: split
from mpi4py import MPI

COMM = MPI.COMM_WORLD
SIZES = {1: 80, 2: 14, 3: 4}


@pytest.fixture(autouse=True)
def tight_solves(monkeypatch):
    """Ranks may stop an iteration apart; here far below what is compared: only the order of sums counts."""
    monkeypatch.setattr(pressure, "RTOL", 1e-10)


def scene(d, pair="B1-B0", ends="walls", **options):
    """A ball of dense gas in a box with heavy gas, closed, open or periodic."""
    mesh = (even_box if ends == "periodic" else box)(d, SIZES[d])
    kinds = {
        "walls": walls(d),
        "open": [SlipWall("left"), *(Outflow(name) for pair in SIDES[:d] for name in pair if name != "left")],
        "periodic": [Periodic(*pair) for pair in SIDES[:d]],
        "inflow": [Inflow("left", 1.0, 1.0, mach=2.0), Outflow("right"), *walls(d)[2:]],
        "slow inflow": [SubsonicInflow("left", 0.2, 0.1, mach=0.4), Outflow("right"), *walls(d)[2:]],
    }
    return Flow(mesh, AIR, blast, kinds[ends], pair=pair, **options)


def alone(monkeypatch, *args, **options):
    """The same scene on this rank only."""
    with monkeypatch.context() as patch:
        patch.setattr(flow, "Ranks", Alone)
        return scene(*args, **options)


def compare(many, one, tolerance=1e-8):
    """Fields and totals, over the largest entry."""
    a, b = one.vertex_fields(), many.vertex_fields()
    for name in ("density", "velocity", "pressure", "mach", "schlieren"):
        scale = np.abs(a[name]).max() * (10 if name in ("mach", "schlieren") else 1)
        np.testing.assert_allclose(b[name], a[name], rtol=0, atol=tolerance * scale, err_msg=name)
    assert totals(many) == pytest.approx(totals(one), rel=0, abs=tolerance * np.abs(totals(one)).max())
    assert many.time == pytest.approx(one.time, rel=tolerance)
    assert (many.steps, many.repeated) == (one.steps, one.repeated)


CASES = [(d, pair, ends) for d in (1, 2, 3) for pair in PAIRS for ends in ("walls", "periodic")]
CASES += [(d, "B1-B0", ends) for d in (1, 2, 3) for ends in ("open", "inflow", "slow inflow")]


@pytest.mark.mpi
@pytest.mark.parametrize("d, pair, ends", CASES)
def test_same_as_on_one_rank(d, pair, ends, monkeypatch):
    """50 steps, 15 in 3D: to 1e-8; only the order of sums differs."""
    options = {"gravity": -np.eye(d)[-1]} if ends == "walls" else {}
    many, one = scene(d, pair, ends, **options), alone(monkeypatch, d, pair, ends, **options)
    steps = 50 if d < 3 else 15
    until = 0.3
    for gas in (many, one):
        for _ in range(steps):
            gas.dt = min(gas.stable_step(), until / 20)
            gas.step(gas.dt)
    compare(many, one)
    assert np.linalg.norm(one.vertex_fields()["velocity"], axis=1).max() > 0.1
    cells = COMM.allgather(len(many.part.cells))
    assert sum(cells) == len(many.mesh.cells) and min(cells) > 0.5 * max(cells)


@pytest.mark.mpi
@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d", [1, 2, 3])
def test_conservation(d, pair):
    """Mass and energy in a closed box to 1e-12, across the borders between ranks."""
    gas = scene(d, pair)
    before = totals(gas)
    advance(gas, 10)
    assert np.abs(totals(gas)[[0, -1]] / before[[0, -1]] - 1).max() < 1e-12


@pytest.mark.mpi
def test_run_with_output(tmp_path, monkeypatch):
    """Log and frames of a run on all ranks are those of a run alone; the first rank writes them."""
    folder = Ranks().broadcast(lambda: tmp_path)
    record = fempm.run(scene(2), 0.1, folder / "many", frames=2, log_every=1, progress=False)
    if COMM.rank == 0:
        assert (folder / "many.xdmf").exists() and (folder / "many.csv").exists()
    one = alone(monkeypatch, 2)
    log = fempm.run(one, 0.1, frames=2, log_every=1, progress=False).log
    for name in ("time", "mass", "energy", "momentum_x", "least_density", "least_pressure"):
        scale = np.abs(log[name]).max()
        np.testing.assert_allclose(record.log[name], log[name], rtol=0, atol=1e-8 * scale, err_msg=name)
    _, fields = record.frames[-1]
    for name in ("density", "velocity", "pressure"):
        np.testing.assert_allclose(fields[name], one.vertex_fields()[name], rtol=0, atol=1e-8, err_msg=name)


@pytest.mark.mpi
def test_errors_on_all_ranks(tmp_path, monkeypatch):
    """Positivity lost on one rank ends the run on all of them."""
    monkeypatch.setattr(flow, "SMALLEST", 1.0)  # it may not repeat the step, which helps here
    mesh = fempm.interval_mesh(np.linspace(0, 1, 101))
    gas = Flow(mesh, AIR, jump((1, -40, 1e-9), (1, 40, 1e-9)), walls(1), limiter="weno")
    with pytest.raises((SimulationError, RemoteError), match="last state in"):
        fempm.run(gas, 5e-3, Ranks().broadcast(lambda: tmp_path) / "lost", progress=False)
    COMM.barrier()


@pytest.mark.slow
@pytest.mark.skipif(COMM.size > 1, reason="starts MPI itself")
def test_three_ranks():
    """Some of the tests above marked mpi."""
    start, env = command(3)
    end = ["-m", "pytest", "-q", "-x", "-m", "mpi", "-k", "B1-B0-walls or errors", __file__]
    done = subprocess.run([*start, *end], env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
