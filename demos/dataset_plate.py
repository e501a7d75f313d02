"""Data set of elastic plates that a rigid actuator bends, for `gnn` (quasi-static, in SI units).

A rubber plate, sometimes with a hole, is clamped at one or two of its ends; a sphere, a capsule or a rounded
box comes down on it, up to 20 degrees from straight down. Both are in one mesh of tetrahedra, whose points
are those at the start. Vertex fields: position in m, stress (von Mises, 0 in the actuator) in Pa. Node
types: 0 plate, 1 actuator, 3 clamped. The cells are linear and few across the plate, so that it is stiffer
than a converged solution. It touches without friction."""

import numpy as np

from fempm.gmsh_reader import model_arrays  # before gmsh: it loads MPI first
from fempm.mesh import facet_neighbours
from fempm.output import MeshFile

# isort: split
import gmsh
from dataset_airfoil import make_all
from elastic_bodies import ElasticBody, RigidContact, minimise
from scipy.spatial import cKDTree

from gnn.graph import HANDLE, NORMAL, OBSTACLE

RADIUS = 0.03  # m, within which nodes of the two bodies count as in contact
LAYER, START = 0.01, 0.015  # m, the gap at which they push each other, and that at the start
YOUNG, POISSON = 1e6, 0.4
SIZES = {
    "paper": {"h": 0.02, "layers": 3, "frames": 400},
    "mini": {"h": 0.04, "layers": 2, "frames": 50},
}


class Actuator:
    """A box that is rounded, or a sphere or capsule where some of its half lengths are zero.

    Attributes
    ----------
    half : (3,) half lengths of the box around which it extends by `radius`, all in m
    turn : (3, 3) its axes are the columns
    centre : (3,) where it is now
    """

    def __init__(self, half, radius, angle, centre):
        c, s = np.cos(angle), np.sin(angle)
        self.half, self.radius, self.angle = np.asarray(half, float), radius, angle
        self.turn, self.centre = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.asarray(centre, float)

    def gap(self, x):
        """Distances (m,) of points (m, 3) from its surface, negative inside, and normals."""
        own = (x - self.centre) @ self.turn
        offset = own - own.clip(-self.half, self.half)
        distance = np.linalg.norm(offset, axis=1)
        return distance - self.radius, offset / distance.clip(1e-300)[:, None] @ self.turn.T

    def volume(self):
        """Add it to the model of gmsh; returns its (dimension, tag)."""
        occ, (a, b, c), r = gmsh.model.occ, self.half, self.radius
        if not self.half.any():
            solid = occ.addSphere(0, 0, 0, r)
        elif not b and not c:
            ends = [(3, occ.addSphere(x, 0, 0, r)) for x in (-a, a)]
            solid = occ.fuse([(3, occ.addCylinder(-a, 0, 0, 2 * a, 0, 0, r))], ends)[0][0][1]
        else:
            box = occ.addBox(-a - r, -b - r, -c - r, 2 * (a + r), 2 * (b + r), 2 * (c + r))
            occ.synchronize()
            edges = gmsh.model.getBoundary(gmsh.model.getBoundary([(3, box)], oriented=False), False, False)
            solid = occ.fillet([box], sorted({tag for _, tag in edges}), [r])[0][1]
        occ.rotate([(3, solid)], 0, 0, 0, 0, 0, 1, self.angle)
        occ.translate([(3, solid)], *self.centre)
        return 3, solid


def two_meshes(plate, hole, actuator, h, layers):
    """Points, tetrahedra and (nc,) bool, those of the actuator.

    plate : (length, width, thickness) from the origin on; hole : (x, y, radius) through it, or None
    """
    gmsh.initialize(readConfigFiles=False)
    try:
        for name in ("General.Terminal", "Mesh.MeshSizeFromPoints", "Mesh.MeshSizeExtendFromBoundary"):
            gmsh.option.setNumber(name, 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        occ = gmsh.model.occ
        flat = [(2, occ.addRectangle(0, 0, 0, *plate[:2]))]
        if hole is not None:
            flat = occ.cut(flat, [(2, occ.addDisk(hole[0], hole[1], 0, hole[2], hole[2]))])[0]
        solid = [e for e in occ.extrude(flat, 0, 0, plate[2], numElements=[layers]) if e[0] == 3]
        rigid = actuator.volume()
        occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [tag for _, tag in solid], 1)
        gmsh.model.addPhysicalGroup(3, [rigid[1]], 2)
        gmsh.model.mesh.generate(3)
        points, cells, groups = model_arrays(gmsh.model, 3)[:3]
    finally:
        gmsh.finalize()
    return points, cells, groups == 2


def random_case(rng):
    """Plate, hole, actuator, its way (3,) in m and whether the far end is clamped, too."""
    plate, both = (0.4, rng.uniform(0.16, 0.24), 0.04), rng.random() < 0.5
    at = np.array([rng.uniform(0.45, 0.6) if both else rng.uniform(0.6, 0.85), rng.uniform(0.35, 0.65)])
    radius, kind = rng.uniform(0.04, 0.06), rng.integers(3)
    length = rng.uniform(0.02, 0.04, 3)
    half = length * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0.5]])[kind]
    centre = [*(at * plate[:2]), plate[2] + radius + half[2] + START]
    actuator = Actuator(half, radius, rng.uniform(0, np.pi), centre)
    hole = (0.28 * plate[0], rng.uniform(0.4, 0.6) * plate[1], 0.035) if rng.random() < 0.5 else None
    tilt, towards = np.deg2rad(rng.uniform(0, 20)), rng.uniform(0, 2 * np.pi)
    way = np.array([np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), -np.cos(tilt)])
    return plate, hole, actuator, way * (START + rng.uniform(0.05, 0.08)), both


def make(path, size, rng):
    """Write a trajectory of settings as in SIZES."""
    plate, hole, actuator, way, both = random_case(rng)
    X, cells, of_actuator = two_meshes(plate, hole, actuator, size["h"], size["layers"])
    node_type = np.full(len(X), NORMAL, np.int32)
    node_type[(X[:, 0] < 1e-9) | (both & (X[:, 0] > plate[0] - 1e-9))] = HANDLE
    rigid = np.unique(cells[of_actuator])
    node_type[rigid] = OBSTACLE
    skin = np.unique(facet_neighbours(cells[~of_actuator])[1])
    body = ElasticBody(X, cells[~of_actuator], YOUNG, POISSON)
    contact = RigidContact(skin, actuator.gap, 5 * YOUNG * size["h"], LAYER)
    x, start, least, iterations, pairs = X.copy(), actuator.centre, np.inf, 0, []
    with MeshFile(path, X, cells, static={"node_type": node_type}) as file:
        for k in range(size["frames"]):
            actuator.centre = start + k / (size["frames"] - 1) * way
            x[rigid] = X[rigid] + actuator.centre - start
            x, count = minimise([body, contact], x, node_type == NORMAL, 1e-6)
            file.write(k, position=np.float32(x), stress=np.float32(body.von_mises(x)))
            iterations, least = iterations + count, min(least, actuator.gap(x[skin])[0].min())
            pairs.append(cKDTree(x[rigid]).count_neighbors(cKDTree(x[skin]), RADIUS))
    return (
        f"{len(X)} nodes, {len(rigid)} of the actuator, {iterations} iterations, contact pairs within "
        f"{RADIUS} m: {np.mean(pairs):.0f} on the average, {max(pairs)} at most; "
        f"least gap {1e3 * least:.1f} mm, way {1e3 * np.linalg.norm(way):.0f} mm"
    )


if __name__ == "__main__":
    make_all(__doc__, make, SIZES)
