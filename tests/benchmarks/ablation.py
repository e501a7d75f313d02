"""Two variations of the coupled step that the thesis warns of (figures 3.3 and 3.4), beside the step.

`MpmFirst` lets the forces of the solid act before the pressure is solved for, not after it. `LocalGradient`
moves the solid with a gradient of the pressure taken from values at the vertices, not with the force by which
the pressure was solved for (3.36).
"""

import numpy as np

import fempm
from coupling import Coupled, IdealGas, SlipWall, pressure
from coupling.scenes import planar_shock
from coupling.sharp import Sharp


class MpmFirst(Coupled):
    """Stress, gravity and walls of the solid before the coupled solve (the order of Fang et al. 2020)."""

    def solid_at_vertices(self, dt):
        vertices, mass, _ = super().solid_at_vertices(dt)
        self.solid.update_grid(dt)
        return vertices, mass, self.solid.velocity[vertices]

    def push_solid(self, dt):
        super().push_solid(dt)
        self.pushed = self.stages.now.copy()

    def one_step(self, U, dt, scheme=None, limiter=None):
        update = self.solid.update_grid
        self.first = True

        def once(dt):
            if self.first:
                self.first = False
                return update(dt)
            at = self.solid_vertices()
            self.solid.velocity[at] = self.pushed[at]  # after the solve nothing else acts

        self.solid.update_grid = once
        try:
            return super().one_step(U, dt, scheme, limiter)
        finally:
            self.solid.update_grid = update


class Local(Sharp):
    """The pressure's gradient at the vertices from their mean pressures, for the solid's final velocity."""

    def implicit_pressure(self, U, dt, advected=None, star=None):
        solid = self.before_stage(star is not None)[0]
        out = super().implicit_pressure(U, dt, advected, star)
        s = self.part.space
        slopes = s.coefficients[:, 0] / s.cell_volumes[:, None, None]
        gradient = np.einsum("cb,cba->ca", self.mean_pressure(self.P)[s.cell_nodes], slopes)
        force = np.zeros_like(s.points)
        in_solid = np.where(self.of_gas, 0, s.cell_volumes)[:, None] / (s.dim + 1) * gradient
        np.subtract.at(force, s.cell_nodes.ravel(), np.repeat(in_solid, s.dim + 1, axis=0))
        pressure.divide_by_mass(self.part.size, self.inverse, self.special, self.walls, force)
        self.now = solid + dt * force
        return out


class SharpInterface(Coupled):
    """The thesis's interface, where the velocity of the solid comes from (3.36)."""

    def __init__(self, *args, **options):
        super().__init__(*args, interface="sharp", **options)


class LocalGradient(SharpInterface):
    """The same with `Local`."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.stages.__class__ = Local


def ellipse_in_a_blast(kind, until, h=0.02, young=1e4):
    """Stiff ellipse, heavier on one side, hit by a shock of Mach 3 (thesis figure 3.4); returns the scene."""
    mesh = fempm.box_mesh((0, 0), (1, 0.6), h)
    x, volume = fempm.fill_box([0.3, 0.1], [0.6, 0.5], h / 2)
    inside = ((x[:, 0] - 0.45) / 0.1) ** 2 + ((x[:, 1] - 0.3) / 0.15) ** 2 < 1
    heavy = inside & (x[:, 1] > 0.3)
    light = inside & ~heavy
    bodies = [
        fempm.Body(x[part], volume[part], fempm.NeoHookean(density, young, 0.3), name=name)
        for part, density, name in ((heavy, 20.0, "heavy"), (light, 5.0, "light"))
    ]
    solid = fempm.Simulation(mesh, bodies, transfer="flip")
    scene = kind(solid, IdealGas(1.4), planar_shock(3.0, 0.2), [SlipWall("boundary")])
    return march(scene, until)


def shell_in_still_air(kind, until, h=0.04):
    """Elastic ring in air at rest, its particles shaken by a hundred-thousandth of the speed of sound."""
    mesh = fempm.box_mesh((0, 0), (1, 1), h)
    x, volume = fempm.fill_box([0.2, 0.2], [0.8, 0.8], h / 2)
    r = np.linalg.norm(x - 0.5, axis=1)
    ring = (r < 0.3) & (r > 0.3 - 4 * h)
    shaken = 1e-5 * np.random.default_rng(0).standard_normal((ring.sum(), 2))
    body = fempm.Body(x[ring], volume[ring], fempm.NeoHookean(1.0, 100.0, 0.3), velocity=shaken, name="shell")
    solid = fempm.Simulation(mesh, [body], transfer="flip")
    return march(kind(solid, IdealGas(1.4), lambda x: (1.0, 0.0, 1.0), [SlipWall("boundary")]), until)


def march(scene, until):
    """Step to a time, or to where the run breaks down."""
    scene.start, scene.broken = scene.summary(), ""
    while scene.time < until:
        scene.dt = scene.stable_step()
        try:
            scene.step(scene.dt)
        except (fempm.SimulationError, fempm.LostParticles) as error:
            scene.broken = str(error)
            break
    return scene


def measure(scene):
    """Energy gained, pressure's jumps from vertex to vertex beside the solid, kinetic energy of the solid."""
    end = scene.summary()
    fields, edges = scene.vertex_fields(), scene.part.whole.edges
    beside = (fields["solid"] > 0) & (fields["solid"] < 1)
    near = np.any(beside[edges], axis=1) & np.all(fields["solid"][edges] < 1, axis=1)
    rough = np.sqrt(np.mean(np.diff(fields["pressure"][edges[near]], axis=1) ** 2))
    return {
        "time": scene.time,
        "energy": end["energy"] / scene.start["energy"] - 1,
        "roughness": rough,
        "kinetic": end["kinetic"],
        "elastic": end["elastic"],
        "repeated": scene.repeated,
        "broken": scene.broken[:60],
    }


def table(quick=False):
    """Rows of the experiment."""
    rows = []
    for name, scene, kinds, until in (
        ("ellipse", ellipse_in_a_blast, (Coupled, MpmFirst), 0.2),
        ("shell", shell_in_still_air, (SharpInterface, LocalGradient), 1.6),
    ):
        for kind in kinds:
            measured = measure(scene(kind, until / (4 if quick else 1)))
            rows.append({"scene": name, "step": kind.__name__, **measured})
    return rows


if __name__ == "__main__":
    for row in table():
        print(row)
