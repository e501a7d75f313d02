"""Gas and solids: error against run time, leaks of thin walls, what a coupled step costs, two ablations."""

import time

import numpy as np
from coupled_scenes import advance, centre, lagrangian_piston, piston, piston_path

import fempm
from coupling import Coupled, Flow, IdealGas, Inflow, Outflow, SlipWall
from coupling.scenes import burst, planar_shock, shocked

from . import ablation
from .drawing import error_over_time

AIR = IdealGas(1.4)
PISTONS = {
    "M = 10": (10.0, (2.0, 1.0), 2.0),
    "M = 1": (1.0, (2.0, 1.0), 2.0),
    "M = 0.1": (0.1, (10.0, 1.0), 0.5),
}
SOLVERS = {
    "mixture, two stages": {},
    "mixture, one stage": {"scheme": "euler"},
    "sharp, two stages": {"interface": "sharp"},
    "sharp, one stage": {"interface": "sharp", "scheme": "euler"},
}


def pistons(cells, kinds=tuple(PISTONS)):
    """Rows: case, solver, cells, largest error over the stroke, drift of energy and mass, CPU seconds."""
    rows = []
    for options in SOLVERS.values():  # compiled before anything is timed
        advance(piston(10, *PISTONS["M = 1"][:2], **options), 0.01)
    for kind in kinds:
        mass, pressures, until = PISTONS[kind]
        exact = lagrangian_piston(mass, pressures, until, 800)
        for solver, options in SOLVERS.items():
            for n in cells:
                scene = piston(n, mass, pressures, **options)
                start = scene.summary()
                scene.stable_step()
                begin = time.process_time()
                path = piston_path(scene, until)
                seconds, end = time.process_time() - begin, scene.summary()
                error = np.abs(np.interp(path[:, 0], *exact.T) - path[:, 1]).max()
                rows.append(
                    {
                        "case": f"piston, {kind}",
                        "solver": solver,
                        "cells": n,
                        "error_%": 100 * error / np.ptp(exact[:, 1]),
                        "energy_%": 100 * (end["energy"] / start["energy"] - 1),
                        "mass": end["mass"] / start["mass"] - 1,
                        "steps": scene.steps,
                        "cpu_s": seconds,
                    }
                )
    return rows


def cylinder(h, **options):
    """The cylinder that a shock of Mach 3 lifts (Forrer and Berger 1999), see the demo."""
    mesh = fempm.box_mesh((0, 0), (1, 0.2), h)
    x, volume = fempm.fill_box([0.1, 0], [0.2, 0.1], h / 2)
    disk = np.linalg.norm(x - [0.15, 0.05], axis=1) < 0.05
    body = fempm.Body(x[disk], volume[disk], fempm.NeoHookean(10.77, 1e4, 0.3), name="cylinder")
    walls = [fempm.Wall("bottom", "contact"), fempm.Wall("top", "contact")]
    solid = fempm.Simulation(mesh, [body], walls, outlets=["right"])
    density, speed, pressure = shocked(3.0, 1.4, 1.0)
    ends = [Inflow("left", density, pressure, velocity=[speed, 0.0]), Outflow("right")]
    ends += [SlipWall("bottom"), SlipWall("top")]
    return Coupled(solid, AIR, planar_shock(3.0, 0.08, 1.4, 1.0), ends, **options)


def cylinders(sizes, until=(0.15, 0.3), solvers=tuple(SOLVERS)):
    """Rows: solver, mesh size, centre at two times, its distance from the finest mesh's, CPU seconds.

    Where a run ends with an error, it is printed and what it did not reach is nan.
    """
    rows = []
    for solver in solvers:
        advance(cylinder(0.04, **SOLVERS[solver]), 1e-3)  # compiled before anything is timed
        for h in sizes:
            scene, places = cylinder(h, **SOLVERS[solver]), []
            begin = time.process_time()
            try:
                for t in until:
                    places.append(centre(advance(scene, t)))
            except fempm.SimulationError as error:
                print(f"{solver}, {0.2 / h:.0f} cells: {error}", flush=True)
                places += [np.full(2, np.nan)] * (len(until) - len(places))
            row = {"case": "cylinder", "solver": solver, "cells": round(0.2 / h)}
            row |= {f"{a}({t:g})": c for t, x in zip(until, places) for a, c in zip("xy", x)}
            rows.append(row | {"steps": scene.steps, "cpu_s": time.process_time() - begin})
    finest = next(r for r in reversed(rows) if r["solver"] == solvers[0])
    names = [name for name in finest if "(" in name]
    for row in rows:
        row["apart"] = float(np.linalg.norm([row[n] - finest[n] for n in names]))
    return rows


def leaks(h=0.02, shifts=(0.0, 0.25, 0.5)):
    """Rows: thickness of a held wall in cells, and which share of the gas passes while sound crosses half."""
    rows = []
    for thickness in (1.0, 1.5, 2.0, 2.5, 3.0):
        row = {"thickness / h": thickness}
        for shift in shifts:
            mesh, middle = fempm.box_mesh((0, 0), (1, 0.2), h), 0.5 + shift * h
            half = 0.5 * thickness * h
            x, volume = fempm.fill_box([middle - half, 0], [middle + half, 0.2], h / 3)
            body = fempm.Body(x, volume, fempm.NeoHookean(1e4, 1e4), name="wall")
            walls = [fempm.Wall("boundary", "slip")]
            solid = fempm.Simulation(mesh, [body], walls, condition=lambda x, v, t: 0 * v)

            def initial(x):
                pressure = np.where(x[:, 0] < 0.5, 2.0, 1.0)
                return pressure, 0.0, pressure

            scene, masses = Coupled(solid, AIR, initial, [SlipWall("boundary")]), []
            for until in (0.0, 0.5 / np.sqrt(1.4)):
                advance(scene, until)
                mass = scene.theta * scene.part.whole.volumes * scene.U[:, 0]
                masses.append(mass[mesh.points[:, 0] < middle].sum())
            row[f"shifted {shift:g}"] = 1 - masses[1] / masses[0]
        rows.append(row)
    return rows


def shell(h):
    """Coupled scene of a shell full of hot gas, the gas alone, and the shell alone."""
    mesh = fempm.box_mesh((0, 0), (1, 1), h)
    x, volume = fempm.fill_box([0.2, 0.2], [0.8, 0.8], h / 2)
    r = np.linalg.norm(x - 0.5, axis=1)
    ring = (r < 0.2) & (r > 0.2 - 3 * h)
    initial, walls = burst((0.5, 0.5), 0.19, 5.0, 10.0), [SlipWall("boundary")]

    def solid():
        body = fempm.Body(x[ring], volume[ring], fempm.NeoHookean(10.0, 100.0, 0.3), name="shell")
        return fempm.Simulation(mesh, [body], [fempm.Wall("boundary", "slip")], transfer="flip")

    return Coupled(solid(), AIR, initial, walls), Flow(mesh, AIR, initial, walls), solid()


def cost(h, steps=250):
    """CPU milliseconds of a coupled step and its parts beside one of the gas and one of the solid alone.

    The three scenes step in turn, with the same time steps, so that each finds the cache as the others have
    left it; medians, that of the ratio over pairs of steps which follow each other.
    """
    coupled, gas, solid = shell(h)
    spent, parts, times = watch(coupled), [], []
    for _ in range(steps):
        spent.update(dict.fromkeys(spent, 0.0))
        times.append([timed_step(coupled), *(timed_step(scene, coupled.dt) for scene in (gas, solid))])
        parts.append(list(spent.values()))
    warm = steps // 10
    times, parts = 1e3 * np.array(times[warm:]), 1e3 * np.median(parts[warm:], axis=0)
    whole, gas_ms, solid_ms = np.median(times, axis=0)
    row = {"vertices": len(coupled.mesh.points), "particles": len(solid.particles)}
    row |= {"coupled_ms": whole, "gas_ms": gas_ms, "solid_ms": solid_ms}
    row["ratio"] = np.median(times[:, 0] / times[:, 1:].sum(axis=1))
    return [row | dict(zip(spent, parts)) | {"rest": whole - parts.sum()}]


def timed_step(scene, dt=None):
    """CPU seconds of a step and of the search for its length, whether or not another one, `dt`, is taken."""
    begin = time.process_time()
    own = scene.stable_step()
    scene.dt = own if dt is None else dt
    scene.step(scene.dt)
    return time.process_time() - begin


def timed(spent, name, call):
    """The function, adding its CPU time to spent[name]."""

    def wrapped(*args, **options):
        begin = time.process_time()
        try:
            return call(*args, **options)
        finally:
            spent[name] += time.process_time() - begin

    return wrapped


def watch(scene):
    """Make the parts of a coupled step keep their CPU time; returns the dict name -> seconds."""
    spent = {}
    solid, stages = scene.solid, scene.stages
    for name, owner, methods in (
        ("transfers", solid, ("particle_to_grid", "update_grid", "move")),
        ("fractions", scene, ("shares", "settle", "regrid", "filled_cells", "begin")),
        ("advection", stages, ("advection",)),
        ("solve", stages.system, ("solve",)),
        ("step length", scene, ("stable_step",)),
    ):
        spent[name] = 0.0
        for method in methods:
            setattr(owner, method, timed(spent, name, getattr(owner, method)))
    return spent


def coupled_benchmarks(folder, quick, table, write_csv):
    """All of the above: print tables, write CSV files and a picture into a folder."""
    print("\npiston between two gases: largest error over its stroke against CPU time")
    rows = pistons((25, 50) if quick else (25, 50, 100), ("M = 1",) if quick else tuple(PISTONS))
    print(table(rows), flush=True)
    write_csv(folder / "coupled_piston.csv", rows)
    print("\ncylinder lifted by a shock: its centre, and how far that is from the finest mesh's")
    lifted = cylinders((0.04, 0.02) if quick else (0.02, 0.0143, 0.01), (0.05, 0.1) if quick else (0.15, 0.3))
    print(table(lifted), flush=True)
    write_csv(folder / "coupled_cylinder.csv", lifted)
    error = {row["case"]: "error_%" for row in rows} | {"cylinder": "apart"}
    path = folder / "coupled_error_against_time.png"
    error_over_time(path, rows + lifted, "case", "solver", error, error)
    print("\nshare of the gas that passes a held wall while sound crosses half of the box")
    print(table(leaks(0.05 if quick else 0.02)), flush=True)
    print("\na coupled step of the shell explosion, CPU time in ms")
    print(table([row for h in ((0.04,) if quick else (0.01, 0.005)) for row in cost(h)]), flush=True)
    print("\nablations (thesis figures 3.4, 3.3): energy gained, jumps of pressure beside the solid")
    print(table(ablation.table(quick)), flush=True)
