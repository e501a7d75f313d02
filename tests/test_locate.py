"""Finding and following the cells of particles, against all cells tried one by one."""

from itertools import combinations

import numpy as np
import pytest
from mesh_factory import MESHES, cube, gmsh_cube, graded_interval, random_points, rectangle

import fempm
from fempm import Body, LostParticles, NeoHookean, Simulation, Wall
from fempm.locate import MAX_WALK, find_cells

BUILD = {
    "1D": lambda: graded_interval(0.1, 2.0),
    "gmsh 2D": lambda: fempm.read_mesh(MESHES / "disk.geo", h=0.2),
    "jittered 2D": lambda: rectangle(12, 3, 4.0, 0.5),
    "3D": lambda: cube(3),
    "gmsh 3D": lambda: gmsh_cube(0.3),
}
any_mesh = pytest.mark.parametrize("name", BUILD)


def barycentric(mesh, x, cells):
    """(n, d + 1) coordinates of x (n, d) in the given cells, from the linear system of the corners."""
    corners = mesh.points[mesh.cells[cells]].transpose(0, 2, 1)
    matrix = np.concatenate([corners, np.ones((len(corners), 1, mesh.dim + 1))], axis=1)
    return np.linalg.solve(matrix, np.append(x, np.ones((len(x), 1)), axis=1)[..., None])[..., 0]


def try_all_cells(mesh, x):
    """(n,) cell with the largest least barycentric coordinate."""
    all_cells = np.arange(len(mesh.cells))
    least = [barycentric(mesh, np.tile(p, (len(all_cells), 1)), all_cells).min(axis=1) for p in x]
    return np.argmax(least, axis=1)


def scene(mesh, x, walls=()):
    return Simulation(mesh, [Body(x, 1e-3, NeoHookean(1.0, 1.0))], walls, gradient="plain")


@pytest.mark.smoke
@any_mesh
def test_random_points(name):
    """Interior points lie in one cell only: the search finds the cell they were drawn from."""
    mesh = BUILD[name]()
    x, cell = random_points(mesh, 400)
    np.testing.assert_array_equal(find_cells(mesh, x), cell)
    np.testing.assert_array_equal(try_all_cells(mesh, x[:100]), cell[:100])


@any_mesh
def test_vertices_edges_and_faces(name):
    """Points shared by cells are found in one of them: coordinates above -1e-10, the search's tolerance."""
    mesh = BUILD[name]()
    for k in range(1, mesh.dim + 2):
        for subset in combinations(range(mesh.dim + 1), k):
            x = mesh.points[mesh.cells[:, subset]].mean(axis=1)
            cell = find_cells(mesh, x)
            assert barycentric(mesh, x, cell).min() > -1.1e-10


@any_mesh
def test_walking_equals_searching(name):
    """From anywhere to anywhere, far longer than a step: walking or its fallback ends in the right cell."""
    mesh = BUILD[name]()
    start, _ = random_points(mesh, 500, seed=1)
    end, cell = random_points(mesh, 500, seed=2)
    s = scene(mesh, start)
    s.particles.position[:] = end
    s.locate_particles()
    np.testing.assert_array_equal(s.particles.cell, cell)
    assert s.wall_hits == 0


@pytest.mark.parametrize("name", ["1D", "gmsh 2D", "jittered 2D", "3D"])
def test_walking_alone(name):
    """In convex Delaunay meshes walks always arrive: they do so when the search has nothing to search."""
    mesh = BUILD[name]()
    start, _ = random_points(mesh, 500, seed=1)
    end, cell = random_points(mesh, 500, seed=2)
    s = scene(mesh, start)
    lower, size, per_axis, first, content = s.bins
    s.bins = lower, size, per_axis, np.zeros_like(first), content
    s.particles.position[:] = end
    s.locate_particles()
    np.testing.assert_array_equal(s.particles.cell, cell)


def test_walk_longer_than_its_limit():
    """Across more cells than a walk may cross, the search over all cells takes over."""
    mesh = fempm.interval_mesh(np.linspace(0, 1, 4 * MAX_WALK + 1))
    s = scene(mesh, [[0.001]])
    s.particles.position[:] = 0.999
    s.locate_particles()
    assert s.particles.cell[0] == 4 * MAX_WALK - 1


@pytest.mark.parametrize("walls", [[], [Wall()]], ids=["open", "wall"])
def test_walk_across_a_notch(walls):
    """The straight way between the arms of an L leaves the mesh, past open facets or a wall."""
    square = rectangle(10, 10, jitter=0)
    centre = square.points[square.cells].mean(axis=1)
    used, cells = np.unique(square.cells[~np.all(centre > 0.5, axis=1)], return_inverse=True)
    mesh = fempm.SimplexMesh(square.points[used], cells.reshape(-1, 3))
    assert mesh.volumes.sum() == pytest.approx(0.75, rel=1e-12)
    rng = np.random.default_rng(0)
    right = np.stack([rng.uniform(0.8, 1, 200), rng.uniform(0.35, 0.5, 200)], axis=1)
    top = right[::-1, ::-1].copy()
    s = scene(mesh, right, walls)
    s.particles.position[:] = top
    s.locate_particles()
    np.testing.assert_array_equal(s.particles.cell, try_all_cells(mesh, top))
    np.testing.assert_array_equal(s.particles.position, top)
    assert s.wall_hits == 0


def test_lost_particles_are_listed():
    """Numbers, positions and the mesh's extent; the message stops after three."""
    mesh = rectangle(4, 4)
    x = np.full((8, 2), 0.5)
    x[[1, 3, 4, 6]] = [[2.5, 0.5], [0.5, -1], [-7, 0.5], [0.5, 1.001]]
    with pytest.raises(LostParticles) as caught:
        find_cells(mesh, x)
    np.testing.assert_array_equal(caught.value.ids, [1, 3, 4, 6])
    np.testing.assert_array_equal(caught.value.positions, x[[1, 3, 4, 6]])
    message = str(caught.value)
    assert "4 particle(s) outside the mesh (which spans [0. 0.] to [1. 1.])" in message
    assert "1 at [2.5, 0.5], 3 at [ 0.5, -1. ], 4 at [-7. ,  0.5], ...;" in message
    assert "6 at" not in message


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("walls", [[], [Wall()]], ids=["open", "wall"])
def test_positions_that_are_no_numbers(walls, value):
    """Found at the start and while walking from any cell, also where a wall takes back what steps out."""
    mesh = rectangle(4, 4)
    x = mesh.points[mesh.cells].mean(axis=1)
    for bad in ([value, 0.5], [0.5, value], [value, value], [value, -value]):
        s = scene(mesh, x, walls)
        s.particles.position[:] = bad
        message = rf"{len(x)} particle\(s\) outside.*: 0 at \[.*(nan|inf).*1 at \["
        with pytest.raises(LostParticles, match=message):
            find_cells(mesh, s.particles.position)
        with pytest.raises(LostParticles, match=f"time 0, step 0: {message}"):
            raise s.locate_particles()
        assert s.wall_hits == 0


@pytest.mark.parametrize("kind", ["sticky", "slip"])
def test_step_through_a_wall_is_taken_back(kind):
    """The particle lands in its last cell, 1e-9 of that cell away from the wall; the other one stays."""
    mesh = rectangle(5, 5)
    s = scene(mesh, [[0.42, 0.03], [0.5, 0.5]], [Wall("boundary", kind)])
    s.particles.position[s.particles.id == 0] = [0.45, -0.02]
    assert s.locate_particles() is None
    assert s.wall_hits == 1
    x, cell = s.gather("position"), s.gather("cell")
    np.testing.assert_array_equal(x[1], [0.5, 0.5])
    assert 0 < x[0, 1] < 1e-8 and abs(x[0, 0] - 0.45) < 0.1
    assert barycentric(mesh, x, cell).min() > 0
    s.step(1e-3)
    assert s.wall_hits == 1


def test_step_through_an_open_boundary_is_an_error():
    """Free flight at speed 2 from x = 0.7: outside after the second step of 0.1, as the message says."""
    x = np.array([[0.7, 0.5], [0.4, 0.5]])
    mesh = fempm.mark_boundary(rectangle(5, 5), "left", lambda x: x[0] < 1e-9)
    body = Body(x, 1e-6, NeoHookean(1.0, 1e-6), velocity=[[2.0, 0.0], [0.0, 0.0]])
    s = Simulation(mesh, [body], [Wall("left")])
    s.step(0.1)
    message = r"time 0\.2, step 2: 1 particle\(s\).*: 0 at \[1\.\d+, "
    with pytest.raises(LostParticles, match=message) as caught:
        s.step(0.1)
    np.testing.assert_array_equal(caught.value.ids, [0])
    assert s.wall_hits == 0
