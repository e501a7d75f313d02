"""Target densities of two variables that samplers are compared on, with their scores and exact samples.

Banana: Haario et al. 1999; double banana: Detommaso et al. 2018; star: Wang and Liu 2019; U1 to U4: Rezende
and Mohamed 2015, U2 to U4 in the window |z| <= 4, where alone they can be normalised.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

import fempm
from fempm.boxes import lattice_mesh
from fempm.parvi_score import normal_start

WINDOW = 4.0
SOFT = 0.1  # width of the push back into the window, for samplers without walls


@dataclass(frozen=True)
class Target:
    """A density, how to draw from it, and settings that suit it.

    Attributes
    ----------
    log_density, score : functions (n, 2) -> (n,) and (n, 2)
    draw : function (n, rng) -> (n, 2), independent samples
    deviation : of the normal start
    size : mesh size, None for the sampler's choice
    window : the density ends at |z| = WINDOW
    modes : (k, 2) centres of modes of equal weight, if any
    temperature : of the start, more than 1 where modes of unequal weight exchange particles
    """

    log_density: Callable
    score: Callable
    draw: Callable
    deviation: float = 1.0
    size: float | None = None
    window: bool = False
    modes: np.ndarray | None = None
    temperature: float = 1.0

    @property
    def start(self):
        """Start for `fempm.parvi.sample`."""
        return normal_start(np.zeros(2), self.deviation)

    def options(self):
        """Options of `sample` for the mesh, its walls and cooling."""
        if not self.window:
            return {"size": self.size, "temperature": self.temperature}
        corner = np.full(2, WINDOW)
        return {"mesh": lattice_mesh(-corner, corner, self.size), "walls": [fempm.Wall("boundary", "slip")]}

    def shares(self, x):
        """(k,) share of the particles next to each mode."""
        nearest = np.argmin(np.sum((x[:, None] - self.modes) ** 2, axis=2), axis=1)
        return np.bincount(nearest, minlength=len(self.modes)) / len(x)


def mixture(means, covariances, weights, **settings):
    """Sum of normal densities."""
    means, weights = np.asarray(means, float), np.asarray(weights, float)
    precision = np.linalg.inv(covariances)
    root = np.linalg.cholesky(covariances)
    constant = np.log(weights) + 0.5 * np.linalg.slogdet(precision)[1]

    def parts(x):
        pull = np.einsum("kij,nkj->nki", precision, x[:, None] - means)
        return pull, constant - 0.5 * np.sum(pull * (x[:, None] - means), axis=2)

    def log_density(x):
        return np.logaddexp.reduce(parts(x)[1], axis=1)

    def score(x):
        pull, log = parts(x)
        share = np.exp(log - np.logaddexp.reduce(log, axis=1)[:, None])
        return -np.einsum("nk,nki->ni", share, pull)

    def draw(n, rng):
        k = rng.choice(len(weights), n, p=weights)
        return means[k] + np.einsum("nij,nj->ni", root[k], rng.standard_normal((n, 2)))

    return Target(log_density, score, draw, **settings)


def ridges(curves, deviation_1=None, **settings):
    """Normal ridges along curves z2 = m(z1), z1 normal or, without a deviation, uniform in the window.

    Parameters
    ----------
    curves : list of (m, dm/dz1, width)
    deviation_1 : of z1
    """
    curve, slope, width = zip(*curves)
    width = np.array(width)

    def outside(x):
        return np.sign(x) * np.maximum(np.abs(x) - WINDOW, 0.0) / SOFT if deviation_1 is None else 0 * x

    def offset(x):
        return (x[:, 1:] - np.stack([m(x[:, 0]) for m in curve], axis=1)) / width

    def log_density(x):
        along = 0.0 if deviation_1 is None else -0.5 * (x[:, 0] / deviation_1) ** 2
        return (
            along + np.logaddexp.reduce(-0.5 * offset(x) ** 2, axis=1) - 0.5 * np.sum(outside(x) ** 2, axis=1)
        )

    def score(x):
        r = offset(x)
        log = -0.5 * r**2
        pull = np.exp(log - np.logaddexp.reduce(log, axis=1)[:, None]) * r / width
        along = np.sum(pull * np.stack([dm(x[:, 0]) for dm in slope], axis=1), axis=1)
        out = np.stack([along, -pull.sum(axis=1)], axis=1) - outside(x) / SOFT
        if deviation_1 is not None:
            out[:, 0] -= x[:, 0] / deviation_1**2
        return out

    def draw(n, rng):
        kept = np.empty((0, 2))
        while len(kept) < n:
            z1 = (
                rng.uniform(-WINDOW, WINDOW, n)
                if deviation_1 is None
                else deviation_1 * rng.standard_normal(n)
            )
            k = rng.choice(len(width), n, p=width / width.sum())
            z2 = np.choose(k, [m(z1) for m in curve]) + width[k] * rng.standard_normal(n)
            inside = np.abs(z2) <= (WINDOW if deviation_1 is None else np.inf)
            kept = np.concatenate([kept, np.stack([z1, z2], axis=1)[inside]])
        return kept[:n]

    return Target(log_density, score, draw, window=deviation_1 is None, **settings)


def from_grid(log_density, score, half_width, **settings):
    """A target drawn from by the weights of a fine grid, even within its squares."""
    squares = 1200

    @cache
    def table():
        centre = ((np.arange(squares) + 0.5) / squares * 2 - 1) * half_width
        x = np.stack(np.meshgrid(centre, centre, indexing="ij"), axis=-1).reshape(-1, 2)
        log = log_density(x)
        return x, np.cumsum(np.exp(log - log.max()))

    def draw(n, rng):
        x, total = table()
        k = np.searchsorted(total, rng.random(n) * total[-1])
        return x[k] + (rng.random((n, 2)) - 0.5) * (2 * half_width / squares)

    return Target(log_density, score, draw, **settings)


def double_banana():
    """|x|^2 / 2 + (F - ln 30)^2 / 0.18 with Rosenbrock's function e^F."""

    def rosenbrock(x):
        return (1 - x[:, 0]) ** 2 + 100 * (x[:, 1] - x[:, 0] ** 2) ** 2

    def log_density(x):
        return -0.5 * np.sum(x**2, axis=1) - (np.log(rosenbrock(x)) - np.log(30)) ** 2 / 0.18

    def score(x):
        across = x[:, 1] - x[:, 0] ** 2
        slope = np.stack([-2 * (1 - x[:, 0]) - 400 * across * x[:, 0], 200 * across], axis=1)
        f = rosenbrock(x)
        return -x - ((np.log(f) - np.log(30)) / 0.09 / f)[:, None] * slope

    return from_grid(log_density, score, 3.0, size=0.05, temperature=100.0)


def two_moons():
    """U1: a ring of radius 2, held at its left and right."""

    def sides(x):
        return np.stack([-0.5 * ((x[:, 0] - c) / 0.6) ** 2 for c in (-2, 2)], axis=1)

    def log_density(x):
        r = np.sqrt(np.sum(x**2, axis=1))
        return -0.5 * ((r - 2) / 0.4) ** 2 + np.logaddexp.reduce(sides(x), axis=1)

    def score(x):
        r = np.sqrt(np.sum(x**2, axis=1, keepdims=True))
        share = np.exp(sides(x) - np.logaddexp.reduce(sides(x), axis=1)[:, None])
        out = -(r - 2) / 0.16 * x / np.maximum(r, 1e-12)
        out[:, 0] -= (x[:, 0] - 2 * (share[:, 1] - share[:, 0])) / 0.36
        return out

    return from_grid(log_density, score, 4.5, size=0.2)


def wave(z):
    """w1 of U2 to U4."""
    return np.sin(np.pi * z / 2)


def wave_slope(z):
    """Derivative of `wave`."""
    return np.pi / 2 * np.cos(np.pi * z / 2)


def targets():
    """Name -> Target, all that the demo shows."""
    turns = {k: np.arange(k) * 2 * np.pi / k for k in (5, 8)}
    around = {k: np.stack([np.cos(t), np.sin(t)], axis=1) for k, t in turns.items()}
    rays = np.einsum("ki,kj->kij", around[5], around[5])
    ring, star = 4 * around[8], 1.5 * around[5]
    three = [(-1.5, 0.0), (1.5, 0.5), (0.0, -1.8)]

    def bump(z):
        return 3 * np.exp(-0.5 * ((z - 1) / 0.6) ** 2)

    def step(z):
        return 3 / (1 + np.exp(-(z - 1) / 0.3))

    lower_3 = (lambda z: wave(z) - bump(z), lambda z: wave_slope(z) + bump(z) * (z - 1) / 0.36, 0.35)
    lower_4 = (lambda z: wave(z) - step(z), lambda z: wave_slope(z) - step(z) * (1 - step(z) / 3) / 0.3, 0.35)
    return {
        "mild banana": ridges([(lambda z: 0.5 * z**2 - 1, lambda z: z, 0.5)], 1.0, size=0.25),
        "three": mixture(
            three,
            np.tile(0.25 * np.eye(2), (3, 1, 1)),
            (0.4, 0.35, 0.25),
            size=0.25,
            temperature=10.0,
            deviation=1.5,
        ),
        "ring": mixture(
            ring, np.tile(0.25 * np.eye(2), (8, 1, 1)), np.full(8, 1 / 8), modes=ring, deviation=3.0
        ),
        "star": mixture(star, 0.01 * np.eye(2) + 0.99 * rays, np.full(5, 0.2), modes=star, deviation=1.5),
        "banana": ridges(
            [(lambda z: 3 - 0.03 * z**2, lambda z: -0.06 * z, 1.0)], 10.0, size=1.4, deviation=5.0
        ),
        "double banana": double_banana(),
        "U1": two_moons(),
        "U2": ridges([(wave, wave_slope, 0.4)], size=0.2),
        "U3": ridges([(wave, wave_slope, 0.35), lower_3], size=0.2),
        "U4": ridges([(wave, wave_slope, 0.4), lower_4], size=0.2),
    }


def chosen(names):
    """Those `targets` whose names are given, separated by commas, all for ""; a ValueError for others."""
    known = targets()
    wanted = names.split(",") if names else list(known)
    if unknown := [name for name in wanted if name not in known]:
        raise ValueError(f"no target {', '.join(unknown)}; there are {', '.join(known)}")
    return {name: known[name] for name in wanted}
