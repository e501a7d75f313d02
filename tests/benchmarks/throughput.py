"""Particle-steps per second and core, their split into the stages of a step, and memory."""

import resource
import time

import numpy as np
from mesh_factory import MESHES

import fempm

STAGES = {
    "sort_particles": "sort",
    "particle_to_grid": "P2G",
    "update_grid": "grid",
    "grid_to_particle": "G2P",
    "update_stress": "stress",
    "locate_particles": "locate",
}
PER_CELL = {1: 4, 2: 4, 3: 8}
VARIANTS = [(t, g) for t in ("pic", "flip", "apic") for g in ("plain", "consistent")]


def box(dim, h):
    """Mesh of the unit box: uniform intervals, or Gmsh's triangles or tetrahedra."""
    if dim == 1:
        return fempm.interval_mesh(np.linspace(0, 1, round(1 / h) + 1))
    return fempm.read_mesh(MESHES / ("square.geo" if dim == 2 else "cube.geo"), h=h)


def full_box(mesh, transfer, gradient="plain", threads=1):
    """Simulation of a box between slip walls, full of a solid in motion.

    Parameters
    ----------
    mesh : SimplexMesh of the unit box
    transfer, gradient : see `fempm.Simulation`
    """
    solid = fempm.NeoHookean(density=1e3, young=1e6, poisson=0.3)
    position, volume = fempm.fill_cells(mesh, PER_CELL[mesh.dim])
    speed = 0.1 * solid.wave_speed()
    body = fempm.Body(position, volume, solid, lambda x: speed * np.sin(np.pi * x))
    walls = [fempm.Wall("boundary", "slip")]
    return fempm.Simulation(mesh, [body], walls, transfer=transfer, gradient=gradient, threads=threads)


def watch_stages(simulation):
    """Dict name -> CPU time, which every later step of the simulation adds to."""
    spent = dict.fromkeys(STAGES.values(), 0.0)

    def timed(name, stage):
        def call(*args):
            begin = time.process_time()
            stage(*args)
            spent[name] += time.process_time() - begin

        return call

    for method, name in STAGES.items():
        setattr(simulation, method, timed(name, getattr(simulation, method)))
    return spent


def time_steps(simulation, repetitions):
    """CPU and wall time of a step, and CPU time of its stages, by name; the best of some repetitions."""
    dt = simulation.stable_step()
    simulation.step(dt)  # compiles
    spent = watch_stages(simulation)
    steps = max(1, round(2e5 / len(simulation.particles)))
    runs = []
    for _ in range(repetitions):
        spent.update(dict.fromkeys(spent, 0.0))
        cpu, wall = time.process_time(), time.perf_counter()
        for _ in range(steps):
            simulation.step(dt)
        runs.append({"cpu": time.process_time() - cpu, "wall": time.perf_counter() - wall, **spent})
    for method in STAGES:
        delattr(simulation, method)  # the timers refer back to the simulation and would keep it in memory
    best = min(runs, key=lambda run: run["cpu"])
    best["wall"] = min(run["wall"] for run in runs)
    return {name: seconds / steps for name, seconds in best.items()}


def array_bytes(simulation):
    """Bytes per particle, and per cell for everything else that the simulation holds."""
    s, n = simulation, len(simulation.particles)
    arrays, fixed = (
        {id(a): a for h in holders for a in vars(h).values() if isinstance(a, np.ndarray)}
        for holders in ((s, s.particles), (s.mesh, s.kernel, s.layer))
    )
    particles = sum(a.nbytes for a in arrays.values() if len(a) == n)
    total = sum(a.nbytes for a in (arrays | fixed).values())
    return particles / n, (total - particles) / len(s.mesh.cells)


def throughput(dim, h, repetitions=15, variants=VARIANTS):
    """Measure variants of one scene.

    Parameters
    ----------
    dim : space dimension
    h : mesh size of the unit box
    repetitions : how often to time; the best one counts
    variants : list of (transfer, gradient)

    Returns
    -------
    list of dict, one per variant: particles and cells, mean and largest ring; 1e6 particle-steps per
    second of CPU and of wall time; nanoseconds per particle-step in every stage; bytes per particle
    and per cell, and the largest memory of the process so far in MB
    """
    mesh = box(dim, h)
    begin = time.process_time()
    phi = full_box(mesh, "pic", "consistent").kernel.phi
    setup = time.process_time() - begin
    rows = []
    for transfer, gradient in variants:
        simulation = full_box(mesh, transfer)
        if gradient == "consistent":
            simulation.kernel.phi = phi  # all that the gradients differ in; solved for only once
        n, ring = len(simulation.particles), np.diff(simulation.kernel.ring_start)
        best = time_steps(simulation, repetitions)
        per_particle, per_cell = array_bytes(simulation)
        rows.append(
            {
                "dim": dim,
                "transfer": transfer,
                "gradient": gradient,
                "particles": n,
                "cells": len(mesh.cells),
                "ring": ring.mean(),
                "ring_max": ring.max(),
                "M/cpu_s": 1e-6 * n / best["cpu"],
                "M/wall_s": 1e-6 * n / best["wall"],
                **{f"{name}_ns": 1e9 * best[name] / n for name in STAGES.values()},
                "B/particle": per_particle,
                "B/cell": per_cell,
                "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                "setup_s": setup,
            }
        )
    return rows
