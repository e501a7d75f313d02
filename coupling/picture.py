"""PNG pictures of a gas, drawn with matplotlib by the first rank."""

import numpy as np

from fempm.parallel import Ranks
from fempm.picture import _PLAIN, _figure, _save

from .probes import probe

PIXELS = 600  # along the longer side of a slice through three dimensions


def profiles(path, x, fields, exact=None, marks=(), title=""):
    """Write a PNG picture of density, velocity and pressure along a line: points, over an exact curve.

    Parameters
    ----------
    path : path
        Missing folders are made.
    x : (n,) array
        Coordinates in m.
    fields : dict of name to (n,) or (n, 1) array
        "density", "velocity" and "pressure"; others are left out.
    exact : pair of (m,) array and dict of name to (m,) array, optional
        Coordinates and values of the curves.
    marks : sequence of float
        Coordinates of dotted vertical lines, such as the exact places of shocks.
    title : str
        Text above the panels.

    Raises
    ------
    ImportError
        If matplotlib is missing.
    """
    if Ranks().rank > 0:
        return path
    figure = _figure(11, 3.4)
    units = {"density": "kg/m³", "velocity": "m/s", "pressure": "Pa"}
    for ax, (name, unit) in zip(figure.subplots(1, 3), units.items()):
        if exact is not None:
            ax.plot(exact[0], np.ravel(exact[1][name]), "k-", lw=0.9, zorder=1)
        ax.plot(x, np.ravel(fields[name]), "o", ms=2.2, mew=0, color=_PLAIN, zorder=2)
        for mark in marks:
            ax.axvline(mark, color="0.6", lw=0.7, ls=":", zorder=0)
        ax.set_axisbelow(True)
        ax.grid(True, color="0.93", lw=0.6)
        ax.set(xlabel="x in m", ylabel=f"{name} in {unit}")
    figure.suptitle(title, fontsize=11)
    return _save(figure, path)


def spread(frames, count):
    """`count` of the frames of a record, or all there are, evenly up to the last and without the first."""
    last = len(frames) - 1
    return [frames[k] for k in sorted({-(-last * i // count) for i in range(1, count + 1)})]


def schlieren_strip(path, mesh, frames, contrast=15.0, plane=None, box=None, particles=None):
    """Write a PNG picture of several moments as a schlieren photograph, exp(-contrast |grad rho| / max).

    Parameters
    ----------
    path : path
        Missing folders are made.
    mesh : fempm.SimplexMesh
        Of two dimensions, or three with a plane.
    frames : list of (t, fields)
        Time in s and vertex fields with "schlieren", as in the record of a run.
    contrast : float
        The larger, the weaker the waves that are seen.
    plane : pair of int and float, optional
        Axis and coordinate of a plane: in 3D, the slice that is drawn.
    box : (left, right, bottom, top), optional
        Part of the domain that is drawn.
    particles : list of (n, d) arrays, optional
        Positions at each moment, drawn over it; in 3D those in front of or behind the plane as well.

    Raises
    ------
    ImportError
        If matplotlib is missing.
    """
    grey = [(t, np.exp(-contrast * f["schlieren"] / max(f["schlieren"].max(), 1e-300))) for t, f in frames]
    return _strip(path, mesh, grey, plane, box, "gray", (0, 1), None, particles)


def colour_strip(path, mesh, frames, field, label="", limits=None, plane=None, box=None, particles=None):
    """Write a PNG picture of a scalar field at several moments, with common limits and colour bar.

    Parameters
    ----------
    path, mesh, frames, plane, box, particles
        As in `schlieren_strip`.
    field : str
        Name of the field.
    label : str
        Text at the colour bar, name and unit.
    limits : pair of float, optional
        Values at its ends, the smallest and largest value unless given.

    Raises
    ------
    ImportError
        If matplotlib is missing.
    """
    shown = [(t, f[field]) for t, f in frames]
    if limits is None:
        limits = min(v.min() for _, v in shown), max(v.max() for _, v in shown)
    return _strip(path, mesh, shown, plane, box, "viridis", limits, label, particles)


def _strip(path, mesh, frames, plane, box, cmap, limits, label, particles):
    """Panels of (time, vertex values), one above the other where the domain is wide."""
    if Ranks().rank > 0:
        return path
    if mesh.dim == 1 or (mesh.dim == 3 and plane is None):
        raise ValueError("a strip shows two dimensions: give the plane of a slice in 3D, or use `profiles`")
    figure = _figure(1, 1)
    axes = [a for a in range(mesh.dim) if plane is None or a != plane[0]]
    low, high = mesh.points.min(axis=0)[axes], mesh.points.max(axis=0)[axes]
    if box is not None:
        low, high = np.array(box)[[0, 2]], np.array(box)[[1, 3]]
    width, height = high - low
    scale = min(7 / width, 4 / height) if width > 1.5 * height else min(3.4 / width, 5 / height)
    rows, columns = (len(frames), 1) if width > 1.5 * height else (1, len(frames))
    figure.set_size_inches(columns * scale * width + 1.2, rows * (scale * height + 0.35) + 0.4)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for k, (ax, (t, values)) in enumerate(zip(panels, frames)):
        if mesh.dim == 2:
            x, y = mesh.points.T
            image = ax.tripcolor(x, y, mesh.cells, values, shading="gouraud", cmap=cmap)
        else:
            image = _slice(ax, mesh, values, plane, axes, low, high, cmap)
        image.set_clim(*limits)
        if particles is not None:
            x = particles[k][:, axes]
            size = np.clip(2e3 * scale / max(len(x), 1) ** 0.5, 0.3, 3.0)
            ax.scatter(*x.T, s=size, color=_PLAIN, linewidths=0)
        ax.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        ax.set(xlabel=f"{'xyz'[axes[0]]} in m", ylabel=f"{'xyz'[axes[1]]} in m")
        ax.set_title(f"t = {t:.4g} s", fontsize=10)
        ax.label_outer()
    if label is not None:
        figure.colorbar(image, ax=list(panels), label=label, shrink=0.85, pad=0.02)
    return _save(figure, path)


def _slice(ax, mesh, values, plane, axes, low, high, cmap):
    """The values in a plane through a mesh of tetrahedra, as pixels."""
    step = np.max(high - low) / PIXELS
    u, v = (np.arange(a + 0.5 * step, b, step) for a, b in zip(low, high))
    points = np.empty((len(v), len(u), 3))
    points[..., axes[0]], points[..., axes[1]], points[..., plane[0]] = u, v[:, None], plane[1]
    pixels = probe(mesh, points, values).reshape(len(v), len(u))
    extent = (low[0], high[0], low[1], high[1])
    return ax.imshow(pixels, extent=extent, origin="lower", cmap=cmap, interpolation="bilinear")
