"""Bayesian posteriors of two and three parameters for the demos of `fempm.parvi`."""

import time
from functools import cache
from pathlib import Path

import numpy as np
from svgd import svgd

from fempm.parvi import sample

DATA = Path(__file__).parent.parent / "tests" / "data" / "breast_cancer_components.csv"
TRUE, NOISE, SEED = np.log([0.8, 1.2]), 0.3, 7  # ln rates, sd of the log counts, seed of the data
STEPS, EVERY, STEP = 40, 4, 0.2  # Runge-Kutta steps to t = 8, every 4th observed


def rates(z, theta):
    """Derivatives of the logarithms z (n, 2) of both counts: ln x' = a (1 - y), ln y' = b (x - 1)."""
    a, b = np.exp(theta).T
    return np.stack([a * (1 - np.exp(z[:, 1])), b * (np.exp(z[:, 0]) - 1)], axis=1)


def counts(theta):
    """(n, m, 2) logarithms of both counts at the times of observation for parameters theta (n, 2)."""
    z, seen = np.tile(np.log([3.0, 0.5]), (len(theta), 1)), []
    for step in range(1, STEPS + 1):  # classical Runge-Kutta
        k1 = rates(z, theta)
        k2 = rates(z + STEP / 2 * k1, theta)
        k3 = rates(z + STEP / 2 * k2, theta)
        z = z + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + rates(z + STEP * k3, theta))
        if step % EVERY == 0:
            seen.append(z)
    return np.stack(seen, axis=1)


@cache
def observed():
    """Logarithms of noisy counts (1, m, 2) for the true rates."""
    noise = np.random.default_rng(SEED).standard_normal((1, STEPS // EVERY, 2))
    return counts(TRUE[None]) + NOISE * noise


def log_density(theta):
    """Prior N(0, 1) of ln rates and normal errors of the observations, up to a constant."""
    misfit = np.sum(((counts(theta) - observed()) / NOISE) ** 2, axis=(1, 2))
    return -0.5 * misfit - 0.5 * np.sum(theta**2, axis=1)


def score(theta, step=1e-5):
    """Central differences of the log density, all in one call."""
    shifts = step * np.concatenate([np.eye(2), -np.eye(2)])
    log = log_density((theta + shifts[:, None]).reshape(-1, 2)).reshape(4, -1)
    return (log[:2] - log[2:]).T / (2 * step)


def on_grid(centre, half, n=101):
    """Mean and deviation of the posterior by quadrature over centre +- half."""
    axes = [np.linspace(c - h, c + h, n) for c, h in zip(centre, half)]
    theta = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    log = log_density(theta)
    weight = np.exp(log - log.max())
    mean = weight @ theta / weight.sum()
    return mean, np.sqrt(weight @ (theta - mean) ** 2 / weight.sum())


def gas_and_svgd(score, start, args, rate):
    """What the gas returns, and name -> (positions, CPU seconds) of it and of SVGD from the same start."""
    began = time.process_time()
    found = sample(score, start, n=args.n, until=args.until, threads=args.threads)
    results = {"MPM-ParVI": (found.positions, time.process_time() - began)}
    if args.steps:
        began = time.process_time()
        x = svgd(start(args.n, np.random.default_rng(0)), score, args.steps, rate)
        results["SVGD"] = x, time.process_time() - began
    return found, results


class Logistic:
    """Log density of the parameters (bias, two slopes) given tumours that are benign or not."""

    prior = 25.0  # variance of each parameter

    def __init__(self):
        table = np.genfromtxt(DATA, delimiter=",", skip_header=1)
        self.sign = 2 * table[:, 2] - 1
        self.features = np.concatenate([np.ones((len(table), 1)), table[:, :2]], axis=1)

    def score(self, w):
        """Gradient (n, 3) at parameters w (n, 3)."""
        wrong = 1 / (1 + np.exp(np.clip(self.sign * (w @ self.features.T), -700, 700)))
        return (self.sign * wrong) @ self.features - w / self.prior

    def accuracy(self, w):
        """Share of the tumours that the mean parameters class rightly."""
        return float(np.mean(self.sign * (self.features @ w) > 0))
