"""DOLFINx meshes from Gmsh's files and models."""

import re
import tempfile
from pathlib import Path

import numpy as np

from . import compat

# Gmsh's element numbers of straight-sided simplices, by their dimension.
_SIMPLEX = (15, 1, 2, 4)


def read_gmsh(comm, path, parameters):
    """Read a .msh file, or mesh a .geo file, with Gmsh on rank 0. Collective.

    Parameters
    ----------
    comm : mpi4py.MPI.Comm
    path : pathlib.Path
    parameters : dict of numbers that override variables of a .geo file

    Returns
    -------
    mesh : dolfinx.mesh.Mesh
    cell_tags, facet_tags : dolfinx.mesh.MeshTags
    names : dict (dimension, name) -> tag

    Raises
    ------
    ImportError, ValueError
        on all ranks, if there is no package gmsh or the file is no mesh of simplices
    """
    return _make_mesh(comm, 0, lambda: _file_arrays(path, parameters))


def _file_arrays(path, parameters):
    try:
        import gmsh
    except (ImportError, OSError) as error:
        # OSError: a wheel of gmsh without the system libraries that it needs.
        raise ImportError(
            f"reading {path.name} needs the package gmsh ({error}): "
            "apt-get install python3-gmsh or pip install fempm[mesh]"
        ) from error
    gmsh.initialize(readConfigFiles=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        try:
            _open(gmsh, path, parameters)
            dim = gmsh.model.getDimension()
            if path.suffix == ".geo" and dim > 0:
                gmsh.model.mesh.generate(dim)
        except Exception as error:  # gmsh raises nothing more special
            raise ValueError(f"gmsh cannot read {path}: {error}") from error
        try:
            return model_arrays(gmsh.model, dim)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    finally:
        gmsh.finalize()


def _open(gmsh, path, parameters):
    # Gmsh's parser stumbles over the rest of a foreign file when it reads the next one.
    data = path.read_bytes()
    if path.suffix == ".msh" and not data.lstrip().startswith(b"$"):
        raise ValueError("it does not start with a section like $MeshFormat")
    if path.suffix == ".geo" and any(byte < 32 and byte not in b"\t\n\r\f" for byte in data):
        raise ValueError("it is not a text file")
    if not parameters:
        gmsh.open(str(path))
        return
    # Gmsh ends the process for such mesh sizes.
    if not 0 < parameters.get("h", 1) < float("inf"):
        raise ValueError(f"the mesh size h = {parameters['h']} is not positive")
    text = path.read_text()
    for name in parameters:
        if not re.search(rf"(DefineConstant\s*\[[^;]*?|Exists\s*\(\s*)\b{name}\b", text):
            raise ValueError(f"it has no variable {name} to be set: write DefineConstant[{name} = 0.1];")
    # Gmsh 4.8 has no other way to set a variable that does not last for the files read later.
    with tempfile.TemporaryDirectory() as folder:
        wrapper = Path(folder) / path.name
        lines = [f"{name} = {float(value)!r};" for name, value in parameters.items()]
        wrapper.write_text("\n".join([*lines, f'Include "{path.resolve()}";\n']))
        gmsh.open(str(wrapper))


def gmsh_model_to_mesh(model, comm, rank, gdim, partitioner=None):
    """Turn a meshed Gmsh model of simplices into a DOLFINx mesh. Collective.

    Parameters
    ----------
    model : gmsh.model on `rank`, anything elsewhere
    comm : mpi4py.MPI.Comm
    rank, gdim : int, the latter the number of coordinates to keep
    partitioner : as in `compat.create_simplex_mesh`

    Returns
    -------
    mesh : dolfinx.mesh.Mesh
    cell_tags, facet_tags : dolfinx.mesh.MeshTags, physical groups of cells and facets
    names : dict (dimension, name) -> physical group

    Raises
    ------
    ValueError
        on all ranks, as `model_arrays` does
    """
    return _make_mesh(comm, rank, lambda: model_arrays(model, gdim), partitioner)


def _make_mesh(comm, rank, arrays, partitioner=None):
    data, problem = None, None
    if comm.rank == rank:
        try:
            data = arrays()
        except (ImportError, ValueError) as error:
            problem = error
    compat.raise_everywhere(comm, problem)
    tdim, names = comm.bcast((data[1].shape[1] - 1, data[-1]) if data else None, root=rank)
    points, cells, groups, facets, facet_groups, _ = data or (
        None,
        np.empty((0, tdim + 1), np.int64),
        np.empty(0, np.int32),
        np.empty((0, tdim), np.int64),
        np.empty(0, np.int32),
        None,
    )
    mesh = compat.create_simplex_mesh(comm, points, cells, partitioner)
    cell_tags = compat.distribute_tags(mesh, tdim, cells, groups)
    return mesh, cell_tags, compat.distribute_tags(mesh, tdim - 1, facets, facet_groups), names


def model_arrays(model, gdim):
    """Points, cells and tagged facets of the physical groups of a meshed Gmsh model.

    The mesh consists of the cells in physical groups of the model's dimension. A model without
    such a group gets one, "all", of all its cells.

    Parameters
    ----------
    model : gmsh.model
    gdim : int, number of coordinates to keep; the others must be the same everywhere

    Returns
    -------
    points : (n, gdim) float64
    cells, cell_groups : (m, tdim + 1) int64 point numbers and (m,) int32 physical groups
    facets, facet_groups : (k, tdim) int64 and (k,) int32, the facets in physical groups
    names : dict (dimension, name) -> physical group

    Raises
    ------
    ValueError
        if there are no cells, or other cells than straight-sided simplices of one kind, if an
        element is in several groups, or if the mesh does not fit into `gdim` dimensions
    """
    tdim = model.getDimension()
    if tdim >= 1 and not model.getPhysicalGroups(tdim):
        entities = [tag for _, tag in model.getEntities(tdim)]
        model.setPhysicalName(tdim, model.addPhysicalGroup(tdim, entities), "all")
    names = {(dim, model.getPhysicalName(dim, tag)): tag for dim, tag in model.getPhysicalGroups()}
    names = {key: int(tag) for key, tag in names.items() if key[1]}
    cells, cell_groups = _group_elements(model, tdim)
    if len(cells) == 0:
        raise ValueError(f"it holds no mesh cells of dimension {tdim}, that of its geometry")

    # Node tags may have gaps, and some nodes may belong to no cell.
    tags, coordinates, _ = model.mesh.getNodes()
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, tdim + 1)
    order = np.argsort(tags)
    points = np.reshape(coordinates, (-1, 3))[order[np.searchsorted(tags, used, sorter=order)]]
    size = np.ptp(points, axis=0)
    if np.any(size[gdim:] > 1e-10 * size.max()):
        raise ValueError(
            f"{tdim}D cells embedded in 3D space, extending over "
            f"{' x '.join(f'{s:.4g}' for s in size)}: give a flat mesh with z = 0; in a .msh file "
            "of a body, the body needs a physical group if its boundary has one"
        )
    # A tagged facet of no tagged cell is not part of the mesh.
    facets, facet_groups = _group_elements(model, tdim - 1)
    inside = np.isin(facets, used).all(axis=1)
    facets = np.searchsorted(used, facets[inside])
    return points[:, :gdim].copy(), cells, cell_groups, facets, facet_groups[inside], names


def _group_elements(model, dim):
    """Node tags and group of all elements in physical groups of a dimension."""
    elements, nodes = [np.empty(0, np.int64)], [np.empty((0, dim + 1), np.int64)]
    groups = [np.empty(0, np.int32)]
    for _, group in model.getPhysicalGroups(dim) if dim >= 0 else ():
        for entity in model.getEntitiesForPhysicalGroup(dim, group):
            for kind, tags, node_tags in zip(*model.mesh.getElements(dim, entity)):
                if kind != _SIMPLEX[dim]:
                    found = model.mesh.getElementProperties(kind)[0]
                    raise ValueError(
                        f"the mesh has cells or facets of kind {found!r}: "
                        "only simplex meshes with straight sides are supported"
                    )
                elements.append(tags.astype(np.int64))
                nodes.append(np.reshape(node_tags, (-1, dim + 1)).astype(np.int64))
                groups.append(np.full(len(tags), group, np.int32))
    elements = np.concatenate(elements)
    if len(np.unique(elements)) < len(elements):
        raise ValueError(f"an element of dimension {dim} is in more than one physical group")
    return np.concatenate(nodes), np.concatenate(groups)
