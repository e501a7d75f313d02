"""The MPM of `structured` in Taichi on one core; run by file name, as Taichi is not required."""

import sys
import time

import numpy as np
import taichi as ti

PER_AXIS = 2


def particle_steps(dim, n, repetitions=15):
    """1e6 particle-steps per second: the best of some repetitions."""
    dx, pad = 1.0 / n, 2
    count = (PER_AXIS * n) ** dim
    young, poisson, density = 1e6, 0.3, 1e3
    mu, lam = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    speed = np.sqrt((lam + 2 * mu) / density)
    volume, dt = (dx / PER_AXIS) ** dim, 0.1 * dx / speed
    mass = density * volume
    x, v = (ti.Vector.field(dim, ti.f64, count) for _ in range(2))
    c, f = (ti.Matrix.field(dim, dim, ti.f64, count) for _ in range(2))
    shape = (n + 2 * pad + 1,) * dim
    grid_v, grid_m = ti.Vector.field(dim, ti.f64, shape), ti.field(ti.f64, shape)

    @ti.func
    def stencil(p):
        base = (x[p] / dx - 0.5).cast(int)
        t = x[p] / dx - base.cast(ti.f64)
        return base, t, [0.5 * (1.5 - t) ** 2, 0.75 - (t - 1.0) ** 2, 0.5 * (t - 0.5) ** 2]

    @ti.kernel
    def particle_to_grid():
        for p in x:
            base, t, w = stencil(p)
            tau = mu * f[p] @ f[p].transpose()
            tau += (lam * ti.log(f[p].determinant()) - mu) * ti.Matrix.identity(ti.f64, dim)
            affine = mass * c[p] - 4.0 * dt * volume / (dx * dx) * tau
            for offset in ti.static(ti.grouped(ti.ndrange(*((3,) * dim)))):
                weight = 1.0
                for a in ti.static(range(dim)):
                    weight *= w[offset[a]][a]
                r = (offset.cast(ti.f64) - t) * dx
                grid_v[base + offset] += weight * (mass * v[p] + affine @ r)
                grid_m[base + offset] += weight * mass

    @ti.kernel
    def update_grid():
        for i in ti.grouped(grid_m):
            if grid_m[i] > 0:
                grid_v[i] /= grid_m[i]

    @ti.kernel
    def grid_to_particle():
        for p in x:
            base, t, w = stencil(p)
            new_v, new_c = ti.Vector.zero(ti.f64, dim), ti.Matrix.zero(ti.f64, dim, dim)
            for offset in ti.static(ti.grouped(ti.ndrange(*((3,) * dim)))):
                weight = 1.0
                for a in ti.static(range(dim)):
                    weight *= w[offset[a]][a]
                r = (offset.cast(ti.f64) - t) * dx
                new_v += weight * grid_v[base + offset]
                new_c += 4.0 / (dx * dx) * weight * grid_v[base + offset].outer_product(r)
            v[p], c[p] = new_v, new_c
            x[p] += dt * new_v
            f[p] += dt * new_c @ f[p]

    def step():
        grid_v.fill(0)
        grid_m.fill(0)
        particle_to_grid()
        update_grid()
        grid_to_particle()
        ti.sync()

    lattice = np.stack(np.meshgrid(*[np.arange(PER_AXIS * n)] * dim, indexing="ij"), -1).reshape(-1, dim)
    order = np.lexsort((lattice // PER_AXIS).T[::-1])
    start = (lattice[order] + 0.5) / PER_AXIS * dx + pad * dx
    x.from_numpy(start)
    v.from_numpy(0.1 * speed * np.sin(np.pi * start))
    f.from_numpy(np.tile(np.eye(dim), (count, 1, 1)))
    step()
    best = np.inf
    for _ in range(repetitions):
        begin = time.perf_counter()
        step()
        best = min(best, time.perf_counter() - begin)
    return 1e-6 * count / best


if __name__ == "__main__":
    ti.init(arch=ti.cpu, cpu_max_num_threads=1, default_fp=ti.f64, log_level=ti.ERROR)
    print(*(particle_steps(dim, int(n)) for dim, n in zip((2, 3), sys.argv[1:])))
