"""Spaces of the gas solver against an assembly by DOLFINx, with basix's Bernstein polynomials."""

import numpy as np
import pytest
from gas_scenes import PAIRS, SIDES, box, even_box
from mesh_factory import rectangle

import fempm
from coupling.spaces import boundary_areas, build_space, facet_nodes
from fempm import compat

# isort: split
import basix
import ufl
from dolfinx import fem
from mpi4py import MPI

NODES = {1: 12, 2: 5, 3: 2}  # cells along an edge


def bernstein_element(cell, degree):
    """Bernstein polynomials as an element for DOLFINx."""
    if hasattr(fem, "functionspace"):
        import basix.ufl as ufl_elements

        make = ufl_elements.element
    else:
        from basix.ufl_wrapper import create_element as make
    return make("P", cell, degree, basix.LagrangeVariant.bernstein)


def bernstein_space(mesh, degree):
    """DOLFINx's space of Bernstein polynomials, and the control point of each of its dofs."""
    cell = ("interval", "triangle", "tetrahedron")[mesh.topology.dim - 1]
    kind = getattr(basix.CellType, cell)
    points, vertices = compat.vertex_points(mesh), compat.cell_vertices(mesh)
    if degree == 0:
        V = compat.functionspace(mesh, ("DG", 0))
        layout = [(0, list(range(vertices.shape[1])))]
    else:
        V = compat.functionspace(mesh, bernstein_element(cell, degree))
        variant = basix.LagrangeVariant.bernstein
        dofs = basix.create_element(basix.ElementFamily.P, kind, degree, variant).entity_dofs
        topology = basix.topology(kind)
        layout = [(n[0], topology[k][e]) for k in (0, 1) for e, n in enumerate(dofs[k]) if n]
    place = np.full((V.dofmap.index_map.size_local, points.shape[1]), np.nan)
    for c in range(len(vertices)):
        for dof, corners in layout:
            place[V.dofmap.cell_dofs(c)[dof]] = points[vertices[c][corners]].mean(axis=0)
    return V, place


def numbering(found, wanted):
    """For each of the wanted points (n, d), the number of the same one among those found."""
    distance = np.linalg.norm(found[None] - wanted[:, None], axis=2)
    order = distance.argmin(axis=1)
    assert len(found) == len(wanted) and distance.min(axis=1).max() < 1e-12
    assert len(set(order.tolist())) == len(order)
    return order


def direction(mesh):
    """A constant vector that forms contain, so that one is compiled for all components."""
    return fem.Constant(mesh, np.zeros(mesh.geometry.dim))


def components(constant, assemble):
    """(..., d) what `assemble()` gives with each unit vector as the constant."""
    out = []
    for k in range(len(constant.value)):
        constant.value[:] = np.eye(len(constant.value))[k]
        out.append(assemble())
    return np.stack(out, axis=-1)


def edge_matrix(space):
    """Dense (n, n, d) c_ij of a space; its diagonal is what makes constants have no gradient."""
    out = np.zeros((len(space.points),) * 2 + (space.dim,))
    i, j = space.edges.T
    out[i, j], out[j, i] = space.forward, space.backward
    return out


@pytest.mark.smoke
@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d", [1, 2, 3])
def test_against_dolfinx(d, pair):
    """Node volumes, c_ij, areas of the boundary and pressure coefficients, to round-off: 1e-13."""
    mesh = box(d, NODES[d])
    space = build_space(mesh, pair)
    theirs = compat.create_simplex_mesh(MPI.COMM_SELF, mesh.points, mesh.cells)
    V, nodes = bernstein_space(theirs, int(pair[1]))
    Q, places = bernstein_space(theirs, int(pair[-1]))
    at = numbering(nodes, space.points)
    u, v, q = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.TestFunction(Q)
    e, n = direction(theirs), ufl.FacetNormal(theirs)

    volumes = fem.assemble_vector(fem.form(v * ufl.dx)).array[at]
    np.testing.assert_allclose(space.volumes, volumes, rtol=0, atol=1e-13)
    assert space.volumes.sum() == pytest.approx(1, abs=1e-13)

    form = fem.form(ufl.dot(e, ufl.grad(u)) * v * ufl.dx)
    wanted = components(e, lambda: np.array(fem.assemble_matrix(form).to_dense()))[np.ix_(at, at)]
    found = edge_matrix(space)
    np.testing.assert_allclose(found, wanted * (1 - np.eye(len(at)))[..., None], rtol=0, atol=1e-13)

    form = fem.form(ufl.dot(e, n) * v * ufl.ds)
    wanted = components(e, lambda: fem.assemble_vector(form).array[at])
    areas = boundary_areas(mesh, space, mesh.exterior_facets)
    np.testing.assert_allclose(areas, wanted, rtol=0, atol=1e-13)

    centres = mesh.points[mesh.cells].mean(axis=1) if pair == "B1-B0" else mesh.points
    dofs = numbering(places, centres)
    form = fem.form(ufl.dot(e, ufl.grad(u)) * q * ufl.dx)
    wanted = components(e, lambda: np.array(fem.assemble_matrix(form).to_dense()))[np.ix_(dofs, at)]
    found = np.zeros_like(wanted)
    c, b = space.cell_pressures, space.cell_nodes
    np.add.at(found, (c[:, :, None], b[:, None, :]), space.coefficients)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13)
    volumes = fem.assemble_vector(fem.form(q * ufl.dx)).array[dofs]
    np.testing.assert_allclose(space.pressure_volumes, volumes, rtol=0, atol=1e-13)


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("d", [1, 2, 3])
def test_dual_cells_close(d, pair):
    """The areas between a node and its neighbours, and those on the boundary, sum to zero: a uniform
    pressure pushes nothing. Volumes are positive, also Bernstein's on vertices, where ordinary
    quadratic functions have none: a node has at least its share of one cell."""
    mesh = box(d, 2 * NODES[d])
    space = build_space(mesh, pair)
    assert space.volumes.min() > 0.999 * mesh.volumes.min() / space.cell_nodes.shape[1]
    n = space.forward - space.backward
    closed = boundary_areas(mesh, space, mesh.exterior_facets)
    np.add.at(closed, space.edges[:, 0], n)
    np.add.at(closed, space.edges[:, 1], -n)
    assert np.abs(closed).max() < 1e-14 * len(mesh.cells)
    on_boundary = np.unique(facet_nodes(mesh, mesh.exterior_facets, space.cell_nodes, space.node_of_vertex))
    inner = np.setdiff1d(np.arange(len(space.points)), on_boundary)
    uniform = np.zeros_like(space.points)
    np.add.at(uniform, space.cell_nodes, space.coefficients.sum(axis=1))
    assert len(inner) and np.abs(uniform[inner]).max() < 1e-14 * len(mesh.cells)
    # each edge vector runs from its first node to its second
    i, j = space.edges.T
    np.testing.assert_allclose(space.vectors, space.points[j] - space.points[i], rtol=0, atol=1e-14)


@pytest.mark.parametrize("pair", PAIRS)
def test_linear_functions_have_their_gradient(pair):
    """Control points reproduce linear functions, so that their lumped gradient is exact at all nodes."""
    mesh = box(2, 8)
    space = build_space(mesh, pair)
    i, j = space.edges.T
    values = space.points @ [2.0, -3.0]
    gradient = np.zeros_like(space.points)
    np.add.at(gradient, i, space.forward * (values[j] - values[i])[:, None])
    np.add.at(gradient, j, space.backward * (values[i] - values[j])[:, None])
    np.testing.assert_allclose(gradient / space.volumes[:, None], [[2.0, -3.0]] * len(values), atol=1e-12)


def test_volumes_of_the_fine_square():
    """Least volume of degree two on the 200 x 200 square: in a corner of one triangle, a sixth of
    1 / 80,000, which is the 2.1e-6 of the design note."""
    space = build_space(rectangle(200, 200, jitter=0), "B2-B1")
    assert space.volumes.min() == pytest.approx(1 / 480_000, rel=1e-10)
    assert space.volumes.sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("pair", PAIRS)
@pytest.mark.parametrize("both", [False, True])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_periodic(d, both, pair):
    """Joined nodes have the summed volumes and areas of their images: P^T C P of the open mesh."""
    mesh = fempm.interval_mesh(np.linspace(0, 1, 9) ** 1.3) if d == 1 else even_box(d, 6 if d == 2 else 3)
    pairs = SIDES[:d] if both else SIDES[:1]
    whole, joined = build_space(mesh, pair), build_space(mesh, pair, pairs)
    folded, first = (
        np.where((x > 1 - 1e-9) & (np.arange(d) < len(pairs)), 0, x) for x in (whole.points, joined.points)
    )
    P = (np.linalg.norm(folded[:, None] - first[None], axis=2) < 1e-9).astype(float)
    assert np.all(P.sum(axis=1) == 1) and len(joined.points) < len(whole.points)
    np.testing.assert_allclose(joined.volumes, whole.volumes @ P, rtol=0, atol=1e-14)
    C = np.stack([P.T @ c @ P for c in np.moveaxis(edge_matrix(whole), 2, 0)], axis=2)
    C[np.arange(len(C)), np.arange(len(C))] = 0
    np.testing.assert_allclose(edge_matrix(joined), C, rtol=0, atol=1e-14)
    # no boundary is left: the areas close at all nodes of a box that is periodic in all directions
    n = joined.forward - joined.backward
    closed = np.zeros_like(joined.points)
    np.add.at(closed, joined.edges[:, 0], n)
    np.add.at(closed, joined.edges[:, 1], -n)
    open_sides = np.abs(closed).max() > 1e-3
    assert open_sides == (d > 1 and not both)
