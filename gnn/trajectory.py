"""Trajectories: the fields of one simulation on the nodes of its mesh, as time series in XDMF files."""

from pathlib import Path

import numpy as np

from .graph import graph_of
from .xdmf import SeriesWriter, XdmfFile, read_items


class Trajectory:
    """One XDMF time series on a mesh that does not change; arrays are read when asked for.

    Bodies that deform have as mesh their material positions, and the field ``position`` says where the
    nodes are.

    Parameters
    ----------
    path : path of a file of fempm's `MeshFile`, DOLFINx, meshio or `write_trajectory`

    Attributes
    ----------
    path : Path
    graph : MeshGraph, with the types of the static field ``node_type`` where there is one
    times : (nt,) float64, in s
    fields : dict of name to number of components of the fields on nodes, without ``node_type``
    static : set of those that are the same array in every frame

    Raises
    ------
    FileNotFoundError
    ValueError
        If there is no time series or its arrays are missing, the mesh changes, or a field is missing in
        a frame or has another number of nodes than the mesh.
    """

    def __init__(self, path):
        self.path = Path(path)
        file = XdmfFile(path)
        frames = file.frames
        self.times = np.array([np.nan if f.time is None else f.time for f in frames])
        if not frames or not (np.isfinite(self.times).all() and (np.diff(self.times) > 0).all()):
            raise ValueError(f"{path}: no time series with increasing times, there is {self.times.tolist()}")
        self._check_mesh(file)
        self.graph = graph_of(file)
        kinds = {name: a.kind.lower() for name, a in frames[0].attributes.items() if a.centre == "Node"}
        self._items = {name: self._field(name, frames) for name in kinds}
        self.static = {name for name, items in self._items.items() if len(set(items)) == 1}
        if "node_type" in kinds and "node_type" not in self.static:
            raise ValueError(f"{path}: node_type changes in time, store it once as a static field")
        self._items.pop("node_type", None)
        self.static.discard("node_type")
        self._vectors = {name for name in self._items if kinds[name] == "vector"}
        d = self.graph.points.shape[1]
        widths = {name: int(np.prod(items[0].shape[1:])) for name, items in self._items.items()}
        self.fields = {name: min(d, c) if name in self._vectors else c for name, c in widths.items()}

    def __len__(self):
        return len(self.times)

    def read(self, name, k):
        """A field in frame k.

        Parameters
        ----------
        name : str
        k : int, 0 <= k < len(self)

        Returns
        -------
        (n,) float32 for scalars, else (n, c): c = d for vectors, all that is stored for others

        Raises
        ------
        KeyError, IndexError
        ValueError
            If a number is not finite, a vector leaves the plane of the mesh, or the arrays are missing.
        """
        return self.read_many(name, k, k + 1)[0]

    def read_many(self, name, k0, k1):
        """(k1 - k0, n) or (k1 - k0, n, c) float32: a field in frames k0 to k1 - 1, see `read`."""
        if name not in self._items:
            raise KeyError(f"{self.path} has no field {name!r} on nodes, there are {sorted(self._items)}")
        if not 0 <= k0 <= k1 <= len(self):
            raise IndexError(f"{self.path} has no frames {k0} to {k1 - 1}, there are {len(self)}")
        n, c = len(self.graph.points), self.fields[name]
        scalar = name not in self._vectors and c == 1
        out = np.empty((k1 - k0, n) if scalar else (k1 - k0, n, c), np.float32)
        for i, a in enumerate(read_items(self.path, self._items[name][k0:k1])):
            a = a.reshape(n, -1)
            if a[:, c:].any():
                raise ValueError(
                    f"{self.path}: vector {name} has a component out of the {c}D mesh in frame {k0 + i}, "
                    "store that component as a scalar of its own"
                )
            out[i] = a[:, 0] if scalar else a[:, :c]
            bad = np.argwhere(~np.isfinite(out[i]))
            if len(bad):
                value, node = out[i][tuple(bad[0])], bad[0, 0]
                raise ValueError(f"{self.path}: field {name} is {value} in frame {k0 + i} at node {node}")
        return out

    def _check_mesh(self, file):
        """The mesh is the same array in all frames, or another one that is equal."""
        for k, frame in enumerate(file.frames):
            for mine, first in (frame.cells, file.mesh.cells), (frame.points, file.mesh.points):
                if mine != first and not np.array_equal(*read_items(self.path, [mine, first])):
                    raise ValueError(
                        f"{self.path}: the mesh of frame {k} is not that of the first; trajectories have one "
                        "mesh, of the undeformed state, and a field 'position' where the nodes move"
                    )

    def _field(self, name, frames):
        """The items of a field in all frames."""
        items = []
        for k, frame in enumerate(frames):
            if name not in frame.attributes:
                raise ValueError(f"{self.path}: field {name} is missing in frame {k}")
            items.append(frame.attributes[name].item)
            if items[k].shape[:1] != (len(self.graph.points),) or items[k].shape[1:] != items[0].shape[1:]:
                raise ValueError(
                    f"{self.path}: field {name} has shape {items[k].shape} in frame {k}, "
                    f"the mesh has {len(self.graph.points)} nodes"
                )
        return items


def write_trajectory(path, graph, times, fields, static=None):
    """Write an XDMF time series, frame by frame, that `Trajectory` and ParaView read.

    Parameters
    ----------
    path : path ending in ``.xdmf``
    graph : MeshGraph; its node types become the static field ``node_type``
    times : (nt,) increasing, in s
    fields : dict of name to (nt, n) or (nt, n, c), stored as float32; one component is read back as a
        scalar where d > 1
    static : dict of name to (n,) or (n, c), stored once

    Raises
    ------
    ValueError
        If a shape or name does not fit, or the times do not increase.
    """
    times, static = np.asarray(times, np.float64), dict(static or {})
    if times.ndim != 1 or not (np.diff(times) > 0).all() or not np.isfinite(times).all():
        raise ValueError(f"{path}: times must increase, not {times}")
    for name, a in fields.items():
        if len(a) != len(times):
            raise ValueError(f"{path}: field {name} has {len(a)} frames, there are {len(times)} times")
    twice = sorted((set(fields) & set(static)) | ({"node_type"} & (set(fields) | set(static))))
    if twice:
        raise ValueError(f"{path}: field {twice[0]} is given twice")
    static = {name: _single(a, graph) for name, a in static.items()}
    static["node_type"] = graph.node_type
    with SeriesWriter(path, graph.points, graph.cells, static) as file:
        for k, t in enumerate(times):
            file.write(t, {name: _single(a[k], graph) for name, a in fields.items()})


def _single(a, graph):
    """float32 array; one column is a scalar, except in 1D, where it is a vector."""
    a = np.asarray(a, np.float32)
    return a[:, 0] if a.ndim == 2 and a.shape[1] == 1 < graph.points.shape[1] else a
