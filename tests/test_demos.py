"""Every demo with a short setting: the numbers that it prints, and the files that it writes."""

import importlib
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from small_scene import command

from fempm.cli import scene_arguments

DEMOS = Path(__file__).parent.parent / "demos"
sys.path.insert(0, str(DEMOS))


def run_demo(name, tmp_path, *options):
    """Results of a demo's main function; its files lie in tmp_path."""
    demo = importlib.import_module(f"demo_{name}")
    return demo.main([*options, "--output", str(tmp_path / name)])


def check_files(record, frames):
    """Particles and vertex fields readable by meshio at every frame."""
    particles, mesh, log = record.files
    reader = meshio.xdmf.TimeSeriesReader(particles)
    assert reader.num_steps == frames + 1
    reader.mesh_grid = reader.collection[frames]
    points, _ = reader.read_points_cells()
    assert np.array_equal(points[:, : record.frames[-1][1].shape[1]], record.frames[-1][1])
    with meshio.xdmf.TimeSeriesReader(mesh) as series:
        series.read_points_cells()
        assert series.num_steps == frames + 1
    assert np.genfromtxt(log, names=True, delimiter=",")["time"][-1] == record.log["time"][-1]


def check_gas_files(record, frames, columns=()):
    """Vertex fields readable by meshio at every frame, those of the record, and a log as long as its own."""
    path, log = record.files
    with meshio.xdmf.TimeSeriesReader(path) as series:
        points, _ = series.read_points_cells()
        assert series.num_steps == frames + 1 == len(record.frames)
        for k in range(frames + 1):
            time, fields, _ = series.read_data(k)
            expected = record.frames[k]
            assert time == pytest.approx(expected[0], abs=1e-15)
            assert {"density", "velocity", "pressure", "mach", "schlieren"} == set(fields)
            assert np.array_equal(fields["density"], expected[1]["density"])
            assert all(len(f) == len(points) and np.isfinite(f).all() for f in fields.values())
    written = np.genfromtxt(log, names=True, delimiter=",")
    assert {"mass", "energy", "iterations", "repeated", *columns} <= set(written.dtype.names)
    assert np.array_equal(written["time"], record.log["time"])


@pytest.mark.smoke
def test_every_demo_is_a_short_scene():
    """Under 60 lines each, with a docstring that --help prints."""
    for path in DEMOS.glob("demo_*.py"):
        assert len(path.read_text().splitlines()) < 60, path.name


@pytest.mark.smoke
def test_vibrating_bar(tmp_path):
    """The bound asked of graded meshes at h = 1; tests/test_bar.py has the convergence."""
    result = run_demo("vibrating_bar", tmp_path, "--mesh", "graded", "--h", "1")
    assert result["error"] < 0.5
    check_files(result["record"], 20)
    assert (tmp_path / "vibrating_bar.png").stat().st_size > 10_000


def test_rotating_square(tmp_path):
    result = run_demo("rotating_square", tmp_path, "--until", "0.005", "--every", "0.001", "--h", "0.04")
    assert result["linear"] <= 1e-13 and result["angular"] <= 1e-10
    check_files(result["record"], 5)


def test_colliding_disks(tmp_path):
    """The disks bounce: the structured reference recovers 0.88 to 0.93 of the momentum (0.1 to 0.025 m)."""
    result = run_demo("colliding_disks", tmp_path, "--h", "0.05")
    assert result["drift"] <= 1e-13
    assert 0.85 < result["recovered"] < 1.0
    check_files(result["record"], 20)


@pytest.mark.slow
def test_cantilever(tmp_path):
    """Largest deflection at 15, 30, 45 degrees against 0: below the thesis's 1.27, 2.18, 4.72 %."""
    result = run_demo("cantilever", tmp_path, "--until", "2.3")
    assert np.all(np.array(result["errors"][1:]) < [1.27, 2.18, 4.72])
    # Euler and Bernoulli's first mode under a sudden load swings to twice q l^4 / (8 E' I); shear adds to it
    modulus, inertia = 1e5 / (1 - 0.29**2), 2**3 / 12
    twice_static = 2 * 2 * 9.81 * 2 * 10**4 / (8 * modulus * inertia)
    assert 0.9 < -result["tips"][0].min() / twice_static < 1.2


def test_sphere_container(tmp_path):
    """The body stays inside without any particle put back, energy does not rise by more than symplectic
    steps do, and by symmetry the centre of mass stays, to what an irregular mesh of seven cells does."""
    result = run_demo("sphere_container", tmp_path, "--h", "0.15", "--body-h", "0.15", "--until", "0.005")
    assert result["hits"] == 0
    assert 0.42 < result["reach"] < 0.5
    assert result["energy"].max() < 1.01
    assert result["centre"] < 0.05
    check_files(result["record"], 20)


def test_ring_collision(tmp_path):
    """The rings bounce: 76 and 77 % of the momentum at 4 and 2.5 mm, the rest swings on or is lost."""
    result = run_demo("ring_collision", tmp_path, "--h", "0.005")
    assert result["drift"] < 1e-12
    assert 0.65 < result["recovered"] < 0.9
    assert result["energy"]["elastic"].max() > 0.6 and result["energy"]["total"].max() < 1.01
    check_files(result["record"], 20)


@pytest.mark.slow
def test_column_collapse(tmp_path):
    """Mean height of the reference, 0.1184 m; h = 0.05, 0.025, 0.0125 m give 0.1209, 0.1194, 0.1201 m."""
    result = run_demo("column_collapse", tmp_path)
    assert result["height"] == pytest.approx(0.1184, rel=0.02)
    check_files(result["record"], 20)


def test_dam_break(tmp_path):
    """The front keeps within 0.4 a of the measured one, ahead of it in the end as there is no friction in the
    scene, and behind that of shallow water; F-bar keeps tension and pressure near the hydrostatic ones."""
    result = run_demo("dam_break", tmp_path, "--cells", "4")
    assert result["error"] < 0.4
    assert -0.1 < result["pressure"][0] < result["pressure"][1] < 0.6
    assert result["measured"][-1] - 0.1 < result["front"][-1] < 1 + 2 * 3.33
    check_files(result["record"], 20)


def test_own_material(tmp_path):
    """Bar: eight cells long, (k h)^2 / 6 and the surfaces that cut through cells make 1 %. Block: elastic."""
    result = run_demo("own_material", tmp_path)
    assert result["swing"] == pytest.approx(1, abs=0.03)
    assert result["slid"] == pytest.approx(1, abs=0.01)
    check_files(result["record"], 20)


@pytest.mark.slow
def test_slope_failure(tmp_path):
    """A slice of the slope slides out; without F-bar the same mesh locks and nothing moves."""
    options = ["--width", "1", "--poisson", "0.49", "--until", "2"]
    result = run_demo("slope_failure", tmp_path, *options)
    assert result["run_out"][-1] > 0.5 and np.mean(result["strain"] > 0.2) > 0.1
    check_files(result["record"], 20)
    assert (tmp_path / "slope_failure_run_out.png").stat().st_size > 10_000
    locked = run_demo("slope_failure", tmp_path, *options, "--locking")
    assert locked["run_out"][-1] < 0.1 and locked["strain"].max() < 0.1


@pytest.mark.smoke
@pytest.mark.parametrize(("case", "bound"), [("sod", 2.1e-3), ("two_rarefactions", 4e-3), ("blast", 9.3e-2)])
def test_shock_tube(tmp_path, case, bound):
    """Bounds of the mean error asked at 400 cells (blasts: PyClaw's second order), and of iterations."""
    result = run_demo("shock_tube", tmp_path, "--case", case)
    assert result["error"] < bound and result["iterations"] <= 15
    check_gas_files(result["record"], 1)
    assert (tmp_path / "shock_tube.png").stat().st_size > 10_000


def test_shock_tube_of_smooth_waves(tmp_path):
    """Second order in cells and steps together; the waves change the density by 1e-4."""
    cells = ("200", "400")
    options = ("--case", "smooth", "--cells")
    errors = [run_demo("shock_tube", tmp_path, *options, n)["error"] for n in cells]
    assert errors[1] < 1e-6 and np.log2(errors[0] / errors[1]) > 1.8


def test_circular_shock(tmp_path):
    """Shock and contact of the radial reference to half a cell, and a closed box keeps mass and energy."""
    result = run_demo("circular_shock", tmp_path, "--h", "0.05")
    assert abs(result["shock"] - 0.8134) < 0.025 and abs(result["contact"] - 0.620) < 0.025
    assert max(result["drift"].values()) < 1e-12
    assert result["spread"] < 5e-3
    check_gas_files(result["record"], 5)
    assert (tmp_path / "circular_shock.png").stat().st_size > 10_000


def test_explosion(tmp_path):
    """The shock of a radial reference (4,000 cells, HLLC, second order) to half a cell."""
    result = run_demo("explosion", tmp_path, "--h", "0.1")
    assert abs(result["shock"] - 0.793) < 0.05
    assert max(result["drift"].values()) < 1e-12
    check_gas_files(result["record"], 5)
    assert (tmp_path / "explosion.png").stat().st_size > 10_000


def test_forward_step(tmp_path):
    """Stand-off and stem of h = 0.0125, 0.285 and 0.24, to a cell or two; Rayleigh's pressure at the foot, to
    what four cells below the corner of the step make of it (2 % at h = 0.0125)."""
    result = run_demo("forward_step", tmp_path, "--h", "0.05")
    assert abs(result["stand_off"] - 0.285) < 0.05 and abs(result["stem"] - 0.24) < 0.1
    assert result["foot"] == pytest.approx(1, abs=0.12)
    check_gas_files(result["record"], 8)
    assert (tmp_path / "forward_step.png").stat().st_size > 10_000


def test_mach_diamond(tmp_path):
    """The shocks cross on the axis, 0.98 widths of the nozzle above it (exact), and the place where the
    pressure there passes 1.1 lies up to two cells behind (0.16 widths each; 1.06 at h = 0.00625)."""
    result = run_demo("mach_diamond", tmp_path, "--h", "0.02", "--until", "1")
    assert 0.98 < result["crossing"] < 0.98 + 2 * 0.16
    check_gas_files(result["record"], 10)
    assert (tmp_path / "mach_diamond.png").stat().st_size > 10_000


def test_airfoil(tmp_path):
    """Without an angle the irregular mesh alone makes lift, 1.2 % of the drag; the nose is behind a normal
    shock (Rayleigh), four cells from it; the drag is that of half the mesh size, 0.0903, until 8 s."""
    result = run_demo("airfoil", tmp_path, "--mach", "2", "--angle", "0", "--h", "0.04", "--until", "3")
    assert abs(result["lift"]) < 0.04 * result["drag"]
    assert result["nose"] == pytest.approx(1, abs=0.15)
    assert result["drag"] == pytest.approx(0.0903, rel=0.04)
    check_gas_files(result["record"], 20, ("lift", "drag"))
    assert (tmp_path / "airfoil_cp.png").stat().st_size > 10_000


def test_options_of_petsc_pass_and_others_do_not(capsys):
    """Those of PETSc go to the pressure solver; what nobody knows is an error; a gas has no threads."""
    scene = {"until": 1.0, "cells": (100, "number of cells")}
    petsc = ["-ksp_monitor", "--cells", "7", "-ksp_rtol", "1e-10", "-pc_type", "none", "-ksp_shift", "-0.5"]
    args = scene_arguments("A gas.", petsc, **scene, threads=False)
    assert args.cells == 7 and not hasattr(args, "threads")
    assert scene_arguments("Sand.", ["--threads", "2"], until=1).threads == 2
    for unknown in (["--threads", "2"], ["-ksp"], ["-ksp_rtol", "1e-3", "1e-4"], ["--cell", "7", "-x"]):
        with pytest.raises(SystemExit):
            scene_arguments("A gas.", unknown, **scene, threads=False)
        assert "unrecognized arguments" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("demo", "options"),
    [("column_collapse", ["--h", "0.1", "--until", "0.2"]), ("circular_shock", ["--h", "0.05"])],
)
def test_on_two_ranks(tmp_path, demo, options):
    """The sand column, with contact, friction and internal variables, and a gas: the same printed numbers."""
    script, printed = str(DEMOS / f"demo_{demo}.py"), []
    for ranks in (1, 2):
        start, env = command(ranks)
        output = ["--output", str(tmp_path / f"on_{ranks}")]
        run = subprocess.run(
            [*start, script, *options, *output], env=env, capture_output=True, text=True, timeout=300
        )
        assert run.returncode == 0, run.stderr
        printed.append([line for line in run.stdout.splitlines() if " m" in line and "wrote" not in line])
    assert printed[0] and printed[0] == printed[1]
