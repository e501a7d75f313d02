"""Checkpoints: what goes on from one, and what is refused."""

import subprocess

import h5py
import numpy as np
import pytest
from mesh_factory import rectangle
from small_scene import Fatigue, advance, command, scene, state

import fempm
from fempm import CheckpointError, checkpoint, load_checkpoint, save_checkpoint
from fempm.parallel import Ranks


@pytest.fixture
def folder(tmp_path):
    """A temporary folder, the same on all ranks."""
    return Ranks().broadcast(lambda: tmp_path)


def assert_same(found, wanted):
    assert found.keys() == wanted.keys()
    for name, array in wanted.items():
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array), name


SCENES = {
    "apic": {"transfer": "apic", "imbalance": 1.0},
    "flip": {"transfer": "flip", "imbalance": 1.0},
    "pic": {"transfer": "pic", "imbalance": 1.0},
    "contact": {"walls": [fempm.Wall("boundary", "contact", friction=0.3)], "transfer": "flip"},
}


@pytest.mark.mpi
@pytest.mark.parametrize("options", SCENES.values(), ids=SCENES.keys())
def test_goes_on_bit_by_bit(folder, options):
    """From the start, between two sorts and just after one; particles have moved in memory by then."""
    whole = scene(**options)
    for steps in (0, 57, 100):
        advance(whole, steps - whole.steps)
        save_checkpoint(whole, folder / f"{steps}.h5")
    advance(whole, 160 - whole.steps)
    assert whole.gather("state/worst").max() > 0.1
    assert whole.ranks.max(int(np.any(np.diff(whole.particles.id) < 0)))
    for steps in (0, 57, 100):
        parts = scene(**options)
        advance(parts, 3)  # what it was before does not matter
        load_checkpoint(parts, folder / f"{steps}.h5")
        assert parts.steps == steps
        advance(parts, 160 - steps)
        assert_same(state(parts), state(whole))


@pytest.mark.mpi
def test_saving_changes_nothing(folder):
    s = scene()
    advance(s, 20)
    before = state(s)
    save_checkpoint(s, folder / "new" / "a.h5")
    save_checkpoint(s, folder / "new" / "a.h5")
    assert_same(state(s), before)
    assert [p.name for p in (folder / "new").iterdir()] == ["a.h5"]


def test_moving_walls_and_counters_without_walls(folder):
    """Walls at rest and moving ones; a fresh simulation has not computed their motion yet."""
    for walls in ([], [fempm.Wall(velocity=lambda t: np.array([np.sin(9 * t), 0.0]))]):
        whole, parts = (scene("flip", walls=walls) for _ in range(2))
        advance(whole, 30)
        save_checkpoint(whole, folder / "a.h5")
        advance(whole, 10)
        load_checkpoint(parts, folder / "a.h5")
        advance(parts, 10)
        assert_same(state(parts), state(whole))


ELSEWHERE = """if True:
    import sys
    import numpy as np
    sys.path.insert(0, sys.argv[1])
    from small_scene import advance, scene
    from fempm import load_checkpoint, save_checkpoint
    s = scene()
    if sys.argv[2]:
        load_checkpoint(s, sys.argv[2])
    advance(s, 60)
    save_checkpoint(s, sys.argv[3])
"""


@pytest.mark.slow
@pytest.mark.parametrize("before, after", [(2, 1), (1, 3), (3, 2)])
def test_goes_on_with_other_ranks(tmp_path, before, after):
    """60 steps and 60 more elsewhere against 120 here: 1e-11, as sums run in another order (1e-16 a step,
    and errors grow while the blocks hit the wall)."""
    for ranks, given, written in ((before, "", "a.h5"), (after, tmp_path / "a.h5", "b.h5")):
        start, env = command(ranks)
        end = ["-c", ELSEWHERE, "tests", given, tmp_path / written]
        subprocess.run([*start, *map(str, end)], env=env, check=True, timeout=300)
    with h5py.File(tmp_path / "b.h5") as file:
        assert file["counts"].shape == (after, 2)
    there, here = scene(), scene()
    load_checkpoint(there, tmp_path / "b.h5")
    advance(here, 120)
    assert there.steps == 120
    assert there.time == pytest.approx(here.time, rel=1e-11)
    for name in here.particles.arrays:
        a, b = there.gather(name), here.gather(name)
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11 * max(1, np.abs(b).max(initial=0)), err_msg=name)


def cut(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def write_text(path):
    path.write_text("time,step\n0,0\n")


def write_foreign(path):
    with h5py.File(path, "w") as file:
        file["particles"] = np.arange(3)


def raise_version(path):
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 99


def remove_array(path):
    with h5py.File(path, "r+") as file:
        del file["particles/stress"]


def shorten_array(path):
    with h5py.File(path, "r+") as file:
        short = file["particles/stress"][1:]
        del file["particles/stress"]
        file["particles/stress"] = short


DAMAGES = {
    cut: "cannot be read as a checkpoint: .*truncated",
    write_text: "cannot be read as a checkpoint",
    write_foreign: "is no checkpoint of fempm",
    raise_version: "checkpoint of format version 99, this fempm reads 1",
    remove_array: "cannot be read as a checkpoint: .*stress",
    shorten_array: "particles/stress is float64",
}


@pytest.mark.mpi
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda f: f.__name__)
def test_damaged_and_foreign_files(folder, damage):
    """All ranks refuse them by name, and the simulation stays as it is."""
    s, path = scene(), folder / "a.h5"
    save_checkpoint(s, path)
    s.ranks.broadcast(lambda: damage(path))
    advance(s, 2)
    before = state(s)
    with pytest.raises(CheckpointError, match=f"{path}.*{DAMAGES[damage]}"):
        load_checkpoint(s, path)
    with pytest.raises(FileNotFoundError, match="checkpoint .*none.h5 does not exist"):
        load_checkpoint(s, folder / "none.h5")
    assert_same(state(s), before)
    advance(s, 2)


def body(material=None, name="first", spacing=0.05):
    material = material or fempm.NeoHookean(1.0, 10.0)
    return fempm.Body(*fempm.fill_box((0.2, 0.2), (0.6, 0.6), spacing), material, name=name)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "options, message",
    [
        ({"cells": 11}, "mesh: .* cells, SHA-256 .*, here"),
        ({"transfer": "flip"}, "transfer: apic, here flip"),
        ({"bodies": [body(name="ball")]}, "bodies: 'first' of 64 particles, here 'ball' of 64 particles"),
        ({"bodies": [body(spacing=0.1)]}, "bodies: 'first' of 64 particles, here 'first' of 16 particles"),
        ({"bodies": [body(fempm.NeoHookean(1.0, 11.0))]}, r"materials: NeoHookean\(.*, here .*young=11.0"),
        ({"bodies": [body(Fatigue(1.0, 10.0))]}, "arrays of the particles: .*, here .*state/worst"),
    ],
)
def test_checkpoints_of_other_scenes(folder, options, message):
    """The file and what differs are named."""
    save_checkpoint(scene(bodies=[body()]), folder / "a.h5")
    s = scene(**{"bodies": [body()], **options})
    advance(s, 1)
    before = state(s)
    with pytest.raises(CheckpointError, match=f"a.h5 is the checkpoint of another scene; .*{message}"):
        load_checkpoint(s, folder / "a.h5")
    assert_same(state(s), before)


def test_checkpoints_of_another_dimension(tmp_path):
    line = fempm.interval_mesh(np.linspace(0, 1, 6))
    save_checkpoint(fempm.Simulation(line, [fempm.Body([[0.5]], 0.1, Fatigue(1.0, 1.0))]), tmp_path / "a.h5")
    square = fempm.Simulation(rectangle(3, 3), [fempm.Body([[0.5, 0.5]], 0.1, Fatigue(1.0, 1.0))])
    with pytest.raises(CheckpointError, match="dimension: 1, here 2"):
        load_checkpoint(square, tmp_path / "a.h5")


@pytest.mark.mpi
def test_a_write_that_fails_leaves_the_old_file(folder, monkeypatch):
    """A full disk on the first rank is an error of all ranks."""
    s, path = scene(), folder / "a.h5"
    save_checkpoint(s, path)
    advance(s, 1)

    def full(path, name, array):
        if name == "particles/mass":
            raise OSError(28, "No space left on device")
        append(path, name, array)

    append = checkpoint.append
    monkeypatch.setattr(checkpoint, "append", full)
    with pytest.raises(OSError, match="No space left"):
        save_checkpoint(s, path)
    s.ranks.max(0)
    assert [p.name for p in folder.iterdir()] == ["a.h5"]
    load_checkpoint(s, path)
    assert s.steps == 0
