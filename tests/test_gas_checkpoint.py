"""Checkpoints of the gas: bit by bit on as many ranks, to the solver's tolerance on others, or refused."""

import subprocess

import h5py
import numpy as np
import pytest
from gas_scenes import AIR, PAIRS, SIDES, advance, blast, box, walls
from small_scene import command

import fempm
from coupling import Flow, IdealGas, Outflow, pressure
from fempm import CheckpointError
from fempm.parallel import Ranks


@pytest.fixture
def folder(tmp_path):
    """A temporary folder, the same on all ranks."""
    return Ranks().broadcast(lambda: tmp_path)


def scene(d=2, n=10, eos=AIR, ends=None, **options):
    """A ball of dense gas in a box that is open at the top."""
    ends = [*walls(d)[:-1], Outflow(SIDES[d - 1][1])] if ends is None else ends
    return Flow(box(d, n), eos, blast, ends, gravity=-np.eye(d)[-1], **options)


def state(gas):
    """Copies of all that a gas goes on from, on this rank."""
    return {"U": gas.U.copy(), "numbers": np.array([gas.time, gas.dt, gas.steps, gas.repeated])}


def assert_same(found, wanted):
    for name, array in wanted.items():
        np.testing.assert_array_equal(found[name], array, err_msg=name)


@pytest.mark.mpi
@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d, n", [(1, 50), (2, 10), (3, 3)])
def test_goes_on_bit_by_bit(folder, d, n, pair):
    """From the start, within the first steps that sound limits, and after them."""
    whole = scene(d, n, pair=pair)
    for steps in (0, 3, 9):
        advance(whole, steps - whole.steps) if steps else None
        whole.save(folder / f"{steps}.h5")
    advance(whole, 6)
    for steps in (0, 3, 9):
        parts = scene(d, n, pair=pair)
        advance(parts, 2)  # what it was before does not matter
        parts.load(folder / f"{steps}.h5")
        assert parts.steps == steps
        advance(parts, 15 - steps)
        assert_same(state(parts), state(whole))


@pytest.mark.mpi
def test_run_is_taken_up(folder):
    """A run with a checkpoint in its middle ends as the one that did not stop; so do its files."""
    options = {"every": 0.02, "log_every": 1, "progress": False}
    whole = scene()
    record = fempm.run(whole, 0.12, folder / "whole", **options)
    parts = scene()
    fempm.run(parts, 0.06, folder / "parts", checkpoint_every=1e9, **options)
    again = scene()
    restart = folder / "parts_checkpoint.h5"
    continued = fempm.run(again, 0.12, folder / "parts", restart=restart, **options)
    assert_same(state(again), state(whole))
    np.testing.assert_array_equal(continued.log["energy"][-1], record.log["energy"][-1])
    if again.ranks.rank == 0:
        tables = [
            np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True) for name in ("parts", "whole")
        ]
        for name in ("step", "time", "mass", "energy", "least_pressure", "repeated"):
            np.testing.assert_array_equal(*(t[name] for t in tables), err_msg=name)


ELSEWHERE = """if True:
    import sys
    sys.path.insert(0, sys.argv[1])
    from gas_scenes import advance
    from test_gas_checkpoint import scene
    gas = scene()
    advance(gas, 10)
    gas.save(sys.argv[2])
"""


@pytest.mark.skipif(Ranks().size > 1, reason="starts MPI itself")
def test_goes_on_with_other_ranks(tmp_path, monkeypatch):
    """Ten steps on two ranks and ten here against twenty here: to 1e-8, with pressures solved far below."""
    start, env = command(2)
    env = env | {"PETSC_OPTIONS": "-ksp_rtol 1e-10"}
    monkeypatch.setattr(pressure, "RTOL", 1e-10)
    subprocess.run(
        [*start, "-c", ELSEWHERE, "tests", str(tmp_path / "a.h5")], env=env, check=True, timeout=300
    )
    there, here = scene(), scene()
    there.load(tmp_path / "a.h5")
    assert there.steps == 10
    advance(there, 10)
    advance(here, 20)
    np.testing.assert_allclose(there.U, here.U, rtol=0, atol=1e-8 * np.abs(here.U).max())
    assert there.time == pytest.approx(here.time, rel=1e-8)


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def write_text(path):
    path.write_text("time,step\n0,0\n")


def remove_array(path):
    with h5py.File(path, "r+") as file:
        del file["conserved"]


DAMAGES = {
    cut: "cannot be read as a checkpoint: .*truncated",
    write_text: "cannot be read as a checkpoint",
    remove_array: "cannot be read as a checkpoint: .*conserved",
}


@pytest.mark.mpi
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda f: f.__name__)
def test_damaged_files(folder, damage):
    """All ranks refuse them by name, and the gas stays as it is."""
    gas, path = scene(), folder / "a.h5"
    gas.save(path)
    gas.ranks.broadcast(lambda: damage(path))
    advance(gas, 2)
    before = state(gas)
    with pytest.raises(CheckpointError, match=f"{path}.*{DAMAGES[damage]}"):
        gas.load(path)
    with pytest.raises(FileNotFoundError, match="checkpoint .*none.h5 does not exist"):
        gas.load(folder / "none.h5")
    assert_same(state(gas), before)
    advance(gas, 2)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "options, message",
    [
        ({"n": 11}, "mesh: .* cells, SHA-256 .*, here"),
        ({"d": 1, "n": 50}, "dimension: 2, here 1"),
        ({"eos": IdealGas(1.6)}, r"gas: IdealGas\(gamma=1.4\), here IdealGas\(gamma=1.6\)"),
        ({"pair": "B2-B1"}, "scheme: B1-B0, imex, contact, here B2-B1, imex, contact"),
        ({"scheme": "euler"}, "scheme: B1-B0, imex, contact, here B1-B0, euler, contact"),
        ({"limiter": "mc"}, "scheme: B1-B0, imex, contact, here B1-B0, imex, mc"),
    ],
)
def test_checkpoints_of_other_scenes(folder, options, message):
    """The file and what differs are named."""
    scene().save(folder / "a.h5")
    gas = scene(**options)
    advance(gas, 1)
    before = state(gas)
    with pytest.raises(CheckpointError, match=f"a.h5 is the checkpoint of another scene; .*{message}"):
        gas.load(folder / "a.h5")
    assert_same(state(gas), before)


def test_checkpoints_of_solids_are_refused(tmp_path):
    mesh = box(2, 10)
    material = fempm.NeoHookean(1.0, 10.0)
    solid = fempm.Simulation(mesh, [fempm.Body([[0.5, 0.5]], 0.1, material)], gradient="plain")
    fempm.save_checkpoint(solid, tmp_path / "solid.h5")
    with pytest.raises(CheckpointError, match="solid.h5"):
        scene().load(tmp_path / "solid.h5")
    scene().save(tmp_path / "gas.h5")
    with pytest.raises(CheckpointError, match="gas.h5"):
        fempm.load_checkpoint(solid, tmp_path / "gas.h5")
