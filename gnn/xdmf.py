"""XDMF files and the HDF5 arrays beside them: reading what the solvers write, and writing time series."""

import contextlib
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np

CELLS = {1: "Polyvertex", 2: "Polyline", 3: "Triangle", 4: "Tetrahedron"}
VERTICES = {name.lower(): k for k, name in CELLS.items()}


class Item(NamedTuple):
    """Where an array is: its shape, "HDF" or "XML", and "file.h5:/key" or the numbers themselves."""

    shape: tuple
    form: str
    text: str


class Attribute(NamedTuple):
    """A field: "Node" or "Cell", XDMF's kind ("Scalar", "Vector", ...) and its array."""

    centre: str
    kind: str
    item: Item


@dataclass
class Grid:
    """A mesh with fields: vertices (nc, k) of cells and points (n, d) as items, attributes by name."""

    time: float | None
    cells: Item
    points: Item
    attributes: dict


def read_items(path, items):
    """Iterate over the arrays of some items of the XDMF file `path`; each HDF5 file is opened once.

    Raises
    ------
    ValueError
        If an HDF5 file or dataset is missing, or has another shape than the XDMF file says.
    """
    with contextlib.ExitStack() as stack:
        files = {}
        for item in items:
            if item.form == "HDF":
                name, key = item.text.rsplit(":", 1)
                if name not in files:
                    files[name] = stack.enter_context(_open(path, name))
                yield _dataset(path, files[name], key, item)
            else:
                yield _inline(path, item)


def _open(path, name):
    file = Path(path).parent / name
    if not file.is_file():
        raise ValueError(f"{path}: its arrays are missing, there is no file {file}")
    try:
        return h5py.File(file, "r", locking=False)  # it may be read while a run goes on
    except OSError as error:
        raise ValueError(f"{file} cannot be read: {error}") from error


def _dataset(path, h5, key, item):
    try:
        a = h5[key][()]
    except (KeyError, OSError) as error:
        raise ValueError(f"{path}: cannot read {item.text}: {error}") from error
    if a.size != np.prod(item.shape):
        raise ValueError(f"{path}: {item.text} has shape {a.shape}, not {item.shape}")
    return a.reshape(item.shape)


def _inline(path, item):
    try:
        return np.array(item.text.split(), np.float64).reshape(item.shape)
    except ValueError as error:
        raise ValueError(f"{path}: numbers of shape {item.shape} expected: {error}") from error


class XdmfFile:
    """The light data of an XDMF file; `read_items` reads the arrays.

    Attributes
    ----------
    path : Path
    grids : list of Grid, those outside of time series; the mesh first, then tags on its parts
    frames : list of Grid, the time series; several (DOLFINx writes one a function) are joined

    Raises
    ------
    FileNotFoundError
    ValueError
        If the file is not XDMF, or has parts that are not understood.
    """

    def __init__(self, path):
        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"no such file: {path}")
        try:
            self._root = ET.parse(self.path).getroot()
        except (ET.ParseError, ValueError) as error:
            raise ValueError(f"{path} is not an XDMF file: {error}") from error
        collections = self._root.findall("Domain/Grid[@CollectionType='Temporal']")
        self.frames = self._join([[self._grid(g) for g in c.findall("Grid")] for c in collections])
        others = self._root.findall("Domain/Grid")
        self.grids = [self._grid(g) for g in others if g.get("GridType", "Uniform") == "Uniform"]
        if not self.grids + self.frames:
            raise ValueError(f"{path} holds no mesh")

    @property
    def mesh(self):
        """The Grid whose cells and points are the mesh."""
        return (self.grids or self.frames)[0]

    def _grid(self, grid):
        name = f"{self.path}: grid {grid.get('Name', '')!r}"
        topology, geometry = self._part(grid, "Topology"), self._part(grid, "Geometry")
        if topology is None or geometry is None:
            raise ValueError(f"{name} has no cells or points")
        kind = topology.get("TopologyType", topology.get("Type", "")).lower()
        if kind not in VERTICES:
            raise ValueError(f"{name} has {kind} cells, only simplices of one kind can be read")
        cells, points = self._item(topology), self._item(geometry)
        if len(cells.shape) != 2 or cells.shape[1] != VERTICES[kind]:
            raise ValueError(f"{name} has {kind} cells of shape {cells.shape}, not (nc, {VERTICES[kind]})")
        if len(points.shape) != 2:
            raise ValueError(f"{name} has points of shape {points.shape}, not (n, d)")
        time = grid.find("Time")
        attributes = {}
        for a in grid.findall("Attribute"):
            kind = a.get("AttributeType", a.get("Type", "Scalar"))
            attributes[a.get("Name")] = Attribute(a.get("Center", "Node"), kind, self._item(a))
        return Grid(None if time is None else float(time.get("Value", "nan")), cells, points, attributes)

    def _part(self, grid, name):
        """The Topology or Geometry of a grid, its own or one it includes from another grid."""
        if grid.find(name) is not None:
            return grid.find(name)
        for include in (e for e in grid if e.tag.endswith("}include")):
            parts = re.fullmatch(r"xpointer\((.*)/(\w+|\*\[.*\])\)", include.get("xpointer", "").strip())
            if parts and name in parts[2]:
                # ElementTree has no absolute paths.
                place = parts[1].replace("//", ".//", 1).replace("/Xdmf/", "", 1)
                try:
                    other = self._root.find(place)
                except SyntaxError as error:
                    raise ValueError(f"{self.path}: cannot follow {parts[0]}: {error}") from error
                return None if other is None else other.find(name)
        return None

    def _item(self, parent):
        item = parent.find("DataItem")
        if item is None or item.get("Dimensions") is None:
            raise ValueError(f"{self.path}: a {parent.tag} without a DataItem of known Dimensions")
        form, text = item.get("Format", "XML").upper(), (item.text or "").strip()
        if form not in ("HDF", "XML") or (form == "HDF" and ":" not in text):
            form = f"{item.get('Format')} ({text[:40]})"
            raise ValueError(f"{self.path}: data as {form} cannot be read, write them as HDF or XML")
        return Item(tuple(map(int, item.get("Dimensions").split())), form, text)

    def _join(self, series):
        """One time series of several that have the same times."""
        series = [frames for frames in series if frames]
        for frames in series[1:]:
            if [f.time for f in frames] != [f.time for f in series[0]]:
                names = [", ".join(s[0].attributes) for s in (series[0], frames)]
                raise ValueError(f"{self.path}: the series of {names[0]} and {names[1]} have different times")
            for frame, more in zip(series[0], frames):
                frame.attributes.update(more.attributes)
        return series[0] if series else []


class SeriesWriter:
    """Time series on one mesh, written frame by frame; the XDMF file is made when it is closed.

    Parameters
    ----------
    path : path ending in ``.xdmf``
        Arrays go to the same name ending in ``.h5``; missing folders are made, old files replaced.
    points : (n, d) array
    cells : (nc, k) integer array, k = 2, 3 or 4
    static : dict of name to (n,) or (n, c) array, stored once and named in every frame
    """

    def __init__(self, path, points, cells, static=None):
        self.path = Path(path)
        if self.path.suffix != ".xdmf":
            raise ValueError(f"{path}: the file name must end in .xdmf")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._n, self._d = points.shape
        self._h5 = h5py.File(self.path.with_suffix(".h5"), "w", locking=False)
        self._root = ET.Element("Xdmf", Version="3.0")
        self._series = ET.SubElement(
            ET.SubElement(self._root, "Domain"),
            "Grid",
            Name="series",
            GridType="Collection",
            CollectionType="Temporal",
        )
        self._topology = ET.Element(
            "Topology",
            TopologyType=CELLS[cells.shape[1]],
            NumberOfElements=str(len(cells)),
            NodesPerElement=str(cells.shape[1]),
        )
        self._item(self._topology, "cells", cells)
        self._geometry = ET.Element("Geometry", GeometryType="XYZ")
        self._item(self._geometry, "points", _padded(points))
        self._static = [self._attribute(f"static/{name}", name, a) for name, a in (static or {}).items()]

    def __enter__(self):
        return self

    def __exit__(self, kind, *exc):
        if kind is None:
            self.close()
        else:  # without its .xdmf nobody takes the part that is there for the whole
            self._h5.close()

    def write(self, time, fields):
        """Add the frame at a time: a dict of name to (n,) or (n, c) array.

        Raises
        ------
        ValueError
            If a name or shape does not fit.
        """
        k = len(self._series)
        attributes = [self._attribute(f"{k}/{name}", name, a) for name, a in fields.items()]
        grid = ET.SubElement(self._series, "Grid", Name="mesh", GridType="Uniform")
        ET.SubElement(grid, "Time", Value=repr(float(time)))
        grid.extend([self._topology, self._geometry, *self._static, *attributes])

    def close(self):
        """Write the XDMF file and close the other."""
        self._h5.close()
        ET.ElementTree(self._root).write(self.path, encoding="utf-8", xml_declaration=True)

    def _attribute(self, key, name, a):
        a = np.asarray(a)
        if "/" in name or ":" in name:
            raise ValueError(f"{self.path}: a field name must not contain '/' or ':', as {name!r} does")
        if a.ndim not in (1, 2) or len(a) != self._n:
            raise ValueError(f"{self.path}: {name} has shape {a.shape}, not ({self._n},) or ({self._n}, c)")
        kind = "Scalar" if a.ndim == 1 else "Vector" if a.shape[1] == self._d else "Matrix"
        attribute = ET.Element("Attribute", Name=name, Center="Node", AttributeType=kind)
        self._item(attribute, key, _padded(a) if kind == "Vector" else a)
        return attribute

    def _item(self, parent, key, a):
        self._h5[key] = a
        item = ET.SubElement(parent, "DataItem", Format="HDF", Dimensions=" ".join(map(str, a.shape)))
        item.set("NumberType", "Float" if a.dtype.kind == "f" else "Int")
        item.set("Precision", str(a.dtype.itemsize))
        item.text = f"{self.path.stem}.h5:/{key}"


def _padded(vectors):
    """Vectors (n, d) with zeros for the directions that are not there: viewers want three."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
