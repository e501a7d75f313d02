"""The benchmarks run, at sizes where their numbers mean little."""

from pathlib import Path

import numpy as np
import pytest
from benchmarks import ablation, coupled, gas
from benchmarks import comparison as others
from benchmarks.comparison import comparison
from benchmarks.run_benchmarks import table
from benchmarks.structured import scene, step
from benchmarks.throughput import STAGES, throughput
from benchmarks.vibrating_bar import error_against_time
from benchmarks.work import peak, work

from coupling import Coupled


@pytest.mark.parametrize("dim, h", [(1, 0.05), (2, 0.2), (3, 0.4)])
def test_throughput(dim, h):
    variants = [("flip", "plain"), ("apic", "consistent")]
    rows = throughput(dim, h, repetitions=1, variants=variants)
    assert [(r["transfer"], r["gradient"]) for r in rows] == variants
    for row in rows:
        assert row["particles"] == {1: 4, 2: 4, 3: 8}[dim] * row["cells"]
        assert row["M/cpu_s"] > 0 and row["M/wall_s"] > 0
        assert row["ring_max"] >= row["ring"] > dim + 1
        # The stages are the whole step but for two additions; timing them costs some microseconds.
        stages = 1e-3 * sum(row[f"{stage}_ns"] for stage in STAGES.values())
        assert 0.5 < stages * row["M/cpu_s"] <= 1
        # x, v, m, V0, F, det F, tau and 9 bytes for cell, place in the order and status; 8 d^2 for APIC's B.
        assert row["B/particle"] == 16 * dim + 24 + 16 * dim**2 + 9 + 8 * dim**2 * (row["transfer"] == "apic")
        assert row["B/cell"] > 0 and row["peak_MB"] > 0
    assert len(table(rows).splitlines()) == 3


@pytest.mark.parametrize("dim", [2, 3])
def test_structured_grid_conserves(dim):
    """Mass on the grid and momentum of the particles, which deform."""
    arguments = scene(dim, 6)
    _, x, v, _, f, mass, *_, grid = arguments
    before, start = mass @ v, x.copy()
    for _ in range(10):
        step(*arguments)
    assert grid[:, 0].sum() == pytest.approx(mass.sum(), rel=1e-12)
    np.testing.assert_allclose(mass @ v, before, rtol=1e-12)
    assert 1e-3 < np.abs(f - np.eye(dim)).max() < 0.5 and np.abs(x - start).max() > 1e-3


def test_comparison_and_work(monkeypatch):
    """Every code has a row; the share of the peak is one."""
    monkeypatch.setattr(others, "TRIAL", Path("none"))
    variants = [("apic", "consistent")]
    speed = throughput(2, 0.2, 1, variants) + throughput(3, 0.4, 1, variants)
    rows = comparison(speed, {2: 6, 3: 4}, 1)
    assert [row["code"].split(",")[0] for row in rows[:2]] == ["fempm", "structured grid"]
    assert all(row["2D"] > 0 and row["3D"] > 0 for row in rows[:2])
    assert 0 < work(speed[0], peak(10_000))["of_peak_%"] < 100


def test_error_against_time_decreases():
    """A second-order method divides the error by four as h is halved; 2.5 leaves room for coarse meshes."""
    rows = error_against_time({"graded": (2.0, 1.0), "jittered": (2.0, 1.0)})
    for mesh in ("graded", "jittered"):
        coarse, fine = (r for r in rows if (r["mesh"], r["gradient"]) == (mesh, "consistent"))
        assert fine["error_%"] < coarse["error_%"] / 2.5
        assert fine["steps_s"] > 0 and fine["setup_s"] > 0
        plain = next(r for r in rows if (r["mesh"], r["gradient"], r["h"]) == (mesh, "plain", 1.0))
        assert plain["error_%"] > fine["error_%"]


def test_gas_error_against_time():
    """Half the cells, more of the error, in each code; the second stage gains more than a quarter."""
    rows = {(r["code"], r["cells"]): r for r in gas.error_against_time((50, 100), cases=("sod",))}
    for code in gas.SOLVERS:
        assert rows[code, 100]["L1"] < 0.7 * rows[code, 50]["L1"]
    assert rows["two stages", 100]["L1"] < 0.75 * rows["one stage", 100]["L1"]


def test_gas_still_gas_and_slow_flow():
    assert gas.circular_shock(0.1)["L1"] < 0.05
    left_out, computed = gas.still_gas(0.1, 3)
    assert left_out["vertices"] == computed["vertices"] > 100
    by_velocity, by_sound = gas.slow_vortex(0.12, mach=0.1, turns=0.05)
    assert 3 * by_velocity["steps"] < by_sound["steps"]


def test_coupled_benchmarks():
    """Finer pistons are better with either interface, the parts of a step all take time."""
    rows = {(r["solver"], r["cells"]): r for r in coupled.pistons((15, 30), ("M = 1",))}
    for solver in coupled.SOLVERS:
        assert rows[solver, 30]["error_%"] < rows[solver, 15]["error_%"]
    row = coupled.cost(0.1, steps=4)[0]
    assert all(row[part] > 0 for part in list(row)[6:])
    assert row["ratio"] > 1


def test_ablation_of_the_order():
    """Forces of the solid before the coupled solve: energy from nowhere (thesis figure 3.4)."""
    good, bad = (
        ablation.measure(ablation.ellipse_in_a_blast(kind, 0.05, h=0.04))
        for kind in (Coupled, ablation.MpmFirst)
    )
    assert abs(good["energy"]) < 1e-3
    assert bad["energy"] > 0.01


def test_ablation_of_the_gradient():
    """A local gradient moves a shell in still air: its elastic energy grows (thesis figure 3.3)."""
    kinds = ablation.SharpInterface, ablation.LocalGradient
    good, bad = (ablation.measure(ablation.shell_in_still_air(kind, 0.5)) for kind in kinds)
    assert bad["elastic"] > 10 * good["elastic"] > 0
