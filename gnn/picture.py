"""Pictures of rollouts: truth, prediction and error side by side, as a strip of moments or a film."""

import numpy as np


def magnitude(values):
    """(n,) of scalars (n,), or lengths of vectors (n, c)."""
    return values if values.ndim == 1 else np.linalg.norm(values, axis=1)


def draw(ax, graph, values, low, high, points=None, colours="viridis"):
    """A field on a mesh: a line in 1D, triangles in 2D, nodes in 3D seen along the second axis."""
    x = graph.points if points is None else points
    if x.shape[1] == 1:
        ax.plot(x[:, 0], values, ".")
        ax.set_ylim(low, high)
        return
    if x.shape[1] == 3 or graph.cells.shape[1] != 3:
        order = np.argsort(-x[:, 1])
        ax.scatter(x[order, 0], x[order, -1], c=values[order], s=4, vmin=low, vmax=high, cmap=colours)
    else:
        shading = {"shading": "gouraud", "vmin": low, "vmax": high, "cmap": colours}
        ax.tripcolor(x[:, 0], x[:, 1], graph.cells, values, **shading)
    ax.set_aspect("equal")
    ax.set_axis_off()


def panels(graph, truth, found, deforms):
    """Title, values and positions of the three rows of a moment."""
    if deforms:
        truth, found = truth.reshape(graph.points.shape), found.reshape(graph.points.shape)
    error = magnitude(found - truth)
    if deforms:
        shift = magnitude(truth - graph.points), magnitude(found - graph.points)
        return [("truth", shift[0], truth), ("prediction", shift[1], found), ("error", error, truth)]
    return [
        ("truth", magnitude(truth), None),
        ("prediction", magnitude(found), None),
        ("error", error, None),
    ]


def all_panels(graph, truth, found, chosen, deforms):
    """Panels of each of the chosen moments, and the scales (low, high, colours) of their titles."""
    rows = [panels(graph, truth[k], found[k], deforms) for k in chosen]
    fields = [values for row in rows for _, values, _ in row[:2]]
    scale = min(v.min() for v in fields), max(v.max() for v in fields), "viridis"
    worst = max(row[2][1].max() for row in rows) or 1.0
    return rows, {"truth": scale, "prediction": scale, "error": (0.0, worst, "magma")}


def rollout_strip(path, graph, times, truth, found, moments=4, name="", deforms=False):
    """PNG with a column for each of some moments; truth and found are (nt, n[, c]).

    Returns
    -------
    path
    """
    from matplotlib.figure import Figure

    chosen = np.unique(np.linspace(0, len(times) - 1, moments + 1).round().astype(int))[1:]
    rows, scales = all_panels(graph, truth, found, chosen, deforms)
    figure = Figure(figsize=(4 * len(chosen), 5), layout="constrained")
    axes = figure.subplots(3, len(chosen), squeeze=False)
    for column, (k, row) in enumerate(zip(chosen, rows)):
        for line, (title, values, points) in enumerate(row):
            low, high, colours = scales[title]
            draw(axes[line, column], graph, values, low, high, points, colours)
            text = f"{name} {title}, t = {times[k]:.3g}" if line == 0 else title
            axes[line, column].set_title(text, fontsize=9)
    low, high, _ = scales["truth"]
    figure.suptitle(f"{low:.3g} to {high:.3g}; error up to {scales['error'][1]:.3g}", fontsize=9)
    figure.savefig(path, dpi=110)
    return path


def rollout_film(path, graph, times, truth, found, name="", deforms=False, most=60):
    """GIF of the same."""
    from matplotlib.animation import FuncAnimation, PillowWriter
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    chosen = np.unique(np.linspace(0, len(times) - 1, most).round().astype(int))
    rows, scales = all_panels(graph, truth, found, chosen, deforms)
    figure = Figure(figsize=(6, 6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, 1)

    def frame(k):
        for ax, (title, values, points) in zip(axes, rows[k]):
            ax.clear()
            low, high, colours = scales[title]
            draw(ax, graph, values, low, high, points, colours)
            ax.set_title(f"{name} {title}, t = {times[chosen[k]]:.3g}", fontsize=9)

    film = FuncAnimation(figure, frame, frames=len(chosen))
    film.save(path, writer=PillowWriter(fps=12))
    return path


def levels_picture(path, named, most=6):
    """PNG of the graphs of all levels, a row for each of some meshes (thesis figure 4.4).

    Parameters
    ----------
    named : name -> (MeshGraph, Hierarchy)

    Returns
    -------
    path
    """
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    columns = min(most, max(len(hierarchy.levels) for _, hierarchy in named.values()))
    figure = Figure(figsize=(2.6 * columns, 2.4 * len(named)), layout="constrained")
    axes = figure.subplots(len(named), columns, squeeze=False)
    for row, (name, (graph, hierarchy)) in zip(axes, named.items()):
        x, shown = (
            graph.points[:, [0, -1]] if graph.points.shape[1] == 3 else graph.points,
            np.arange(columns),
        )
        picked = np.linspace(0, len(hierarchy.levels) - 1, columns).round().astype(int)
        for l, level in enumerate(hierarchy.levels):
            for ax in row[shown[picked == l]]:
                ax.add_collection(LineCollection(x[level.edges], linewidths=0.4, colors="tab:blue"))
                ax.plot(*x.T, ".", color="tab:red", markersize=min(4, 60 / np.sqrt(len(x))))
                ax.set_title(f"{name}, level {l}: {len(x)} nodes", fontsize=8)
            if level.kept is not None:
                x = x[level.kept]
        for ax in row:
            low, high = graph.points[:, [0, -1]].min(axis=0), graph.points[:, [0, -1]].max(axis=0)
            rim = 0.03 * (high - low)
            ax.set(**{f"{a}lim": (low[k] - rim[k], high[k] + rim[k]) for k, a in enumerate("xy")})
            ax.set_aspect("equal")
            ax.set_axis_off()
    figure.savefig(path, dpi=130)
    return path
