"""Data set of compressible flow over NACA four-digit aerofoils, for `gnn` (air in SI units, chord 1 m).

The wind of Mach 0.2 to 0.7 blows at once at up to 10 degrees with the chord; a trajectory is the flow from
there on, inviscid, in a circle of six or ten chords. Vertex fields: density in kg/m^3, velocity in m/s,
pressure in Pa. Node types: 0 inside, 2 aerofoil, 4 and 5 far field where the wind enters and leaves."""

import argparse
import multiprocessing
import os
import shutil
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from fempm import SimplexMesh
from fempm.gmsh_reader import model_arrays  # before gmsh: it loads MPI first
from fempm.output import MeshFile
from fempm.run import advance

# isort: split
import gmsh

from coupling import Flow, IdealGas, Outflow, SlipWall
from gnn.graph import AIRFOIL, INFLOW, NORMAL, OUTFLOW

SIZES = {  # h: mesh size along the aerofoil, growing by `growth` per length up to the circle; frame time in s
    "paper": {"h": 0.016, "growth": 0.097, "radius": 10.0, "frames": 600, "every": 5e-5},
    "mini": {"h": 0.05, "growth": 0.23, "radius": 6.0, "frames": 100, "every": 3e-4},
}
AIR = {"density": 1.2, "pressure": 1e5}
PROFILE = {"camber": (0, 0.05), "place": (0.3, 0.6), "thickness": (0.08, 0.18)}  # in chords
RANGES = PROFILE | {"mach": (0.2, 0.7), "angle": (-10, 10)}


def outline(camber, place, thickness, count=40):
    """(2 count, 2) points of a closed NACA profile from the tail over the upper side, the nose at the origin.

    camber and its place, and the thickness, are in chords: 0.02, 0.4, 0.12 for NACA 2412.
    """
    x = 0.5 * (1 + np.cos(np.pi * np.arange(count + 1) / count))
    half = 5 * thickness * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    front = x < place
    scale = camber / np.where(front, place, 1 - place) ** 2
    line = scale * np.where(front, 2 * place * x - x**2, 1 - 2 * place + 2 * place * x - x**2)
    turn = np.arctan(2 * scale * (place - x))
    upper = np.column_stack([x - half * np.sin(turn), line + half * np.cos(turn)])
    lower = np.column_stack([x + half * np.sin(turn), line - half * np.cos(turn)])
    return np.concatenate([upper, lower[-2:0:-1]])


def airfoil_mesh(points, h, growth, radius):
    """Mesh of the disk around an outline, with boundaries "airfoil" and "outer"; a third of h at the nose."""
    gmsh.initialize(readConfigFiles=False)
    try:
        for name, value in {"General.Terminal": 0, "Mesh.MeshSizeExtendFromBoundary": 0}.items():
            gmsh.option.setNumber(name, value)
        occ, field = gmsh.model.occ, gmsh.model.mesh.field
        tags, nose = [occ.addPoint(*p, 0) for p in points], len(points) // 2
        sides = [occ.addSpline(tags[: nose + 1]), occ.addSpline([*tags[nose:], tags[0]])]
        rim = occ.addCircle(0.5, 0, 0, radius)
        occ.addPlaneSurface([occ.addCurveLoop([rim]), occ.addCurveLoop(sides)])
        occ.synchronize()
        tag_of = {"airfoil": gmsh.model.addPhysicalGroup(1, sides)}
        tag_of["outer"] = gmsh.model.addPhysicalGroup(1, [rim])
        for tag, what, where in ((1, "Curves", sides), (2, "Points", [tags[nose]])):
            field.add("Distance", tag)
            field.setNumbers(tag, f"{what}List", where)
        field.setNumber(1, "NumPointsPerCurve", 400)
        field.add("MathEval", 3)
        field.setString(3, "F", f"min({h} + {growth} * F1, {h / 3} + {growth} * F2)")
        field.setAsBackgroundMesh(3)
        gmsh.model.mesh.generate(2)
        x, cells, _, facets, groups, _ = model_arrays(gmsh.model, 2)
    finally:
        gmsh.finalize()
    return SimplexMesh(x, cells, {name: facets[groups == tag] for name, tag in tag_of.items()})


def make(path, size, rng, **given):
    """Write a trajectory of settings as in SIZES; the case is random but for what is given of it."""
    case = {name: rng.uniform(*ends) for name, ends in RANGES.items()} | given
    mesh = airfoil_mesh(outline(*map(case.get, PROFILE)), size["h"], size["growth"], size["radius"])
    angle, sound = np.deg2rad(case["angle"]), np.sqrt(1.4 * AIR["pressure"] / AIR["density"])
    wind = AIR | {"velocity": case["mach"] * sound * np.array([np.cos(angle), np.sin(angle)])}
    initial = wind["density"], wind["velocity"], wind["pressure"]
    gas = Flow(mesh, IdealGas(1.4), lambda x: initial, [Outflow("outer", **wind), SlipWall("airfoil")])
    node_type, rim = np.full(len(mesh.points), NORMAL, np.int32), np.unique(mesh.facets("outer"))
    node_type[np.unique(mesh.facets("airfoil"))] = AIRFOIL
    node_type[rim] = np.where((mesh.points[rim] - [0.5, 0]) @ wind["velocity"] < 0, INFLOW, OUTFLOW)
    with MeshFile(path, mesh.points, mesh.cells, static={"node_type": node_type}) as file:
        # the start, where a uniform wind meets the aerofoil at once, is no step to learn
        for k in range(1, size["frames"] + 1):
            while gas.time < k * size["every"]:
                advance(gas, k * size["every"], None)
            fields = gas.vertex_fields()
            file.write(gas.time, **{n: np.float32(fields[n]) for n in ("density", "velocity", "pressure")})
    says = ", ".join(f"{name} {value:.3g}" for name, value in case.items())
    return f"{len(mesh.points)} nodes, {gas.steps} steps, largest Mach {fields['mach'].max():.2f}; {says}"


def make_all(description, make, sizes, argv=None):
    """Write those trajectories of a data set that are not there yet, as the command line says; their paths.

    make(path, size, rng) writes one and returns what to print, whatever its order: rng is of seed and number.
    """
    parser = argparse.ArgumentParser(description=description)
    numbers = {"trajectories": (10, "how many"), "seed": (0, "of the random cases"), "jobs": (1, "processes")}
    for name, (default, text) in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=default, help=f"{text} (default: {default})")
    parser.add_argument("--size", choices=sizes, default="mini", help="of the meshes (default: mini)")
    parser.add_argument("--out", type=Path, required=True, help="folder, one for each size and seed")
    args = parser.parse_args(argv)
    paths = [args.out / f"trajectory_{k:04}.xdmf" for k in range(args.trajectories)]
    jobs = [(make, p, sizes[args.size], [args.seed, k]) for k, p in enumerate(paths) if not p.exists()]
    print(f"{len(paths) - len(jobs)} of {len(paths)} trajectories are in {args.out} already", flush=True)
    if min(args.jobs, len(jobs)) > 1:
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        fresh = multiprocessing.get_context("spawn")  # MPI does not survive a fork
        with ProcessPoolExecutor(min(args.jobs, len(jobs)), mp_context=fresh) as pool:
            done = list(pool.map(make_one, jobs))
    else:
        done = list(map(make_one, jobs))
    if not all(done):
        sys.exit(f"{done.count(False)} of {len(done)} trajectories failed, their numbers are left out")
    return paths


def make_one(job):
    """Write a trajectory in a folder of its own and move it to its place when complete; False if it fails."""
    make, path, size, seed = job
    folder, start = path.parent / f"{path.stem}_unfinished", time.process_time()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        says = make(folder / path.name, size, np.random.default_rng(seed))
    except Exception as error:  # gmsh raises nothing more special; the others do not depend on this one
        print(f"{path.name} failed, {type(error).__name__}: {error}", flush=True)
        return False
    for suffix in (".h5", ".xdmf"):  # the one that says that it is finished comes last
        (folder / path.name).with_suffix(suffix).replace(path.with_suffix(suffix))
    folder.rmdir()
    print(f"{path.name}: {time.process_time() - start:.1f} s of CPU time; {says}", flush=True)
    return True


if __name__ == "__main__":
    make_all(__doc__, make, SIZES)
