"""Coupled scenes on many ranks, restarts, files and the log."""

import subprocess
from pathlib import Path

import meshio
import numpy as np
import pytest
from coupled_scenes import advance, block_in_blast
from small_scene import Alone, command

import fempm
from coupling import pressure

# isort: split
from mpi4py import MPI

COMM = MPI.COMM_WORLD


CASES = [
    {"dim": 1},
    {"dim": 2},
    {"dim": 3, "h": 0.15},
    {"dim": 2, "pair": "B2-B1"},
    {"dim": 2, "scheme": "euler", "openness": "ball"},
]


@pytest.fixture(autouse=True)
def tight_solves(monkeypatch):
    """The preconditioner knows the cells of one rank alone: ranks differ by what the solver leaves."""
    monkeypatch.setattr(pressure, "RTOL", 1e-13)


@pytest.mark.mpi
@pytest.mark.parametrize("options", CASES, ids=str)
def test_ranks(options, monkeypatch):
    """20 steps on all ranks and on one: the same fields and particles, to round-off times 1e3."""
    options = {"material": fempm.NeoHookean(3.0, 50.0, 0.3 if options["dim"] > 1 else 0.0), **options}
    many = block_in_blast(**options)
    with monkeypatch.context() as patch:
        for module in ("coupling.flow", "fempm.solver"):
            patch.setattr(f"{module}.Ranks", Alone)
        one = block_in_blast(**options)
    for _ in range(20):
        one.step(5e-3)
        many.step(5e-3)
    a, b = one.vertex_fields(), many.vertex_fields()
    for name, field in a.items():
        np.testing.assert_allclose(
            b[name], field, rtol=0, atol=1e-10 * max(1, np.abs(field).max()), err_msg=name
        )
    np.testing.assert_allclose(many.gather("position"), one.gather("position"), rtol=0, atol=1e-12)
    start, end = one.summary(), many.summary()
    for name in ("mass", "energy", "momentum_x", "gas", "ghost"):
        assert end[name] == pytest.approx(start[name], rel=1e-10, abs=1e-10), name


@pytest.mark.mpi
@pytest.mark.parametrize("options", [{"dim": 2}, {"dim": 2, "pair": "B2-B1"}], ids=str)
def test_restart(options, tmp_path_factory):
    """What goes on from a checkpoint is bit by bit what never stopped."""
    folder = COMM.bcast(tmp_path_factory.mktemp("restart") if COMM.rank == 0 else None)
    scene = block_in_blast(**options)
    advance(scene, 0.05)
    scene.save(folder / "state.h5")
    other = block_in_blast(**options)
    other.load(folder / "state.h5")
    for _ in range(5):
        for s in (scene, other):
            s.dt = s.stable_step()
            s.step(s.dt)
    np.testing.assert_array_equal(other.U, scene.U)
    np.testing.assert_array_equal(other.theta, scene.theta)
    np.testing.assert_array_equal(other.gather("position"), scene.gather("position"))
    assert other.summary() == scene.summary()
    stiffer = block_in_blast(**options, ghost_modulus=1e4)
    with pytest.raises(fempm.CheckpointError, match="coupling"):
        stiffer.load(folder / "state.h5")


@pytest.mark.skipif(COMM.size > 1, reason="starts MPI itself")
def test_checkpoint_on_other_ranks(tmp_path):
    """Written by two ranks, taken up by one: the same to round-off."""
    program = (
        "from coupled_scenes import advance, block_in_blast\n"
        f"scene = advance(block_in_blast(), 0.05); scene.save({str(tmp_path / 'two.h5')!r})\n"
    )
    start, env = command(2)
    env = env | {"PETSC_OPTIONS": "-ksp_rtol 1e-13"}
    subprocess.run([*start, "-c", program], env=env, check=True, timeout=200, cwd=Path(__file__).parent)
    scene = block_in_blast()
    scene.load(tmp_path / "two.h5")
    whole = advance(block_in_blast(), 0.05)
    assert scene.time == whole.time and scene.steps == whole.steps
    np.testing.assert_allclose(scene.U, whole.U, rtol=0, atol=1e-10)
    np.testing.assert_allclose(advance(scene, 0.06).U, advance(whole, 0.06).U, rtol=0, atol=1e-10)


def test_files(tmp_path):
    """Particles and fields of the gas in XDMF files that meshio reads, the log beside them."""
    scene = block_in_blast()
    record = fempm.run(scene, until=0.05, frames=2, output=tmp_path / "blast", progress=False)
    particles, fields, log = record.files
    with meshio.xdmf.TimeSeriesReader(fields) as series:
        series.read_points_cells()
        assert series.num_steps == 3
        time, at_points, _ = series.read_data(2)
    assert time == pytest.approx(0.05)
    assert {"density", "velocity", "pressure", "mach", "schlieren", "solid"} == set(at_points)
    assert np.array_equal(at_points["solid"], record.vertex_frames[2][1]["solid"])
    reader = meshio.xdmf.TimeSeriesReader(particles)
    reader.mesh_grid = reader.collection[2]
    assert np.array_equal(reader.read_points_cells()[0][:, :2], record.frames[2][1])
    columns = np.genfromtxt(log, names=True, delimiter=",")
    needed = {
        "mass",
        "energy",
        "gas",
        "kinetic",
        "elastic",
        "ghost",
        "momentum_x",
        "least_density",
        "iterations",
    }
    assert needed <= set(columns.dtype.names)
    parts = sum(columns[name] for name in ("gas", "kinetic", "elastic", "gravity", "ghost"))
    np.testing.assert_allclose(columns["energy"], parts, rtol=1e-12)
