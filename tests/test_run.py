"""Runs: output times, continuing after a stop, failures, and the same files on any number of ranks."""

import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from small_scene import command, scene

import fempm
from fempm import CheckpointError, Interrupted, SimulationError, run
from fempm.cli import run_options, scene_arguments
from fempm.parallel import Ranks, RemoteError
from fempm.run import output_times

EVERY = {"every": 0.03, "log_every": 5, "progress": False}


@pytest.fixture
def folder(tmp_path):
    """A temporary folder, the same on all ranks."""
    return Ranks().broadcast(lambda: tmp_path)


def contents(output):
    """Text and arrays of the series of a run, without what their names are made of."""
    out = {"csv": output.with_name(f"{output.name}.csv").read_text()}
    for end in ("", "_mesh"):
        name = f"{output.name}{end}"
        out[f"xdmf{end}"] = output.with_name(f"{name}.xdmf").read_text().replace(name, "NAME")
        with h5py.File(output.with_name(f"{name}.h5"), "r") as file:
            keys = []
            file.visit(keys.append)
            out |= {f"{end}/{key}": file[key][()] for key in keys if hasattr(file[key], "shape")}
    return out


def assert_same(found, wanted):
    assert found.keys() == wanted.keys()
    for name, value in wanted.items():
        assert np.array_equal(found[name], value), name


@pytest.mark.parametrize(
    "start, until, every, expected",
    [
        (0.0, 0.3, 0.1, [0.0, 0.1, 0.2, 0.3]),
        (0.0, 0.25, 0.1, [0.0, 0.1, 0.2, 0.25]),
        (0.15, 0.3, 0.1, [0.15, 0.2, 0.3]),
        (0.0, 0.05, 0.1, [0.0, 0.05]),
        (0.2, 0.2, 0.1, [0.2]),
    ],
)
def test_frames_at_multiples_of_a_time(start, until, every, expected):
    """k * every to the last bit, and the start and the end."""
    times = output_times(start, start, until, None, every)
    assert len(times) == len(expected)
    for t, e in zip(times, expected):
        assert t in (start, until) or t == every * round(e / every)
        assert t == pytest.approx(e, abs=1e-15)


def test_frame_times_of_a_run():
    record = run(scene(), 0.1, **EVERY)
    assert [t for t, _, _ in record.frames] == [0.0, 0.03, 0.06, 0.09, 0.1]


@pytest.mark.parametrize(
    "options, message",
    [
        ({"frames": 3, "every": 0.1}, "frames 3, every 0.1: give one of them"),
        ({"every": 0.0}, "every 0.0: it must be positive"),
        ({"every": np.nan}, "every nan"),
        ({"checkpoint_every": -1.0}, "checkpoint_every -1.0: it must be positive"),
    ],
)
def test_options(options, message):
    with pytest.raises(ValueError, match=message):
        run(scene(), 1.0, progress=False, **options)


@pytest.mark.mpi
def test_fields_in_the_order_of_the_ids(folder):
    """Frames, also read one by one and by slices, internal variables, and sums of mass on the vertices."""
    s = scene()
    record = run(s, 0.06, folder / "a", **EVERY)
    assert len(record.frames) == 3 and len(record.frames[::2]) == 2
    with pytest.raises(IndexError):
        record.frames[3]
    x, v = s.gather("position"), s.gather("velocity")
    for t, positions, velocities in (record.frames[2], record.frames[-1], record.frames[1:][-1]):
        assert t == 0.06 and np.array_equal(positions, x) and np.array_equal(velocities, v)
    density = s.gather("mass") / (s.gather("volume") * s.gather("jacobian"))
    worst, body = s.gather("state/worst"), s.gather("body")
    with h5py.File(folder / "a.h5", "r") as file:
        fields = file["2/Node"]
        assert np.array_equal(fields["id"][()], np.arange(s.num_particles))
        assert np.array_equal(fields["density"][()], density) and density.std() > 0
        assert np.array_equal(fields["worst"][()], worst) and worst.max() > 0
        assert np.array_equal(fields["body"][()], body)
        assert fields.keys() == {
            *("velocity", "cauchy_stress", "deformation_gradient", "density", "body", "id", "worst")
        }
    total = s.ranks.sum(s.particles.mass.sum())
    with h5py.File(folder / "a_mesh.h5", "r") as file:
        for k in range(3):
            assert file[f"{k}/Node/mass"][()].sum() == pytest.approx(total, rel=1e-12)
    assert np.genfromtxt(folder / "a.csv", names=True, delimiter=",")["time"][-1] == 0.06
    assert (folder / "a.csv").read_text().count("step") == 1


def stop_at(step, ranks=(0,), number=signal.SIGINT):
    """A function to watch with: signals some ranks at a step."""

    def watch(s):
        if s.steps == step and s.ranks.rank in ranks:
            signal.raise_signal(number)
        return {}

    return watch


@pytest.mark.mpi
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_and_continued(folder, capsys, number):
    """Stopped on its last rank and continued, a run leaves the files and log of one in one go, bit by bit."""
    whole, parts = scene(), scene()
    wanted = run(whole, 0.3, folder / "whole", **EVERY)
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(Interrupted) as caught:
        run(parts, 0.3, folder / "parts", watch=stop_at(35, [parts.ranks.size - 1], number), **EVERY)
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before
    path = folder / "parts_checkpoint.h5"
    assert caught.value.code == 130 and caught.value.path == path and parts.steps == 35
    message = f"step 35; the state is in {path}, the same command with --restart {path} goes on from there"
    assert (message in capsys.readouterr().err) == (parts.ranks.rank == 0)
    fresh = scene()
    found = run(fresh, 0.3, folder / "parts", restart=path, **EVERY)
    assert fresh.steps == whole.steps > 70
    assert_same(contents(folder / "parts"), contents(folder / "whole"))
    assert_same(found.log, wanted.log)
    for a, b in zip(found.frames, wanted.frames, strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b))
    for name, array in whole.particles.arrays.items():
        assert np.array_equal(fresh.particles.arrays[name], array), name


def test_stopped_at_a_frame_and_without_output(tmp_path, monkeypatch):
    """The step that meets a frame's time stops the run before the frame: the continued one has it."""
    monkeypatch.chdir(tmp_path)
    s = scene()
    with pytest.raises(Interrupted):
        run(
            s,
            0.3,
            watch=lambda s: s.time == 0.03 and signal.raise_signal(signal.SIGINT) or {},
            log_every=1,
            frames=10,
            progress=False,
        )
    assert s.time == 0.03
    record = run(scene(), 0.09, restart="fempm_checkpoint.h5", **EVERY)
    assert [t for t, _, _ in record.frames] == [0.03, 0.06, 0.09]
    assert record.log["time"][[0, -1]].tolist() == [0.03, 0.09]
    assert [p.name for p in tmp_path.iterdir()] == ["fempm_checkpoint.h5"]


def test_continued_without_some_of_the_files(tmp_path):
    """What is missing or damaged starts at the checkpoint."""
    with pytest.raises(Interrupted):
        run(scene(), 0.3, tmp_path / "a", watch=stop_at(35), **EVERY)
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe")
    (tmp_path / "a_mesh.h5").unlink()
    s = scene()
    with pytest.warns(UserWarning, match="a.csv cannot be continued .* and is started anew"):
        record = run(s, 0.3, tmp_path / "a", restart=tmp_path / "a_checkpoint.h5", **EVERY)
    assert [t for t, _, _ in record.frames] == pytest.approx(0.03 * np.arange(11))
    assert 0.12 < record.log["time"][0] < 0.18 and record.log["time"][-1] == 0.3
    with meshio.xdmf.TimeSeriesReader(tmp_path / "a_mesh.xdmf") as reader:
        reader.read_points_cells()
        first = reader.read_data(0)[0]
        assert reader.num_steps == round((0.3 - first) / 0.03) + 1 and 0.15 <= first <= 0.18


@pytest.mark.mpi
def test_checkpoints_by_the_clock_and_at_the_end(folder):
    """The last one is that of the end: from it, the run goes on to a later end as if that had been given."""
    whole, parts, more = scene(), scene(), scene()
    run(whole, 0.2, folder / "whole", **EVERY)
    record = run(parts, 0.15, folder / "parts", checkpoint_every=1e-3, **EVERY)
    assert record.files[3:] == [folder / "parts_checkpoint.h5"]
    with pytest.raises(ValueError, match="until 0.1: the simulation is at time 0.15 already"):
        run(scene(), 0.1, folder / "parts", restart=record.files[3], **EVERY)
    run(more, 0.2, folder / "parts", restart=record.files[3], **EVERY)
    assert more.steps == whole.steps
    assert_same(contents(folder / "parts"), contents(folder / "whole"))


def test_no_checkpoints_by_default(tmp_path):
    run(scene(), 0.01, tmp_path / "a", frames=1, progress=False)
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".csv", ".h5", ".h5", ".xdmf", ".xdmf"]


def test_foreign_checkpoint_leaves_the_files_alone(tmp_path):
    run(scene(), 0.03, tmp_path / "a", **EVERY)
    before = contents(tmp_path / "a")
    with pytest.raises(CheckpointError, match="a.h5 is no checkpoint"):
        run(scene(), 0.06, tmp_path / "a", restart=tmp_path / "a.h5", **EVERY)
    assert_same(contents(tmp_path / "a"), before)


def test_run_outside_the_main_thread(tmp_path):
    """Where Python allows no signal handlers."""
    records = []
    thread = threading.Thread(target=lambda: records.append(run(scene(), 0.01, progress=False)))
    thread.start()
    thread.join()
    assert len(records) == 1


@pytest.mark.mpi
def test_failure_on_one_rank(folder):
    """A single particle is torn apart: its rank says so, all write the state, of all particles."""
    s = scene()
    mine = np.flatnonzero(s.particles.id == 0)
    s.particles.deformation_gradient[mine] = np.nan
    with pytest.raises(SimulationError if len(mine) else RemoteError) as caught:
        run(s, 0.1, folder / "bad", dt=1e-3, **EVERY)
    assert "particle 0 of body 'first' has det F = nan" in str(caught.value)
    assert "step 1, position" in str(caught.value)
    assert str(caught.value).endswith(f"; last state in {folder / 'bad_last.xdmf'}")
    x = s.gather("position")
    with meshio.xdmf.TimeSeriesReader(folder / "bad_last.xdmf") as reader:
        reader.mesh_grid = reader.collection[0]
        assert np.array_equal(reader.read_points_cells()[0][:, :2], x)
    s.ranks.max(0)


def test_standard_options():
    args = scene_arguments("a scene", [], until=2, h=(0.1, "size"))
    defaults = {"until": 2.0, "every": None, "restart": None, "checkpoint_every": None}
    assert run_options(args).items() >= defaults.items() and args.threads == 1 and args.h == 0.1
    given = [
        "--until",
        "3",
        "--every",
        "0.5",
        "--output",
        "o",
        "--restart",
        "c.h5",
        "--checkpoint-every",
        "60",
    ]
    args = scene_arguments("a scene", given, until=2, every=0.1)
    assert run_options(args) == {
        "until": 3.0,
        "every": 0.5,
        "output": "o",
        "restart": "c.h5",
        "checkpoint_every": 60.0,
    }


def program(ranks, *options):
    """The scene as a program of its own."""
    start, env = command(ranks)
    return subprocess.Popen(
        [*start, "tests/small_scene.py", *map(str, options)],
        env=env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def leaves(pid):
    """The processes that a process started, down to the last: the ranks of a parallel run."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [leaf for child in children for leaf in leaves(child)] or [int(pid)]


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
def test_ctrl_c(tmp_path, ranks):
    """Status 130, one message and no traceback; files can be read; the continued run is that in one go.

    One rank gets the signal. (mpirun itself sends SIGTERM to all after its odls_base_sigkill_timeout.)
    """
    options = ["--cells", "30"]
    whole = program(ranks, *options, "--output", tmp_path / "whole")
    output = ["--output", tmp_path / "parts"]
    parts = program(ranks, *options, *output)
    rows = 0
    while rows < 5 and parts.poll() is None:
        time.sleep(0.05)
        rows = (tmp_path / "parts.csv").read_text().count("\n") if (tmp_path / "parts.csv").exists() else 0
    os.kill(parts.pid if ranks == 1 else leaves(parts.pid)[-1], signal.SIGINT)
    out, err = parts.communicate(timeout=300)
    path = tmp_path / "parts_checkpoint.h5"
    assert parts.returncode == 130, err
    assert err.count(f"the same command with --restart {path}") == 1 and "Traceback" not in err
    assert "steps" not in out
    assert len(contents(tmp_path / "parts")) > 5
    out, err = program(ranks, *options, *output, "--restart", path).communicate(timeout=300)
    assert whole.communicate(timeout=300)[0] == out and out.count("steps") == 1, err
    assert_same(contents(tmp_path / "parts"), contents(tmp_path / "whole"))


def with_momenta(fields):
    """Momenta in the place of velocities on vertices, where those with hardly any mass have any velocity."""
    for k in range(11):
        node = f"_mesh/{k}/Node"
        fields[f"{node}/velocity"] = fields[f"{node}/velocity"] * fields[f"{node}/mass"][:, None]
    return fields


@pytest.mark.slow
def test_files_do_not_depend_on_the_ranks(tmp_path):
    """Two ranks and three against one: the same frames and rows to 1e-11 of the largest number."""
    runs = [program(n, "--output", tmp_path / str(n)) for n in (1, 2, 3)]
    printed = [p.communicate(timeout=300)[0] for p in runs]
    assert printed[0] == printed[1] == printed[2] and printed[0].count("steps") == 1
    one = with_momenta(contents(tmp_path / "1"))
    log = np.genfromtxt(tmp_path / "1.csv", names=True, delimiter=",")
    for n in ("2", "3"):
        other = with_momenta(contents(tmp_path / n))
        assert other.keys() == one.keys()
        for name in one.keys() - {"csv", "xdmf", "xdmf_mesh"}:
            size = np.abs(one[name]).max(initial=1)
            np.testing.assert_allclose(other[name], one[name], rtol=0, atol=1e-11 * size, err_msg=name)
        rows = np.genfromtxt(tmp_path / f"{n}.csv", names=True, delimiter=",")
        assert rows.dtype == log.dtype
        for name in log.dtype.names:
            np.testing.assert_allclose(rows[name], log[name], rtol=0, atol=1e-11 * np.abs(log[name]).max())


def test_module_exports():
    assert {"Interrupted", "CheckpointError", "save_checkpoint", "load_checkpoint"} <= set(fempm.__all__)
