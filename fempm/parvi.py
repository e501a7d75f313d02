"""Sampling by letting a gas flow into a target density (MPM-ParVI, Huang 2024, with an isothermal gas).

Particles of equal mass are the material points of a gas with pressure c^2 rho under the body force
c^2 grad log pi per mass: at rest grad p = rho b, so that rho is pi, whatever its normalisation. In the
discretisation the density cancels: f_i = sum_p m c^2 (w_ip score(x_p) + g_ip). Mesh, kernel, transfers,
threads and ranks are those of `solver.Simulation`, with damping and a speed limit, without effect at rest.
"""

from dataclasses import dataclass

import numpy as np

from .boxes import lattice_mesh
from .locate import LostParticles
from .output import Progress
from .parallel import Ranks
from .particles import Body
from .parvi_diagnostics import kernel_stein
from .parvi_score import Score, widths
from .solver import Simulation
from .time_step import cell_sizes

SPEED_LIMIT = 2.0  # largest speed over the speed of sound
RESOLUTION = 0.6  # mesh size over the target's width
PER_CUBE = 2  # least mean number of particles in the occupied cubes of the mesh
MARGIN = 6  # cubes between the particles and the boundary of a mesh that grows
GROW_EVERY = 10  # steps in which no particle may cross half of them
MAX_CUBES = 2_000_000
COARSE = 2.0  # mesh size over the target's width above which modes blur
LEAST_PULL = 0.5  # share of the pressure that a proper target bears, even before it is at rest
RECORDS = 40  # rows of the history of a flow that is not ended early
PATIENCE = 4  # rows that must agree that the flow has settled
STEADY = 0.01  # relative change of the spread in these rows


@dataclass(frozen=True)
class IsothermalGas:
    """Pressure p = c^2 rho: tau = J sigma = -rho_0 c^2 I whatever the density is.

    Attributes
    ----------
    density : rho_0 at the start, which has no effect on samples
    speed : c, speed of sound
    """

    density: float = 1.0
    speed: float = 1.0
    state = {}

    def __post_init__(self):
        for name in ("density", "speed"):
            if not getattr(self, name) > 0:
                raise ValueError(f"IsothermalGas: {name} must be positive, got {getattr(self, name)}")

    def wave_speed(self, stretch=1.0, jacobian=1.0):
        """Speed of sound in any state."""
        return self.speed

    def kirchhoff_stress(self, deformation_gradient, out):
        """Write tau (n, d, d) to `out`; no state is a wrong one, so -1."""
        out[:] = -self.density * self.speed**2 * np.eye(out.shape[1])
        return -1

    def energy(self, deformation_gradient):
        """Free energy per initial volume psi (n,), zero at J = 1."""
        return -self.density * self.speed**2 * np.log(np.linalg.det(deformation_gradient))


class Flow(Simulation):
    """A simulation pulled by a score, with damping and a speed limit.

    Parameters
    ----------
    score : Score
    amplification : force per mass over the score
    others : as for `Simulation`
    """

    def __init__(self, mesh, body, walls, score, amplification, **options):
        self.score, self.amplification, self.pull = score, amplification, None
        super().__init__(mesh, [body], walls, body_force=lambda x, time: self.pull, **options)
        self.limit = SPEED_LIMIT * body.material.wave_speed()

    def look_up(self, temperature=1.0):
        """Force per mass on the particles where they are now. Collective."""
        error = None
        try:
            self.pull = self.amplification / temperature * self.score(self.particles.position)
        except ValueError as problem:
            error = problem
        self.ranks.raise_together(error)

    def flow(self, dt, damping, temperature):
        """A step with damping rate `damping` towards the density pi^(1 / temperature). Collective."""
        self.look_up(temperature)
        self.particle_to_grid()
        self.fold(dt)
        self.update_grid(dt)
        used = self.vertices[: self.num_vertices]
        v = self.velocity[used] * np.exp(-damping * dt)
        speed = np.sqrt(np.sum(v**2, axis=1, keepdims=True))
        self.velocity[used] = v * np.minimum(1.0, self.limit / np.maximum(speed, 1e-300))
        self.move(dt)

    def net_force(self):
        """RMS over the particles of the acceleration from rest, over that of the score alone. Collective."""
        p = self.particles
        kept = p.velocity.copy(), p.affine.copy()
        p.velocity[:], p.affine[:] = 0.0, 0.0
        self.look_up()
        self.particle_to_grid()
        self.fold(1.0)
        self.update_grid(1.0)
        self.grid_to_particle(0.0)
        net, alone = self.ranks.sum(np.array([np.sum(p.velocity**2), np.sum(self.pull**2)]))
        p.velocity[:], p.affine[:] = kept
        return float(np.sqrt(net / alone)) if alone > 0 else np.inf


@dataclass
class Samples:
    """What `sample` returns, the same on all ranks.

    Attributes
    ----------
    positions : (n, d) in the order of the initial ones
    score : (n, d) of the target there
    mesh : SimplexMesh that they ended on
    size : (d,) its mesh size along the axes, the mean one for a mesh of one's own
    history : dict of (k,) arrays: "time" (in crossing times), "net_force", "spread" (largest
        standard deviation), "steps"
    diagnostics : dict: "net_force" and "ksd" at the end (nan with walls: Stein's identity needs a density
        that vanishes at the boundary), "width" (d,) of the target, "steps"
    settled : whether the net force fell below the tolerance
    """

    positions: np.ndarray
    score: np.ndarray
    mesh: object
    size: np.ndarray
    history: dict
    diagnostics: dict
    settled: bool


def sample(
    target,
    initial,
    mesh=None,
    n=1000,
    size=None,
    walls=(),
    material=None,
    amplification=None,
    transfer="pic",
    damping=2.0,
    temperature=1.0,
    until=30.0,
    tolerance=0.01,
    torch=False,
    seed=0,
    threads=1,
    progress=True,
):
    """Sample a density of one to three variables, known up to a factor. Collective.

    Parameters
    ----------
    target : score (n, d) -> (n, d), or log density (n, d) -> (n,), see `Score`
    initial : (n, d) positions, or function (n, rng) -> (n, d) such as `normal_start`: wide for many modes
    mesh : SimplexMesh with, for targets of bounded support, `walls` (kind "slip"); without one a box around
        the particles that grows with them
    n, seed : number of particles and seed, for an `initial` that is a function
    size : mesh size of that box, a number or (d,); by default about half of the target's width, see `Sampler`
    material : law of the moving body, `IsothermalGas` (exact at rest) unless given; solids for comparison
    amplification : force per mass over the score (the paper's constant): c^2 for the gas, 1 for others
    transfer, threads : as for `Simulation`; "pic" and "apic" are the paper's Algorithms 1 and 2
    damping : rate over the speed of sound per standard deviation, 2 being critical for the slowest wave; a
        number or a function of the share of `until` that has passed
    temperature : T >= 1 of the start, from which the target pi^(1/T) cools to pi in the first half
    until : end of the flow in crossing times (of sound, through a standard deviation of the particles)
    tolerance : net force over the force of the score below which the flow ends, once it is cool and if
        several rows of the history agree; 0 for all of `until`, where modes exchange particles slowly
    torch : `target` works on torch tensors
    progress : show a progress line

    Returns
    -------
    Samples

    Raises
    ------
    ValueError
        for wrong options, more than three dimensions, a score that is not finite, a mesh too coarse for the
        target's width, or a density that is not proper
    """
    if not until > 0 or not temperature >= 1:
        raise ValueError(f"until {until}, temperature {temperature}: give more than 0, and at least 1")
    x = start_positions(initial, n, seed)
    given = Score(target, x.shape[1], torch), x, mesh, size, walls, material, amplification
    state = Sampler(*given, {"transfer": transfer, "threads": threads})
    return state.result(state.run(until, damping, temperature, tolerance, progress))


def start_positions(initial, n, seed):
    """(n, d) initial positions, given or from a function of n and a generator."""
    x = initial(n, np.random.default_rng(seed)) if callable(initial) else initial
    x = np.array(x, float)
    if x.ndim != 2 or len(x) < 2 or not np.isfinite(x).all():
        raise ValueError(f"initial positions of shape {x.shape}: give (n, d) finite numbers, n of at least 2")
    return x


class Sampler:
    """A flow, the mesh that grows with it, and its history; what `sample` runs."""

    def __init__(self, score, x, mesh, size, walls, material, amplification, options):
        self.material = IsothermalGas() if material is None else material
        if self.material.state:
            raise ValueError(f"{type(self.material).__name__}: give a material without internal variables")
        if amplification is None:
            amplification = self.material.speed**2 if isinstance(self.material, IsothermalGas) else 1.0
        if not np.all(np.ptp(x, axis=0) > 0):
            raise ValueError(
                f"initial positions all have the same coordinate {np.argmin(np.ptp(x, axis=0))}: spread them"
            )
        self.score, self.amplification, self.options = score, amplification, options
        self.mesh, self.walls, self.own_mesh, self.fixed_size = mesh, walls, mesh is None, size is not None
        d = x.shape[1]
        if self.own_mesh and len(walls):
            raise ValueError(
                "walls need a mesh with those boundaries: give one, such as lattice_mesh(lower, upper, h)"
            )
        self.size = np.full(d, np.nan) if size is None else np.broadcast_to(np.asarray(size, float), d)
        if self.fixed_size and not np.all(self.size > 0):
            raise ValueError(f"size {size}: give more than 0")
        self.clock, self.steps, self.rows = 0.0, 0, []
        self.width = self.measure_width(x)
        if not self.own_mesh:
            self.fixed_size, self.size = True, np.full(d, cell_sizes(mesh).mean())
        elif not self.fixed_size:
            self.size = self.wanted_size(x)
        self.volume = np.prod(np.maximum(np.ptp(x, axis=0), 1e-9)) / len(x)
        self.place(x, volume=self.volume)

    def measure_width(self, x):
        """(d,) width of the target along each axis, a quarter of the particles being in narrower places."""
        return np.quantile(widths(self.score, x), 0.25, axis=0, method="lower")

    def wanted_size(self, x):
        """(d,) mesh size that resolves the target, with two particles or more per occupied square."""
        size = np.minimum(RESOLUTION * self.width, x.std(axis=0) / 2)
        size = np.maximum(size, 1e-3 * x.std(axis=0))
        for _ in range(100):
            if len(x) >= PER_CUBE * len(np.unique(np.floor(x / size), axis=0)):
                break
            size = 1.05 * size
        return np.minimum(size, np.maximum(self.width, 1e-3 * x.std(axis=0)))

    def place(self, x, **state):
        """Put the particles on a mesh, a new one around them where it is ours to choose. Collective."""
        if self.own_mesh:
            cube = self.size  # its vertices lie on multiples of it: where the mesh begins has no effect
            reach = MARGIN * self.size + 0.25 * np.ptp(x, axis=0)
            lower, upper = np.floor((x.min(axis=0) - reach) / cube), np.ceil((x.max(axis=0) + reach) / cube)
            if np.prod(upper - lower) > MAX_CUBES:
                raise ValueError(
                    f"particles between {x.min(axis=0)} and {x.max(axis=0)} need too large a mesh of size "
                    f"{self.size}: the density may not be proper (give a prior, or a mesh with walls); else "
                    "give a larger size"
                )
            self.mesh = Ranks().broadcast(lambda: lattice_mesh(lower * cube, upper * cube, cube))
        body = Body(x, material=self.material, name="sample", **state)
        gradient = "plain" if self.own_mesh else "consistent"  # on uniform meshes both are the same
        given = (self.mesh, body, self.walls, self.score, self.amplification)
        self.flow = Flow(*given, gradient=gradient, **self.options)

    def run(self, until, damping, temperature, tolerance, progress):
        """Flow until the net force is below `tolerance` or the time is over; whether it is. Collective."""
        bar = Progress(until, "crossings") if progress and Ranks().rank == 0 else None
        damping_at = damping if callable(damping) else lambda share: damping
        try:
            return self.relax(until, damping_at, temperature, tolerance, bar)
        finally:
            if bar:
                bar.close()

    def relax(self, until, damping, temperature, tolerance, bar):
        """What `run` does, with damping as a function and a progress line, or None."""
        marks = 0
        while self.clock < until:
            share = self.clock / until
            if share * RECORDS >= marks:
                marks += 1
                self.look(share)
                if self.is_settled(tolerance) and (share >= 0.5 or temperature == 1):
                    return True
            flow = self.flow
            heat = temperature ** max(0.0, 1 - 2 * share)
            rate = self.material.wave_speed() / max(self.spread, 1e-300)
            dt = min(flow.stable_step(), (until - self.clock) / rate)
            self.advance(dt, damping(share) * rate, heat)
            self.clock += dt * rate
            if bar:
                bar.update(self.clock, f"net force {self.rows[-1]['net_force']:.2g}")
        self.look(1.0)
        return self.is_settled(tolerance)

    def is_settled(self, tolerance):
        """Whether the net force is below `tolerance` and the spread steady in the last rows of history."""
        last = self.rows[-PATIENCE:]
        spread = [row["spread"] for row in last]
        still = len(last) == PATIENCE and np.ptp(spread) < STEADY * max(spread)
        return still and max(row["net_force"] for row in last) < tolerance

    def advance(self, dt, damping, temperature):
        """A step; on a mesh of ours particles stay well inside. Collective."""
        flow, self.steps = self.flow, self.steps + 1
        try:
            flow.flow(dt, damping, temperature)
        except LostParticles as lost:
            raise ValueError(
                f"{lost}; on a mesh of your own: where the density ends, give its boundary a wall of kind "
                "'slip', or leave the mesh out"
            ) from None
        if self.own_mesh and self.steps % GROW_EVERY == 0:
            points, x = self.mesh.points, flow.particles.position
            room = MARGIN / 2 * self.size
            outside = np.any((x < points.min(axis=0) + room) | (x > points.max(axis=0) - room))
            if flow.ranks.max(int(outside)):
                self.again()

    def again(self):
        """Go on from the present state on a new mesh. Collective."""
        old = self.flow
        state = {"volume": self.volume, "velocity": old.gather("velocity")}
        if not isinstance(self.material, IsothermalGas):  # whose F has no effect and may be anything
            state["volume"] = old.gather("volume") * old.gather("jacobian")
            state["deformation_gradient"] = old.gather("deformation_gradient")
        affine = old.gather("affine") if old.transfer == "apic" else None
        self.place(old.gather("position"), **state)
        if affine is not None:
            self.flow.particles.affine[:] = affine[self.flow.particles.id]

    def look(self, share):
        """Add a row to the history at a share of the time; adapt or check the mesh size. Collective."""
        flow, x = self.flow, self.flow.gather("position")
        self.spread, self.width = float(x.std(axis=0).max()), self.measure_width(x)
        if not self.fixed_size and 0 < share <= 0.5:
            wanted = self.wanted_size(x)
            if np.any(np.abs(np.log(wanted / self.size)) > 0.25):
                self.size = wanted
                self.again()
                flow = self.flow
        elif share > 0.1 and self.fixed_size and np.any(self.size > COARSE * self.width):
            raise ValueError(
                f"mesh size {self.size} is too coarse for a target of width {self.width} along the axes: "
                f"give at most {COARSE} times the width, or leave the size out"
            )
        row = {"time": self.clock, "net_force": flow.net_force(), "spread": self.spread, "steps": self.steps}
        self.rows.append(row)

    def result(self, settled):
        """Samples of the present state. Collective."""
        x = self.flow.gather("position")
        score = self.score(x)
        if isinstance(self.material, IsothermalGas) and not len(self.walls):
            check_proper(x, score)
        diagnostics = {
            "net_force": self.rows[-1]["net_force"],
            "ksd": np.nan if len(self.walls) else kernel_stein(x, score),
            "width": self.width,
            "steps": self.steps,
        }
        history = {name: np.array([row[name] for row in self.rows]) for name in self.rows[0]}
        return Samples(x, score, self.mesh, self.size, history, diagnostics, settled)


def check_proper(x, score):
    """Raise ValueError where the target does not hold the particles: at rest -mean((x - mean) score^T) is 1.

    That is Stein's identity with the functions x; a density that is flat in a direction gives 0 there.
    """
    pull = -(x - x.mean(axis=0)).T @ score / len(x)
    least, direction = (part[..., 0] for part in np.linalg.eigh((pull + pull.T) / 2))
    if least < LEAST_PULL:
        raise ValueError(
            f"the target bears only {least:.2g} of the pressure in direction {direction}, where particles "
            f"reach from {x.min(axis=0)} to {x.max(axis=0)}: it is not proper (give a prior, or a mesh with "
            "walls), or the flow has not settled (start closer to it, or give a later `until`)"
        )
