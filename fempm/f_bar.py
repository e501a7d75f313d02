"""F-bar: volume changes averaged over the kernel, against locking of nearly incompressible materials."""

import numpy as np

from . import grid, transfer


def average_jacobian(simulation, bodies):
    """F-bar (Zhao et al. 2023): F times (J_bar / J)^(1/d) with J averaged over the kernel.

    J_i = sum w V0 J / sum w V0 at the vertices, J_bar = sum w J_i at the particles of bodies with
    `f_bar`; bodies that touch share the averages. V0 is the initial volume.

    Parameters
    ----------
    simulation : Simulation, with its particles sorted
    bodies : numbers of the bodies to average
    """
    s = simulation
    p, k, layer = s.particles, s.kernel, s.layer
    unknowns, active = len(s.mesh.points) + layer.num_free, (s.stamp, s.steps)
    share, jacobian, average = np.zeros(len(p)), p.jacobian, np.ones(len(p))
    for b in bodies:
        share[p.ranges[b]] = p.volume[p.ranges[b]]
    grid.clear(s.grids[:1], s.vertices, s.num_vertices)
    sums = s.grids[0]
    sorted_cells = (0, s.num_active, s.active, s.start, s.order, p.position)
    transfer.scatter_average(k.axes, *sorted_cells, share, jacobian, k.rings, sums)
    grid.fold_scalars(sums, *active, unknowns, layer.source)
    s.borders.add_shared(sums, *active)
    grid.divide(sums, s.vertices, s.num_vertices, unknowns, layer.source, s.scalar)
    transfer.gather_average(k.axes, *sorted_cells, share, s.scalar, k.rings, average)
    for b in bodies:
        part = p.ranges[b]
        with np.errstate(invalid="ignore"):  # an inverted particle is found by `update_stress`
            scale = (average[part] / jacobian[part]) ** (1 / s.mesh.dim)
        p.deformation_gradient[part] *= scale[:, None, None]
