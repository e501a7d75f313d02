"""Files of a run, XDMF time series and CSV logs, and a progress line."""

import shutil
import sys
import time
import warnings
import xml.etree.ElementTree as ET
from pathlib import Path

import h5py
import numpy as np


class _Closing:
    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()


def _pad(array, shape):
    """Copy ``array`` into the leading corner of zeros of the given trailing ``shape``."""
    out = np.zeros(array.shape[:1] + shape, array.dtype)
    out[tuple(slice(k) for k in array.shape)] = array
    return out


def _numbers(name, a):
    """Array with one of the number types that all XDMF readers know."""
    a = np.asarray(a)
    if a.dtype.kind not in "fiub":
        raise ValueError(f"{name}: {a.dtype} is neither a real nor an integer type")
    floating = a.dtype.kind == "f"
    narrow, wide = (np.float32, np.float64) if floating else (np.int32, np.int64)
    return a.astype(narrow if a.dtype == narrow else wide, copy=False)


def _attribute(name, a, n, d):
    """XDMF kind and padded array of a field of ``n`` scalars, vectors or tensors."""
    a = _numbers(name, a)
    if "/" in name or ":" in name:
        raise ValueError(f"{name}: a field name must not contain '/' or ':'")
    if a.shape == (n,):
        return "Scalar", a
    if a.shape in ((n, d), (n, 3)):
        return "Vector", _pad(a, (3,))
    if a.shape in ((n, d, d), (n, 3, 3)):
        return "Tensor", _pad(a, (3, 3)).reshape(n, 9)
    raise ValueError(f"{name}: shape {a.shape} is none of ({n},), ({n}, {d}), ({n}, {d}, {d})")


def _fields(centre, folder, arrays, n, d):
    """(centre, folder, name, kind, padded array) of each of a dict of fields."""
    return [(centre, folder, name, *_attribute(name, a, n, d)) for name, a in arrays.items()]


def _points(x):
    x = _numbers("positions", x)
    if x.ndim != 2 or x.shape[1] not in (1, 2, 3):
        raise ValueError(f"positions have shape {x.shape}, not (n, d) with d = 1, 2 or 3")
    return x


def _start_anew(path, error):
    """Warn that a file cannot be continued; one that is not there needs no warning."""
    if not isinstance(error, FileNotFoundError):
        warnings.warn(f"{path} cannot be continued ({error}) and is started anew", stacklevel=4)


class _Series(_Closing):
    """Temporal collection: light data in ``path`` (.xdmf), arrays next to it (.h5)."""

    # No lock, and no superblock that marks the file as open: a viewer may read during the run,
    # and what was flushed stays readable after the run is killed.
    _HDF5 = {"locking": False, "libver": ("earliest", "v108")}
    _HEAD = (
        b'<?xml version="1.0" encoding="utf-8"?>\n<Xdmf Version="3.0"><Domain>\n'
        b'<Grid Name="series" GridType="Collection" CollectionType="Temporal">\n'
    )
    _TAIL = b"</Grid>\n</Domain></Xdmf>\n"

    def __init__(self, path, keep_before=-np.inf):
        self.path = Path(path)
        if self.path.suffix != ".xdmf":
            raise ValueError(f"{path}: the file name must end in .xdmf")
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.times = []
        if keep_before == -np.inf or not self._resume(keep_before):
            self.path.unlink(missing_ok=True)
            self._h5 = h5py.File(self.path.with_suffix(".h5"), "w", **self._HDF5)

    def close(self):
        """Close the HDF5 file; the files on disk are complete after every `write` already."""
        self._h5.close()

    def _resume(self, before):
        """Take up the frames before a time, drop later ones; False where the files do not allow it."""
        h5 = None
        try:
            text = self.path.read_bytes()
            if not (text.startswith(self._HEAD) and text.endswith(self._TAIL)):
                raise ValueError("not written by fempm, or not completely")
            lines = text[len(self._HEAD) : -len(self._TAIL)].splitlines(keepends=True)
            grids = [ET.fromstring(line) for line in lines]
            times = [float(grid.find("Time").get("Value")) for grid in grids]
            kept = int(np.searchsorted(times, before))
            h5 = h5py.File(self.path.with_suffix(".h5"), "r+", **self._HDF5)
            for item in (item for grid in grids[:kept] for item in grid.iter("DataItem")):
                h5[item.text.split(":/")[1]].shape  # noqa: B018, a KeyError where it is missing
            for key in [key for key in h5 if key.isdigit() and int(key) >= kept]:
                del h5[key]
        except (OSError, ValueError, KeyError, ET.ParseError) as error:
            if h5 is not None:
                h5.close()
            _start_anew(self.path, error)
            return False
        self._h5, self.times = h5, times[:kept]
        self._end = len(self._HEAD) + sum(map(len, lines[:kept]))
        if kept:
            with open(self.path, "r+b") as f:
                f.seek(self._end)
                f.write(self._TAIL)
                f.truncate()
        else:
            self.path.unlink()
        return True

    def _item(self, parent, key, a):
        if key not in self._h5:
            self._h5[key] = a
        item = ET.SubElement(parent, "DataItem", Format="HDF")
        item.set("Dimensions", " ".join(map(str, a.shape)))
        item.set("NumberType", "Float" if a.dtype.kind == "f" else "Int")
        item.set("Precision", str(a.dtype.itemsize))
        item.text = f"{self.path.stem}.h5:/{key}"

    def _write(self, t, points, cells, fields):
        """Add a frame; points and cells are (key, array), fields (centre, folder, name, kind, array)."""
        grid = ET.Element("Grid", Name=self.path.stem, GridType="Uniform")
        ET.SubElement(grid, "Time", Value=repr(float(t)))
        m = cells[1].shape[1]
        topology = ET.SubElement(grid, "Topology", NodesPerElement=str(m))
        topology.set("TopologyType", ("Polyvertex", "Polyline", "Triangle", "Tetrahedron")[m - 1])
        topology.set("NumberOfElements", str(len(cells[1])))
        self._item(topology, *cells)
        self._item(ET.SubElement(grid, "Geometry", GeometryType="XYZ"), *points)
        for centre, folder, name, kind, a in fields:
            attribute = ET.SubElement(grid, "Attribute", Name=name, Center=centre)
            attribute.set("AttributeType", kind)
            self._item(attribute, f"{folder}/{name}", a)
        self._h5.flush()
        frame = ET.tostring(grid, encoding="utf-8") + b"\n"
        text = frame + self._TAIL if self.times else self._HEAD + frame + self._TAIL
        # One write over the closing tags, so that the file is complete before and after it.
        with open(self.path, "r+b" if self.times else "wb", buffering=len(text) + 1) as f:
            f.seek(self._end if self.times else 0)
            f.write(text)
            self._end = f.tell() - len(self._TAIL)
        self.times.append(float(t))


class ParticleFile(_Series):
    """Time series of particles for ParaView: XDMF with the arrays in HDF5.

    The files are complete after every `write`, also while the run goes on or after it was killed.
    Everything is stored in 3D, padded with zeros. In meshio, positions belong to a step::

        with meshio.xdmf.TimeSeriesReader("p.xdmf") as r:
            for k in range(r.num_steps):
                r.mesh_grid = r.collection[k]
                points, _ = r.read_points_cells()
                t, fields, _ = r.read_data(k)

    Parameters
    ----------
    path : path ending in ``.xdmf``
        The arrays go to the same name ending in ``.h5``; missing folders are made, old files replaced.
    keep_before : float, optional
        Go on with old files after their frames before this time, and drop the later ones; files that
        cannot be read are replaced with a warning.

    Attributes
    ----------
    times : list of float
        Times of the frames in the file.

    Raises
    ------
    ValueError
        If ``path`` does not end in ``.xdmf``.
    """

    def write(self, t, x, /, **fields):
        """Add the particles at time ``t``; their number may differ from frame to frame.

        Parameters
        ----------
        t : float
            Time in s.
        x : (n, d) array
            Positions in m, d = 1, 2 or 3.
        **fields : (n,), (n, d) or (n, d, d) array
            Scalars, vectors and tensors (9 components, row by row), real or integer, in any unit; vectors
            and tensors may also have 3 components a direction when d < 3.

        Raises
        ------
        ValueError
            If a shape, number type or field name does not fit; nothing is written then.
        """
        x = _points(x)
        k, n = len(self.times), len(x)
        fields = _fields("Node", f"{k}/Node", fields, *x.shape)
        cells = np.arange(n, dtype=np.int64)[:, None]
        self._write(t, (f"{k}/points", _pad(x, (3,))), (f"cells/{n}", cells), fields)


class MeshFile(_Series):
    """Time series of fields on a simplex mesh for ParaView: XDMF with the arrays in HDF5.

    The mesh is stored once; the files are complete after every `write`, as in `ParticleFile`.
    ``meshio.xdmf.TimeSeriesReader`` reads it (`read_points_cells`, then `read_data`).

    Parameters
    ----------
    path : as in `ParticleFile`
    points : (nv, d) array
        Vertex positions in m, d = 1, 2 or 3.
    cells : (nc, d + 1) integer array
        Vertices of the intervals, triangles or tetrahedra.
    keep_before : float, optional
        As in `ParticleFile`; the mesh and the static fields stay those of the old files.
    static : dict of name to (nv,), (nv, d) or (nv, d, d) array, optional
        Fields on vertices that do not change: stored once, part of every frame.

    Raises
    ------
    ValueError
        If ``path`` does not end in ``.xdmf``, or a shape, number type or name does not fit.
    """

    def __init__(self, path, points, cells, keep_before=-np.inf, static=None):
        points, cells = _points(points), _numbers("cells", cells)
        self._nv, self._d = points.shape
        self._mesh = ("points", _pad(points, (3,))), ("cells", cells)
        if cells.ndim != 2 or cells.shape[1] != self._d + 1 or cells.dtype.kind != "i":
            raise ValueError(f"cells: {cells.dtype} {cells.shape}, not integer (nc, {self._d + 1})")
        self._static = _fields("Node", "static", static or {}, self._nv, self._d)
        super().__init__(path, keep_before)

    def write(self, t, /, *, cell_fields=None, **vertex_fields):
        """Add the fields at time ``t``.

        Parameters
        ----------
        t : float
            Time in s.
        cell_fields : dict of name to (nc,) array, optional
            Scalars on cells.
        **vertex_fields : (nv,), (nv, d) or (nv, d, d) array
            Fields on vertices, as in `ParticleFile.write`.

        Raises
        ------
        ValueError
            If a shape, number type or field name does not fit; nothing is written then.
        """
        k, d = len(self.times), self._d
        for name in {field[2] for field in self._static} & set(vertex_fields):
            raise ValueError(f"{name}: this field is static and cannot be written in a frame")
        fields = _fields("Node", f"{k}/Node", vertex_fields, self._nv, d)
        fields += _fields("Cell", f"{k}/Cell", cell_fields or {}, len(self._mesh[1][1]), d)
        self._write(t, *self._mesh, self._static + fields)


class TimeLog(_Closing):
    """CSV table with one row per step that is logged; `numpy.genfromtxt` reads it exactly.

    Parameters
    ----------
    path : path
        Missing folders are made, an old file is replaced.
    keep_before : int, optional
        Go on with an old file after its rows before this step, drop the later ones; a file that cannot be
        read is replaced with a warning.

    Attributes
    ----------
    columns : dict of name to list
        The rows of an old file that were kept, without the steps.
    """

    def __init__(self, path, keep_before=None):
        self._path = Path(path)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._names, self.columns = None, {}
        if keep_before is None or not self._resume(keep_before):
            self._file = open(path, "w", encoding="utf-8")

    def _resume(self, before):
        """Take up the rows before a step, drop later ones; False where the file does not allow it."""
        try:
            lines = self._path.read_bytes().splitlines(keepends=True)
            head, *rows = (line.decode().strip().split(",") for line in lines)
            kept = int(np.searchsorted([int(row[0]) for row in rows], before))
            if head[0] != "step" or any(len(row) != len(head) for row in rows[:kept]):
                raise ValueError("not written by fempm")
            columns = zip(*([float(x) for x in row[1:]] for row in rows[:kept]))
            self.columns = dict(zip(head[1:], map(list, columns)))
        except (OSError, ValueError) as error:
            _start_anew(self._path, error)
            return False
        if not kept:
            return False
        self._names = head[1:]
        self._file = open(self._path, "a", encoding="utf-8")
        self._file.truncate(sum(map(len, lines[: 1 + kept])))
        return True

    def write(self, step, /, **columns):
        """Add a row and flush it; the first row sets the columns, ``step`` and then in order.

        Raises
        ------
        ValueError
            If the columns are not those of the first row.
        """
        if self._names is None:
            self._names = list(columns)
            print("step", *self._names, sep=",", file=self._file)
        if set(columns) != set(self._names):
            raise ValueError(f"columns {list(columns)} are not {self._names}")
        row = (np.asarray(columns[name]).item() for name in self._names)
        print(int(step), *map(repr, row), sep=",", file=self._file, flush=True)

    def close(self):
        """Close the file."""
        self._file.close()


class Progress(_Closing):
    """One-line progress bar; about ten lines in all where ``stream`` is not a terminal.

    Parameters
    ----------
    total : float
        Value at the end, usually the simulated time.
    unit : str
        Unit of ``total``.
    stream : text stream, optional
        Standard error unless given.
    done : float
        Value at the start, which took none of the time.
    """

    def __init__(self, total, unit="s", stream=None, done=0.0):
        self._done = done / total if total else 0.0
        self._total, self._unit, self._stream = total, unit, stream or sys.stderr
        self._tty = self._stream.isatty()
        self._start = time.monotonic()
        self._next = 0.0
        self._line = self._shown = ""

    def update(self, value, note=""):
        """Show that ``value`` of the total is reached; cheap enough to call in every step."""
        now = time.monotonic() - self._start
        part = min(value / self._total, 1.0) if self._total else 1.0
        left = _clock(now * (1 - part) / (part - self._done)) if part > self._done else "?"
        bar = "#" * int(24 * part)
        self._line = (
            f"[{bar:<24}] {100 * part:5.1f}%  {value:.4g}/{self._total:.4g} {self._unit}"
            f"  {_clock(now)} elapsed, {left} left  {note}".rstrip()
        )
        reached = now if self._tty else part
        if reached >= self._next:
            self._next = now + 0.1 if self._tty else (np.floor(10 * part + 1e-9) + 1) / 10
            self._show()

    def close(self):
        """Show the last update and end the line."""
        self._show()
        if self._tty and self._line:
            print(file=self._stream, flush=True)

    def _show(self):
        if self._line == self._shown:
            return
        self._shown = self._line
        if self._tty:
            width = shutil.get_terminal_size().columns - 1
            print(f"\r{self._line[:width]}\x1b[K", end="", file=self._stream, flush=True)
        else:
            print(self._line, file=self._stream, flush=True)


def _clock(seconds):
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"
