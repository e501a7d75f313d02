"""The benchmarks run, at sizes where their numbers mean little."""

import pytest
from benchmarks.run_benchmarks import table
from benchmarks.throughput import STAGES, throughput
from benchmarks.vibrating_bar import error_against_time


@pytest.mark.parametrize("dim, h", [(1, 0.05), (2, 0.2), (3, 0.4)])
def test_throughput(dim, h):
    variants = [("flip", "plain", "cells"), ("apic", "consistent", "random")]
    rows = throughput(dim, h, repetitions=1, variants=variants)
    assert [(r["transfer"], r["gradient"], r["order"]) for r in rows] == variants
    for row in rows:
        assert row["particles"] == {1: 4, 2: 4, 3: 8}[dim] * row["cells"]
        assert row["M/cpu_s"] > 0 and row["M/wall_s"] > 0
        assert row["ring_max"] >= row["ring"] > dim + 1
        # The stages are the whole step but for two additions; timing them costs some microseconds.
        stages = 1e-3 * sum(row[f"{stage}_ns"] for stage in STAGES.values())
        assert 0.5 < stages * row["M/cpu_s"] <= 1
        # x, v, m, V0, F, tau and 9 bytes for cell, place in the order and status; 8 d^2 more for APIC's B.
        assert row["B/particle"] == 16 * dim + 16 + 16 * dim**2 + 9 + 8 * dim**2 * (row["transfer"] == "apic")
        assert row["B/cell"] > 0 and row["peak_MB"] > 0
    assert len(table(rows).splitlines()) == 3


def test_error_against_time_decreases():
    """A second-order method divides the error by four as h is halved; 2.5 leaves room for coarse meshes."""
    rows = error_against_time({"graded": (2.0, 1.0), "jittered": (2.0, 1.0)})
    for mesh in ("graded", "jittered"):
        coarse, fine = (r for r in rows if (r["mesh"], r["gradient"]) == (mesh, "consistent"))
        assert fine["error_%"] < coarse["error_%"] / 2.5
        assert fine["steps_s"] > 0 and fine["setup_s"] > 0
        plain = next(r for r in rows if (r["mesh"], r["gradient"], r["h"]) == (mesh, "plain", 1.0))
        assert plain["error_%"] > fine["error_%"]
