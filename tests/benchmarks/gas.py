"""Speed of the gas solver: error against run time beside PyClaw, a circular shock, slow flow, still gas."""

import importlib.util
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import fempm
from coupling import Flow, IdealGas, Outflow, SlipWall, stages
from coupling.cases import CASES, exact_density, mean_error, tube
from coupling.spaces import PAIRS

from .comparison import output
from .drawing import error_over_time

HERE = Path(__file__).resolve().parent
DATA, MESHES = HERE.parent / "data", HERE.parent.parent / "meshes"
SOLVERS = {
    "one stage": {"scheme": "euler"},
    "two stages": {},
    "B2-B1": {"pair": "B2-B1"},
}


def advance(gas, until, dt_limit=np.inf):
    """Run to a time without files; returns CPU seconds, without those of compilation."""
    dt = min(gas.stable_step(), dt_limit)
    gas.one_step(gas.U, dt)  # compiles what is needed and leaves the gas as it is
    gas.stages.iterations.clear()
    start = time.process_time()
    while gas.time < until * (1 - 1e-12):
        left = until - gas.time
        dt = left / np.ceil(left / min(gas.stable_step(), dt_limit))
        gas.dt = dt
        gas.step(dt)
    return time.process_time() - start


def error_against_time(cells, cases=("sod", "mach3")):
    """Rows: case, code, cells, L1 density error, CPU seconds, steps, largest number of iterations."""
    rows = []
    for case in cases:
        for name, options in SOLVERS.items():
            for n in cells:
                gas = tube(case, n, **options)
                seconds = advance(gas, CASES[case].until)
                x, density = gas.mesh.points[:, 0], gas.vertex_fields()["density"]
                rows.append(
                    {
                        "case": case,
                        "code": name,
                        "cells": n,
                        "L1": mean_error(x, density, exact_density(case, x)),
                        "cpu_s": seconds,
                        "steps": gas.steps,
                        "iterations": max(gas.stages.iterations),
                    }
                )
        if importlib.util.find_spec("clawpack"):
            rows += [pyclaw(case, n) for n in cells]
    return rows


def pyclaw(case, cells):
    """The same row by PyClaw, in a process of its own: beside PETSc's libraries its solver ends at once."""
    words = output(HERE / "pyclaw_tube.py", case, cells).split()
    error, seconds, steps = map(float, words[-3:]) if words else (np.nan, np.nan, 0)
    row = {"case": case, "code": "PyClaw", "cells": cells, "L1": error, "cpu_s": seconds}
    return row | {"steps": int(steps), "iterations": 0}


def density_deviation(cells, fine=4096):
    """Rows: case, pair, cells, N e with the thesis's e (3.38) against a fine run of B1-B0, and its order.

    e = sum (rho - rho_b)^2 / (sum rho_b)^2 over the vertices falls with 1 / N by definition, N e does not.
    """
    rows = []
    for case in CASES:
        if case == "smooth":
            continue
        reference = tube(case, fine)
        advance(reference, CASES[case].until)
        exact = reference.vertex_fields()["density"]
        for pair in PAIRS:
            last = None
            for n in cells:
                gas = tube(case, n, pair=pair)
                advance(gas, CASES[case].until)
                at = np.interp(gas.mesh.points[:, 0], reference.mesh.points[:, 0], exact)
                value = n * np.sum((gas.vertex_fields()["density"] - at) ** 2) / np.sum(at) ** 2
                order = np.log2(last / value) if last else np.nan
                rows.append({"case": case, "pair": pair, "cells": n, "N e": value, "order": order})
                last = value
    return rows


def draw_deviation(path, rows):
    """N e over the number of cells, one colour per case, B2-B1 dashed (thesis figure 3.5)."""
    figure = Figure(figsize=(6, 4.4), layout="constrained")
    ax = figure.subplots()
    for k, case in enumerate(dict.fromkeys(row["case"] for row in rows)):
        for pair, style in zip(PAIRS, ("o-", "s--")):
            line = [row for row in rows if (row["case"], row["pair"]) == (case, pair)]
            label = CASES[case].title if pair == PAIRS[0] else None
            ax.loglog([r["cells"] for r in line], [r["N e"] for r in line], style, color=f"C{k}", label=label)
    ax.set(xlabel="cells N", ylabel="N e (thesis 3.38)", title="B1-B0, and dashed B2-B1")
    ax.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(path, dpi=130)


def circular_shock(h, cfl=0.5, still=None):
    """A row on the circular shock: vertices, L1 density error, steps, CPU seconds.

    Parameters
    ----------
    h : mesh size
    cfl : Courant number, see `Flow`
    still : share of the speed of sound below which gas counts as at rest, -1 for never
    """
    mesh = fempm.read_mesh(MESHES / "tank.geo", h=h, W=2, H=2, x0=-1, y0=-1)
    ends = [Outflow(name) for name in ("left", "right", "bottom", "top")]
    gas = Flow(mesh, IdealGas(), circle, ends, cfl=cfl)
    usual = stages.STILL
    stages.STILL = usual if still is None else still
    try:
        seconds = advance(gas, 0.25)
    finally:
        stages.STILL = usual
    reference = np.genfromtxt(DATA / "circular_shock_t0.25.csv", delimiter=",", names=True)
    s, radius = gas.part.space, np.linalg.norm(gas.part.space.points, axis=1)
    apart = np.abs(gas.U[:, 0] - np.interp(radius, reference["r"], reference["rho"]))
    return {
        "vertices": len(radius),
        "CFL": cfl,
        "L1": s.volumes @ apart / 4,
        "steps": gas.steps,
        "cpu_s": seconds,
        "us/vertex/step": 1e6 * seconds / gas.steps / len(radius),
        "iterations": max(gas.stages.iterations),
        "mean": float(np.mean(gas.stages.iterations)),
    }


def circle(x):
    """Density, velocity and pressure: high inside of r = 0.4."""
    inside = np.linalg.norm(x, axis=1) < 0.4
    return np.where(inside, 1.0, 0.125), 0.0, np.where(inside, 1.0, 0.1)


def still_gas(h, size):
    """CPU seconds of one advection, with and without still gas left out: a small explosion in a large box.

    Parameters
    ----------
    h : mesh size
    size : side of the box over the diameter of the hot gas
    """
    width = 0.4 * size
    mesh = fempm.read_mesh(MESHES / "tank.geo", h=h, W=width, H=width, x0=-width / 2, y0=-width / 2)

    def hot(x):
        return 1.0, 0.0, np.where(np.linalg.norm(x, axis=1) < 0.2, 10.0, 1.0)

    gas = Flow(mesh, IdealGas(), hot, [SlipWall("boundary")])
    advance(gas, 0.05)
    rows, usual = [], stages.STILL
    for name, share in (("left out", usual), ("computed", -1.0)):
        stages.STILL = share
        times = []
        for _ in range(5):
            start = time.process_time()
            gas.stages.advection(gas.U)
            times.append(time.process_time() - start)
        rows.append({"still gas": name, "vertices": len(gas.U), "advection_ms": 1e3 * min(times)})
    stages.STILL = usual
    return rows


def slow_vortex(h, mach=0.01, turns=0.25):
    """Rows on a steady vortex of a Mach number: step from |u| and grad p, and one limited by sound.

    Gaussian vortex u = U r / R exp((1 - (r / R)^2) / 2) in a box, exact for the density 1 and the pressure
    p0 - U^2 exp(1 - (r / R)^2) / 2; error: int |u - u_exact| over U pi R^2, after some turns of its core. The
    pair is B2-B1: one pressure per triangle is too many for a gas that can hardly be compressed.
    """
    radius, speed = 0.15, mach
    mesh = fempm.read_mesh(MESHES / "square.geo", h=h)

    def vortex(x):
        offset, r2 = x - 0.5, np.sum((x - 0.5) ** 2, axis=1) / radius**2
        turn = speed / radius * np.exp(0.5 * (1 - r2))
        velocity = turn[:, None] * np.stack([-offset[:, 1], offset[:, 0]], axis=1)
        return 1.0, velocity, 1 / 1.4 - 0.5 * speed**2 * np.exp(1 - r2)  # the speed of sound is 1

    rows = []
    for name, courant in (("|u| and grad p", np.inf), ("sound, 0.5", 0.5)):
        gas = Flow(mesh, IdealGas(), vortex, [SlipWall("boundary")], pair="B2-B1")
        exact, volumes = vortex(gas.part.space.points)[1], gas.part.space.volumes
        seconds = advance(gas, turns * 2 * np.pi * radius / speed, courant * gas.width.min())
        apart = np.linalg.norm(gas.U[:, 1:-1] / gas.U[:, :1] - exact, axis=1)
        rows.append(
            {
                "Mach": mach,
                "step from": name,
                "nodes": len(apart),
                "error_%": 100 * (volumes @ apart) / (np.pi * radius**2 * speed),
                "steps": gas.steps,
                "cpu_s": seconds,
                "iterations": max(gas.stages.iterations),
            }
        )
    return rows


def gas_benchmarks(folder, quick, table, write_csv):
    """All of the above: print tables, write CSV files and a picture into a folder."""
    cells = (100, 200) if quick else (100, 200, 400, 800, 1600)
    print("\ngas: mean density error against CPU time, PyClaw (pip install clawpack) where it is installed")
    rows = error_against_time(cells)
    print(table(rows), flush=True)
    write_csv(folder / "gas_error_against_time.csv", rows)
    titles = {name: CASES[name].title for name in {row["case"] for row in rows}}
    names = dict.fromkeys(titles, "L1"), dict.fromkeys(titles, "mean density error")
    error_over_time(folder / "gas_error_against_time.png", rows, "case", "code", *names, titles=titles)
    print("\nthesis's deviation of the density (3.38) against 4096 cells")
    deviation = density_deviation((64, 128) if quick else (128, 256, 512, 1024), 512 if quick else 4096)
    print(table(deviation), flush=True)
    write_csv(folder / "gas_deviation.csv", deviation)
    draw_deviation(folder / "gas_deviation.png", deviation)
    print("\ncircular shock on irregular triangles, two stages, t = 0.25; mean: iterations of a solve")
    sizes = (0.04, 0.028) if quick else (0.0426, 0.0213, 0.01065)
    shocks = [circular_shock(h, cfl) for h in sizes for cfl in (0.5, 0.8)]
    print(table(shocks), flush=True)
    write_csv(folder / "gas_circular_shock.csv", shocks)
    print("\none advection of a small explosion in a large box")
    print(table(still_gas(0.04 if quick else 0.02, 6)), flush=True)
    print("\nslow vortex, a quarter of a turn, B2-B1")
    slow = [row for mach in ((0.1,) if quick else (0.1, 0.01)) for row in slow_vortex(0.06, mach)]
    print(table(slow), flush=True)
    write_csv(folder / "gas_slow_vortex.csv", slow)
