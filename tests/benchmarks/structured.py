"""Speed of a structured-grid MPM, for comparison: MLS-MPM (Hu et al. 2018) with quadratic B-splines.

APIC, neo-Hookean, float64, 2D (plane strain) and 3D, on one core; particles lie sorted by cell in memory. A
node is one vector of the processor, mass and momentum, and nodes are visited in lines of three.
"""

import time

import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import cgutils

from fempm.lane_memory import entry, load, scratch, store, take, take_matrix
from fempm.lanes import FAST, FLOAT, INDEX, VECTOR, Value, dot, formula, zero
from fempm.weights import options

PER_AXIS = 2  # particles per axis and cell: 4 in 2D, 8 in 3D


def call(name, x):
    """A mathematical function of a formula's number."""
    kind = ir.FunctionType(FLOAT, [FLOAT])
    function = x.builder and cgutils.get_or_insert_function(x.builder.module, kind, f"llvm.{name}.f64")
    return Value(x.builder, x.builder and x.builder.call(function, [x.ir], fastmath=FAST), wide=False)


def together(*numbers):
    """A node's vector from its numbers."""
    b, out = numbers[0].builder, ir.Constant(VECTOR, None)
    for i, number in enumerate(numbers):
        out = b and b.insert_element(out, number.ir, INDEX[i])
    return Value(b, out, wide=True)


def velocity(node, axes):
    """Numbers 1 to d of a node's vector."""
    b = node.builder
    return tuple(Value(b, b and b.extract_element(node.ir, INDEX[1 + a]), wide=False) for a in axes)


def determinant(f):
    """det F."""
    if len(f) == 2:
        return f[0][0] * f[1][1] - f[0][1] * f[1][0]
    pairs = ((1, 2), (2, 0), (0, 1))
    return dot(f[0], [f[1][i] * f[2][k] - f[1][k] * f[2][i] for i, k in pairs])


@formula
def stencil(x, dx, size):
    """Lowest node; weight and offsets of the lines of nodes; weights and offsets along them."""
    base = [call("floor", x_a / dx - 0.5) for x_a in x]
    node, lines = base[0], [()]
    for b in base[1:]:
        node = node * size + b
    w, r = [], []
    for x_a, b in zip(x, base):
        t = x_a / dx - b
        w.append((0.5 * (1.5 - t) * (1.5 - t), 0.75 - (t - 1.0) * (t - 1.0), 0.5 * (t - 0.5) * (t - 0.5)))
        r.append(tuple((i - t) * dx for i in range(3)))
    for a in range(len(x) - 1):
        lines = [
            (w_i * line[0] if a else w_i, *line[1:], r_i) for line in lines for w_i, r_i in zip(w[a], r[a])
        ]
    return node, tuple(lines), w[-1], r[-1]


@formula
def momentum(v, c, f, mass, volume, lam, mu, dx, dt):
    """Vectors p and a_k of w (p + sum a_k r_k) = w (m, m v + (m C - dt V0 4 / dx^2 tau) r)."""
    pressure, scale, axes = (
        lam * call("log", determinant(f)) - mu,
        4.0 * dt * volume / (dx * dx),
        range(len(v)),
    )
    tau = [[mu * dot(f[i], f[k]) + (pressure if i == k else 0.0) for i in axes] for k in axes]
    columns = [[mass * c[i][k] - scale * tau[k][i] for i in axes] for k in axes]
    return together(mass, *(mass * v_a for v_a in v)), tuple(together(zero(mass), *a) for a in columns)


@formula
def add_line(nodes, p, a, line, w, r):
    """A line of three nodes with a particle's share added."""
    for a_k, r_k in zip(a, line[1:]):
        p = p + a_k * r_k
    p, last = line[0] * p, line[0] * a[-1]
    return tuple(node + w_e * (p + last * r_e) for node, w_e, r_e in zip(nodes, w, r))


@formula
def gather_line(sums, nodes, line, w, r):
    """Sums of w v and of w v r_k with a line of three nodes added."""
    value, last = dot(w, nodes), dot([w_e * r_e for w_e, r_e in zip(w, r)], nodes)
    value, last = line[0] * value, line[0] * last
    return sums[0] + value, *(s + r_k * value for s, r_k in zip(sums[1:], line[1:])), sums[-1] + last


@formula
def no_nodes(x):
    """Vectors of zeros: a line of nodes, and the sums of `gather_line`."""
    o = Value(x[0].builder, ir.Constant(VECTOR, None), wide=True)
    return (o,) * 3, (o,) * (1 + len(x))


@formula
def moved(x, f, sums, dx, dt):
    """New position, velocity, C = 4 / dx^2 sum w v (x) r and F + dt C F."""
    axes = range(len(x))
    v, *columns = [velocity(s, axes) for s in sums]
    c = tuple(tuple(4.0 / (dx * dx) * columns[k][i] for k in axes) for i in axes)
    f = tuple(tuple(f[i][k] + dt * dot(c[i], [row[k] for row in f]) for k in axes) for i in axes)
    return tuple(x_a + dt * v_a for x_a, v_a in zip(x, v)), v, c, f


@njit(**options)
def step(axes, x, v, c, f, mass, volume, lam, mu, dx, dt, size, lines, grid):
    """One time step; `lines` are the distances of the lines of a stencil from its lowest node."""
    dim, table = len(axes), scratch(27)
    grid[:] = 0.0
    for p in range(len(x)):
        x_p, f_p = take(x, p * dim, axes), take_matrix(f, p * dim * dim, axes)
        node, outer, w, r = stencil(x_p, dx, size)
        store(table, 0, outer)
        v_p, c_p = take(v, p * dim, axes), take_matrix(c, p * dim * dim, axes)
        vectors = momentum(v_p, c_p, f_p, mass[p], volume[p], lam, mu, dx, dt)
        like, _ = no_nodes(x_p)
        for o in range(3 ** (dim - 1)):
            at = int(node) + entry(lines, o)
            nodes = add_line(load(grid, at, like), vectors[0], vectors[1], take(table, o * dim, axes), w, r)
            store(grid, at, nodes)
    for i in range(len(grid)):
        if grid[i, 0] > 0.0:
            grid[i, 1:] /= grid[i, 0]
    for p in range(len(x)):
        x_p, f_p = take(x, p * dim, axes), take_matrix(f, p * dim * dim, axes)
        node, outer, w, r = stencil(x_p, dx, size)
        store(table, 0, outer)
        like, sums = no_nodes(x_p)
        for o in range(3 ** (dim - 1)):
            nodes = load(grid, int(node) + entry(lines, o), like)
            sums = gather_line(sums, nodes, take(table, o * dim, axes), w, r)
        x_p, v_p, c_p, f_p = moved(x_p, f_p, sums, dx, dt)
        store(x, p * dim, x_p)
        store(v, p * dim, v_p)
        store(c, p * dim * dim, c_p)
        store(f, p * dim * dim, f_p)


def scene(dim, n):
    """Arguments of `step` for a box of n^dim cells full of a solid in motion, with two empty cells around."""
    dx, size = 1.0 / n, n + 5
    cells = np.stack(np.meshgrid(*[np.arange(n)] * dim, indexing="ij"), -1).reshape(-1, 1, dim)
    within = np.stack(np.meshgrid(*[np.arange(PER_AXIS)] * dim, indexing="ij"), -1).reshape(1, -1, dim)
    x = ((cells + (within + 0.5) / PER_AXIS).reshape(-1, dim) + 2) * dx
    volume, density, young, poisson = np.full(len(x), (dx / PER_AXIS) ** dim), 1e3, 1e6, 0.3
    mu, lam = young / (2 * (1 + poisson)), young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    speed = np.sqrt((lam + 2 * mu) / density)
    c, f = np.zeros((len(x), dim, dim)), np.tile(np.eye(dim), (len(x), 1, 1))
    i = np.arange(3)
    lines = size * i if dim == 2 else (size * size * i[:, None] + size * i).ravel()
    constants = (lam, mu, dx, 0.1 * dx / speed, float(size), lines, np.zeros((size**dim, 4)))
    axes, v = tuple(range(dim)), 0.1 * speed * np.sin(np.pi * x)
    return (axes, x, v, c, f, density * volume, volume, *constants)


def structured(dim, n, repetitions=15):
    """1e6 particle-steps per second of CPU time: the best of some repetitions."""
    arguments = scene(dim, n)
    step(*arguments)
    best = np.inf
    for _ in range(repetitions):
        begin = time.process_time()
        step(*arguments)
        best = min(best, time.process_time() - begin)
    return 1e-6 * len(arguments[1]) / best
