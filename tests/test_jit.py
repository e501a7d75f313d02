"""What a start compiles: only what the scene uses, and nothing the second time."""

import json
import os
import subprocess
import sys
from pathlib import Path

SCENE = """
import json, sys
from numba.core import event
recorder = event.RecordingListener()
event.register("numba:compile", recorder)
sys.path.insert(0, "tests")
from mesh_factory import rectangle
import fempm
mesh = rectangle(6, 6)
body = fempm.Body(*fempm.fill_box((0.3, 0.3), (0.7, 0.7), 0.1), fempm.NeoHookean(1.0, 10.0, 0.3))
scene = fempm.Simulation(mesh, [body], [fempm.Wall("boundary", "slip")], (0.0, -1.0), transfer="flip")
fempm.run(scene, 0.02, progress=False)
started = [e.data["dispatcher"].py_func for _, e in recorder.buffer if e.is_start]
print(json.dumps([f"{f.__module__}.{f.__name__}" for f in started]))
"""
UNUSED = ("contact", "barrier", "plasticity", "f_bar", "parallel")


def compiled(cache):
    """Functions that a 2D FLIP scene compiles in a new process."""
    root = Path(__file__).parent.parent
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", SCENE], cwd=root, env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def test_first_and_second_start(tmp_path):
    """Numba reports every compilation as an event: none in the second process, whose scene is the same."""
    first = compiled(tmp_path)
    assert any(name.endswith("transfer.particle_to_grid") for name in first)
    assert any(name.endswith("materials.neo_hookean_stress") for name in first)
    unused = [name for name in first if any(f"fempm.{part}." in name for part in UNUSED)]
    other_laws = {"linear_stress", "st_venant_kirchhoff_stress", "fluid_stress", "hencky_stress"}
    unused += [name for name in first if name.split(".")[-1] in other_laws | {"inverse_inertia"}]
    assert unused == []
    assert compiled(tmp_path) == []
