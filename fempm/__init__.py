"""fempm: the material point method on unstructured simplex meshes (UMLS-MPM) for FEniCSx.

A scene is a mesh, bodies of particles with materials, walls, and a run:

    mesh = read_mesh("meshes/sphere.geo")
    ball = Body(*fill_cells(mesh, 8, inside), NeoHookean(density=1e3, young=1e6, poisson=0.3))
    simulation = Simulation(mesh, [ball], [Wall("wall", "sticky")], gravity=(0, 0, -9.81))
    run(simulation, until=1.0, output="results/ball")
"""

from .boxes import box_mesh
from .checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from .contact import Obstacle
from .interrupt import Interrupted
from .locate import LostParticles
from .materials import (
    Hencky,
    LinearElastic,
    NeoHookean,
    StVenantKirchhoff,
    WeaklyCompressibleFluid,
)
from .mesh import SimplexMesh, from_dolfinx, interval_mesh, mark_boundary, read_mesh
from .particles import Body, fill_box, fill_cells
from .plasticity import DruckerPrager, J2Softening, VonMises
from .run import run
from .solver import Simulation, SimulationError
from .walls import Wall

__version__ = "0.1.0"
__all__ = [
    "Body",
    "CheckpointError",
    "DruckerPrager",
    "Hencky",
    "Interrupted",
    "J2Softening",
    "LinearElastic",
    "LostParticles",
    "NeoHookean",
    "Obstacle",
    "SimplexMesh",
    "Simulation",
    "SimulationError",
    "StVenantKirchhoff",
    "VonMises",
    "Wall",
    "WeaklyCompressibleFluid",
    "box_mesh",
    "fill_box",
    "fill_cells",
    "from_dolfinx",
    "interval_mesh",
    "load_checkpoint",
    "mark_boundary",
    "read_mesh",
    "run",
    "save_checkpoint",
]
