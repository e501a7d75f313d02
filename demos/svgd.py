"""Stein variational gradient descent (Liu and Wang 2016), a short reference to compare `fempm.parvi` with."""

import numpy as np

from fempm.parvi_diagnostics import squared_distances


def svgd(x, score, steps=1000, rate=0.1, memory=0.9):
    """Particles after gradient descent with a Gaussian kernel of median width, RMS-scaled steps.

    Parameters
    ----------
    x : (n, d) start
    score : function (n, d) -> (n, d)
    steps, rate, memory : number of steps, their length in the unit of x (a tenth of it in the last fifth),
        and the share of the mean square of the gradient that is kept in a step
    """
    n, square = len(x), 0.0
    for step in range(steps):
        r2 = squared_distances(x, x)
        h = np.median(r2) / np.log(n + 1)
        k = np.exp(-r2 / h)
        gradient = (k @ score(x) + 2 / h * (x * k.sum(axis=1, keepdims=True) - k @ x)) / n
        square = memory * square + (1 - memory) * gradient**2 if step else gradient**2
        fine = 0.1 if step > 0.8 * steps else 1.0
        x = x + fine * rate * gradient / (1e-6 + np.sqrt(square))
    return x
