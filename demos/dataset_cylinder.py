"""Training set of channel flows past a cylinder, as in MeshGraphNets (Pfaff et al. 2021): XDMF with HDF5.

Channel of 1.6 m x 0.41 m, rho = 1, mu = 1e-3; place and radius of the cylinder and the peak of the parabolic
inflow are random. Vertex fields "velocity" and "pressure" every 0.01 s, and "node_type".
"""

import argparse
import shutil
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import h5py
import numpy as np
from navier_stokes import IncompressibleFlow

from fempm import compat
from fempm.gmsh_reader import gmsh_model_to_mesh
from fempm.output import MeshFile
from gnn.graph import INFLOW, OUTFLOW, WALL

# isort: split
import gmsh
from mpi4py import MPI

LENGTH, HEIGHT, EVERY = 1.6, 0.41, 0.01  # m, m, s
# Mesh size at the cylinder and from 0.5 m on, in m, and frames: about 500, 3,000 and 1,900 nodes.
SIZES = {"mini": (0.02, 0.06, 250), "large": (0.008, 0.024, 250), "paper": (0.01, 0.03, 600)}
NODE_TYPES = {"inlet": INFLOW, "outlet": OUTFLOW, "walls": WALL, "cylinder": WALL}
# Benchmark 2D-2 of Schaefer and Turek, Flow Simulation with High-Performance Computers II, 1996.
PUBLISHED = {"maximum drag": (3.22, 3.24), "maximum lift": (0.99, 1.01), "Strouhal number": (0.295, 0.305)}


def channel_mesh(centre, radius, near, far, length=LENGTH):
    """DOLFINx mesh of the channel around the cylinder, and the facets of each key of `NODE_TYPES`."""
    gmsh.initialize(readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    occ, model = gmsh.model.occ, gmsh.model
    box = occ.addRectangle(0, 0, 0, length, HEIGHT)
    [surface], _ = occ.cut([(2, box)], [(2, occ.addDisk(*centre, 0, radius, radius))])
    occ.synchronize()
    curves = {name: [] for name in NODE_TYPES}
    for _, curve in model.getBoundary([surface], oriented=False):
        x, y, _ = occ.getCenterOfMass(1, curve)
        at = [x < 1e-9, x > length - 1e-9, min(y, HEIGHT - y) < 1e-9, True].index(True)
        curves[list(NODE_TYPES)[at]].append(curve)
    for name, found in curves.items():
        model.setPhysicalName(1, model.addPhysicalGroup(1, found), name)

    def size(dim, tag, x, y, *rest):
        distance = np.hypot(x - centre[0], y - centre[1]) - radius
        return near + (far - near) * min(distance / 0.5, 1.0)

    model.mesh.setSizeCallback(size)
    model.mesh.generate(2)
    mesh, _, tags, names = gmsh_model_to_mesh(model, MPI.COMM_SELF, 0, 2)
    gmsh.finalize()
    return mesh, {name: tags.find(names[1, name]) for name in NODE_TYPES}


def node_types(mesh, facets):
    """(nv,) int32, 0 inside; a vertex on two sides has the larger type."""
    types = np.zeros(len(compat.vertex_points(mesh)), np.int32)
    for name, value in NODE_TYPES.items():
        types[compat.facet_vertices(mesh, facets[name])] = value
    return types


def channel_flow(mesh, facets, peak, dt):
    """`IncompressibleFlow` with a parabolic inflow of the given peak, in m/s."""

    def inflow(x):
        return np.outer(4 * peak * x[:, 1] * (HEIGHT - x[:, 1]) / HEIGHT**2, [1, 0])

    walls = np.concatenate([facets["walls"], facets["cylinder"]])
    return IncompressibleFlow(mesh, facets["inlet"], walls, facets["outlet"], inflow, dt)


def draw(seed, number):
    """Parameters of a trajectory; they do not depend on how many others there are."""
    rng = np.random.default_rng([seed, number])
    x, y, radius, peak = rng.uniform([0.15, 0.10, 0.02, 0.25], [0.50, 0.30, 0.08, 2.25])
    return {"centre": (x, y), "radius": radius, "peak": peak}


def is_finished(path, parameters):
    """Whether the trajectory is there; ValueError if it is there with other parameters."""
    if not path.exists():
        return False
    with h5py.File(path.with_suffix(".h5"), "r") as h5:
        for name, value in parameters.items():
            if not np.array_equal(h5.attrs[name], value):
                raise ValueError(f"{path} has {name} {h5.attrs[name]}, not {value}: give another folder")
    return True


def mesh_past(size, parameters):
    """`channel_mesh` of a trajectory, and the mesh size at its cylinder."""
    near, far, _ = SIZES[size]
    near = min(near, parameters["radius"] / 2)
    return *channel_mesh(parameters["centre"], parameters["radius"], near, far), near


def make(path, size, parameters, frames=None, refine=1.0):
    """Write a trajectory, in a hidden folder until it is complete; returns a line about it.

    Where the flow is unstable it is computed again with half the time step, 1 / `refine` times the usual one.
    """
    start = time.process_time()
    (x, y), radius, peak = (parameters[name] for name in ("centre", "radius", "peak"))
    mesh, facets, near = mesh_past(size, parameters)
    # Explicit convection bounds the step: the flow is fast where the cylinder narrows the channel.
    steps = int(np.ceil(EVERY * peak / (1 - 2 * radius / HEIGHT) / (0.09 * near) * refine))
    flow = channel_flow(mesh, facets, peak, EVERY / steps)
    hidden = path.parent / f".{path.stem}" / path.name
    points, cells = compat.vertex_points(mesh), compat.cell_vertices(mesh)
    static = {"node_type": node_types(mesh, facets)}
    try:
        with MeshFile(hidden, points, cells, static=static) as file:
            # The first frame is that at 0.01 s: the pressure of the initial Stokes flow lacks inertia.
            for frame in range(1, (frames or SIZES[size][-1]) + 1):
                for _ in range(steps):
                    flow.step()
                velocity, pressure = (a.astype(np.float32) for a in flow.vertex_values())
                file.write(frame * EVERY, velocity=velocity, pressure=pressure)
    except FloatingPointError:
        return make(path, size, parameters, frames, 2 * refine)
    with h5py.File(hidden.with_suffix(".h5"), "r+") as h5:
        h5.attrs.update(parameters | {"size": size, "steps_per_frame": steps})
    for suffix in (".h5", ".xdmf"):
        hidden.with_suffix(suffix).replace(path.with_suffix(suffix))
    shutil.rmtree(hidden.parent)
    drawn = f"centre ({x:.3f}, {y:.3f}) m, radius {radius:.3f} m, peak {peak:.3f} m/s"
    made = f"{len(points)} nodes, {frame} frames of {steps} steps"
    return f"{path.name}: {drawn}; {made}, {time.process_time() - start:.1f} s of CPU time"


def check(near=0.006, far=0.03, dt=3e-4, until=7.0):
    """Drag, lift and frequency of the benchmark, printed beside the published ones; returns (3,) ratios."""
    start = time.process_time()
    mesh, facets = channel_mesh((0.2, 0.2), 0.05, near, far, length=2.2)
    flow, rows = channel_flow(mesh, facets, peak=1.5, dt=dt), []
    while flow.time < until:
        flow.step()
        if flow.time > until - 1.5:
            rows.append((flow.time, *flow.force(facets["cylinder"]) * 2 / 0.1))  # mean 1 m/s, diameter 0.1 m
    times, drag, lift = np.transpose(rows)
    rising = np.flatnonzero((lift[:-1] < 0) & (lift[1:] >= 0))
    crossings = times[rising] - dt * lift[rising] / (lift[rising + 1] - lift[rising])
    found = drag.max(), lift.max(), 0.1 / np.diff(crossings).mean()
    ratios = np.array(found) / np.mean([*PUBLISHED.values()], axis=1)
    print(f"{len(compat.vertex_points(mesh))} nodes, {time.process_time() - start:.0f} s of CPU time")
    print("                 computed   published      off by")
    for (name, bounds), value, ratio in zip(PUBLISHED.items(), found, ratios):
        print(f"{name:16} {value:8.4f}   {bounds[0]:<5} - {bounds[1]:<5}  {100 * (ratio - 1):+.2f} %")
    return ratios


def main(argv=None):
    """Make what is missing of the set."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trajectories", type=int, default=20, help="(default: %(default)s)")
    parser.add_argument("--size", choices=SIZES, default="mini", help="(default: %(default)s)")
    parser.add_argument("--out", type=Path, default="results/cylinder", help="folder (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the parameters (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: 1); or use mpirun")
    parser.add_argument("--check", action="store_true", help="compute the benchmark DFG 2D-2 instead")
    args = parser.parse_args(argv)
    if args.check:
        return check()
    numbers = range(MPI.COMM_WORLD.rank, args.trajectories, MPI.COMM_WORLD.size)
    tasks = [(args.out / f"cylinder_{k:04}.xdmf", args.size, draw(args.seed, k)) for k in numbers]
    tasks = [task for task in tasks if not is_finished(task[0], task[2] | {"size": args.size})]
    if args.jobs == 1:
        for task in tasks:
            print(make(*task), flush=True)
        return
    # Fresh processes, since MPI does not survive a fork.
    with ProcessPoolExecutor(args.jobs, get_context("spawn")) as pool:
        for done in as_completed([pool.submit(make, *task) for task in tasks]):
            print(done.result(), flush=True)


if __name__ == "__main__":
    main()
