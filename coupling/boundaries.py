"""Boundary conditions of the gas on named boundaries of the mesh (thesis 3.2.9)."""

from dataclasses import dataclass

import numpy as np

from fempm.walls import CORNER_ANGLE, check_disjoint, smooth_patches

from .spaces import boundary_areas


@dataclass
class SlipWall:
    """A wall at rest: no flow through it, no friction along it."""

    boundary: str = "boundary"


@dataclass
class Periodic:
    """Two boundaries that are the same up to a translation."""

    boundary: str
    other: str


@dataclass
class Inflow:
    """Gas that comes in faster than sound: the whole state is given.

    Attributes
    ----------
    boundary : name
    density, pressure : of the gas that comes in
    velocity : (d,), or
    mach : its Mach number, straight into the domain
    """

    boundary: str
    density: float
    pressure: float
    velocity: np.ndarray | None = None
    mach: float | None = None
    supersonic = True


@dataclass
class SubsonicInflow(Inflow):
    """Gas that comes in slower than sound: density and velocity are given, the pressure is that inside.

    Its pressure only turns a Mach number into a velocity.
    """

    supersonic = False


@dataclass
class Outflow:
    """An open end: waves leave, and what comes in slowly takes the far state.

    Every outgoing wave passes; the deviations that incoming ones carry from the far state decay with
    exp(-attenuation t), as in Kwatra et al. 2009. Faster than sound this is plain extrapolation. A jet that
    pumps gas out of a box needs a higher rate to keep the pressure around it.

    Attributes
    ----------
    boundary : name
    attenuation : rate in 1/s, half the far speed of sound over the size of the mesh when not given
    density, velocity, pressure : the far state, the initial one of each node when not given
    """

    boundary: str
    attenuation: float | None = None
    density: float | None = None
    velocity: np.ndarray | None = None
    pressure: float | None = None


class Boundaries:
    """All conditions of a scene, as arrays on the nodes of a space.

    Parameters
    ----------
    mesh, space : the mesh and the whole space on it
    conditions : list of the above, one for each exterior facet
    eos : equation of state
    initial : (n, d + 2) primitive variables, the far state of outflows that name none

    Attributes
    ----------
    constrained : (k,) nodes with a condition on their velocity
    project : (k, d, d) projections onto its free directions, zero at inflows
    fixed : (f,) nodes at inflows; fixed_state : (f, d + 2) their density, velocity and pressure;
        fixed_area : (f, d) int phi_i n there
    floating : (f,) bool, the subsonic ones, whose pressure is that inside
    open : (m,) nodes at outflows; open_area : (m, d) int phi_i n there; resistance : (m, d, d) the sum of
        |int phi_i n| n n^T over outflows; far : (m, d + 2) density, velocity, pressure; attenuation : (m,)

    Raises
    ------
    KeyError, ValueError
        for an unknown boundary, facets with two conditions or none, a state that does not fit
    """

    def __init__(self, mesh, space, conditions, eos, initial):
        conditions = [c for c in conditions if not isinstance(c, Periodic)]
        d = space.dim
        facets = [np.asarray(mesh.facets(c.boundary)).reshape(-1, d) for c in conditions]
        check_disjoint(mesh, conditions, facets)
        walls, inflows, outflows = [], {}, []
        fixed_area = np.zeros_like(space.points)
        for condition, f in zip(conditions, facets):
            if isinstance(condition, SlipWall):
                walls.append(f)
            elif isinstance(condition, Inflow):
                area = boundary_areas(mesh, space, f)
                nodes = np.flatnonzero(np.any(area != 0, axis=1))
                state = inflow_state(condition, area[nodes], eos)
                fixed_area += area
                inflows |= {i: (s, not condition.supersonic) for i, s in zip(nodes.tolist(), state)}
            else:
                outflows.append((condition, boundary_areas(mesh, space, f)))
        self.fixed = np.array(sorted(inflows), int)
        self.fixed_state = np.array([inflows[i][0] for i in self.fixed]).reshape(-1, d + 2)
        self.floating = np.array([inflows[i][1] for i in self.fixed], bool)
        self.fixed_area = fixed_area[self.fixed]
        walls = np.concatenate([np.empty((0, d), int), *walls])
        normals = wall_normals(mesh, space, walls)
        zero = {i: np.zeros((d, d)) for i in inflows}
        projections = {i: np.eye(d) - np.linalg.pinv(n, 1e-6) @ n for i, n in normals.items()} | zero
        self.constrained = np.array(sorted(projections), int)
        self.project = np.array([projections[i] for i in self.constrained]).reshape(-1, d, d)
        self.collect_outflows(space, eos, outflows, initial)

    def collect_outflows(self, space, eos, outflows, initial):
        """Fill in the arrays of the outflows, without the nodes at inflows."""
        d, far = space.dim, initial.copy()
        area, rate = np.zeros_like(space.points), np.zeros(len(space.points))
        resistance = np.zeros((*area.shape, d))
        for condition, part in outflows:
            area += part
            size = np.maximum(np.linalg.norm(part, axis=1), 1e-300)
            resistance += part[:, :, None] * (part / size[:, None])[:, None, :]
            nodes = np.any(part != 0, axis=1)
            state = condition.density, condition.velocity, condition.pressure
            for value, column in zip(state, (0, slice(1, d + 1), d + 1)):
                if value is not None:
                    far[nodes, column] = value
            sound = np.sqrt(eos.bulk_modulus(far[nodes, 0], far[nodes, -1]) / far[nodes, 0])
            usual = 0.5 * sound / np.ptp(space.points, axis=0).max()
            rate[nodes] = usual if condition.attenuation is None else condition.attenuation
        area[self.fixed] = 0
        self.open = np.flatnonzero(np.any(area != 0, axis=1))
        self.open_area, self.resistance = area[self.open], resistance[self.open]
        self.far, self.attenuation = far[self.open], rate[self.open]

    def restrict(self, nodes):
        """Keep only the conditions at these nodes (sorted), numbered by their place among them."""
        for index, columns in (
            ("constrained", ("project",)),
            ("fixed", ("fixed_state", "fixed_area", "floating")),
            ("open", ("open_area", "resistance", "far", "attenuation")),
        ):
            kept = np.isin(getattr(self, index), nodes)
            for name in columns:
                setattr(self, name, getattr(self, name)[kept])
            setattr(self, index, np.searchsorted(nodes, getattr(self, index)[kept]))


def inflow_state(condition, areas, eos):
    """(k, d + 2) density, velocity and pressure at inflow nodes with areas (k, d)."""
    d = areas.shape[1]
    density, pressure = np.array([condition.density]), np.array([condition.pressure])
    name = f"inflow {condition.boundary!r}"
    if (condition.velocity is None) == (condition.mach is None):
        raise ValueError(f"{name}: give either velocity or mach")
    for what, value in (("density", condition.density), ("pressure", condition.pressure)):
        if not value > 0:
            raise ValueError(f"{name}: {what} {value} must be positive")
    sound = float(np.sqrt(eos.bulk_modulus(density, pressure) / density)[0])
    inward = -areas / np.linalg.norm(areas, axis=1, keepdims=True)
    if condition.mach is not None:
        velocity = condition.mach * sound * inward
    else:
        velocity = np.broadcast_to(np.asarray(condition.velocity, float).reshape(-1), (len(areas), d))
    mach = np.sum(velocity * inward, axis=1) / sound
    if condition.supersonic and not np.all(mach >= 1):
        raise ValueError(f"{name}: Mach {mach.min():.4g} is subsonic, use SubsonicInflow or Outflow")
    if not condition.supersonic and not np.all((mach < 1) & (mach > 0)):
        raise ValueError(f"{name}: Mach {mach.max():.4g} is not between 0 and 1, use Inflow")
    return np.concatenate(
        [np.full((len(areas), 1), density), velocity, np.full((len(areas), 1), pressure)], 1
    )


def wall_normals(mesh, space, facets):
    """Node -> (m, d) normals of the walls there: one per smooth piece, their mean around outer edges.

    In a corner that the gas fills, no piece lets it through; around one that stands into the gas it turns.
    """
    found, centres = {}, {}
    for patch in smooth_patches(mesh, 0, facets):
        area = boundary_areas(mesh, space, patch.facets)
        centre = mesh.points[patch.facets].mean(axis=1)
        near = {}
        for f, x in zip(patch.facets.tolist(), centre):
            for v in f:
                near.setdefault(int(space.node_of_vertex[v]), []).append(x)
        for i in np.flatnonzero(np.any(area != 0, axis=1)).tolist():
            found.setdefault(i, []).append(area[i])
            centres.setdefault(i, []).append(np.mean(near.get(i, [space.points[i]]), axis=0))
    return {i: merged_normals(space.points[i], areas, centres[i]) for i, areas in found.items()}


def merged_normals(point, areas, centres):
    """Unit normals of the pieces of wall at a node, those around an edge that stands into the gas as one."""
    areas = [a.copy() for a in areas]
    normals = [a / np.linalg.norm(a) for a in areas]
    label = list(range(len(areas)))
    for k in range(len(areas)):
        for m in range(k):
            outer = normals[m] @ (centres[k] - point) > 1e-6 * np.linalg.norm(centres[k] - point)
            if outer or normals[m] @ normals[k] > np.cos(CORNER_ANGLE):
                label = [label[m] if other == label[k] else other for other in label]
    sums = [sum(a for a, other in zip(areas, label) if other == name) for name in sorted(set(label))]
    return np.array([s / np.linalg.norm(s) for s in sums])


def check_covered(mesh, conditions):
    """Raise a ValueError unless each exterior facet has a condition."""
    claimed = [mesh.facets(name).reshape(-1, mesh.dim) for c in conditions for name in names(c)]
    missing = mesh.other_facets(np.concatenate([np.empty((0, mesh.dim), np.int32), *claimed]))
    if len(missing):
        at = mesh.points[missing[0]].mean(axis=0)
        raise ValueError(
            f"{len(missing)} facets of the boundary have no condition, the first at {at.tolist()}: "
            f"this mesh has {sorted(mesh.boundaries)}"
        )


def names(condition):
    """Names of the boundaries of one condition."""
    return [condition.boundary, condition.other] if isinstance(condition, Periodic) else [condition.boundary]
