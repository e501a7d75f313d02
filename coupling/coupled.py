"""Gas and deformable solids on one mesh, coupled both ways (thesis 3.2.2)."""

import warnings

import numpy as np

from fempm import boundaries as moving
from fempm import checkpoint, diagnostics
from fempm.parallel import RemoteError
from fempm.solver import SimulationError

from . import fractions, merging, push
from .boundaries import Periodic
from .flow import Flow
from .mixture import Mixture, add_filled, cells_near
from .sharp import Sharp

GHOST = "ghost_volume_ratio"  # J_g of the particles
INTERFACES = {"mixture": Mixture, "sharp": Sharp}
STIFF = 20.0  # least lambda_g over the largest pressure of the gas


class Coupled(Flow):
    """A gas and the bodies of an MPM simulation, ready for `fempm.run`.

    A step: particles to grid, volume fractions, advection of the gas, the pressure of both phases, then the
    forces and walls of the solid, and grid to particles. Gas is stored in the open share of each dual cell.

    Parameters
    ----------
    solid : fempm.Simulation, whose mesh this is; from now on this object steps it
    eos, initial, boundaries, pair, scheme, limiter, cfl, gravity : see `Flow`; the initial state is asked for
        inside of the solid as well, its pressure there is that of the ghost matrix
    interface : "mixture", by volume fractions, or "sharp", the thesis's with multipliers, see `sharp`
    openness : share of a dual face that is open to the gas, see `fractions.edge_openness`
    ghost_modulus : lambda_g of the ghost matrix that gives the solid a pressure; when not given that of each
        body's pressure waves, rho c^2, or twenty times the gas's largest pressure if that is more

    Attributes
    ----------
    U : (n, d + 2) density, momentum, energy of the gas per open volume
    theta : (n,) open share of each dual cell of the whole space
    unclaimed : energy that the pressure gave to vertices without gas, lost to round-off and implicit damping
    """

    def __init__(
        self,
        solid,
        eos,
        initial,
        boundaries,
        interface="mixture",
        openness="least",
        ghost_modulus=None,
        **options,
    ):
        if interface not in INTERFACES:
            raise ValueError(f"interface {interface!r}: give one of {', '.join(map(repr, INTERFACES))}")
        if openness not in fractions.OPENNESS:
            raise ValueError(f"openness {openness!r}: give one of {', '.join(map(repr, fractions.OPENNESS))}")
        if any(isinstance(c, Periodic) for c in boundaries):
            raise ValueError(
                "boundaries: a gas with solids cannot be periodic, their particles would not follow"
            )
        options.setdefault("gravity", solid.gravity if np.any(solid.gravity) else None)
        if not np.array_equal(
            0 * solid.gravity if options["gravity"] is None else options["gravity"], solid.gravity
        ):
            raise ValueError(
                f"gravity {options['gravity']} of the gas, {solid.gravity} of the solid: give one"
            )
        self.interface, self.stages_kind = interface, INTERFACES[interface]
        super().__init__(solid.mesh, eos, initial, boundaries, **options)
        self.solid, self.openness, self.buffers, self.used = solid, openness, {}, {}
        self.unclaimed, self.solid_rate = 0.0, 0.0
        whole = self.part.whole
        n = len(whole.points)
        self.adjacency = self.graph = merging.adjacency(whole.edges, n)
        if self.ranks.size > 1:  # of this rank's edges
            self.graph = merging.adjacency(self.part.space.edges, len(self.part.nodes))
        self.root, self.touched = np.arange(n, dtype=np.int32), np.empty(0, np.int64)
        self.vertices = np.flatnonzero(self.part.nodes < len(self.mesh.points))  # local nodes at vertices
        self.ends = self.open_nodes()
        self.constrain_solid()
        _, pressure = self.stages.primitive(self.U)
        self.moduli = ghost_moduli(solid, ghost_modulus, self.ranks.max(pressure.max()))
        self.start_ghost(self.part.gather(pressure)[whole.node_of_vertex])
        self.theta = self.shares()[0]
        self.settle(self.theta, self.theta > 0)
        self.warn_of_thin_bodies()

    def warn_of_thin_bodies(self):
        """Bodies that close no vertex at all let gas through. Collective."""
        p, nodes = self.solid.particles, self.part.whole.cell_nodes
        for body, part in zip(self.solid.bodies, p.ranges, strict=True):
            closed = bool(np.any(self.theta[nodes[p.cell[part]]] == 0))
            if not self.ranks.max(int(closed)):
                warnings.warn(
                    f"body {body.name!r} closes no vertex of the mesh to the gas: it is thinner than about "
                    "two cells and lets gas through, mesh finer if it is to be tight",
                    stacklevel=3,
                )

    def open_nodes(self):
        """Nodes of the whole space at inflows and outflows. Collective."""
        local = np.concatenate([self.stages.open.nodes, self.stages.fixed]).astype(np.int64)
        return np.unique(self.ranks.concatenate(self.part.nodes[local]))

    def constrain_solid(self):
        """Tell the pressure of the walls of the solid."""
        layer, nodes = self.solid.layer, self.part.nodes
        mine = np.isin(layer.vertices, nodes[self.vertices])
        self.stages.constrain_solid(np.searchsorted(nodes, layer.vertices[mine]), layer.project[mine])

    def start_ghost(self, pressure):
        """J_g = 1 - p / lambda_g: bodies at rest in gas at rest are in equilibrium."""
        p, mesh = self.solid.particles, self.mesh
        p.add_state(GHOST, ())
        around = np.sum(mesh.barycentric(p.position, p.cell) * pressure[mesh.cells[p.cell]], axis=1)
        p.state[GHOST][:] = 1 - around / self.modulus_of_particles()

    def modulus_of_particles(self):
        """(np,) lambda_g."""
        return np.repeat(self.moduli, self.solid.particles.counts)

    def shares(self):
        """(n,) open share of all nodes, alpha / (lambda_g J_g) there, and that times p_g. Collective."""
        p, mesh, whole = self.solid.particles, self.mesh, self.part.whole
        modulus, ratio = self.modulus_of_particles(), p.state[GHOST]
        volume = self.volume = p.volume * p.jacobian
        compliance = volume / (modulus * np.maximum(ratio, 0.1))
        values = np.stack([volume, compliance, compliance * modulus * (1 - ratio)], axis=1)
        sums = self.buffer("shares", (len(whole.points), 3))
        lists = mesh.cells, mesh.points, mesh.inverse, mesh.neighbours, whole.cell_nodes
        sizes = self.part.size, (1,) * whole.cell_nodes.shape[1]
        fractions.add_volumes(*sizes, p.position, p.cell, values, *lists, sums)
        sums = self.ranks.sum(sums)
        some = self.used["shares"] = np.flatnonzero(sums[:, 0] > 0)
        sums[some] /= whole.volumes[some, None]
        alpha, compliance, ghost = sums.T
        if self.interface == "mixture":
            theta = np.ones(len(sums))
            theta[some] = fractions.open_share(alpha[some], self.openness)
            theta[self.ends] = 1  # whatever reaches an open end is about to leave
            return theta, compliance, ghost
        of_gas = np.minimum(alpha, 1)[whole.cell_nodes].mean(axis=1) < 0.5
        return self.stages.divide_cells(of_gas), compliance, ghost

    def buffer(self, name, shape):
        """An array of zeros, the same in every step; `used` tells which rows are to be cleared then."""
        if name not in self.buffers:
            self.buffers[name] = np.zeros(shape)
        array, rows = self.buffers[name], self.used.pop(name, None)
        if rows is None:
            array[:] = 0
        else:
            push.clear(rows, array.reshape(len(array), -1))
        return array

    def settle(self, theta, held):
        """Close and open nodes, and find where small ones share their state: changes theta. Collective."""
        self.root[self.touched] = self.touched
        self.touched = np.flatnonzero((theta < 1) | (self.theta < 1))
        merging.settle(self.touched, held, theta, *self.adjacency, self.root)
        root = self.root[self.touched]
        small = self.touched[(root != self.touched) & (root >= 0)]
        members = np.union1d(small, self.root[small])
        group = np.unique(self.root[members], return_inverse=True)[1]
        self.groups = members, group, *self.part.find(members)

    def regrid(self, U, old, new):
        """U (n, d + 2) of this rank for open shares `new` of all nodes that were `old`. Collective."""
        part, out = self.part, U.copy()
        at, here = part.find(self.touched)
        open_here = here & (new[self.touched] > 0)
        at, nodes = at[open_here], self.touched[open_here]
        out[at] *= (old[nodes] / new[nodes])[:, None]
        return self.merge(U, old, new, out)

    def merge(self, U, old, new, out):
        """Nodes of one state get the mean, by open shares `new`, of U (n, d + 2), by `old`. Collective."""
        members, group, at, here = self.groups
        if len(members):
            volumes = self.part.whole.volumes[members]
            totals = U[at] * ((here & self.part.mine[at]) * old[members] * volumes)[:, None]
            volumes = new[members] * volumes
            means = merging.means(group, volumes, self.ranks.sum(totals))
            kept = here & (volumes > 0)
            out[at[kept]] = means[kept]
        return out

    def one_step(self, U, dt, scheme=None, limiter=None):
        """The gas after a step, and the solid moved on: in the order of thesis 3.2.2. Collective."""
        solid, stages = self.solid, self.stages
        solid.particle_to_grid()
        moving_solid = self.solid_at_vertices(dt)
        theta, compliance, ghost = self.shares()
        self.settle(theta, self.theta > 0)
        U = self.regrid(U, self.theta, theta)
        self.begin(U, theta, *moving_solid, *self.filled_cells(theta, compliance, ghost))
        U = super().one_step(U, dt, scheme, limiter)
        self.push_solid(dt)
        solid.update_grid(dt)
        self.squeeze(stages.P[stages.soft] + stages.kicked(self.solid_velocity()))
        try:
            solid.move(dt)
        except RemoteError as error:  # no shorter step of the gas mends it
            raise SimulationError(str(error)) from None
        self.theta, self.unclaimed = theta, self.unclaimed + self.ranks.sum(stages.lost)
        return U

    def solid_at_vertices(self, dt):
        """Vertices (k,) with solid, and its mass (k,) and velocity (k, d) there, on all ranks. Collective."""
        s = self.solid
        moving.fold(s, moving.wall_motion(s, dt)[0][0])
        found = diagnostics.at_vertices(s)
        s.borders.add_shared(s.grids[0], s.stamp, s.steps)
        return found

    def solid_vertices(self):
        """Vertices of the mesh that this rank's particles reach."""
        at = self.solid.vertices[: self.solid.num_vertices]
        return at[at < len(self.mesh.points)]

    def begin(self, U, theta, vertices, mass, velocity, *cells):
        """Give the stages the solid, and closed nodes of U the state of their neighbours. Collective."""
        part, s, whole = self.part, self.part.space, theta
        theta = part.local(theta)
        number, sums = self.buffer("number", len(theta)), self.buffer("beside", U.shape)
        merging.add_open_neighbours(np.flatnonzero(theta == 0), theta, *self.graph, U, number, sums)
        part.sum_nodes(number)
        part.sum_nodes(sums)
        beside = self.used["number"] = self.used["beside"] = np.flatnonzero(number > 0)
        filled = beside[theta[beside] == 0]
        U[filled] = sums[filled] / number[filled, None]
        inverse, start = self.buffer("inverse", len(theta)), self.buffer("start", s.points.shape)
        at, here = part.find(vertices)
        self.heavy = at[here], vertices[here]
        if self.stages.ends is None:  # else nodes in the middle of edges are filled as well
            self.used["inverse"] = self.used["start"] = at[here]
        inverse[at[here]] = 1 / mass[here]
        start[at[here]] = velocity[here]
        openness = fractions.edge_openness(self.openness, theta, s)
        flat = beside[theta[beside] > 0]
        self.stages.begin(
            theta, openness, flat, start, inverse, *cells, lambda U: self.merge(U, whole, whole, U)
        )

    def filled_cells(self, theta, compliance, ghost):
        """What `Mixture.begin` needs of cells: filled, ghost, taken, soft and cells. Collective.

        The ghost's pressure is the mean over the particles by the same weights with which `squeeze` hands
        its change back to them, so that it takes that up; the mean over the nodes is for cells without any.
        """
        part, s = self.part, self.part.space
        theta, compliance, ghost = (part.local(values) for values in (theta, compliance, ghost))
        dry, soft = np.empty(len(s.cell_nodes), np.uint8), np.zeros(len(part.dofs), np.uint8)
        near = ((theta < 1) | (compliance > 0)).view(np.uint8)
        wet = cells_near(part.shape[1], s.cell_nodes, near, dry)
        filled = self.buffer("filled", (len(soft), 3))
        lists = s.cell_nodes, s.cell_pressures, s.weights, s.cell_volumes, wet
        add_filled(part.shape, *lists, theta, compliance, ghost, soft, filled)
        part.sum_dofs(filled)
        soft = self.used["filled"] = np.flatnonzero(part.sum_dofs(soft) > 0)
        own = self.buffer("own", (len(part.whole.pressure_volumes), 2))
        dofs, *values = self.particle_pressures()
        merging.add_weighted(dofs, *values, own)
        self.used["own"] = dofs.ravel()
        sums = self.ranks.sum(own)[part.dofs] if self.ranks.size > 1 else own
        mean = np.zeros(len(filled))
        merging.divide(soft, sums, filled, mean)
        return filled, mean, sums[:, 0], soft, (wet, dry)

    def particle_pressures(self):
        """Dofs (np, k) of the cells of the particles, the particles' weights there, and p_g (np,)."""
        p, whole = self.solid.particles, self.part.whole
        modulus, ratio = self.modulus_of_particles(), p.state[GHOST]
        dofs = whole.cell_pressures[p.cell]
        linear = dofs.shape[1] > 1
        share = self.mesh.barycentric(p.position, p.cell) if linear else np.ones((len(p), 1))
        return dofs, share * (self.volume / modulus)[:, None], modulus * (1 - ratio)

    def push_solid(self, dt):
        """Add the force of the pressure to that of the stress at the vertices. Collective."""
        s, stages = self.solid, self.stages
        change, here = self.buffer("push", stages.now.shape), np.flatnonzero(stages.inverse > 0)
        self.used["push"], size = here, self.part.size
        states = stages.start, stages.now, self.width
        self.solid_rate = push.find_acceleration(size, here, *states, dt, change)
        push.add_force(size, self.solid_vertices(), self.part.gather(change), s.grids[0])

    def solid_velocity(self):
        """(n, d) velocity of the solid now, at this rank's nodes at vertices. Collective."""
        s, nv = self.solid, len(self.mesh.points)
        velocity, at = np.zeros((nv, self.mesh.dim)), self.solid_vertices()
        velocity[at] = s.velocity[at]
        if self.ranks.size > 1:  # ranks that share a vertex all have its velocity
            velocity, count = self.ranks.sum(velocity), np.zeros(nv)
            count[at] = 1
            velocity /= np.maximum(self.ranks.sum(count), 1)[:, None]
        out, (at, vertices) = np.zeros((len(self.part.nodes), self.mesh.dim)), self.heavy
        out[at] = velocity[vertices]
        return out

    def squeeze(self, pressure):
        """J_g of the particles after the `soft` pressures have changed to those given. Collective."""
        stages, whole, p = self.stages, self.part.whole, self.solid.particles
        change, at = np.zeros(len(stages.P)), stages.soft
        change[at] = np.where(stages.compliance > 0, stages.ghost[at] - pressure, 0.0)
        change = self.part.gather_dofs(change)[whole.cell_pressures[p.cell]]
        if change.shape[1] > 1:
            change = change * self.mesh.barycentric(p.position, p.cell)
        p.state[GHOST] += change.sum(axis=1) / self.modulus_of_particles()

    def stable_step(self):
        """The shorter one of the gas's and the solid's, also for what the gas has pushed. Collective."""
        limit = self.cfl / max(self.ranks.max(self.solid_rate), 1e-300)
        return min(super().stable_step(), self.solid.stable_step(), limit)

    def gather(self, name):
        """One array of all ranks' particles in the order of `id`. Collective."""
        return self.solid.gather(name)

    @property
    def particles(self):
        """The particles of the solid, of this rank."""
        return self.solid.particles

    def vertex_fields(self):
        """Those of the gas at the mesh's vertices, and "solid", the share that is filled. Collective."""
        fields = super().vertex_fields()
        fields["solid"] = 1 - self.theta[self.part.whole.node_of_vertex]
        fields["mach"] = np.where(fields["solid"] < 1, fields["mach"], 0.0)
        fields["schlieren"] = np.where(fields["solid"] > 0, 0.0, fields["schlieren"])  # no gradient of gas
        return fields

    def summary(self):
        """Totals and energies of gas and solid, the columns of a run's log. Collective."""
        p, names = self.solid.particles, "xyz"[: self.mesh.dim]
        gas = super().summary()
        total = self.part.total(self.theta[self.part.nodes, None] * self.U)
        ratio = p.state[GHOST]
        stored = 0.5 * self.modulus_of_particles() * (ratio - 1) ** 2 * p.volume * p.jacobian
        parts = {"gas": total[-1], **diagnostics.energies(self.solid), "ghost": self.ranks.sum(stored.sum())}
        momentum = diagnostics.linear_momentum(self.solid)
        out = {"time": self.time, "dt": self.dt, "mass": total[0], "energy": sum(parts.values())}
        out |= {f"momentum_{a}": g + s for a, g, s in zip(names, total[1:-1], momentum)}
        out |= {f"solid_momentum_{a}": s for a, s in zip(names, momentum)}
        out |= parts | {"unclaimed": self.unclaimed}
        return out | {name: value for name, value in gas.items() if name not in out}

    def store(self, store):
        """Write what a checkpoint holds. Collective."""
        super().store(store)
        checkpoint.store_particles(self.solid, store)
        s, first = self.solid, int(self.ranks.rank == 0)
        store("theta", self.theta[: first * len(self.theta)])
        store(
            "solid",
            np.array([[s.time, s.dt, s.steps, self.unclaimed, self.solid_rate]] * first).reshape(-1, 5),
        )

    def load(self, path):
        """Take up a checkpoint of the same scene, see `Flow.load`. Collective."""
        solid, found = checkpoint.read(self.ranks, path, self.fingerprint(), self.needed)
        checkpoint.take_up(self.solid, **solid)
        vars(self).update(found)
        self.root[:] = np.arange(len(self.root))
        self.touched = np.flatnonzero(self.theta < 1)

    def needed(self, file):
        """What this rank needs of a checkpoint: arguments of `checkpoint.take_up`, and attributes."""
        solid = checkpoint.needed(self.solid, file)
        *clock, unclaimed, rate = file["solid"][0].tolist()
        solid["scalars"] |= {"time": clock[0], "dt": clock[1], "steps": int(clock[2])}
        own = {"theta": file["theta"][()], "unclaimed": unclaimed, "solid_rate": rate}
        return solid, self.stored(file) | own

    def fingerprint(self):
        """What a checkpoint and the scene that goes on from it must have in common."""
        both = super().fingerprint() | checkpoint.fingerprint(self.solid)
        return both | {"coupling": f"{self.interface}, {self.openness}, ghost moduli {self.moduli.tolist()}"}


def ghost_moduli(solid, given, pressure):
    """(bodies,) lambda_g: as given, or stiff enough for the bodies and for the pressure of the gas."""
    stiff = [b.material.density * b.material.wave_speed() ** 2 for b in solid.bodies]
    moduli = np.maximum(stiff, STIFF * pressure) if given is None else np.full(len(stiff), float(given))
    if not moduli.min() > pressure:
        raise ValueError(
            f"ghost_modulus {given}: it must exceed the pressure of the gas, {pressure:.6g}, many times"
        )
    return moduli
