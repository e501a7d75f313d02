"""coupling: compressible gas on the meshes of fempm, and its coupling with the solids there.

A gas is a mesh, an equation of state, an initial state, boundary conditions, and a run:

    mesh = fempm.read_mesh("meshes/tank.geo", h=0.02)
    walls = [SlipWall("bottom"), SlipWall("top"), Outflow("left"), Outflow("right")]
    gas = Flow(mesh, IdealGas(1.4), initial, walls)
    fempm.run(gas, until=0.2, output="results/gas")

With bodies in it, `Coupled(fempm.Simulation(mesh, bodies), IdealGas(1.4), initial, walls)` takes its place.
"""

from .boundaries import Inflow, Outflow, Periodic, SlipWall, SubsonicInflow
from .coupled import Coupled
from .flow import Flow
from .gas import IdealGas
from .riemann import State

__all__ = [
    "Coupled",
    "Flow",
    "IdealGas",
    "Inflow",
    "Outflow",
    "Periodic",
    "SlipWall",
    "State",
    "SubsonicInflow",
]
