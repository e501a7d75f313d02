"""PNG pictures of particles and of convergence, drawn with matplotlib by the first rank."""

from pathlib import Path

import numpy as np

from .parallel import Ranks

_PLAIN = (0.27, 0.51, 0.71)


def snapshot(path, x, values=None, mesh=None, label="", title="", limits=None):
    """Write a PNG picture of particles, coloured by a scalar.

    In 1D the values are drawn over the positions, in 2D the particles are discs, in 3D shaded
    spheres that hide each other, seen from the front right and above with the third axis upwards.

    Parameters
    ----------
    path : path
        Missing folders are made.
    x : (n, d) array
        Positions in m, d = 1, 2 or 3; particles that are not at a finite place are left out.
    values : (n,) array, optional
        What the colours show.
    mesh : pair of (nv, d or 3) and (nc, d + 1) arrays, optional
        Points and cells: drawn as thin lines in 1D and 2D, as their bounding box in 3D.
    label, title : str
        Text at the colour bar (name and unit of the values) and above the picture.
    limits : pair of float, optional
        Values at the ends of the colour bar, the smallest and largest value unless given.

    Raises
    ------
    ImportError
        If matplotlib is missing.
    """
    return _strip(path, [(title, x, values)], mesh, label, limits)


def snapshot_strip(path, frames, mesh=None, label=""):
    """Write a PNG picture of several moments side by side, with common limits and colour bar.

    Parameters
    ----------
    path, mesh, label
        As in `snapshot`.
    frames : list of (t, x, values)
        Time in s, positions (n, d) in m and values (n,) or None; n may differ.

    Raises
    ------
    ImportError
        If matplotlib is missing.
    """
    return _strip(path, [(f"t = {t:.4g} s", x, values) for t, x, values in frames], mesh, label, None)


def convergence_plot(path, sizes, errors, ylabel, reference_orders=(1, 2)):
    """Write a PNG picture of errors over mesh sizes, both logarithmic, with the fitted orders.

    Parameters
    ----------
    path : path
        Missing folders are made.
    sizes : (m,) array
        Mesh sizes in m, at least two.
    errors : dict of name to (m,) array
        Positive errors, in the unit that ``ylabel`` names.
    ylabel : str
        Text at the vertical axis.
    reference_orders : sequence of float
        Slopes of the dashed lines.

    Raises
    ------
    ImportError
        If matplotlib is missing.
    """
    if Ranks().rank > 0:
        return path
    figure = _figure(5.2, 4.2)
    ax = figure.subplots()
    sizes = np.asarray(sizes, float)
    for marker, (name, e) in zip("osD^vP*X" * len(errors), errors.items(), strict=False):
        order = np.polyfit(np.log(sizes), np.log(e), 1)[0]
        ax.loglog(sizes, e, marker=marker, ms=5, lw=1.5, label=f"{name} (order {order:.2f})")
    ends = np.array([sizes.min(), sizes.max()])
    top = 0.6 * min(np.asarray(e)[sizes.argmax()] for e in errors.values())
    for order in reference_orders:
        line = top * (ends / ends[1]) ** order
        ax.loglog(ends, line, "--", color="0.6", lw=1, zorder=1)
        ax.annotate(
            f"{order:g}",
            (ends[0], line[0]),
            (-4, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            color="0.45",
        )
    ax.grid(True, which="both", color="0.93", lw=0.6)
    ax.set(xlabel="mesh size h in m", ylabel=ylabel)
    ax.legend(frameon=False)
    return _save(figure, path)


def curves(path, x, values, xlabel, ylabel):
    """Write a PNG picture of curves over one axis, such as columns of a log over time.

    Parameters
    ----------
    path : path
        Missing folders are made.
    x : (m,) array
    values : dict of name to (m,) array
        A legend is drawn where there is more than one.
    xlabel, ylabel : str
        Texts at the axes, with units.

    Raises
    ------
    ImportError
        If matplotlib is missing.
    """
    if Ranks().rank > 0:
        return path
    figure = _figure(5.2, 3.4)
    ax = figure.subplots()
    for name, y in values.items():
        ax.plot(x, y, lw=1.5, label=name)
    ax.grid(True, color="0.93", lw=0.6)
    ax.set(xlabel=xlabel, ylabel=ylabel)
    if len(values) > 1:
        ax.legend(frameon=False)
    return _save(figure, path)


def _figure(width, height):
    try:
        import matplotlib.backends.backend_agg
        import matplotlib.figure
    except ImportError as e:
        raise ImportError("pictures need matplotlib: pip install fempm[plot]") from e
    figure = matplotlib.figure.Figure((width, height), dpi=200, layout="constrained")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    return figure


def _save(figure, path):
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png", bbox_inches="tight")
    return path


def _strip(path, panels, mesh, label, limits):
    """Panels of (title, x, values) with the same axes."""
    if Ranks().rank > 0:
        return path
    figure = _figure(1, 1)
    from matplotlib.cm import ScalarMappable

    panels = [(title, *_finite(x, values)) for title, x, values in panels]
    d = panels[0][1].shape[1]
    places = [x for _, x, _ in panels]
    if mesh is not None:
        mesh = np.asarray(mesh[0], float)[:, :d], mesh[1]
        places.append(mesh[0])
    box = np.array(
        [
            np.min([p.min(0) for p in places if len(p)], axis=0),
            np.max([p.max(0) for p in places if len(p)], axis=0),
        ]
    )
    shown = [v[np.isfinite(v)] for _, _, v in panels if v is not None]
    coloured = len(shown) > 0
    shown = np.concatenate([*shown, [] if limits is None else limits])
    if limits is None:
        limits = (shown.min(), shown.max()) if len(shown) else (0, 1)
    colours = ScalarMappable(cmap="viridis")
    colours.set_clim(*limits)

    corners = _view(_corners(_grow(box))) if d == 3 else _grow(box)
    width, height = np.ptp(corners[:, :2], axis=0) if d > 1 else (3, 2)
    scale = min(6 / max(width, height), 16 / (len(panels) * width))
    figure.set_size_inches(len(panels) * max(scale * width, 1.5) + 1.2, max(scale * height, 1.0) + 0.8)
    axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    draw = (_draw1, _draw2, _draw3)[d - 1]
    for ax, (title, x, values) in zip(axes, panels, strict=True):
        draw(ax, x, values, mesh, box, colours)
        ax.set_title(title, fontsize=10)
    if d > 1 and coloured:
        figure.colorbar(colours, ax=axes, label=label, shrink=0.85, pad=0.02)
    elif d == 1:
        axes[0].set_ylabel(label)
    return _save(figure, path)


def _finite(x, values):
    x = np.asarray(x, float)
    keep = np.isfinite(x).all(axis=1)
    return x[keep], None if values is None else np.asarray(values, float)[keep]


def _spacing(x):
    """Distance of neighbours, estimated from the share of the bounding box that is occupied."""
    n, d = x.shape
    size = np.ptp(x, axis=0)
    longest = size.max()
    size = np.maximum(size, longest / n)
    edge = (4 * np.prod(size) / n) ** (1 / d)
    bins = np.floor((x - x.min(0)) / (edge or 1.0)).astype(np.int64)
    occupied = len(np.unique(bins, axis=0))
    return min(edge * (occupied / n) ** (1 / d), 0.1 * longest or 1.0)


def _grow(box):
    return box + np.array([[-0.02], [0.02]]) * (np.ptp(box, axis=0).max() or 1.0)


def _draw1(ax, x, values, mesh, box, colours):
    if mesh is not None:
        ax.vlines(mesh[0][:, 0], 0, 1, transform=ax.get_xaxis_transform(), color="0.9", lw=0.5, zorder=0)
    values = np.zeros(len(x)) if values is None else values
    ax.scatter(x[:, 0], values, s=8, c=colours.to_rgba(values), linewidths=0)
    lo, hi = colours.get_clim()
    pad = 0.05 * (hi - lo) or 1.0
    ax.set(xlim=_grow(box)[:, 0], ylim=(lo - pad, hi + pad), xlabel="x in m")


def _draw2(ax, x, values, mesh, box, colours):
    from matplotlib.collections import EllipseCollection

    if mesh is not None:
        points, cells = mesh
        ax.triplot(points[:, 0], points[:, 1], cells, lw=0.4, color="0.85", zorder=0)
    if len(x):
        size = [1.2 * _spacing(x)]
        faces = [_PLAIN] if values is None else colours.to_rgba(values)
        discs = EllipseCollection(
            size,
            size,
            [0],
            units="xy",
            offsets=x,
            facecolors=faces,
            offset_transform=ax.transData,
            linewidths=0,
        )
        ax.add_collection(discs)
    xlim, ylim = _grow(box).T
    ax.set(xlim=xlim, ylim=ylim, aspect="equal", xlabel="x in m")
    ax.label_outer()
    if ax.get_subplotspec().is_first_col():
        ax.set_ylabel("y in m")


def _view(x):
    """Turn positions to (right, up, towards the eye)."""
    a, e = np.radians(-60), np.radians(22)
    right = [-np.sin(a), np.cos(a), 0]
    up = [-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)]
    eye = [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]
    return x @ np.array([right, up, eye]).T


def _corners(box):
    return np.array([[box[i, 0], box[j, 1], box[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])


def _draw3(ax, x, values, mesh, box, colours):
    corner = _view(_corners(_grow(box)))
    for i, j in ((i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit):
        if 5 not in (i, j):  # the corner next to the eye, in front of the particles
            ax.plot(*corner[[i, j], :2].T, color="0.75", lw=0.7, zorder=0)
    for name, axis, i, j, side in (
        ("x", 0, 0, 4, "top"),
        ("y", 1, 4, 6, "top"),
        ("z", 2, 0, 1, "bottom"),
    ):
        along = corner[j] - corner[i]
        text = f"{name}  {box[0, axis]:.3g} … {box[1, axis]:.3g} m"
        ax.text(
            *(corner[i] + along / 2)[:2],
            text,
            fontsize=7,
            color="0.3",
            ha="center",
            va=side,
            rotation=np.degrees(np.arctan2(along[1], along[0])),
            rotation_mode="anchor",
        )
    if len(x):
        rgb = np.tile(_PLAIN, (len(x), 1)) if values is None else colours.to_rgba(values)[:, :3]
        lo, hi = corner.min(0), corner.max(0)
        image = _spheres(_view(x) - lo, rgb, 0.55 * _spacing(x), (hi - lo)[:2])
        ax.imshow(image, extent=(lo[0], hi[0], lo[1], hi[1]), origin="lower", zorder=1)
    ax.set_aspect("equal")
    ax.set_axis_off()


def _spheres(x, rgb, radius, size, pixels=1400):
    """RGBA image of shaded spheres at (right, up, towards the eye), nearest ones on top."""
    scale = pixels / size.max()
    # Limits the work for many particles and the size of a few.
    r = np.clip(radius * scale, 1.5, min(3000 / np.sqrt(len(x)), 0.02 * pixels))
    w, h = np.ceil(size * scale).astype(int) + 1
    order = np.argsort(x[:, 2])
    rgb = rgb[order].astype(np.float32)
    i, j, z = (x[order] * scale).T
    i, j = i.astype(int), j.astype(int)
    depth = np.full(w * h, -np.inf)
    owner = np.full(w * h, -1)
    light = np.zeros(w * h, np.float32)
    reach = int(r)
    for di, dj in np.ndindex(2 * reach + 1, 2 * reach + 1):
        di, dj = di - reach, dj - reach
        up2 = r**2 - di**2 - dj**2
        if up2 <= 0:
            continue
        front = z + np.sqrt(up2)
        pixel = (np.clip(j + dj, 0, h - 1)) * w + np.clip(i + di, 0, w - 1)
        new = front > depth[pixel]
        # Sorted by depth: of several spheres in one pixel the assignment keeps the nearest.
        depth[pixel[new]] = front[new]
        owner[pixel[new]] = np.flatnonzero(new)
        light[pixel[new]] = 0.35 + 0.65 * max(0.0, (-0.4 * di + 0.5 * dj + 0.77 * up2**0.5) / r)
    image = np.zeros((w * h, 4), np.float32)
    hit = owner >= 0
    fog = (z[owner[hit]] - z[0]) / (np.ptp(z) or 1.0)
    shade = (light[hit] * (0.7 + 0.3 * fog))[:, None]
    image[hit, :3] = rgb[owner[hit]] * shade
    image[hit, 3] = 1
    return image.reshape(h, w, 4)
