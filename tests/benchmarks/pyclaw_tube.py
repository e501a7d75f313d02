"""A case of Kwatra et al. by PyClaw; run by file name, as PyClaw is not required."""

import sys
import time
from pathlib import Path

import numpy as np
from clawpack import pyclaw, riemann

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))
from coupling.cases import CASES, exact_density


def tube(case, cells):
    """L1 density error, CPU seconds and steps with Roe's solver, MC limiter, Courant number 0.9."""
    solver = pyclaw.ClawSolver1D(riemann.euler_with_efix_1D)
    solver.all_bcs = pyclaw.BC.extrap
    solver.limiters, solver.cfl_desired, solver.cfl_max = pyclaw.limiters.tvd.MC, 0.9, 1.0
    solver.dt_initial = 1e-6 * CASES[case].until
    domain = pyclaw.Domain([pyclaw.Dimension(0.0, 1.0, cells, name="x")])
    state = pyclaw.State(domain, 3)
    state.problem_data.update(gamma=1.4, gamma1=0.4, efix=True)
    x = domain.grid.x.centers
    density, velocity, pressure = CASES[case].initial(x[:, None])
    velocity = np.ravel(velocity)
    state.q[:] = density, density * velocity, pressure / 0.4 + 0.5 * density * velocity**2
    control = pyclaw.Controller()
    control.solution, control.solver = pyclaw.Solution(state, domain), solver
    control.tfinal, control.num_output_times = CASES[case].until, 1
    control.output_format, control.keep_copy, control.verbosity = None, False, 0
    start = time.process_time()
    steps = control.run()["numsteps"]
    seconds = time.process_time() - start
    return np.mean(np.abs(control.solution.state.q[0] - exact_density(case, x))), seconds, steps


if __name__ == "__main__":
    print(*tube(sys.argv[1], int(sys.argv[2])))
