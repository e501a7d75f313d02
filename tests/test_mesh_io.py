"""Reading meshes from files and DOLFINx, and what is said of those that cannot be read."""

import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

from fempm import compat, fill_cells  # before DOLFINx: it loads the right MPI
from fempm.mesh import from_dolfinx, read_mesh

# isort: split
from dolfinx import io
from dolfinx import mesh as dmesh
from mpi4py import MPI

COMM = MPI.COMM_WORLD
MESHES = Path(__file__).parent.parent / "meshes"
# Measure of the domain, measures of the boundaries, lowest quality, of Gmsh 4.8 and later.
DOMAINS = {
    "bar": (30, {"left": 1, "right": 1, "sides": 60}, 0.85),
    "clamp_box": (264, {"clamp": 22, "sides": 46}, 0.75),
    "collision_box": (1, {"walls": 4}, 0.85),
    "cube": (1, {"walls": 6}, 0.55),
    "disk": (np.pi, {"wall": 2 * np.pi}, 0.85),
    "metatron": (4 / np.sqrt(27) * 0.3**3, {"wall": 4 * 0.3**2 * np.sqrt(3)}, 0.55),
    "sphere": (np.pi / 6, {"wall": np.pi}, 0.55),
    "square": (1, {"left": 1, "right": 1, "bottom": 1, "top": 1}, 0.75),
}


@pytest.fixture
def gmsh():
    return pytest.importorskip("gmsh", exc_type=ImportError)


def measure(mesh, name):
    """Length or area of a boundary."""
    corners = mesh.points[mesh.facets(name)]
    edges = corners[:, 1:] - corners[:, :1]
    if mesh.dim == 2:
        return np.linalg.norm(edges[:, 0], axis=1).sum()
    return np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum() / 2


def check_domain(mesh, name):
    volume, boundaries, quality = DOMAINS[name]
    assert mesh.volumes.sum() == pytest.approx(volume, rel=0.02)
    assert set(mesh.boundaries) == {"boundary", *boundaries}
    for boundary, size in boundaries.items():
        assert measure(mesh, boundary) == pytest.approx(size, rel=0.02)
    assert sum(len(mesh.facets(b)) for b in boundaries) == len(mesh.facets("boundary"))
    assert min(mesh.quality(c) for c in range(len(mesh.cells))) > quality


@pytest.mark.smoke
@pytest.mark.parametrize("name", DOMAINS)
def test_geo_files(gmsh, name):
    check_domain(read_mesh(MESHES / f"{name}.geo"), name)


@pytest.mark.smoke
@pytest.mark.parametrize("name", ["disk", "metatron", "sphere", "square"])
def test_msh_files(gmsh, name):
    check_domain(read_mesh(MESHES / f"{name}.msh"), name)


@pytest.mark.smoke
@pytest.mark.parametrize("variable", ["DefineConstant[h = 0.5];", "If (!Exists(h))\n h = 0.5;\nEndIf"])
def test_size_holds_for_one_reading(gmsh, tmp_path, variable):
    path = tmp_path / "line.geo"
    path.write_text(variable + "\nPoint(1) = {0, 0, 0, h}; Point(2) = {1, 0, 0, h}; Line(1) = {1, 2};\n")
    cells = [len(read_mesh(str(path), **h).cells) for h in ({}, {"h": 0.1}, {}, {"h": 0.25})]
    assert cells == [2, 10, 2, 4]


def test_size_that_would_be_ignored(gmsh, tmp_path):
    path = tmp_path / "line.geo"
    path.write_text("h = 1; Point(1) = {0, 0, 0, h}; Point(2) = {1, 0, 0, h}; Line(1) = {1, 2};\n")
    with pytest.raises(ValueError, match=r"line.geo.*no variable h.*DefineConstant\[h"):
        read_mesh(path, h=0.1)
    with pytest.raises(ValueError, match=r"parameters \(h\) can only be set in a .geo file"):
        read_mesh(MESHES / "disk.msh", h=0.1)
    for h in (0, -0.1, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="square.geo: the mesh size h = .* is not positive"):
            read_mesh(MESHES / "square.geo", h=h)


def test_other_variables(gmsh):
    assert read_mesh(MESHES / "bar.geo", h=0.5, H=2).volumes.sum() == pytest.approx(60)
    turned = read_mesh(MESHES / "clamp_box.geo", angle=30)
    normal = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    assert np.allclose(turned.points[turned.facets("clamp")] @ normal, 0)


@pytest.mark.mpi
def test_gmsh_file_on_all_ranks(gmsh):
    mesh = read_mesh(MESHES / "square.msh")
    assert mesh.volumes.sum() == pytest.approx(1)
    on_left = mesh.points[mesh.facets("left")]
    assert (on_left[:, :, 0] == 0).all()
    assert len(on_left) >= 20


@pytest.mark.mpi
def test_errors_reach_all_ranks(gmsh, tmp_path):
    path = COMM.bcast(tmp_path) / "text.msh"
    path.write_text("Dear all,\nthis is no mesh.\n")
    COMM.barrier()
    with pytest.raises(ValueError, match="gmsh cannot read .*text.msh"):
        read_mesh(path)


def test_unnamed_groups_are_called_by_their_number(gmsh, tmp_path):
    path = tmp_path / "line.geo"
    path.write_text(
        "Point(1) = {0, 0, 0}; Point(2) = {1, 0, 0}; Line(1) = {1, 2};"
        'Physical Point("start") = {1}; Physical Point(7) = {2}; Mesh.MeshSizeMax = 0.25;\n'
    )
    mesh = read_mesh(path, boundaries={"outside": lambda x: x[0] > -1})
    assert set(mesh.boundaries) == {"boundary", "start", "7", "outside"}
    assert mesh.points[mesh.facets("start")].tolist() == [[[0.0]]]
    assert mesh.points[mesh.facets("7")].tolist() == [[[1.0]]]
    assert len(mesh.facets("outside")) == 2


def test_unknown_boundary(gmsh):
    mesh = read_mesh(MESHES / "square.msh")
    with pytest.raises(KeyError, match="unknown boundary tag 'lid'.*'bottom', 'boundary', 'left'"):
        mesh.facets("lid")
    with pytest.raises(ValueError, match="'lid': its predicate holds on no exterior facet"):
        read_mesh(MESHES / "square.msh", boundaries={"lid": lambda x: x[1] > 2})


@pytest.mark.smoke
@pytest.mark.mpi
def test_xdmf_of_dolfinx(tmp_path):
    path = COMM.bcast(tmp_path) / "cube.xdmf"
    written = dmesh.create_unit_cube(COMM, 2, 2, 2)
    floor = dmesh.locate_entities_boundary(written, 2, lambda x: x[2] == 0)
    tags = dmesh.meshtags(written, 2, floor, np.full(len(floor), 4, np.int32))
    with io.XDMFFile(COMM, str(path), "w") as file:
        file.write_mesh(written)
        compat.write_meshtags(file, written, tags)
    mesh = read_mesh(path)
    assert mesh.volumes.sum() == pytest.approx(1)
    assert set(mesh.boundaries) == {"boundary", "4"}
    assert (mesh.points[mesh.facets("4")][:, :, 2] == 0).all()
    if COMM.size == 1:
        assert len(mesh.facets("4")) == 8 and len(mesh.facets("boundary")) == 48


@pytest.mark.smoke
def test_dolfinx_meshes():
    comm = MPI.COMM_SELF
    made = (
        dmesh.create_interval(comm, 5, [0.0, 2.0]),
        dmesh.create_rectangle(comm, [[0.0, 0.0], [2.0, 1.0]], [4, 2]),
        dmesh.create_box(comm, [[0.0, 0.0, 0.0], [2.0, 1.0, 1.0]], [4, 2, 2]),
    )
    for dim, mesh in enumerate(made, 1):
        right = dmesh.locate_entities_boundary(mesh, dim - 1, lambda x: x[0] == 2)
        tags = dmesh.meshtags(mesh, dim - 1, right, np.full(len(right), 3, np.int32))
        wrapped = from_dolfinx(mesh, tags, {"right": 3}, {"left": lambda x: x[0] == 0})
        assert wrapped.dim == dim and wrapped.volumes.sum() == pytest.approx(2)
        assert len(wrapped.facets("right")) == len(wrapped.facets("left")) == len(right) > 0
        assert (wrapped.points[wrapped.facets("right")][..., 0] == 2).all()


def test_other_cells_than_simplices(gmsh, tmp_path):
    for mesh in (
        dmesh.create_unit_square(MPI.COMM_SELF, 2, 2, dmesh.CellType.quadrilateral),
        dmesh.create_unit_cube(MPI.COMM_SELF, 2, 2, 2, dmesh.CellType.hexahedron),
    ):
        with pytest.raises(ValueError, match="(quadrilateral|hexahedron) cells: only simplex meshes"):
            from_dolfinx(mesh)
    corners = np.array([[x, y, z] for z in (0.0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
    triangles, quads, hexahedra = [[4, 5, 6], [4, 6, 7]], [[0, 1, 2, 3]], [list(range(8))]
    blocks = {
        "quad": (corners[:4], [("quad", quads)]),
        "hexahedron": (corners, [("hexahedron", hexahedra)]),
        "mixed": (corners[[0, 1, 2, 3, 0, 1, 2, 3]], [("triangle", triangles), ("quad", quads)]),
    }
    for name, (points, cells) in blocks.items():
        path = tmp_path / f"{name}.msh"
        meshio.write(path, meshio.Mesh(points, cells), file_format="gmsh22")
        with pytest.raises(ValueError, match=f"{name}.msh.*(Quadr|Hexahedron).*only simplex meshes"):
            read_mesh(path)
        path = tmp_path / f"{name}.xdmf"
        meshio.write(path, meshio.Mesh(points, cells), data_format="XML")
        with pytest.raises(ValueError, match="only simplex meshes|cells of several kinds"):
            read_mesh(path)


def test_curved_cells(gmsh, tmp_path):
    points = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0.5, 0, 0], [0.6, 0.6, 0], [0, 0.5, 0]]
    mesh = meshio.Mesh(np.array(points), [("triangle6", [list(range(6))])])
    meshio.write(tmp_path / "curved.msh", mesh, file_format="gmsh22")
    meshio.write(tmp_path / "curved.xdmf", mesh, data_format="XML")
    with pytest.raises(ValueError, match="curved.msh.*Triangle 6.*straight"):
        read_mesh(tmp_path / "curved.msh")
    with pytest.raises(ValueError, match="geometry of degree 2: only straight"):
        read_mesh(tmp_path / "curved.xdmf")


def test_surface_in_space(gmsh, tmp_path):
    kernel = 'SetFactory("OpenCASCADE"); Mesh.MeshSizeMax = 0.5;'
    (tmp_path / "ball.geo").write_text(kernel + "Sphere(1) = {0, 0, 0, 1}; Delete { Volume{1}; }\n")
    (tmp_path / "flat.geo").write_text(kernel + "Rectangle(1) = {0, 0, 0.3, 1, 1};\n")
    with pytest.raises(ValueError, match="ball.geo.*2D cells embedded in 3D space, extending over 1.9"):
        read_mesh(tmp_path / "ball.geo")
    assert read_mesh(tmp_path / "flat.geo").points.shape[1] == 2

    triangles = [("triangle", [[0, 1, 2], [1, 3, 2]])]
    for height, name in ((0, "flat"), (1, "steep")):
        points = [[0.0, 0, 2], [1, 0, 2], [0, 1, 2], [1, 1, 2 + height]]
        meshio.write(tmp_path / f"{name}.xdmf", meshio.Mesh(points, triangles), data_format="XML")
    assert read_mesh(tmp_path / "flat.xdmf").volumes.sum() == pytest.approx(1)
    with pytest.raises(ValueError, match="triangle mesh embedded in 3D space"):
        read_mesh(tmp_path / "steep.xdmf")


def test_missing_and_unknown_files(tmp_path):
    for name in ("no.msh", "no.geo", "no.xdmf"):
        with pytest.raises(FileNotFoundError, match=f"mesh file .*{name} does not exist"):
            read_mesh(tmp_path / name)
    (tmp_path / "ball.stl").write_text("solid")
    with pytest.raises(ValueError, match="ball.stl: unknown mesh format '.stl', give .geo, .msh or .xdmf"):
        read_mesh(tmp_path / "ball.stl")


def test_foreign_files(gmsh, tmp_path):
    whole = (MESHES / "square.msh").read_text()
    files = {
        "text.msh": "Dear all,\nthis is no mesh.\n",
        "text.geo": "Dear all,\nthis is no mesh.\n",
        "text.xdmf": "Dear all,\nthis is no mesh.\n",
        "empty.msh": "",
        "empty.geo": "",
        "empty.xdmf": "",
        "page.xdmf": "<html><body/></html>",
        "half.msh": whole[: len(whole) // 2],
        "most.msh": whole[: int(0.95 * len(whole))],
        "header.msh": whole[:30],
        "point.geo": "Point(1) = {0, 0, 0};",
        "open.geo": "Point(1) = {0, 0, 0}; Line(1) = {1, 2};",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        with pytest.raises(ValueError, match=name):
            read_mesh(tmp_path / name)
    (tmp_path / "bytes.msh").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "bytes.xdmf").write_bytes(bytes(range(256)) * 20)
    for name in ("bytes.msh", "bytes.xdmf"):
        with pytest.raises(ValueError, match=name):
            read_mesh(tmp_path / name)
    # A failed reading leaves nothing behind.
    assert read_mesh(MESHES / "square.msh").volumes.sum() == pytest.approx(1)


def test_xdmf_without_its_data(tmp_path):
    mesh = meshio.Mesh([[0.0, 0], [1, 0], [0, 1]], [("triangle", [[0, 1, 2]])])
    meshio.write(tmp_path / "alone.xdmf", mesh, compression=None)
    (tmp_path / "alone.h5").unlink()
    with pytest.raises(ValueError, match="alone.xdmf"):
        read_mesh(tmp_path / "alone.xdmf")


def test_without_gmsh(monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    with pytest.raises(ImportError, match=r"square.msh needs the package gmsh.*pip install fempm\[mesh\]"):
        read_mesh(MESHES / "square.msh")


def test_other_formats_need_no_gmsh():
    code = "import sys; sys.modules['gmsh'] = None; import fempm.mesh, fempm.compat, fempm.gmsh_reader"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_regions_of_a_file_become_bodies(gmsh, tmp_path):
    """Two physical surfaces of areas 1 and 3: regions by name, filled one by one."""
    (tmp_path / "two.geo").write_text(
        'SetFactory("OpenCASCADE");\nRectangle(1) = {0, 0, 0, 1, 1};\nRectangle(2) = {1, 0, 0, 3, 1};\n'
        'Coherence;\nPhysical Surface("soft") = {1};\nPhysical Surface("hard") = {2};\n'
        "Mesh.MeshSizeMax = 0.3;\n"
    )
    mesh = read_mesh(tmp_path / "two.geo")
    assert set(mesh.regions) == {"soft", "hard"}
    for name, area in (("soft", 1), ("hard", 3)):
        x, volume = fill_cells(mesh, 4, region=name)
        assert volume.sum() == pytest.approx(area, rel=1e-12)
        assert np.all((x[:, 0] < 1) == (name == "soft"))
    with pytest.raises(KeyError, match="unknown region 'wet': this mesh has .'hard', 'soft'."):
        fill_cells(mesh, 4, region="wet")
