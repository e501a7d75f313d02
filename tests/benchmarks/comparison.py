"""Other codes beside ours in the same run: million particle-steps per second and core."""

import importlib.util
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from .structured import structured

HERE = Path(__file__).resolve().parent
TRIAL = HERE.parents[2] / "shared/experiments/transfer_speed_3d.py"  # not part of the repository


def output(*command):
    """What a Python program prints, or "" where it fails."""
    done = subprocess.run(
        [sys.executable, *map(str, command)], capture_output=True, text=True, cwd=tempfile.gettempdir()
    )
    return done.stdout if done.returncode == 0 else ""


def comparison(speed, cells, repetitions):
    """Rows with the columns code, 2D and 3D; text where there is no number.

    Parameters
    ----------
    speed : rows of `throughput`
    cells : {2: n, 3: n}, cells per axis of the structured grids
    repetitions : how often to time; the best one counts
    """
    ours = {r["dim"]: r["M/cpu_s"] for r in speed if (r["transfer"], r["gradient"]) == ("apic", "consistent")}
    rows = [{"code": "fempm, unstructured, consistent gradients", "2D": ours[2], "3D": ours[3]}]
    own = {f"{d}D": structured(d, n, repetitions) for d, n in cells.items()}
    rows.append({"code": "structured grid, B-splines, Numba with lanes", **own})
    taichi = dict.fromkeys(("2D", "3D"), "not installed")
    if importlib.util.find_spec("taichi"):
        words = output(HERE / "taichi_mpm.py", *cells.values()).split()
        taichi = dict(zip(taichi, map(float, words[-2:]))) if words else dict.fromkeys(taichi, "failed")
    rows.append({"code": "structured grid, B-splines, Taichi", **taichi})
    if TRIAL.exists():
        found = re.findall(r"vc True apic True .* ([\d.]+) M/core-s", output(TRIAL))
        number = float(found[0]) if found else "failed"
        rows.append({"code": "trial script, both transfers only", "2D": "-", "3D": number})
    return rows
