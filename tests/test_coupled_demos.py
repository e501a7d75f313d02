"""Every demo of gas and solids with a short, coarse setting: what is conserved, what moves, and the files.

The bounds of the motion are what each scene gives at this setting, less a third or more; the solids
start at rest, so that the signs alone would fail a scene whose gas does not push. A closed box has no way for
mass to leave: 1e-12 is round-off. Energy is lost on purpose, by the implicit pressure and by APIC: bounds of
a few per cent, and never a gain beyond a thousandth.
"""

import meshio
import numpy as np
import pytest
from test_demos import run_demo

pytestmark = pytest.mark.filterwarnings("ignore:body")  # thinner than two cells, which are coarse here

SCENES = {
    "lifting_cylinder": (),
}


def play(name, tmp_path, *options, frames=2):
    """Results and log of a demo, whose files are complete, and whose gas kept its positivity."""
    until = float(options[options.index("--until") + 1])
    result = run_demo(name, tmp_path, *options, "--every", str(until / frames))
    record = result["record"]
    check_coupled_files(record, frames)
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    log = record.log
    assert log["time"][-1] == pytest.approx(until)
    assert min(log["least_density"].min(), log["least_pressure"].min()) > 0
    assert all(np.isfinite(log[column]).all() for column in ("mass", "energy", "kinetic", "elastic"))
    return result, log


def check_coupled_files(record, frames):
    """Particles, vertex fields and log, readable at every frame and those of the record."""
    particles, mesh, table = record.files
    reader = meshio.xdmf.TimeSeriesReader(particles)
    assert reader.num_steps == frames + 1 == len(record.frames) == len(record.vertex_frames)
    for k in range(frames + 1):
        reader.mesh_grid = reader.collection[k]
        points, _ = reader.read_points_cells()
        x = record.frames[k][1]
        assert len(x) and np.array_equal(points[:, : x.shape[1]], x)
    with meshio.xdmf.TimeSeriesReader(mesh) as series:
        points, _ = series.read_points_cells()
        assert series.num_steps == frames + 1
        for k in range(frames + 1):
            time, fields, _ = series.read_data(k)
            assert time == pytest.approx(record.vertex_frames[k][0], abs=1e-15)
            assert {"density", "velocity", "pressure", "mach", "schlieren", "solid"} <= set(fields)
            assert all(len(f) == len(points) and np.isfinite(f).all() for f in fields.values())
            assert np.array_equal(fields["density"], record.vertex_frames[k][1]["density"])
            assert 0 <= fields["solid"].min() < fields["solid"].max() <= 1
    written = np.genfromtxt(table, names=True, delimiter=",")
    for name in ("time", "mass", "energy", "least_pressure"):
        assert np.allclose(written[name], record.log[name], rtol=1e-12, atol=0)


def check_closed(log, energy):
    """Mass of the gas to round-off; energy may only be lost, up to a share."""
    assert np.ptp(log["mass"]) < 1e-12 * log["mass"][0]
    assert -energy < log["energy"].min() / log["energy"][0] - 1
    assert log["energy"].max() / log["energy"][0] - 1 < 1e-3


def moved(log, name):
    """How far a column of the log is at the end from where it began."""
    return log[name][-1] - log[name][0]
