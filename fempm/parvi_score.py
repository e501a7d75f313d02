"""Targets of `parvi.sample`: the score, given or from a log density, its checks and width; even starts."""

import warnings
from statistics import NormalDist

import numpy as np

ADVICE = (
    "meshes have 1 to 3 dimensions: project onto the few directions that matter (principal components), or "
    "sample blocks of 2 or 3 coordinates in turn, the others held"
)


class Score:
    """The gradient of the log density of a target, checked at every call.

    Parameters
    ----------
    function : positions (n, d) -> scores (n, d), or -> log densities (n,); the number of axes tells which
    dim : d, 1 to 3
    torch : the function works on torch tensors (float64); log densities are then differentiated by autograd,
        those of NumPy by central differences, with a warning

    Raises
    ------
    ValueError
        for more dimensions, values of another shape, and at any later call for a value that is not finite
    """

    def __init__(self, function, dim, torch=False):
        if dim not in (1, 2, 3):
            raise ValueError(f"positions with {dim} coordinates: {ADVICE}")
        self.function, self.dim, self.torch, self.is_density = function, dim, torch, None

    def __call__(self, x):
        """(n, d) scores at positions x (n, d)."""
        if len(x) == 0:
            return np.zeros_like(x)
        if self.is_density is None:
            self._look(x)
        score = self._autograd(x) if self.torch else self._numpy(x.copy())  # whatever the function does to it
        bad = np.flatnonzero(~np.isfinite(score).all(axis=1))
        if len(bad):
            raise ValueError(
                f"the score at {x[bad[0]]} is {score[bad[0]]} ({len(bad)} of {len(x)} positions): the target "
                "must be positive and smooth there; bound it by a mesh with walls, or start closer to it"
            )
        return score

    def _look(self, x):
        """Find out what the function returns."""
        value = self._autograd(x, raw=True) if self.torch else np.asarray(self.function(x.copy()))
        if value.shape not in (x.shape, x.shape[:1]):
            raise ValueError(
                f"the target returns shape {tuple(value.shape)} for positions {x.shape}: give scores "
                f"{x.shape} or log densities ({len(x)},)"
            )
        self.is_density = value.ndim == 1
        if self.is_density and not self.torch:
            warnings.warn(
                "the score is a finite difference of the log density: 2 d evaluations a step, six digits; "
                "give the score, or a torch function",
                stacklevel=5,
            )

    def _numpy(self, x):
        if not self.is_density:
            return np.asarray(self.function(x), float)
        score = np.empty_like(x)
        for a in range(self.dim):
            step = 6e-6 * np.maximum(np.abs(x[:, a]), 1.0)  # cube root of the rounding error
            apart = np.zeros_like(x)
            apart[:, a] = step
            score[:, a] = (self.function(x + apart) - self.function(x - apart)) / (2 * step)
        return score

    def _autograd(self, x, raw=False):
        import torch

        at = torch.tensor(x, dtype=torch.float64, requires_grad=True)
        value = self.function(at)
        if raw:
            return value.detach().numpy()
        if self.is_density:
            (value,) = torch.autograd.grad(value.sum(), at)
        return value.detach().numpy().astype(float)


def widths(score, x):
    """(n, d) width of the target along the axes at positions x, 1 / sqrt(-d score_a / d x_a), inf where flat.

    For a normal target it is the conditional standard deviation of each coordinate.
    """
    out = np.empty_like(x)
    for a in range(x.shape[1]):
        apart = np.zeros(x.shape[1])
        apart[a] = 1e-4 * max(np.ptp(x[:, a]) if len(x) else 0.0, 1e-9)
        slope = (score(x + apart)[:, a] - score(x - apart)[:, a]) / (2 * apart[a])
        with np.errstate(divide="ignore", invalid="ignore"):
            out[:, a] = np.where(slope < 0, 1 / np.sqrt(-slope), np.inf)
    return out


def normal_start(mean, deviation):
    """A start that covers a normal distribution evenly: a Kronecker sequence through the inverse normal.

    An even start has modes of equal width filled alike, where independent draws would leave each of eight
    modes of a thousand particles off by 10 %.

    Parameters
    ----------
    mean, deviation : (d,) or a number for every coordinate; one of them tells d

    Returns
    -------
    function (n, rng) -> (n, d), for `sample`
    """
    mean, deviation = np.broadcast_arrays(np.atleast_1d(mean).astype(float), np.atleast_1d(deviation))
    if not np.all(deviation > 0):
        raise ValueError(f"deviation {deviation}: give more than 0")

    def positions(n, rng):
        d, ratio = len(mean), 2.0
        for _ in range(60):  # root of ratio^(d + 1) = ratio + 1, the golden ratio for d = 1 (Roberts 2018)
            ratio = (1 + ratio) ** (1 / (d + 1))
        share = (np.arange(n)[:, None] * ratio ** -np.arange(1.0, d + 1) + rng.random(d)) % 1.0
        inverse = np.vectorize(NormalDist().inv_cdf, otypes=[float])
        return mean + deviation * inverse(np.clip(share, 1e-9, 1 - 1e-9))

    return positions
