"""Floating-point operations and bytes of a particle-step, counted from the formulas; peak of a core."""

import time

import numpy as np
from numba import njit

from fempm.lane_memory import add_totals, take, zeros
from fempm.lanes import WIDTH, formula
from fempm.weights import options

CHAINS = 12  # independent sums that hide the latency of a multiply-add


def flops_per_vertex(dim, affine, consistent):
    """Operations per particle and ring vertex in P2G and in G2P, square root and maximum as one each."""
    d, pairs = dim, dim * (dim + 1) // 2
    distance = d + 2 * d - 1 + 2  # offset, dot product, root, times inverse support
    moments = 9 + 1 + 2 * d + 2 * pairs  # B-spline times eta; sums of D, D r, D r (x) r
    weight = 2 * d + 1
    phi = (2 * d + 2 * d * d) * consistent  # sums of w phi, w phi (x) r
    shared = distance + moments + weight + phi
    inertia = (d + 2 * pairs) * affine
    momentum = 2 + d * (2 + 2 * d * affine)
    force = d * (2 + 2 * d) + d * (2 * d + 1) * consistent
    gather = d * (4 + 2 * d + 2 * d * consistent + 2 * d * affine)
    return shared + inertia + momentum + force, shared + gather


def bytes_per_particle(dim, affine):
    """Bytes of particle data that P2G and G2P read and write; vertices stay in the caches."""
    d = 8 * dim
    matrix = d * dim
    read_twice = 4 + d  # order and position
    p2g = read_twice + d + 16 + matrix + matrix * affine  # velocity, mass and volume, stress, affine matrix
    g2p = read_twice + d + d + 2 * matrix + matrix * affine  # position and velocity back, F twice
    return p2g, g2p


@formula
def advance(sums, factor, shifts):
    """One multiply-add per sum."""
    return tuple(factor * s + shift for s, shift in zip(sums, shifts))


@njit(**options)
def multiply_add(chains, n, factor, shifts, out):
    """n multiply-adds of every lane of every chain."""
    sums, shift = zeros(chains), take(shifts, 0, chains)
    for _ in range(n):
        sums = advance(sums, factor, shift)
    add_totals(out, 0, sums)


def peak(n=2_000_000):
    """Floating-point operations per second of one core: the best of some runs of multiply-adds."""
    arguments = ((0,) * CHAINS, n, 0.999, np.arange(1.0, 1.0 + CHAINS), np.zeros(CHAINS))
    multiply_add(*arguments)
    best = np.inf
    for _ in range(10):
        begin = time.process_time()
        multiply_add(*arguments)
        best = min(best, time.process_time() - begin)
    return 2 * WIDTH * CHAINS * n / best


def work(row, peak_rate):
    """Columns for a row of `throughput`: flops and bytes of P2G and G2P, GFlop/s, share of the peak, GB/s."""
    affine, consistent = row["transfer"] == "apic", row["gradient"] == "consistent"
    flops = [f * row["ring"] for f in flops_per_vertex(row["dim"], affine, consistent)]
    moved = bytes_per_particle(row["dim"], affine)
    nanoseconds = row["P2G_ns"] + row["G2P_ns"]
    return {
        "dim": row["dim"],
        "transfer": row["transfer"],
        "gradient": row["gradient"],
        "P2G_flops": flops[0],
        "G2P_flops": flops[1],
        "GFlop/s": sum(flops) / nanoseconds,
        "of_peak_%": 1e11 * sum(flops) / nanoseconds / peak_rate,
        "bytes": sum(moved),
        "GB/s": sum(moved) / nanoseconds,
    }
