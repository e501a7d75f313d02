"""Data set of letters that swell until their strokes touch, for `gnn` (quasi-static plane strain, SI units).

Four random letters in a box, filled with triangles. Their rubber grows across the strokes only, up to the
random factor `growth`, so that these swell like those of balloons and resist where that does not fit: holes
and gaps close. Drag on the nodes slows them down, as in the first-order quasi-static integration of Fang et
al. 2021. Letters and strokes push each other without friction through a barrier. A letter is 1 m wide
or high. Vertex field: position in m; the points of the mesh are those at the start. Node type: 0.
Touching nodes are closer than a mesh size h, which the summary names."""

import string

import numpy as np

from fempm.gmsh_reader import model_arrays  # before gmsh: it loads MPI first
from fempm.mesh import facet_neighbours
from fempm.output import MeshFile

# isort: split
import gmsh
from dataset_airfoil import make_all
from elastic_bodies import Drag, ElasticBody, RigidContact, SelfContact, minimise
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from scipy.spatial import cKDTree

from gnn.contact import contact_edges
from gnn.graph import from_cells

LETTERS = string.ascii_letters + string.digits + "&@"
YOUNG, POISSON, DRAG = 1e5, 0.3, 1e4  # Pa, 1, Pa s/m^2: rubber moves by about YOUNG / DRAG strokes in 1 s
SPACING, BOX = 1.07, 1.17  # m between the middles of the letters, and from the middle to the walls
SIZES = {
    "paper": {"h": 0.0135, "frames": 100},
    "mini": {"h": 0.07, "frames": 30},
}


def outlines(letter, h, origin):
    """Closed outlines (n, 2) of a letter, 1 m wide or high, whichever is more, around an origin (2,)."""
    path = TextPath((0, 0), letter, size=1.0, prop=FontProperties(family="DejaVu Sans", weight="bold"))
    loops = [loop[:-1] for loop in path.to_polygons(closed_only=True)]
    every = np.concatenate(loops)
    low, high = every.min(axis=0), every.max(axis=0)
    return [resampled((loop - 0.5 * (low + high)) / max(high - low) + origin, h) for loop in loops]


def resampled(loop, h):
    """Points about h apart along a closed polygon, corners of more than 30 degrees among them."""
    loop = loop[np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1) > 1e-9]
    ahead = np.roll(loop, -1, axis=0) - loop
    angle = np.unwrap(np.arctan2(*ahead.T[::-1]))
    turn = np.abs((angle - np.roll(angle, 1) + np.pi) % (2 * np.pi) - np.pi)
    corners = np.flatnonzero(turn > np.deg2rad(30))
    loop = np.roll(loop, -corners[0] if len(corners) else 0, axis=0)
    corners = (corners - corners[0]) if len(corners) else np.array([0])
    loop = np.concatenate([loop, loop[:1]])
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
    ends, pieces = length[[*corners, -1]], []
    for a, b in zip(ends[:-1], ends[1:]):
        count = max(1 if len(corners) > 2 else 3, round((b - a) / h))
        pieces.append(np.linspace(a, b, count, endpoint=False))
    at = np.concatenate(pieces)
    return np.column_stack([np.interp(at, length, loop[:, i]) for i in range(2)])


def inside(point, loop):
    """Whether a point is in a polygon: an odd number of its edges lies to the right."""
    (x, y), (a, b) = point, (loop, np.roll(loop, -1, axis=0))
    cut = (a[:, 1] > y) != (b[:, 1] > y)
    a, b = a[cut], b[cut]
    return np.sum(a[:, 0] + (y - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0]) > x) % 2 == 1


def letter_mesh(loops, h):
    """Points (n, 2) and triangles of what outlines enclose, holes left out."""
    depth = [sum(inside(loop[0], other) for other in loops if other is not loop) for loop in loops]
    gmsh.initialize(readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        geo, curves = gmsh.model.geo, []
        for loop in loops:
            tags = [geo.addPoint(*p, 0, h) for p in loop]
            lines = [geo.addLine(a, b) for a, b in zip(tags, [*tags[1:], tags[0]])]
            for line in lines:
                geo.mesh.setTransfiniteCurve(line, 2)
            curves.append(geo.addCurveLoop(lines))
        for i, loop in enumerate(loops):
            if depth[i] % 2 == 0:
                holes = [j for j, o in enumerate(loops) if depth[j] == depth[i] + 1 and inside(o[0], loop)]
                geo.addPlaneSurface([curves[i], *(curves[j] for j in holes)])
        geo.synchronize()
        gmsh.model.mesh.generate(2)
        return model_arrays(gmsh.model, 2)[:2]
    finally:
        gmsh.finalize()


def across(X, cells, segments, samples=8):
    """(nc, 2, 2) projections n n^T onto the directions n from the cells to the nearest points outside."""
    a, b = X[segments[:, :1]], X[segments[:, 1:]]
    on = (a + (np.arange(samples)[:, None] + 0.5) / samples * (b - a)).reshape(-1, 2)
    middle = X[cells].mean(axis=1)
    distance, nearest = cKDTree(on).query(middle)
    n = (on[nearest] - middle) / distance[:, None]
    return n[:, :, None] * n[:, None]


def walls(axis):
    """Gap (m,) of points (m, 2) to the nearer wall of the box across an axis, and its normals."""
    return lambda x: (BOX - np.abs(x[:, axis]), -np.sign(x[:, axis])[:, None] * np.eye(2)[axis])


def make(path, size, rng, letters=None, growth=None):
    """Write a trajectory of settings as in SIZES; letters and growth are random but for what is given."""
    h, letters = size["h"], letters or "".join(rng.choice(list(LETTERS), 4))
    growth = growth or rng.uniform(1.8, 2.6)
    grid = SPACING * np.array([[-0.5, 0.5], [0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
    X, cells = letter_mesh([o for a, at in zip(letters, grid) for o in outlines(a, h, at)], h)
    segments = facet_neighbours(cells)[1]
    contact, rim = SelfContact(segments, YOUNG, layer=0.3 * h, reach=0.5 * h), np.unique(segments)
    box = [RigidContact(rim, walls(axis), 3 * YOUNG, 0.3 * h) for axis in (0, 1)]
    stretch, step = across(X, cells, segments), 1 / (size["frames"] - 1)
    body = ElasticBody(X, cells, YOUNG, POISSON)
    area = np.bincount(cells.ravel(), np.repeat(body.volumes / 3, 3))
    edges = from_cells(X, cells).edges
    x, iterations, pairs = X, 0, []
    with MeshFile(path, X, cells, static={"node_type": np.zeros(len(X), np.int32)}) as file:
        for k in range(size["frames"]):
            if k > 0:
                body = ElasticBody(X, cells, YOUNG, POISSON)
                body.grow(np.eye(2) + k * step * (growth - 1) * stretch)
                terms = [body, contact, *box, Drag(area, DRAG / step, x)]
                x, count = minimise(terms, x, np.ones(len(x), bool), 1e-3 * h)
                iterations += count
            file.write(k * step, position=np.float32(x))
            pairs.append(len(contact_edges(x, edges, h)))
    distance = np.linalg.norm(contact.pairs(x, contact.layer)[2], axis=1)
    return (
        f"{letters} times {growth:.2f}, {len(X)} nodes, {len(edges)} edges, {iterations} iterations, "
        f"contact pairs within {h} m: {np.mean(pairs):.0f} on the average, {pairs[-1]} at the end, outlines "
        f"{distance.min(initial=np.inf) / h:.3f} h apart"
    )


if __name__ == "__main__":
    make_all(__doc__, make, SIZES)
