"""Gas: bad input raises at once, lost positivity and solves that do not converge stop with time and place."""

import numpy as np
import pytest
from gas_scenes import AIR, at_rest, even_box, jump, sod_tube, walls
from mesh_factory import rectangle

import coupling.flow
import fempm
from coupling import Flow, IdealGas, Inflow, Outflow, Periodic, SlipWall, SubsonicInflow
from fempm import SimulationError


def flow(boundaries=None, initial=None, mesh=None, **options):
    """Gas in a tube of ten cells."""
    mesh = fempm.interval_mesh(np.linspace(0, 1, 11)) if mesh is None else mesh
    ends = walls(1) if boundaries is None else boundaries
    return Flow(mesh, AIR, initial or at_rest(), ends, **options)


def test_this_is_good_input():
    """What the tests below spoil is fine without it."""
    assert flow().stable_step() > 0
    assert flow([Inflow("left", 1, 1, [2.0]), Outflow("right")]).stable_step() > 0
    assert flow([SubsonicInflow("left", 1, 1, mach=0.5), Outflow("right")]).stable_step() > 0


@pytest.mark.parametrize(
    "initial, message",
    [
        (at_rest(density=-1.0), "density of the gas must be positive, got -1"),
        (at_rest(density=0.0), "density of the gas must be positive, got 0"),
        (at_rest(pressure=-2.0), "pressure of the gas must be positive, got -2"),
        (at_rest(pressure=np.nan), "pressure of the gas must be positive, got nan"),
        (
            lambda x: (np.where(x[:, 0] > 0.55, -0.5, 1), 0, 1),
            "density of the gas must be positive, got -0.5",
        ),
    ],
)
def test_initial_state(initial, message):
    with pytest.raises(ValueError, match=message):
        flow(initial=initial)


@pytest.mark.parametrize("gamma", [1, 0.5, 0, -1.4, float("nan")])
def test_gamma(gamma):
    with pytest.raises(ValueError, match="gamma .*: the ratio of specific heats must exceed 1"):
        IdealGas(gamma)


@pytest.mark.parametrize(
    "options, message",
    [
        ({"pair": "B3-B2"}, "pair 'B3-B2': give 'B1-B0' or 'B2-B1'"),
        ({"scheme": "rk4"}, "scheme 'rk4': give one of 'imex', 'euler'"),
        ({"limiter": "minmod"}, "limiter 'minmod': give one of 'first_order', .*'contact'"),
        ({"cfl": 0}, "cfl 0: it must be positive"),
        ({"cfl": -0.5}, "cfl -0.5: it must be positive"),
        ({"cfl": float("nan")}, "cfl nan: it must be positive"),
    ],
)
def test_options(options, message):
    with pytest.raises(ValueError, match=message):
        flow(**options)


def test_unknown_boundary():
    with pytest.raises(KeyError, match="'lid'.*left.*right"):
        flow([SlipWall("lid"), SlipWall("left"), SlipWall("right")])


def test_facet_without_condition():
    message = r"1 facets of the boundary have no condition, the first at \[1.0\]"
    with pytest.raises(ValueError, match=message):
        flow([SlipWall("left")])


@pytest.mark.parametrize("other", [Outflow("left"), SlipWall("boundary")])
def test_two_conditions_on_one_facet(other):
    with pytest.raises(ValueError, match="'left'"):
        flow([SlipWall("left"), SlipWall("right"), other])


@pytest.mark.parametrize(
    "inflow, message",
    [
        (Inflow("left", 1, 1, [0.5]), "inflow 'left': Mach 0.4226 is subsonic"),
        (Inflow("left", 1, 1, [-3.0]), "inflow 'left': Mach -2.535 is subsonic"),
        (Inflow("left", 1, 1, mach=0.9), "inflow 'left': Mach 0.9 is subsonic"),
        (SubsonicInflow("left", 1, 1, [3.0]), "inflow 'left': Mach 2.535 is not between 0 and 1, use Inflow"),
        (SubsonicInflow("left", 1, 1, mach=1.2), "inflow 'left': Mach 1.2 is not between 0 and 1"),
        (SubsonicInflow("left", 1, 1, [-0.3]), "inflow 'left': Mach -0.2535 is not between 0 and 1"),
        (Inflow("left", -1, 1, [3.0]), "inflow 'left': density -1 must be positive"),
        (Inflow("left", 1, 0, [3.0]), "inflow 'left': pressure 0 must be positive"),
        (Inflow("left", 1, 1), "inflow 'left': give either velocity or mach"),
        (Inflow("left", 1, 1, [3.0], 2.0), "inflow 'left': give either velocity or mach"),
    ],
)
def test_inflow_that_does_not_fit(inflow, message):
    """The speed of sound of (1, 1) is 1.1832."""
    with pytest.raises(ValueError, match=message):
        flow([inflow, Outflow("right")])


def test_periodic_boundaries_that_do_not_match():
    mesh = even_box(2, 4)
    mesh.points[mesh.points[:, 0] == 0, 1] **= 1.2  # the left side is graded, the right one is not
    mesh = fempm.SimplexMesh(mesh.points, mesh.cells, boundaries=mesh.boundaries)
    with pytest.raises(ValueError, match="boundaries 'left' and 'right' are not images of each other"):
        flow([Periodic("left", "right"), SlipWall("bottom"), SlipWall("top")], mesh=mesh)
    mesh = rectangle(4, 4, jitter=0)
    fempm.mark_boundary(mesh, "left", lambda x: x[0] < 1e-9)
    fempm.mark_boundary(mesh, "half", lambda x: (x[0] > 1 - 1e-9) & (x[1] < 0.51))
    fempm.mark_boundary(mesh, "bottom", lambda x: x[1] < 1e-9)
    fempm.mark_boundary(mesh, "top", lambda x: x[1] > 1 - 1e-9)
    fempm.mark_boundary(mesh, "rest", lambda x: (x[0] > 1 - 1e-9) & (x[1] > 0.49))
    ends = [Periodic("left", "half"), SlipWall("bottom"), SlipWall("top"), SlipWall("rest")]
    with pytest.raises(ValueError, match="boundaries 'left' and 'half' are not images of each other"):
        flow(ends, mesh=mesh)


def test_positivity_that_cannot_be_mended(tmp_path, monkeypatch):
    """Gas torn apart at Mach 10^6, with a limiter that needs steps to be repeated there, which it may not."""
    mesh, initial = fempm.interval_mesh(np.linspace(0, 1, 101)), jump((1, -40, 1e-9), (1, 40, 1e-9))
    fine = flow(initial=initial, mesh=mesh, limiter="weno")
    fempm.run(fine, 5e-3, progress=False)
    assert fine.repeated > 0
    monkeypatch.setattr(coupling.flow, "SMALLEST", 1.0)
    gas = flow(initial=initial, mesh=mesh, limiter="weno")
    message = r"could not go on from time .* at \[0\..*\], .*; last state"
    with pytest.raises(SimulationError, match=message) as error:
        fempm.run(gas, 5e-3, tmp_path / "lost", progress=False)
    assert (tmp_path / "lost_last.xdmf").exists()
    assert str(tmp_path / "lost_last.xdmf") in str(error.value)


@pytest.mark.parametrize("how", ["options", "command line"])
def test_solver_that_does_not_converge(tmp_path, monkeypatch, how):
    """One iteration is too few, wherever PETSc is told so; the last state is written."""
    from petsc4py import PETSc

    options = PETSc.Options()
    if how == "options":
        options.setValue("ksp_max_it", 1)
    else:
        monkeypatch.setattr("sys.argv", ["demo", "-ksp_max_it", "1"])
    try:
        gas = sod_tube(50)
    finally:
        monkeypatch.undo()
        options.delValue("ksp_max_it")
    with pytest.raises(SimulationError, match="the pressure did not converge in 1 iterations of PETSc"):
        fempm.run(gas, 0.1, tmp_path / "stuck", progress=False)
    assert (tmp_path / "stuck_last.xdmf").exists()
    assert sod_tube(50).step(1e-3) is None  # nothing of it is left behind
