"""The update on the vertices: folding of mirror vertices, velocities, walls.

`grid` (nv, 1 + 2 d) holds mass, momentum and force as the transfers accumulate them; `velocity` (nv, d)
and `increment` (nv, d), which only FLIP needs, are what particles read back.
"""

from numba import njit

options = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**options)
def mark_vertices(active, num_active, ring_start, ring_vertex, stamp, now, vertices):
    """List the vertices in the rings of the active cells; returns how many there are."""
    n = 0
    for i in range(num_active):
        c = active[i]
        for j in range(ring_start[c], ring_start[c + 1]):
            v = ring_vertex[j]
            if stamp[v] != now:
                stamp[v] = now
                vertices[n] = v
                n += 1
    return n


@njit(**options)
def clear(grids, vertices, n):
    """Zero the listed rows of every thread's grid."""
    for t in range(grids.shape[0]):
        for i in range(n):
            for j in range(grids.shape[2]):
                grids[t, vertices[i], j] = 0.0


@njit(**options)
def sum_threads(grids, vertices, n):
    """Add the grids of all threads into the first, in order."""
    for i in range(n):
        v = vertices[i]
        for t in range(1, grids.shape[0]):
            for j in range(grids.shape[2]):
                grids[0, v, j] += grids[t, v, j]


@njit(**options)
def fold_mirrors(grid, stamp, now, first_mirror, owner, fold, drift, gravity):
    """m_i += m_g, p_i += C^T (p_g - m_g drift_g), f_i += C^T f_g for every mirror g of vertex i.

    The weight m_g gravity is a force like others; as the update adds gravity to m_i + m_g, the part that
    is not folded is taken out here.
    """
    d = fold.shape[1]
    for g in range(len(owner)):
        v = first_mirror + g
        i = owner[g]
        if stamp[v] == now:
            grid[i, 0] += grid[v, 0]
            for a in range(d):
                grid[i, 1 + d + a] -= grid[v, 0] * gravity[a]
                for b in range(d):
                    p = grid[v, 1 + b] - grid[v, 0] * drift[g, b]
                    grid[i, 1 + a] += fold[g, b, a] * p
                    grid[i, 1 + d + a] += fold[g, b, a] * (grid[v, 1 + d + b] + grid[v, 0] * gravity[b])


@njit(**options)
def update_velocity(grid, vertices, n, num_real, dt, gravity, smallest_mass, velocity, increment):
    """v = p / m + dt (f / m + gravity) on the listed vertices (lines 2 and 6 of Algorithm 1).

    A vertex whose mass is not above `smallest_mass` (negative weights can cancel it) is left out: its
    velocity is zero. Returns the number of such vertices and the momentum they lose, summed by size.
    """
    d = len(gravity)
    keep = len(increment) > 0
    dropped = 0
    lost = 0.0
    for i in range(n):
        v = vertices[i]
        if v >= num_real:
            continue
        m = grid[v, 0]
        if not m > smallest_mass:
            missed = 0.0
            for a in range(d):
                missed += abs(grid[v, 1 + a] + dt * grid[v, 1 + d + a])
                velocity[v, a] = 0.0
                if keep:
                    increment[v, a] = 0.0
            dropped += missed > 0.0
            lost += missed
            continue
        for a in range(d):
            dv = dt * (grid[v, 1 + d + a] / m + gravity[a])
            velocity[v, a] = grid[v, 1 + a] / m + dv
            if keep:
                increment[v, a] = dv
    return dropped, lost


@njit(**options)
def constrain(stamp, now, vertices, project, drift, change, velocity, increment):
    """v = P v + v_wall at wall vertices, with the wall's own velocity change for FLIP (line 6)."""
    d = project.shape[1]
    for i in range(len(vertices)):
        v = vertices[i]
        if stamp[v] != now:
            continue
        apply(project[i], velocity[v], drift[i], d)
        if len(increment) > 0:
            apply(project[i], increment[v], change[i], d)


@njit(**options)
def apply(matrix, x, shift, d):
    """x = matrix x + shift, in place, for d <= 3 entries."""
    x0 = x[0]
    x1 = x[1] if d > 1 else 0.0
    x2 = x[2] if d > 2 else 0.0
    for a in range(d):
        x[a] = shift[a] + matrix[a, 0] * x0
        if d > 1:
            x[a] += matrix[a, 1] * x1
        if d > 2:
            x[a] += matrix[a, 2] * x2


@njit(**options)
def fill_mirrors(stamp, now, first_mirror, owner, fold, drift, change, velocity, increment):
    """v_g = C v_i + drift_g at mirror vertices, and the same for the increments."""
    d = fold.shape[1]
    for g in range(len(owner)):
        v = first_mirror + g
        if stamp[v] != now:
            continue
        for a in range(d):
            velocity[v, a] = velocity[owner[g], a]
        apply(fold[g], velocity[v], drift[g], d)
        if len(increment) > 0:
            for a in range(d):
                increment[v, a] = increment[owner[g], a]
            apply(fold[g], increment[v], change[g], d)


@njit(**options)
def fold_scalars(grid, stamp, now, first_mirror, source):
    """Add the first two columns of mirrors to the vertices whose scalars they share."""
    for g in range(len(source)):
        if stamp[first_mirror + g] == now:
            for j in range(2):
                grid[source[g], j] += grid[first_mirror + g, j]


@njit(**options)
def divide(grid, vertices, n, first_mirror, source, out):
    """out = column 1 / column 0 of the listed vertices, at mirrors that of their source."""
    for i in range(n):
        v = vertices[i]
        if v < first_mirror:
            out[v] = grid[v, 1] / grid[v, 0] if grid[v, 0] > 0 else 1.0
    for i in range(n):
        v = vertices[i]
        if v >= first_mirror:
            out[v] = out[source[v - first_mirror]]
