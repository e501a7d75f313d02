"""How close particles are to a target density: discrepancies of samples, and the error of the mesh.

One number is never enough: a lost mode hardly shows in the kernel Stein discrepancy, wrong tails hardly in
MMD^2. Compare with the numbers of independent samples of the same size.
"""

import numpy as np

from .consistency import Conditions, correct
from .kernel import build_kernel, evaluate_many
from .particles import fill_cells
from .walls import wall_layer

REFERENCE = 2000  # exact samples that MMD^2 is taken against, at a cost that grows with their square
BLOCK = 1000  # rows of a matrix of distances that are in memory at a time


def squared_distances(x, y):
    """(n, m) |x_i - y_j|^2."""
    return np.maximum(np.sum(x**2, axis=1)[:, None] + np.sum(y**2, axis=1) - 2 * x @ y.T, 0.0)


def mean_kernel(x, y, width):
    """Mean of exp(-|x_i - y_j|^2 / (2 width^2)) over all pairs."""
    parts = [np.exp(squared_distances(x[i : i + BLOCK], y) / (-2 * width**2)).sum() for i in blocks(x)]
    return sum(parts) / (len(x) * len(y))


def blocks(x):
    """First rows of the blocks of x."""
    return range(0, len(x), BLOCK)


def mmd2(x, y, width=0.5):
    """Squared maximum mean discrepancy with a Gaussian kernel, the V-statistic (Gretton et al. 2012).

    Parameters
    ----------
    x, y : (n, d), (m, d) samples
    width : of the kernel, in the unit of x
    """
    return mean_kernel(x, x, width) + mean_kernel(y, y, width) - 2 * mean_kernel(x, y, width)


def sliced_wasserstein(x, y, directions=200, quantiles=1000):
    """Sliced Wasserstein-2 distance: root of the mean square over directions (Bonneel et al. 2015).

    Parameters
    ----------
    x, y : (n, d), (m, d) samples
    directions : number of directions, evenly spread over a half circle in 2D, quasi-random in 3D
    quantiles : points at which the quantiles of the projections are compared
    """
    axes = spread_directions(x.shape[1], directions)
    at = (np.arange(quantiles) + 0.5) / quantiles
    difference = projected_quantiles(x, axes, at) - projected_quantiles(y, axes, at)
    return float(np.sqrt(np.mean(difference**2)))


def projected_quantiles(x, axes, at):
    """(k, m) quantiles `at` (m,) of x (n, d) along axes (k, d), linear between the sorted values."""
    order = np.sort(axes @ x.T, axis=1)  # many quantiles: np.quantile would partition for each
    place = at * (len(x) - 1)
    low = np.minimum(place.astype(int), len(x) - 2)
    return order[:, low] + (place - low) * (order[:, low + 1] - order[:, low])


def spread_directions(d, number):
    """(number, d) unit vectors spread over a half sphere; the Fibonacci lattice in 3D."""
    k = (np.arange(number) + 0.5) / number
    if d == 1:
        return np.ones((1, 1))
    if d == 2:
        return np.stack([np.cos(np.pi * k), np.sin(np.pi * k)], axis=1)
    angle = np.pi * (1 + np.sqrt(5)) * np.arange(number)
    radius = np.sqrt(1 - k**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), k], axis=1)


def kernel_stein(x, score, width=1.0):
    """Kernel Stein discrepancy with the kernel (width^2 + r^2)^(-1/2) (Gorham and Mackey 2017).

    Parameters
    ----------
    x : (n, d) samples
    score : (n, d) gradient of the log density there
    """
    n, d = x.shape
    own = np.sum(x * score, axis=1)
    total = 0.0
    for i in blocks(x):
        rows = slice(i, i + BLOCK)
        r2 = squared_distances(x[rows], x)
        u = width**2 + r2
        # (x - y) . (s(x) - s(y))
        mixed = own[rows, None] + own - x[rows] @ score.T - score[rows] @ x.T
        total += np.sum(u**-0.5 * (score[rows] @ score.T) + u**-1.5 * (mixed + d) - 3 * r2 * u**-2.5)
    return float(np.sqrt(max(total, 0.0)) / n)


def compare(x, exact, score, width=0.5):
    """Numbers of a sample beside exact ones: dict with "MMD2", "SW2" and "KSD", nan where `score` is None.

    Parameters
    ----------
    x, exact : (n, d) sample, and (m, d) independent samples of the target, many
    score : (n, d) of the target at x; None for a density that does not vanish at its boundary
    width : of the kernel of MMD^2
    """
    ksd = np.nan if score is None else kernel_stein(x, score)
    return {"MMD2": mmd2(x, exact[:REFERENCE], width), "SW2": sliced_wasserstein(x, exact), "KSD": ksd}


def stationary_residual(mesh, log_density, score, walls=(), gradient="plain", per_cell=None):
    """Share of the score's force that the discrete gas does not balance when it lies as the target.

    |int pi (w_i score + g_i)| / |int pi w_i score|, roots of sums over vertices of squares over mass. With
    the true gradient of w_i in place of g_i it is zero (int pi (g_i - grad w_i) by parts).

    Parameters
    ----------
    mesh, walls, gradient : as for `Simulation`
    log_density, score : functions of (n, d) positions, log pi up to a constant and its gradient
    per_cell : quadrature points in a cell, 16 (8 in 3D) when not given
    """
    layer = wall_layer(mesh, walls)
    kernel = build_kernel(mesh, layer)
    if gradient == "consistent":
        correct(kernel, mesh, layer)
    x, volume = fill_cells(mesh, per_cell or min(16, 2 ** (mesh.dim * (5 - mesh.dim))))
    cell = np.repeat(np.arange(len(mesh.cells)), len(x) // len(mesh.cells))
    log = log_density(x)
    weight = volume * np.exp(log - log.max())
    near = weight > 1e-12 * weight.max()
    x, cell, weight = x[near], cell[near], weight[near] / weight.sum()
    mass = np.zeros(len(kernel.points))
    net, pull = np.zeros_like(kernel.points), np.zeros_like(kernel.points)
    for first in blocks(x):
        rows = slice(first, first + BLOCK)
        w, g = evaluate_many(kernel, x[rows], cell[rows])
        start, end = kernel.ring_start[cell[rows]], kernel.ring_start[cell[rows] + 1]
        used = np.arange(w.shape[1]) < (end - start)[:, None]
        vertex = kernel.ring_vertex[(start[:, None] + np.arange(w.shape[1]))[used]]
        force = w[:, :, None] * score(x[rows])[:, None]
        share = weight[rows, None, None]
        np.add.at(mass, vertex, (share[:, :, 0] * w)[used])
        np.add.at(pull, vertex, (share * force)[used])
        np.add.at(net, vertex, (share * (force + g))[used])
    conditions = Conditions(kernel, mesh, layer)
    net, pull = conditions.fold(net), conditions.fold(pull)
    np.add.at(mass, layer.source, mass[conditions.unknowns :])
    inner = mass > 1e-12
    inner[layer.vertices] = False
    inner[len(mesh.points) :] = False
    return float(np.sqrt(np.sum(net[inner].T ** 2 / mass[inner]) / np.sum(pull[inner].T ** 2 / mass[inner])))
