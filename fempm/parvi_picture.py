"""Pictures of samples: particles over contours of the density, and marginal histograms."""

import numpy as np


def draw_samples(path, samples, columns=5):
    """Scatter of two-dimensional samples over contours of their densities, one panel each.

    Parameters
    ----------
    path : of the picture
    samples : list of (title, positions (n, 2), log density (m, 2) -> (m,))

    Returns
    -------
    path
    """
    from matplotlib.figure import Figure

    if not samples:
        raise ValueError("no samples to draw: give at least one of them")
    columns = min(columns, len(samples))
    rows = -(-len(samples) // columns)
    figure = Figure(figsize=(2.6 * columns, 2.7 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for ax, (title, x, log_density) in zip(panels, samples):
        contours(ax, x, log_density)
        ax.plot(*x.T, ".", color="C3", ms=1.5)
        ax.set(title=title)
    for ax in panels[len(samples) :]:
        ax.set_axis_off()
    figure.savefig(path, dpi=140)
    return path


def contours(ax, x, log_density):
    """Contours of a density over the range of positions x (n, 2)."""
    room = 0.1 * np.ptp(x, axis=0)
    axes = [np.linspace(a, b, 200) for a, b in zip(x.min(axis=0) - room, x.max(axis=0) + room)]
    grid = np.stack(np.meshgrid(*axes), axis=-1)
    log = log_density(grid.reshape(-1, 2)).reshape(grid.shape[:2])
    levels = np.linspace(0.02, 1, 8)
    ax.contour(*axes, np.exp(log - log.max()), levels, colors="C0", linewidths=0.6, alpha=0.8)


def draw_marginals(path, x, names, reference=None):
    """Histograms of every coordinate and scatters of every pair.

    Parameters
    ----------
    path : of the picture
    x : (n, d) positions
    names : of the d coordinates
    reference : (m, d) another sample, drawn as lines and behind

    Returns
    -------
    path
    """
    from matplotlib.figure import Figure

    d = x.shape[1]
    figure = Figure(figsize=(2.4 * d, 2.3 * d), layout="constrained")
    for i, row in enumerate(figure.subplots(d, d, squeeze=False)):
        for j, ax in enumerate(row):
            if j > i:
                ax.set_axis_off()
            elif j == i:
                ax.hist(x[:, i], 30, density=True, color="C3", alpha=0.6)
                if reference is not None:
                    ax.hist(reference[:, i], 30, density=True, histtype="step", color="C0")
            else:
                if reference is not None:
                    ax.plot(reference[:, j], reference[:, i], ".", color="C0", ms=1.5, alpha=0.4)
                ax.plot(x[:, j], x[:, i], ".", color="C3", ms=1.5)
            if i == d - 1:
                ax.set_xlabel(names[j])
            if j == 0 and i > 0:
                ax.set_ylabel(names[i])
    figure.savefig(path, dpi=140)
    return path
