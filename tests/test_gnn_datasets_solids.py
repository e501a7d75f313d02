"""Data sets of aerofoils, plates and letters: their files, and their solvers against closed forms."""

import shutil
import sys
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import brentq

import fempm
from fempm.mesh import facet_neighbours

sys.path.insert(0, str(Path(__file__).parent.parent / "demos"))

import dataset_airfoil
import dataset_font
import dataset_plate
from elastic_bodies import Drag, ElasticBody, NotConverged, SelfContact, Term, minimise

AIRFOIL = {"h": 0.2, "growth": 0.4, "radius": 5.0, "frames": 4, "every": 3e-4}
PLATE = {"h": 0.05, "layers": 1, "frames": 5}
FONT = {"h": 0.15, "frames": 5}


def read(path, dim):
    """Points (n, dim), cells, node types and {name: (frames, n[, 3])} of an XDMF file, by meshio."""
    with meshio.xdmf.TimeSeriesReader(path) as reader:
        points, cells = reader.read_points_cells()
        frames = [reader.read_data(k)[1] for k in range(reader.num_steps)]
    fields = {name: np.array([f[name] for f in frames]) for name in frames[0]}
    node_type = fields.pop("node_type")
    assert np.all(node_type == node_type[0])
    assert all(np.all(np.isfinite(field)) for field in fields.values())
    with h5py.File(Path(path).with_suffix(".h5")) as file:  # the mesh and the types are there only once
        assert file["points"].shape == points.shape
        assert not any("node_type" in file[str(k)]["Node"] for k in range(len(frames)))
    return points[:, :dim], cells[0].data, node_type[0], fields


class Load(Term):
    """Forces (n, d) in N that do not change."""

    def __init__(self, force):
        self.force = force

    def energy(self, x):
        return -np.sum(self.force * x)

    def derivatives(self, x, convex=True):
        return -self.force, sparse.csc_matrix((x.size, x.size))


# Solvers


def check_derivatives(term, x, e):
    """The gradient is that of the energy, the Hessian that of the gradient, by differences over e."""
    way = np.random.default_rng(0).normal(size=x.shape)
    slope = (term.energy(x + e * way) - term.energy(x - e * way)) / (2 * e)
    gradient, hessian = term.derivatives(x, convex=False)
    assert slope == pytest.approx(np.sum(gradient * way), rel=1e-6)
    change = (term.derivatives(x + e * way)[0] - term.derivatives(x - e * way)[0]).ravel() / (2 * e)
    assert np.allclose(hessian @ way.ravel(), change, atol=1e-6 * abs(change).max())
    least = np.linalg.eigvalsh(term.derivatives(x, convex=True)[1].toarray())[0]
    assert least > -1e-9 * abs(hessian).max()


@pytest.mark.parametrize("node", [[0.3, 0.07], [-0.03, 0.04], [1.02, -0.05]])
def test_contact_derivatives(node):
    """Of a node beside a segment, and of those beyond its ends."""
    contact = SelfContact(np.array([[0, 1], [2, 3]]), 10.0, 0.1, 1.0)
    check_derivatives(contact, np.array([[0.0, 0.0], [1.0, 0.0], node, [0.5, 2.0]]), 1e-6)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("stretch", [1.5, 0.5])
def test_body_derivatives(dim, stretch):
    """Of a body that grew, stretched and compressed."""
    rng, mesh = np.random.default_rng(0), fempm.box_mesh([0] * dim, [1] * dim, 0.5)
    body = ElasticBody(mesh.points, mesh.cells, 100.0, 0.3)
    body.grow(np.eye(dim) + 0.1 * rng.normal(size=(len(mesh.cells), dim, dim)))
    check_derivatives(body, stretch * mesh.points + 0.02 * rng.normal(size=mesh.points.shape), 1e-5)


def test_patch():
    """Large affine displacements of the surface give the same inside, with the stress of the closed form."""
    mesh = fempm.box_mesh([0, 0, 0], [1, 1, 1], 0.25)
    surface = np.unique(mesh.facets("boundary"))
    inner = np.setdiff1d(np.arange(len(mesh.points)), surface)
    X = mesh.points.copy()
    X[inner] += 0.02 * np.random.default_rng(1).normal(size=(len(inner), 3))
    body, F = ElasticBody(X, mesh.cells, 1e6, 0.4), np.array([[1.2, 0.3, 0], [0, 0.8, 0.1], [0.2, 0, 1.1]])
    x = X.copy()
    x[surface] = X[surface] @ F.T
    x[inner] = x[surface].mean(axis=0) + 0.3 * (X[inner] - 0.5)
    x, _ = minimise([body], x, np.isin(np.arange(len(X)), inner), 1e-10)
    assert np.allclose(x, X @ F.T, atol=1e-9)  # Newton stops at 1e-10
    mu, lame, J = 1e6 / 2.8, 0.4e6 / (1.4 * 0.2), np.linalg.det(F)
    cauchy = (mu * (F @ F.T - np.eye(3)) + lame * np.log(J) * np.eye(3)) / J
    d = np.diag(cauchy)
    shear = cauchy[0, 1] ** 2 + cauchy[1, 2] ** 2 + cauchy[2, 0] ** 2
    expected = np.sqrt(0.5 * ((d[0] - d[1]) ** 2 + (d[1] - d[2]) ** 2 + (d[2] - d[0]) ** 2) + 3 * shear)
    assert np.allclose(body.von_mises(x), expected, rtol=1e-6)


def tip_stiffness(layers, length=1.0, thick=0.2, young=1e6):
    """Force over deflection in N/m of a square beam that is clamped at one end, nu = 0."""
    mesh = fempm.box_mesh([0, 0, 0], [length, thick, thick], thick / layers)
    X, force, end = mesh.points, np.zeros_like(mesh.points), mesh.facets("right")
    a, b, c = X[end].transpose(1, 0, 2)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    np.add.at(force[:, 1], end, (area / (3 * thick**2))[:, None] * np.ones(3))
    x, _ = minimise([ElasticBody(X, mesh.cells, young, 0.0), Load(force)], X, X[:, 0] > 1e-9, 1e-9)
    return 1 / np.mean((x - X)[X[:, 0] > length - 1e-9, 1])


def test_cantilever():
    """Linear cells are too stiff by a share ~ h^2; without it, the stiffness is Timoshenko's."""
    exact = 1 / (1.0 / (3 * 1e6 * 0.2**4 / 12) + 1.0 / (5 / 6 * 0.5e6 * 0.2**2))
    coarse, fine = tip_stiffness(2), tip_stiffness(4)
    assert coarse > fine > exact
    # 2 %: next order of the extrapolation, and the shear coefficient 5/6 is that of a free cross-section
    assert (4 * fine - coarse) / 3 == pytest.approx(exact, rel=0.02)


def test_growth():
    """Equal growth in all cells makes a free body larger, without energy."""
    mesh = fempm.box_mesh([0, 0], [1, 1], 0.25)
    body, X = ElasticBody(mesh.points, mesh.cells, 1e5, 0.3), mesh.points
    body.grow(np.broadcast_to(np.diag([1.5, 1.2]), (len(mesh.cells), 2, 2)))
    x, _ = minimise([body, Drag(np.full(len(X), 0.01), 1e-6, X)], X, np.ones(len(X), bool), 1e-9)
    assert np.allclose(x - x.mean(axis=0), (X - 0.5) * [1.5, 1.2], atol=1e-6)  # the drag's 1e-8 J / 1e5 Pa
    assert body.energy(x) < 1e-10 * 1e5


def test_barrier():
    """A node pressed against a segment stops where the barrier's slope is the force; it never crosses."""
    X, layer, stiffness = np.array([[0.0, 0.0], [1.0, 0.0], [0.3, 0.5], [0.3, 0.9]]), 0.1, 1e5
    contact = SelfContact(np.array([[0, 1], [2, 3]]), stiffness, layer, reach=10.0)
    for force in (1.0, 1e4, 1e7):
        push = Load(np.array([[0, 0], [0, 0], [0, -force], [0, 0]]))
        hold = Drag(np.array([0, 0, 1.0, 0]), 1e-3 * force, X)
        x, _ = minimise([contact, push, hold], X, np.arange(4) == 2, 1e-12)

        def residual(s, force=force):
            slope = 2 * (layer - s) * np.log(layer / s) + (layer - s) ** 2 / s
            return stiffness * slope - force + 1e-3 * force * (0.5 - s)

        assert x[2, 1] == pytest.approx(brentq(residual, 1e-9, layer), rel=1e-6)
        assert x[2, 0] == pytest.approx(0.3, abs=1e-9)


def test_no_equilibrium_is_an_error():
    """A force on a free body has no equilibrium."""
    mesh = fempm.box_mesh([0, 0], [1, 1], 0.5)
    free = np.ones(len(mesh.points), bool)
    terms = [
        ElasticBody(mesh.points, mesh.cells, 1.0, 0.3),
        Drag(free * 1.0, 1e-9, mesh.points),
        Load(mesh.points),
    ]
    with pytest.raises(NotConverged, match="smaller frames"):
        minimise(terms, mesh.points, free, 1e-12, most=2)


# Aerofoil


def test_profile():
    """NACA 2412 of Abbott and von Doenhoff's table, in chords; their tail is open by 0.2 %."""
    points = dataset_airfoil.outline(0.02, 0.4, 0.12, count=200)
    upper, lower = points[200::-1], np.concatenate([points[200:], points[:1]])
    for x, above, below in ((0.3, 0.0788, -0.0412), (0.4, 0.0780, -0.0380), (0.5, 0.0724, -0.0334)):
        assert np.interp(x, *upper.T) == pytest.approx(above, abs=3e-4)
        assert np.interp(x, *lower.T) == pytest.approx(below, abs=3e-4)


def test_airfoil(tmp_path):
    """Types by place; the mass stays as long as no wave has come to the far field."""
    path = tmp_path / "a.xdmf"
    case = {"camber": 0.0, "thickness": 0.12, "mach": 0.5, "angle": 5.0}
    dataset_airfoil.make(path, AIRFOIL, np.random.default_rng(0), **case)
    X, cells, node_type, fields = read(path, 2)
    assert {name: field.shape for name, field in fields.items()} == {
        "density": (4, len(X)), "pressure": (4, len(X)), "velocity": (4, len(X), 3)
    }  # fmt: skip
    x, y = X[node_type == 2].T
    half = 0.6 * (0.2969 * np.sqrt(x.clip(0)) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    assert np.allclose(abs(y), half, atol=1e-3)  # of the spline through 80 points, at the nose
    far = np.hypot(X[:, 0] - 0.5, X[:, 1]) > 5 - 1e-6
    assert np.array_equal(far, np.isin(node_type, [4, 5]))
    enters = (X - [0.5, 0]) @ [np.cos(np.deg2rad(5)), np.sin(np.deg2rad(5))] < 0
    assert np.array_equal(node_type == 4, far & enters)
    assert np.array_equal(np.unique(facet_neighbours(cells)[1]), np.flatnonzero(node_type))

    density, pressure = fields["density"], fields["pressure"]
    assert np.ptp(pressure[-1]) > 1e4  # the flow has begun
    a, b = X[cells[:, 1]] - X[cells[:, 0]], X[cells[:, 2]] - X[cells[:, 0]]
    area = 0.5 * abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    mass = density @ np.bincount(cells.ravel(), np.repeat(area / 3, 3))
    print(mass / mass[0] - 1, abs(density[-1, far] / 1.2 - 1).max())
    assert np.allclose(mass, mass[0], rtol=1e-6)  # single precision


def test_air_at_rest_stays_at_rest(tmp_path):
    """Without wind nothing moves at the aerofoil and the far field, to single precision."""
    path = tmp_path / "a.xdmf"
    dataset_airfoil.make(path, AIRFOIL, np.random.default_rng(1), mach=0.0)
    fields = read(path, 2)[3]
    assert np.allclose(fields["density"], 1.2, rtol=1e-6)
    assert np.allclose(fields["pressure"], 1e5, rtol=1e-6)
    assert abs(fields["velocity"]).max() < 1e-6 * 340


# Plate


def inside(x, corners):
    """(m,) bool, whether points (m, 3) are in one of the tetrahedra (nc, 4, 3)."""
    inverse = np.linalg.inv(corners[:, 1:] - corners[:, :1])
    share = np.einsum("mci,cij->mcj", x[:, None] - corners[:, 0], inverse)
    return np.any((share.min(axis=2) > 1e-9) & (share.sum(axis=2) < 1 - 1e-9), axis=1)


@pytest.mark.parametrize("seed", [0, 2])
def test_plate(tmp_path, seed):
    """The actuator moves as prescribed, clamps hold, and neither body has nodes in the other's cells."""
    path = tmp_path / "p.xdmf"
    said = dataset_plate.make(path, PLATE, np.random.default_rng(seed))
    X, cells, node_type, fields = read(path, 3)
    x, stress = fields["position"].astype(float), fields["stress"]
    plate, hole, actuator, way, both = dataset_plate.random_case(np.random.default_rng(seed))
    rigid = node_type == 1
    assert np.array_equal(node_type == 3, (X[:, 0] < 1e-9) | ((X[:, 0] > plate[0] - 1e-9) & both & ~rigid))
    assert np.array_equal(rigid, X[:, 2] > plate[2] + 1e-9)
    for k in range(5):  # single precision of positions up to 0.5 m
        assert np.allclose((x[k] - X)[rigid], k / 4 * way, atol=1e-7)
        assert np.allclose((x[k] - X)[node_type == 3], 0, atol=1e-7)
    assert np.all(stress[:, rigid] == 0) and stress[-1, ~rigid].max() > 1e3
    of_actuator = rigid[cells].all(axis=1)
    assert np.array_equal(of_actuator, rigid[cells].any(axis=1))  # two components
    assert not inside(x[-1][~rigid], x[-1][cells[of_actuator]]).any()
    assert not inside(x[-1][rigid], x[-1][cells[~of_actuator]]).any()
    distance = np.linalg.norm(x[-1][rigid][:, None] - x[-1][~rigid], axis=2)
    assert np.sum(distance < 0.03) > 0, said
    assert (X - x[-1])[~rigid, 2].max() > 0.02  # it has been pushed down


@pytest.mark.parametrize("half", [[0, 0, 0], [0.03, 0, 0], [0.03, 0.02, 0.01]])
def test_actuator(half):
    """The mesh of the actuator lies on and under the surface that its gap says."""
    actuator = dataset_plate.Actuator(half, 0.04, 0.7, [0.2, 0.1, 0.2])
    X, cells, of_actuator = dataset_plate.two_meshes((0.4, 0.2, 0.04), None, actuator, 0.04, 1)
    skin = np.unique(facet_neighbours(cells[of_actuator])[1])
    assert np.allclose(actuator.gap(X[skin])[0], 0, atol=1e-8)
    x = np.array([[0.2, 0.1, 0.2 + half[2] + 0.05]])
    assert np.allclose(actuator.gap(x)[0], 0.01) and np.allclose(actuator.gap(x)[1], [0, 0, 1])


# Letters


def signed_area(loop):
    return 0.5 * np.sum(loop[:, 0] * np.roll(loop[:, 1], -1) - loop[:, 1] * np.roll(loop[:, 0], -1))


@pytest.mark.parametrize("letter", ["e", "i", "B", "@"])
def test_letter_mesh(letter):
    """The triangles cover what the outlines enclose: holes turn the other way round."""
    loops = dataset_font.outlines(letter, 0.1, np.zeros(2))
    X, cells = dataset_font.letter_mesh(loops, 0.1)
    a, b = X[cells[:, 1]] - X[cells[:, 0]], X[cells[:, 2]] - X[cells[:, 0]]
    area = 0.5 * abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
    assert area == pytest.approx(abs(sum(map(signed_area, loops))), rel=1e-9)
    assert np.ptp(X, axis=0).max() == pytest.approx(1, abs=0.02)  # curves are cut off between points


def crossings(x, segments):
    """How many pairs of segments without a common node cross."""

    def side(p, q, r):
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (
            r[..., 0] - p[..., 0]
        )

    a, b = x[segments[:, 0]], x[segments[:, 1]]
    first = side(a[:, None], b[:, None], a[None]) * side(a[:, None], b[:, None], b[None]) < 0
    return np.sum(first & first.T) // 2


def test_font(tmp_path):
    """The letters swell monotonously, touch, and neither cross nor leave the box."""
    path = tmp_path / "f.xdmf"
    dataset_font.make(path, FONT, np.random.default_rng(0), letters="e4oG", growth=2.2)
    X, cells, node_type, fields = read(path, 2)
    x, segments = fields["position"][:, :, :2].astype(float), facet_neighbours(cells)[1]
    assert np.all(node_type == 0) and np.allclose(x[0], X, atol=1e-7)
    a, b = x[:, cells[:, 1]] - x[:, cells[:, 0]], x[:, cells[:, 2]] - x[:, cells[:, 0]]
    areas = 0.5 * np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
    total = areas.sum(axis=1)
    assert (
        np.all(np.diff(total) > 0) and 1.5 < total[-1] / total[0] < 2.2
    )  # by the growth where nothing resists
    assert all(crossings(frame, segments) == 0 for frame in x)
    assert abs(x).max() < dataset_font.BOX
    contact = SelfContact(segments, 1.0, 0.3 * FONT["h"], 1.0)
    assert len(contact.pairs(x[-1], contact.layer)[0]) > len(contact.pairs(x[0], contact.layer)[0]) + 5


# Command line


def write_small(path, size, rng):
    """A trajectory with a random number, or none for a size that fails."""
    if size["fails"] and rng.random() < 0.6:
        raise NotConverged("it does not work")
    X = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    with fempm.output.MeshFile(
        path, X, np.array([[0, 1, 2]]), static={"node_type": np.zeros(3, int)}
    ) as file:
        file.write(0.0, value=rng.random(3))
    return "small"


def test_resumed(tmp_path, capsys):
    """Finished files are kept, missing ones are made again as they were, unfinished ones are not taken."""
    sizes = {"mini": {"fails": False}, "paper": {"fails": True}}

    def run(*options):
        return dataset_airfoil.make_all("", write_small, sizes, ["--out", str(tmp_path), *options])

    paths = run("--trajectories", "3")
    first = [read(path, 2)[3]["value"] for path in paths]
    assert not np.array_equal(first[0], first[1])
    for path in paths[1:]:
        path.unlink()
    shutil.copy(paths[0].with_suffix(".h5"), paths[1].with_suffix(".h5"))
    (tmp_path / "trajectory_0001_unfinished").mkdir()
    before = paths[0].stat().st_mtime_ns
    run("--trajectories", "3", "--jobs", "2")
    assert np.array_equal(first, [read(path, 2)[3]["value"] for path in paths])
    assert paths[0].stat().st_mtime_ns == before and not list(tmp_path.glob("*unfinished"))
    with pytest.raises(SystemExit, match=r"3 of 5 trajectories failed"):
        run("--trajectories", "8", "--size", "paper")
    assert "NotConverged: it does not work" in capsys.readouterr().out
