"""Contact edges: nodes close in space that no edge of the mesh joins (thesis 4.2.2)."""

import numpy as np
from scipy.spatial import cKDTree


def contact_edges(x, edges, radius):
    """Pairs of nodes at most `radius` apart that are not an edge of the mesh.

    Parameters
    ----------
    x : (n, d) positions of the nodes now
    edges : (ne, 2) edges of the mesh, the lower node first
    radius : contact radius, in the unit of x

    Returns
    -------
    (nce, 2) int32, the lower node first, sorted

    Raises
    ------
    ValueError : a radius that is not positive, positions that are not finite
    """
    x, n = np.asarray(x, float), len(x)
    if not radius > 0:
        raise ValueError(f"contact radius {radius}: it must be positive")
    lost = np.flatnonzero(~np.isfinite(x).all(axis=1))
    if len(lost):
        raise ValueError(f"node {lost[0]} is at {x[lost[0]]}: contact needs finite positions")
    pairs = np.sort(cKDTree(x).query_pairs(radius, output_type="ndarray"), axis=1).astype(np.int64)
    keys = np.sort(pairs[:, 0] * n + pairs[:, 1])
    keys = np.setdiff1d(keys, np.asarray(edges, np.int64) @ [n, 1], assume_unique=True)
    return np.stack(np.divmod(keys, n), axis=1).astype(np.int32)
