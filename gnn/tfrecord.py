"""DeepMind's MeshGraphNets data sets (Pfaff et al. 2021): TFRecord files read without TensorFlow."""

import json
from pathlib import Path

import numpy as np

from .graph import from_cells
from .trajectory import write_trajectory

NAMES = {"world_pos": "position"}  # their names of fields that have another one here


def read_tfrecord(path, meta):
    """Iterate over the trajectories of a file.

    Parameters
    ----------
    path : .tfrecord file, records of tf.train.Example
    meta : the meta.json beside it, which says the type and shape of the features

    Yields
    ------
    dict of name to array (nt, n, c), (1, n, c) where static, as float32 or int32

    Raises
    ------
    FileNotFoundError
    ValueError
        If a record is cut off, is no Example, or does not fit what meta says.
    """
    features = read_meta(meta)["features"]
    for number, record in enumerate(_records(path)):
        try:
            stored = _example(record)
            arrays = {name: _array(name, stored, feature) for name, feature in features.items()}
        except ValueError as error:
            raise ValueError(f"{path}, record {number}: {error}") from error
        yield arrays


def convert_tfrecord(path, meta, folder):
    """Write each trajectory of a file as XDMF, see `write_trajectory`.

    ``mesh_pos`` becomes the mesh and ``world_pos`` the field ``position``; frames are ``dt`` of meta apart,
    1 where it does not say.

    Parameters
    ----------
    path, meta : as in `read_tfrecord`
    folder : made where it is missing; files are named by the record, as in train_00000.xdmf

    Returns
    -------
    list of Path

    Raises
    ------
    FileNotFoundError
    ValueError
        As `read_tfrecord`, and for records without mesh or with one that changes.
    """
    about, paths = read_meta(meta), []
    dt, frames = about.get("dt") or 1.0, about["trajectory_length"]
    for number, arrays in enumerate(read_tfrecord(path, meta)):
        place = f"{path}, record {number}"
        mesh = [_constant(place, arrays, name) for name in ("mesh_pos", "cells", "node_type")]
        try:
            graph = from_cells(*mesh[:2], mesh[2][:, 0])
        except ValueError as error:
            raise ValueError(f"{place}: {error}") from error
        fields = {NAMES.get(name, name): a for name, a in arrays.items() if len(a) == frames}
        static = {NAMES.get(name, name): a[0] for name, a in arrays.items() if len(a) == 1 != frames}
        paths.append(Path(folder) / f"{Path(path).stem}_{number:05}.xdmf")
        write_trajectory(paths[-1], graph, dt * np.arange(frames), fields, static)
    return paths


def read_meta(path):
    """The dict in a meta.json; ValueError where it lacks something, or of types that cannot be read."""
    try:
        meta = json.loads(Path(path).read_text(encoding="utf-8"))
        frames = {"static": 1, "dynamic": meta["trajectory_length"]}
        features = {n: (f["type"], f["dtype"], f["shape"][0]) for n, f in meta["features"].items()}
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(f"{path} does not describe a data set: {error!r}") from error
    for name, (kind, dtype, count) in features.items():
        if kind not in frames or dtype not in ("float32", "int32"):
            raise ValueError(
                f"{path}: feature {name} is {kind} {dtype}, only static and dynamic float32 and int32 "
                "can be read (sets with remeshing have others)"
            )
        if count != frames[kind]:
            raise ValueError(f"{path}: {kind} feature {name} has {count} frames, not {frames[kind]}")
    return meta


def _constant(place, arrays, name):
    """Take out an array that is the same in all frames."""
    if name not in arrays:
        raise ValueError(f"{place} has no {name}")
    a = arrays.pop(name)
    if (a != a[0]).any():
        raise ValueError(f"{place}: {name} changes in time, trajectories have one mesh")
    return a[0]


def _array(name, stored, feature):
    if name not in stored:
        raise ValueError(f"no feature {name}, there are {sorted(stored)}")
    a = np.frombuffer(stored[name], np.dtype(feature["dtype"]).newbyteorder("<"))
    try:
        return a.reshape(feature["shape"])
    except ValueError:
        raise ValueError(f"{name} has {a.size} numbers, not the shape {feature['shape']}") from None


def _records(path):
    """Iterate over the payloads: length (8 bytes), its checksum (4), payload, its checksum (4)."""
    with open(path, "rb") as file:
        while head := file.read(12):
            length = int.from_bytes(head[:8], "little")
            rest = Path(path).stat().st_size - file.tell()
            if len(head) < 12 or rest < length + 4:
                raise ValueError(f"{path} ends within a record: it is cut off, or no TFRecord file")
            yield memoryview(file.read(length + 4))[:length]


def _example(record):
    """{name: bytes} of a tf.train.Example: Features are field 1, in it a map of name (1) to Feature (2)."""
    out = {}
    for features in _fields(record, 1):
        for entry in _fields(features, 1):
            name, feature = b"".join(_fields(entry, 1)).decode(), next(_fields(entry, 2), b"")
            # A feature that is a list of bytes (1) holds arrays as they lie in memory.
            out[name] = b"".join(value for values in _fields(feature, 1) for value in _fields(values, 1))
    return out


def _fields(message, wanted):
    """Iterate over the values of one length-delimited field of a protobuf message."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        # The other wire types are a varint (0) and 8 (1) or 4 bytes (5).
        if key & 7 == 0:
            length, at = 0, _varint(message, at)[1]
        elif key & 7 == 2:
            length, at = _varint(message, at)
        elif key & 7 in (1, 5):
            length = 8 if key & 7 == 1 else 4
        else:
            raise ValueError("it is no tf.train.Example")
        if at + length > len(message):
            raise ValueError("it is no tf.train.Example, or cut off")
        if key >> 3 == wanted and key & 7 == 2:
            yield message[at : at + length]
        at += length


def _varint(message, at):
    """Number stored 7 bits a byte, the last one without the high bit, and where it ends."""
    value = shift = 0
    while at < len(message):
        value |= (message[at] & 127) << shift
        at, shift = at + 1, shift + 7
        if message[at - 1] < 128:
            return value, at
    raise ValueError("it is no tf.train.Example, or cut off")
