"""Which cell holds each particle: walking across facets, with a search over all cells as fallback."""

import numpy as np
from numba import njit

from .weights import barycentric

INSIDE = -1e-10  # barycentric coordinate below which a point counts as outside
MAX_WALK = 64
FOUND, ON_WALL, LOST = 0, 1, 2


class LostParticles(RuntimeError):
    """Particles that are in no cell of the mesh.

    Attributes
    ----------
    ids : (n,) numbers of the particles
    positions : (n, d)
    """

    def __init__(self, ids, positions, lower, upper):
        self.ids, self.positions = np.asarray(ids), np.asarray(positions)
        first = ", ".join(
            f"{i} at {np.array2string(x, precision=6, separator=', ')}"
            for i, x in zip(self.ids[:3], self.positions[:3], strict=False)
        )
        super().__init__(
            f"{len(self.ids)} particle(s) outside the mesh (which spans {lower} to {upper}): {first}"
            f"{', ...' if len(self.ids) > 3 else ''}; enlarge the mesh, give its boundary a wall, "
            "or shorten the time step"
        )


def find_cells(mesh, x):
    """Cells (n,) int32 that hold the points x (n, d); LostParticles if any is outside the mesh."""
    x = np.ascontiguousarray(x, float)
    not_finite = np.flatnonzero(~np.isfinite(x).all(axis=1))
    cell = np.zeros(len(x), np.int32)
    if len(not_finite) == 0:
        axes = tuple(range(mesh.dim))
        search(axes, x, cell, mesh.cells, mesh.points, mesh.inverse, *cell_bins(mesh))
        not_finite = np.flatnonzero(cell < 0)
    if len(not_finite):
        raise LostParticles(not_finite, x[not_finite], mesh.points.min(axis=0), mesh.points.max(axis=0))
    return cell


def cell_bins(mesh):
    """Cells binned by bounding box: (lower corner, 1 / bin size, bins per axis, CSR start, cells)."""
    lower, upper = mesh.points.min(axis=0), mesh.points.max(axis=0)
    per_axis = max(1, int(len(mesh.cells) ** (1 / mesh.dim) / 2))
    shape = np.full(mesh.dim, per_axis)
    inverse_size = shape / (upper - lower)
    corners = mesh.points[mesh.cells]
    first = np.clip(((corners.min(axis=1) - lower) * inverse_size - 1e-9).astype(int), 0, shape - 1)
    last = np.clip(((corners.max(axis=1) - lower) * inverse_size + 1e-9).astype(int), 0, shape - 1)
    start, content = fill_bins(first, last, per_axis)
    return lower, inverse_size, per_axis, start, content


def wall_facets(mesh, layer):
    """(nc, d + 1) bool: facets on walls, by the vertex opposite."""
    return (mesh.neighbours == -1) & ~mark_facets(mesh, layer.open_facets)


def mark_facets(mesh, facets):
    """(nc, d + 1) bool: exterior facets that are among those given, (nf, d), by the vertex opposite."""
    out, (cell, corner) = np.zeros(mesh.cells.shape, bool), np.nonzero(mesh.neighbours == -1)
    place = mesh.exterior_places(facets)
    place = place[place >= 0]
    out[cell[place], corner[place]] = True
    return out


@njit(cache=True)
def fill_bins(first, last, per_axis):
    """CSR (start, cells) of the cells whose box [first, last] touches each bin."""
    nc, dim = first.shape
    start = np.zeros(per_axis**dim + 1, np.int64)
    content = np.empty(0, np.int32)
    for fill in range(2):
        at = start[:-1].copy() if fill else np.zeros(1, np.int64)
        for c in range(nc):
            i = first[c].copy()
            while True:
                b = 0
                for a in range(dim):
                    b = b * per_axis + i[a]
                if fill:
                    content[at[b]] = c
                    at[b] += 1
                else:
                    start[b + 1] += 1
                a = 0
                while a < dim and i[a] == last[c, a]:
                    i[a] = first[c, a]
                    a += 1
                if a == dim:
                    break
                i[a] += 1
        if not fill:
            start = np.cumsum(start)
            content = np.empty(start[-1], np.int32)
    return start, content


@njit(cache=True)
def search(axes, x, cell, cells, points, inverse, lower, inverse_size, per_axis, start, content):
    """Cell of each point by its bin, -1 where there is none."""
    for p in range(len(x)):
        cell[p] = search_one(
            axes, x[p], cells, points, inverse, lower, inverse_size, per_axis, start, content
        )


@njit(cache=True)
def search_one(axes, x, cells, points, inverse, lower, inverse_size, per_axis, start, content):
    """Cell in the bin of x with the largest least barycentric coordinate, -1 if x is in none."""
    b = np.empty(4)
    index = 0
    for a in range(len(axes)):
        i = int((x[a] - lower[a]) * inverse_size[a])
        index = index * per_axis + min(max(i, 0), per_axis - 1)
    best, found = -1e300, -1
    for j in range(start[index], start[index + 1]):
        barycentric(axes, b, x, content[j], cells, points, inverse)
        least = b[: len(axes) + 1].min()
        if least > best:
            best, found = least, content[j]
    return found if best >= INSIDE else -1


@njit(cache=True, nogil=True, error_model="numpy")
def walk(axes, first, last, x, cell, cells, points, inverse, neighbours, wall_facet, bins, status, counts):
    """Move particles first..last-1 to their cells, stepping across the most negative facet.

    A particle that steps through a wall, by less than the height of the cell there, is put back onto
    it (`counts[0]` of them). Where the walk ends at an open facet or runs too long, all cells of the
    particle's bin are tried; a particle in none of them gets status LOST (`counts[1]`).
    """
    b = np.empty(4)
    y = np.empty(len(axes))
    corners = len(axes) + 1
    for p in range(first, last):
        for a in range(len(axes)):  # a copy, as a view x[p] would count references
            y[a] = x[p, a]
        c = cell[p]
        status[p] = LOST
        for _ in range(MAX_WALK):
            barycentric(axes, b, y, c, cells, points, inverse)
            q = 0
            for i in range(1, corners):
                if b[i] < b[q]:
                    q = i
            if b[q] >= INSIDE:
                status[p] = FOUND
                break
            if not b[q] < INSIDE:  # not a number
                break
            if neighbours[c, q] < 0:
                if wall_facet[c, q] and b[q] > -1.0:
                    status[p] = ON_WALL
                break
            c = neighbours[c, q]
        if status[p] != FOUND:
            found = -1
            finite = np.isfinite(b[0])
            if finite:
                found = search_one(axes, y, cells, points, inverse, *bins)
            if found >= 0:
                c = found
                status[p] = FOUND
            elif finite and status[p] == ON_WALL:
                put_back(axes, b, x[p], c, cells, points)
                counts[0] += 1
            else:
                status[p] = LOST
                counts[1] += 1
        cell[p] = c


@njit(cache=True)
def put_back(axes, b, x, c, cells, points):
    """Move x, outside cell c, to the point of c with its negative barycentric coordinates cut off."""
    total = 0.0
    for q in range(len(axes) + 1):
        b[q] = max(b[q], 1e-9)
        total += b[q]
    for a in range(len(axes)):
        x[a] = 0.0
        for q in range(len(axes) + 1):
            x[a] += b[q] / total * points[cells[c, q], a]


@njit(cache=True, error_model="numpy")
def sort_by_cell(cell, count, order, active, start):
    """Counting sort: `order` lists particles cell by cell; active cells and their ranges in it.

    Cells come in the order in which particles first touch them; cells without particles cost nothing.
    `count` (nc + 1,) is scratch, zero before and after. Returns the number of active cells.
    """
    active_cells = 0
    for c in cell:
        if count[c] == 0:
            active[active_cells] = c
            active_cells += 1
        count[c] += 1
    total = 0
    for i in range(active_cells):
        start[i] = total
        total += count[active[i]]
        count[active[i]] = start[i]
    start[active_cells] = total
    for p in range(len(cell)):
        order[count[cell[p]]] = p
        count[cell[p]] += 1
    for i in range(active_cells):
        count[active[i]] = 0
    return active_cells
