"""The explicit material point method: scene, time step and run loop (thesis Algorithm 1)."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from . import boundaries, checkpoint, consistency, diagnostics, grid, locate, time_step, transfer
from .contact import Contact, Obstacle
from .f_bar import average_jacobian
from .kernel import build_kernel, check_cells
from .outlets import outlet_facets, remove_escaped
from .parallel import Borders, Ranks, bisect, migrate
from .particles import Body, join_bodies
from .walls import Wall, wall_layer
from .weights import optional

TRANSFERS = ("apic", "flip", "pic")
SORT_EVERY = 100  # steps after which particles are sorted in memory; a sort costs a fifth of a step
BALANCE_EVERY = 50  # steps between looks at how the particles are spread over the ranks


class SimulationError(RuntimeError):
    """A run that went wrong: what happened, when and where."""


class Simulation:
    """Bodies moving on a background mesh.

    Parameters
    ----------
    mesh : SimplexMesh
    bodies : list of Body
    walls : list of Wall; boundaries without one are open, particles must not leave through them
    gravity : (d,) constant acceleration
    body_force : acceleration at the particles, (d,) or a function (positions (n, d), time) -> (n, d)
    obstacles : list of Obstacle, rigid bodies at rest
    condition : a boundary condition of one's own, called in every step after those of the walls: function
        (points (k, d), velocity (k, d), time) -> (k, d) velocity of the vertices next to particles
    transfer : "apic", "flip" or "pic"
    flip : share of FLIP in its blend with PIC, for transfer="flip"
    gradient : "consistent" (design note) or "plain" (the paper's MLS gradient)
    diminishing : False switches eta off, for comparison only
    support : support of the kernel over the mean edge length, see `kernel.SUPPORT`
    max_iterations : cap on the solve for consistent gradients, see `consistency`
    cfl : time step over (local mesh size) / (wave speed + particle speed)
    threads : threads of the transfers; one by default
    imbalance : cells are dealt out again when a rank has more than this many times its fair share of
        particles; without effect on one rank
    outlets : names of open boundaries through which particles leave the simulation

    Attributes
    ----------
    particles : Particles, of this rank
    time, steps : simulated time and number of steps taken
    ranks : Ranks
    """

    def __init__(
        self,
        mesh,
        bodies,
        walls=(),
        gravity=None,
        body_force=None,
        obstacles=(),
        condition=None,
        transfer="apic",
        flip=1.0,
        gradient="consistent",
        diminishing=True,
        support=None,
        max_iterations=300,
        cfl=0.3,
        threads=1,
        imbalance=1.2,
        outlets=(),
    ):
        check_options(transfer, gradient, flip, threads=threads, cfl=cfl, imbalance=imbalance)
        for given, kind in ((bodies, Body), (walls, Wall), (obstacles, Obstacle)):
            if isinstance(given, kind) or not all(isinstance(item, kind) for item in given):
                raise TypeError(f"{given!r}: give a list of {kind.__name__}")
        self.ranks = Ranks()
        self.mesh, self.bodies, self.walls = mesh, list(bodies), list(walls)
        self.transfer, self.cfl, self.threads, self.imbalance = transfer, cfl, threads, imbalance
        self.body_force, self.condition = body_force, condition
        self.flip = flip if transfer == "flip" else 0.0
        d = mesh.dim
        self.gravity = np.zeros(d) if gravity is None else np.asarray(gravity, float)
        if self.gravity.shape != (d,) or not np.isfinite(self.gravity).all():
            raise ValueError(f"gravity {gravity}: give {d} finite numbers")
        self.layer = wall_layer(mesh, self.walls)
        self.kernel = build_kernel(mesh, self.layer, support, diminishing)
        check_cells(self.kernel, mesh)
        self.correction = {"solved": False, "before": np.nan, "after": np.nan, "iterations": 0}
        if gradient == "consistent":
            self.correction, self.kernel.phi = self.ranks.broadcast(lambda: self._correct(max_iterations))
        self.particles = join_bodies(self.bodies, d, transfer == "apic")
        self.particles.cell[:] = locate.find_cells(mesh, self.particles.position)
        self.smallest_mass = 1e-12 * self.particles.mass.min()
        self.contact = Contact(mesh, self.walls, obstacles, self.bodies)
        self.contact.add_state(self.particles)
        self.contact.check(self.particles)
        self.cell_size = time_step.cell_sizes(mesh)
        self.bins = locate.cell_bins(mesh)
        self.wall_facet = locate.wall_facets(mesh, self.layer)
        self.outlet = outlet_facets(mesh, outlets) if len(outlets) else None
        self.pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self.time, self.steps, self.dt, self.escaped_mass = 0.0, 0, 0.0, 0.0
        self.dropped_vertices, self.lost_momentum, self.wall_hits, self.held_back = 0, 0.0, 0, 0
        self._allocate()
        self.num_particles = len(self.particles)
        self.distribute(np.bincount(self.particles.cell, minlength=len(mesh.cells)))
        if self.ranks.size > 1:
            elsewhere = np.flatnonzero(self.owner[self.particles.cell] != self.ranks.rank)
            self.particles.replace(elsewhere, {}, np.empty(0, int))
            self.particles.reserve(len(self.particles) + len(self.particles) // 4 + 64)
        self.sort_particles()
        self.ranks.raise_together(self.update_stress())
        self.find_contacts()

    def _correct(self, max_iterations):
        found = consistency.correct(self.kernel, self.mesh, self.layer, max_iterations=max_iterations)
        return found, self.kernel.phi

    def _allocate(self):
        nv, nc = len(self.kernel.points), len(self.mesh.cells)
        d = self.mesh.dim
        self.order, self.status = np.empty(0, np.int32), np.empty(0, np.int8)
        self.active, self.start = np.empty(nc, np.int32), np.empty(nc + 1, np.int32)
        self.count = np.zeros(nc + 1, np.int32)
        self.stamp, self.vertices = np.full(nv, -1, np.int64), np.empty(nv, np.int32)
        self.grids = np.zeros((self.threads, nv, 1 + 2 * d))
        self.velocity = np.zeros((nv, d))
        self.increment = np.zeros((nv if self.flip > 0 else 0, d))
        self.f_bar = [b for b, body in enumerate(self.bodies) if body.f_bar]
        self.scalar = np.zeros(nv if self.f_bar else 0)

    def distribute(self, count):
        """Deal the cells out to the ranks, particles `count` (nc,) in each. Collective."""
        centres = self.mesh.points[self.mesh.cells].mean(axis=1)
        self.owner = bisect(centres, count, self.ranks.size)
        rings = (self.kernel.ring_start, self.kernel.ring_vertex)
        self.borders = Borders(self.ranks, self.owner, *rings, len(self.kernel.points))

    def balance(self):
        """Deal the cells out again where a rank has too many particles. Collective."""
        n = len(self.particles)
        if self.ranks.max(n) > self.imbalance * self.num_particles / self.ranks.size + 1:
            cells = len(self.mesh.cells)
            self.distribute(self.ranks.sum(np.bincount(self.particles.cell, minlength=cells)))
            migrate(self.ranks, self.particles, self.owner)

    def step(self, dt):
        """One step of Algorithm 1.

        Raises
        ------
        SimulationError
            for an inverted or not finite particle, with time and place
        LostParticles
            for particles that left the mesh
        """
        self.particle_to_grid()
        self.fold(dt)
        self.update_grid(dt)
        self.move(dt)

    def move(self, dt):
        """The part of a step that follows on the velocities at the vertices: particles move."""
        self.grid_to_particle(dt)
        self.contact.slide(self.particles, dt)
        self.time += dt
        self.steps += 1
        lost = self.locate_particles()
        self.sort_particles()
        if self.f_bar:
            average_jacobian(self, self.f_bar)
        inverted = self.update_stress()
        self.find_contacts()
        self.ranks.raise_together(inverted or lost)

    def sort_particles(self):
        """List particles cell by cell, and the vertices and threads' shares of the active cells."""
        p, k = self.particles, self.kernel
        if self.ranks.size > 1:
            migrate(self.ranks, p, self.owner)
            if self.steps % BALANCE_EVERY == 0:
                self.balance()
        if self.steps % SORT_EVERY == 0:
            p.sort_by_cell()
        if len(p) > len(self.order):
            room = len(p.stored["mass"])
            self.order, self.status = np.empty(room, np.int32), np.empty(room, np.int8)
        self.num_active = locate.sort_by_cell(p.cell, self.count, self.order, self.active, self.start)
        self.num_vertices = grid.mark_vertices(
            self.active,
            self.num_active,
            k.ring_start,
            k.ring_vertex,
            self.stamp,
            self.steps,
            self.vertices,
        )
        self.shares = np.searchsorted(self.start[: self.num_active + 1], self.parts(0, len(p)))

    def particle_to_grid(self):
        """Mass, momentum and force of the particles on the vertices."""
        p = self.particles
        grid.clear(self.grids, self.vertices, self.num_vertices)
        force = p.state.get("contact_force")
        if self.body_force is not None:
            weight = p.mass[:, None] * self.acceleration()
            force = weight if force is None else weight + force
        affine = p.affine if self.transfer == "apic" else None
        fixed = (self.active, self.start, self.order, p.position, p.velocity, affine, p.mass)
        fields = (p.volume, p.stress, force, self.kernel.rings, optional(self.kernel.phi))

        def share(thread):
            first, last = self.shares[thread : thread + 2]
            transfer.particle_to_grid(self.kernel.axes, first, last, *fixed, *fields, self.grids[thread])

        self.on_threads(share)
        if self.threads > 1:
            grid.sum_threads(self.grids, self.vertices, self.num_vertices)

    def acceleration(self):
        """(n, d) body force per mass at the particles."""
        b, shape = self.body_force, self.particles.position.shape
        b = np.asarray(b(self.particles.position, self.time) if callable(b) else b, float, order="C")
        if b.shape not in (shape, shape[1:]):
            raise ValueError(f"body_force of shape {b.shape}: give ({shape[1]},) or {shape}")
        return np.broadcast_to(b, shape)

    def fold(self, dt):
        """Add what mirrors and other ranks hold to the sums at the vertices. Collective."""
        boundaries.fold(self, boundaries.wall_motion(self, dt)[0][0])
        self.borders.add_shared(self.grids[0], self.stamp, self.steps)

    def update_grid(self, dt):
        """Update velocities, apply walls, fill mirrors."""
        unknowns = len(self.mesh.points) + self.layer.num_free
        drift, change = self.motion
        dropped, lost = grid.update_velocity(
            self.grids[0],
            self.vertices,
            self.num_vertices,
            unknowns,
            dt,
            self.gravity,
            self.smallest_mass,
            self.velocity,
            self.increment,
        )
        self.dropped_vertices += dropped
        self.lost_momentum += lost
        boundaries.apply_walls(self, drift, change)
        if self.condition is not None:
            boundaries.impose(self, unknowns)
            boundaries.fill_mirrors(self, drift, change)
        if self.contact:
            boundaries.hold_back(self, dt, drift, change)

    def grid_to_particle(self, dt):
        """Velocities, positions and deformation gradients of the particles."""
        p = self.particles
        affine = p.affine if self.transfer == "apic" else None
        fixed = (self.active, self.start, self.order, p.position, p.velocity, affine)
        fields = (
            p.deformation_gradient,
            self.kernel.rings,
            optional(self.kernel.phi),
            self.velocity,
            optional(self.increment),
        )

        def share(thread):
            first, last = self.shares[thread : thread + 2]
            transfer.grid_to_particle(self.kernel.axes, first, last, *fixed, *fields, self.flip, dt)

        self.on_threads(share)

    def parts(self, first, last):
        """Bounds of equal parts of a range, one part per thread."""
        return [first + (last - first) * t // self.threads for t in range(self.threads + 1)]

    def on_threads(self, share):
        """Call share(thread) for every thread."""
        if self.pool is None:
            share(0)
        else:
            list(self.pool.map(share, range(self.threads)))

    def find_contacts(self):
        """Contacts of the particles at their present positions, and the forces there."""
        if self.contact:
            self.contact.find(self.particles, self.active, self.num_active, self.start, self.order)

    def update_stress(self):
        """Kirchhoff stress of every body from its material; returns a SimulationError if one is inverted."""
        p = self.particles
        for body, part in zip(self.bodies, p.ranges, strict=True):
            names, bounds = getattr(body.material, "state", ()), self.parts(part.start, part.stop)
            first_bad = np.full(self.threads, len(p))

            def share(thread, material=body.material, names=names, bounds=bounds, first_bad=first_bad):
                piece = slice(bounds[thread], bounds[thread + 1])
                state = {name: p.state[name][piece] for name in names}
                bad = material.kirchhoff_stress(p.deformation_gradient[piece], p.stress[piece], **state)
                if bad >= 0:
                    first_bad[thread] = piece.start + bad

            self.on_threads(share)
            i = first_bad.min()
            if i < len(p):
                j = np.linalg.det(p.deformation_gradient[i])
                return SimulationError(
                    f"particle {p.id[i]} of body {body.name!r} has det F = {j:.3g}, inverted or not finite, "
                    f"at time {self.time:.6g}, step {self.steps}, position {p.position[i]}: "
                    "take a smaller cfl or a finer mesh"
                )
        return None

    def locate_particles(self):
        """Cells of the moved particles; those that stepped through a wall are put back on it.

        Returns LostParticles if there are any, None else.
        """
        p, m = self.particles, self.mesh
        counts = np.zeros((self.threads, 2), np.int64)
        bounds = self.parts(0, len(p))
        cells = (m.cells, m.points, m.inverse, m.neighbours, self.wall_facet, self.bins)

        def share(thread):
            part = (bounds[thread], bounds[thread + 1], p.position, p.cell)
            locate.walk(self.kernel.axes, *part, *cells, self.status, counts[thread])

        self.on_threads(share)
        hits, lost = counts.sum(axis=0)
        self.wall_hits += hits
        if self.outlet is not None:
            lost = remove_escaped(self)
        if not lost:
            return None
        i = np.flatnonzero(self.status[: len(p)] == locate.LOST)
        error = locate.LostParticles(p.id[i], p.position[i], m.points.min(axis=0), m.points.max(axis=0))
        error.args = (f"time {self.time:.6g}, step {self.steps}: {error}",)
        return error

    def stable_step(self):
        """Time step cfl * min h / (c + |v|) over the particles, c the wave speed in their present state.

        Contact shortens it, see `barrier.contact_forces`. Collective.
        """
        return time_step.stable_step(self)

    def vertex_fields(self):
        """Mass (nv,) and velocity (nv, d) on the mesh's vertices now, without particles zero. Collective."""
        return diagnostics.vertex_fields(self)

    def gather(self, name):
        """One array of all ranks' particles in the order of `id`, for instance "position". Collective."""
        p = self.particles
        field = p.arrays[name] if name in p.arrays else np.asarray(getattr(p, name))
        number, field = self.ranks.concatenate(p.id), self.ranks.concatenate(field)
        return field[np.argsort(number)]

    def summary(self):
        """Energies and momenta now, the columns of a run's log. Collective."""
        return diagnostics.summary(self)

    def save(self, path):
        """Write a checkpoint, see `checkpoint.save_checkpoint`. Collective."""
        checkpoint.save_checkpoint(self, path)

    def load(self, path):
        """Take up a checkpoint, see `checkpoint.load_checkpoint`. Collective."""
        checkpoint.load_checkpoint(self, path)

    def active_parts(self):
        """Which parts of the method this scene uses: name -> whether it costs anything."""
        return diagnostics.active_parts(self)

    def report(self):
        """A few lines on the scene: sizes, active parts, correction, counters. Collective."""
        return diagnostics.report(self)


def check_options(transfer, gradient, flip, threads, cfl, imbalance):
    """Raise ValueError for an option of `Simulation` that is none."""
    if transfer not in TRANSFERS:
        raise ValueError(f"transfer {transfer!r}: give one of {', '.join(TRANSFERS)}")
    if gradient not in ("consistent", "plain"):
        raise ValueError(f"gradient {gradient!r}: give 'consistent' or 'plain'")
    if not 0 <= flip <= 1:
        raise ValueError(f"flip {flip}: the share of FLIP lies in [0, 1]")
    if not cfl > 0:
        raise ValueError(f"cfl {cfl}: give more than 0")
    for name, value in (("threads", threads), ("imbalance", imbalance)):
        if not value >= 1:
            raise ValueError(f"{name} {value}: give at least 1")
