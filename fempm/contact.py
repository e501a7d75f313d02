"""Frictional contact of particles with walls and rigid obstacles through a barrier (thesis section 2.3.5).

A particle at distance d < d_hat is pushed away by f_n = kappa (d - d_hat) [2 ln(d / d_hat) - d_hat / d + 1],
the slope of B = -kappa (d - d_hat)^2 ln(d / d_hat), which grows without bound as d -> 0. It is
kappa = 4 rho c^2 A / d_hat with the modulus of the undeformed body and the area A = V^((d-1)/d) of the
particle: a layer of thickness d_hat, four times as stiff as the body, which stops the whole cell behind
the first particles to touch, in impacts up to about 0.7 c (with 1 for 4, up to 0.25 c).

Friction is f_t = -mu s f_n u / |u|, s = 2 |u| / eps - u^2 / eps^2; the slip u grows with the tangential
motion up to |u| = eps, where s = 1: below that, friction holds like a spring, and eps is chosen so that
this spring is about as stiff as the body.

On a wall, d is the distance to the nearest facet of each smooth patch of the boundary (`walls`).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .barrier import FLOOR, GUARD, LEAST, STIFFNESS, WATCH, contact_forces, motions, slips, wall_contacts
from .kernel import evaluate_many
from .locate import cell_bins
from .mesh import mean_edge_length
from .walls import check_friction, facet_normals, smooth_patches


@dataclass
class Obstacle:
    """A rigid body at rest, given by its signed distance function.

    Attributes
    ----------
    distance : function of positions (n, d) -> (n,), negative inside, with a gradient of length one
    friction : coefficient mu of Coulomb's law
    reach : distance d_hat at which contact begins, a quarter of the mean mesh size when not given
    name : used in messages
    """

    distance: Callable
    friction: float = 0.0
    reach: float | None = None
    name: str = "obstacle"

    def __post_init__(self):
        if not callable(self.distance):
            raise TypeError(f"{self.name}: distance {self.distance!r} is not a function of positions")
        check_friction(self.name, self.friction, self.reach)

    def distance_at(self, x):
        """(n,) distances at positions x (n, d)."""
        distance = np.asarray(self.distance(x), float)
        if distance.shape != (len(x),) or not np.isfinite(distance).all():
            raise ValueError(
                f"{self.name}: its distance function returns shape {distance.shape} for {len(x)} positions, "
                "or values that are not finite"
            )
        return distance

    def normal_at(self, x, step):
        """(n, d) gradients of the distance by central differences."""
        shifts = step * np.eye(x.shape[1])
        slope = np.stack([self.distance_at(x + s) - self.distance_at(x - s) for s in shifts], axis=1)
        return slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-300)


class Contact:
    """Contacts of the particles of a simulation with its walls of kind "contact" and its obstacles.

    Attributes
    ----------
    num : number of contacts, particles nearer than WATCH d_hat to a surface
    particle : (num, ) index of the particle, ascending within a cell
    surface : (num,) number of the surface: patches of walls, then obstacles
    distance, normal, start : (num,), (num, d), (num, d) distance d, direction away from the surface, and
        position of the particle when the contact was found
    slip_limit : (num,) eps of the friction law, zero without friction
    rate : largest rate that the contacts ask the time step to resolve, 1 / s
    """

    def __init__(self, mesh, walls, obstacles, bodies):
        self.obstacles, self.axes = list(obstacles), tuple(range(mesh.dim))
        self.num, self.rate, self.reach, self.friction = 0, 0.0, np.empty(0), np.empty(0)
        self._allocate(0)
        chosen = [wall for wall in walls if wall.kind == "contact"]
        if not chosen and not self.obstacles:
            return
        size = mean_edge_length(mesh.points, mesh.adjacency_start, mesh.adjacency)
        patches = [p for k, w in enumerate(chosen) for p in smooth_patches(mesh, k, mesh.facets(w.boundary))]
        reach = [w.reach or 0.25 * size[np.unique(mesh.facets(w.boundary))].mean() for w in chosen]
        around = [o.reach or 0.25 * size.mean() for o in self.obstacles]
        self.reach = np.array([*(reach[p.wall] for p in patches), *around])
        friction = [*(chosen[p.wall].friction for p in patches), *(o.friction for o in self.obstacles)]
        self.friction = np.array(friction, float)
        facets = np.concatenate([np.empty((0, mesh.dim), np.int32), *(p.facets for p in patches)])
        self.facet_surface = np.repeat(np.arange(len(patches)), [len(p.facets) for p in patches])
        self.corners = np.ascontiguousarray(mesh.points[facets])
        inward = -facet_normals(mesh, facets)
        self.inward = inward / np.linalg.norm(inward, axis=1, keepdims=True)
        reach_of_facets = WATCH * self.reach[self.facet_surface]
        self.cell_start, self.cell_facet = facets_near_cells(mesh, self.corners, reach_of_facets)
        self.near_obstacle = [
            cells_near(mesh, o.distance_at(mesh.points), WATCH * r)
            for o, r in zip(self.obstacles, around, strict=True)
        ]
        materials = [body.material for body in bodies]
        self.modulus = STIFFNESS * np.array([m.density * m.wave_speed(1.0, 1.0) ** 2 for m in materials])

    def __bool__(self):
        return len(self.reach) > 0

    def _allocate(self, room):
        d = len(self.axes)
        self.particle, self.surface = np.empty(room, np.int64), np.empty(room, np.int64)
        self.distance, self.slip_limit = np.empty(room), np.empty(room)
        self.normal, self.start = np.empty((room, d)), np.empty((room, d))

    @property
    def _found(self):
        return self.particle, self.surface, self.distance, self.normal, self.start

    def _reserve(self, room):
        """Make room for that many contacts, and some more, keeping those found."""
        if room > len(self.particle):
            before = self._found
            self._allocate(room + room // 4)
            for array, old in zip(self._found, before, strict=True):
                array[: len(old)] = old

    def add_state(self, particles):
        """Give the particles the variables that contact keeps."""
        d = len(self.axes)
        if self:
            particles.add_state("contact_force", (d,))
            particles.add_state("contact_motion", (d,))
        if np.any(self.friction):
            particles.add_state("slip", (d,))
            particles.add_state("friction_work", ())

    def find(self, particles, active, num_active, start, order):
        """Find the contacts of the particles, cell by cell as sorted, and the forces of these contacts."""
        p = particles
        facets = (self.cell_start, self.cell_facet, self.facet_surface, self.corners, self.inward)
        walls = (self.axes, active, num_active, start, order, p.position, *facets, self.reach)
        self.num = wall_contacts(*walls, *self._found)
        if self.num > len(self.particle):
            self._reserve(self.num)
            wall_contacts(*walls, *self._found)
        for k, near in enumerate(self.near_obstacle):
            self._meet(k, near, p)
        if self.obstacles:
            by_particle = np.argsort(self.particle[: self.num], kind="stable")
            for array in self._found:
                array[: self.num] = array[by_particle]
        stops = np.array([part.stop for part in p.ranges])
        self.rate = contact_forces(
            self.num,
            *(self.particle, self.surface, self.distance, self.normal, self.reach, self.friction),
            *(
                stops,
                self.modulus,
                p.velocity,
                p.state["contact_motion"],
                p.mass,
                p.volume,
                p.state.get("slip"),
            ),
            self.slip_limit,
            p.state["contact_force"],
        )

    def _meet(self, k, near, p):
        """Append the contacts with obstacle k."""
        obstacle, surface = self.obstacles[k], len(self.reach) - len(self.obstacles) + k
        # a particle that is no number is reported after the step, whatever the distance function makes of it
        candidates = np.flatnonzero(near[p.cell] & np.isfinite(p.position).all(axis=1))
        distance = obstacle.distance_at(p.position[candidates])
        close = distance < WATCH * self.reach[surface]
        candidates, distance = candidates[close], distance[close]
        first, self.num = self.num, self.num + len(candidates)
        self._reserve(self.num)
        rows = slice(first, self.num)
        self.particle[rows], self.surface[rows], self.distance[rows] = candidates, surface, distance
        self.start[rows] = p.position[candidates]
        self.normal[rows] = obstacle.normal_at(p.position[candidates], 1e-4 * self.reach[surface])

    @property
    def nearby(self):
        """(num,) distance at which each contact begins to act."""
        return self.reach[self.surface[: self.num]]

    def check(self, particles):
        """Raise ValueError for particles that start inside an obstacle."""
        for obstacle in self.obstacles:
            inside = np.flatnonzero(obstacle.distance_at(particles.position) <= 0)
            if len(inside):
                raise ValueError(
                    f"{len(inside)} particle(s) start inside {obstacle.name!r}, one at "
                    f"{particles.position[inside[0]]}: move the body away from it"
                )

    def slide(self, particles, dt):
        """Let the slips follow the particles, which have moved in a step dt since the contacts were found."""
        state, near = particles.state, (self.num, self.particle)
        if self:
            motions(*near, self.start, particles.position, dt, state["contact_motion"])
        if "slip" in state:
            slips(
                *near,
                *(self.normal, self.start, self.slip_limit),
                *(particles.position, state["contact_force"], state["slip"], state["friction_work"]),
            )

    def hold_back(self, particles, kernel, velocity, dt):
        """Change of the vertices' velocities that keeps particles FLOOR d_hat away from the surfaces.

        The barrier's energy grows with ln d only: the vertices around a few particles at a tip can have
        more. A particle may come nearer by half of what is left; where vertices would move it further,
        they lose the velocity lambda that is too much, lambda^2 w / lambda w where several particles ask
        for it. This takes energy, like a plastic impact.

        Returns
        -------
        (nv, 1 + d) sums over the particles of w lambda and w lambda^2 n, or None where there is nothing to do
        """
        n = self.num
        close = np.flatnonzero(self.distance[:n] < GUARD * self.reach[self.surface[:n]])
        if not len(close):
            return None
        index, sums = self.particle[close], None
        cells = particles.cell[index]
        weights, _ = evaluate_many(kernel, particles.position[index], cells)
        for contact, c, w in zip(close, cells, weights, strict=True):
            ring = kernel.ring_vertex[kernel.ring_start[c] : kernel.ring_start[c + 1]]
            w, normal = w[: len(ring)], self.normal[contact]
            left = self.distance[contact] - FLOOR * self.reach[self.surface[contact]]
            excess = -(w @ velocity[ring]) @ normal - (0.5 if left > 0 else 0.05) * left / dt
            if excess > 0:
                sums = np.zeros((len(velocity), 1 + len(normal))) if sums is None else sums
                share = np.maximum(w, 0.0) * excess
                sums[ring, 0] += share
                sums[ring, 1:] += np.outer(share * excess, normal)
        return sums

    def energy(self, particles):
        """Energy of the barriers, sum of B over the contacts (J)."""
        n = self.num
        reach, body = self.reach[self.surface[:n]], particles.body[self.particle[:n]]
        d = np.clip(self.distance[:n], LEAST * reach, reach)
        area = particles.volume[self.particle[:n]] ** (1 - 1 / len(self.axes))
        kappa = self.modulus[body] * area / reach
        force = (d - reach) * (2 * np.log(d / reach) - reach / d + 1)
        nearer = np.maximum(d - self.distance[:n], 0)  # than LEAST, where the force grows no more
        return float(np.sum(kappa * (force * nearer - (d - reach) ** 2 * np.log(d / reach))))


def cells_near(mesh, distance, reach):
    """(nc,) bool: cells where a point nearer than `reach` may be, from distances at the vertices."""
    corners = mesh.points[mesh.cells]
    longest = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=-1).max(axis=(1, 2))
    return (distance[mesh.cells].max(axis=1) - longest < reach) & (
        distance[mesh.cells].min(axis=1) + longest > -longest
    )


def facets_near_cells(mesh, corners, reach):
    """CSR lists of the facets (nf, d, d) that come within their reach (nf,) of each cell."""
    nc, d = len(mesh.cells), mesh.dim
    if not len(corners):
        return np.zeros(nc + 1, np.int64), np.empty(0, np.int32)
    lower, inverse_size, per_axis, start, content = cell_bins(mesh)
    low, high = corners.min(axis=1) - reach[:, None], corners.max(axis=1) + reach[:, None]
    pairs = []
    for f in range(len(corners)):
        first, last = (
            np.clip(((x[f] - lower) * inverse_size).astype(int), 0, per_axis - 1) for x in (low, high)
        )
        boxes = np.zeros(1, int)
        for a in range(d):
            boxes = (boxes[:, None] * per_axis + np.arange(first[a], last[a] + 1)).ravel()
        cells = np.unique(np.concatenate([content[start[b] : start[b + 1]] for b in boxes]))
        x = mesh.points[mesh.cells[cells]]
        meets = np.all((x.min(axis=1) <= high[f]) & (x.max(axis=1) >= low[f]), axis=1)
        pairs.append(np.stack([cells[meets], np.full(meets.sum(), f)], axis=1))
    pairs = np.concatenate(pairs)
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    return np.searchsorted(pairs[:, 0], np.arange(nc + 1)), pairs[:, 1].astype(np.int32)
