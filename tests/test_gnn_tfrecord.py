"""Published sets: TFRecord files that a writer of our own makes from the descriptions of the two formats."""

import json
import struct

import numpy as np
import pytest
from gnn_fields import box, random_fields

from gnn.tfrecord import convert_tfrecord, read_tfrecord
from gnn.trajectory import Trajectory


def varint(value):
    out = b""
    while value > 127:
        out, value = out + bytes([value % 128 + 128]), value // 128
    return out + bytes([value])


def message(number, payload):
    return varint(8 * number + 2) + varint(len(payload)) + payload


def example(arrays):
    """tf.train.Example of arrays as they lie in memory, beside lists of floats and of integers."""
    entries = {name: message(1, message(1, np.ascontiguousarray(a).tobytes())) for name, a in arrays.items()}
    entries["ratio"] = message(2, message(1, struct.pack("<2f", 0.5, 1.5)))
    entries["count"] = message(3, varint(8) + varint(300))
    return message(
        1, b"".join(message(1, message(1, k.encode()) + message(2, v)) for k, v in entries.items())
    )


def record(payload):
    return struct.pack("<QI", len(payload), 12345) + payload + struct.pack("<I", 54321)


def tfrecord_set(folder, d=2, nt=3):
    """Two trajectories on meshes of different size, as in DeepMind's sets; path, meta and arrays."""
    meta = {"simulator": "here", "dt": 0.01, "trajectory_length": nt, "features": {}}
    sets = []
    for seed in range(2):
        points, cells = box(d)
        if seed:
            cells = cells[: len(cells) // 2]
            kept = np.unique(cells)
            points, cells = points[kept], np.searchsorted(kept, cells)
        fields, n = random_fields(len(points), d, nt, seed), len(points)
        sets.append(
            {
                "cells": cells[None].astype(np.int32),
                "mesh_pos": points[None].astype(np.float32),
                "node_type": (np.arange(n) % 7)[None, :, None].astype(np.int32),
                "velocity": fields["v"].astype(np.float32),
                "pressure": fields["p"][:, :, None].astype(np.float32),
                "world_pos": (points + 0.1 * fields["v"]).astype(np.float32),
                "thickness": np.full((1, n, 1), 2 + seed, np.float32),
            }
        )
    for name, a in sets[0].items():
        kind = "dynamic" if len(a) == nt else "static"
        shape = [len(a), -1, a.shape[2]]
        meta["features"][name] = {"type": kind, "shape": shape, "dtype": str(a.dtype)}
    meta["field_names"] = list(meta["features"])
    (folder / "meta.json").write_text(json.dumps(meta))
    (folder / "train.tfrecord").write_bytes(b"".join(record(example(arrays)) for arrays in sets))
    return folder / "train.tfrecord", folder / "meta.json", sets


@pytest.mark.parametrize("d", [2, 3])
def test_tfrecords(tmp_path, d):
    path, meta, sets = tfrecord_set(tmp_path, d)
    found = list(read_tfrecord(path, meta))
    assert len(found) == 2
    for arrays, written in zip(found, sets):
        assert arrays.keys() == written.keys()
        for name, a in written.items():
            assert arrays[name].dtype == a.dtype and np.array_equal(arrays[name], a)
    paths = convert_tfrecord(path, meta, tmp_path / "out")
    assert [p.name for p in paths] == ["train_00000.xdmf", "train_00001.xdmf"]
    for file, written in zip(paths, sets):
        run = Trajectory(file)
        assert np.array_equal(run.graph.points, written["mesh_pos"][0])
        assert np.array_equal(run.graph.cells, written["cells"][0])
        assert np.array_equal(run.graph.node_type, written["node_type"][0, :, 0])
        assert run.fields == {"velocity": d, "pressure": 1, "position": d, "thickness": 1}
        assert run.static == {"thickness"} and np.allclose(run.times, [0, 0.01, 0.02], rtol=1e-15)
        assert np.array_equal(run.read_many("velocity", 0, 3), written["velocity"])
        assert np.array_equal(run.read_many("position", 0, 3), written["world_pos"])
        assert np.array_equal(run.read_many("pressure", 0, 3), written["pressure"][:, :, 0])
        assert np.array_equal(run.read("thickness", 1), written["thickness"][0, :, 0])


def test_bad_tfrecords_are_named(tmp_path):
    path, meta, sets = tfrecord_set(tmp_path)
    whole, about = path.read_bytes(), json.loads(meta.read_text())

    def fails(content, message, about=about, read=lambda: list(read_tfrecord(path, meta))):
        path.write_bytes(content)
        meta.write_text(json.dumps(about))
        with pytest.raises(ValueError, match=message):
            read()

    fails(whole[:-1], "train.tfrecord ends within a record")
    fails(whole[:5], "train.tfrecord ends within a record")
    fails(b"This is no such file.", "train.tfrecord ends within a record")
    fails(record(b"\x0a\xff\x01"), "record 0: it is no tf.train.Example, or cut off")
    fails(record(b"\x0f"), "record 0: it is no tf.train.Example")
    fails(record(b"\x80"), "record 0: it is no tf.train.Example, or cut off")
    short = {name: a for name, a in sets[0].items() if name != "velocity"}
    fails(whole + record(example(short)), "record 2: no feature velocity, there are .*'cells'")
    short["velocity"] = sets[0]["velocity"].ravel()[1:]
    fails(record(example(short)), r"record 0: velocity has 89 numbers, not the shape \[3, -1, 2\]")
    bad = sets[0] | {"cells": sets[0]["cells"][:, :3]}
    fails(
        record(example(bad)), r"record 0: .*in no cell", read=lambda: convert_tfrecord(path, meta, tmp_path)
    )

    features = about["features"]
    for change, message in (
        (
            {"velocity": features["velocity"] | {"type": "dynamic_varlen"}},
            "velocity is dynamic_varlen float32",
        ),
        ({"velocity": features["velocity"] | {"dtype": "int64"}}, "velocity is dynamic int64"),
        ({"velocity": features["velocity"] | {"shape": [4, -1, 2]}}, "velocity has 4 frames, not 3"),
        ({"velocity": {"type": "dynamic"}}, "meta.json does not describe a data set: KeyError"),
    ):
        fails(whole, message, about | {"features": features | change})
    without = {name: f for name, f in features.items() if name != "mesh_pos"}
    fails(
        whole,
        "record 0 has no mesh_pos",
        about | {"features": without},
        lambda: convert_tfrecord(path, meta, tmp_path),
    )
    with pytest.raises(FileNotFoundError):
        next(read_tfrecord(tmp_path / "no.tfrecord", meta))
