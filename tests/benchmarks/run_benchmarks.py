"""Speed of a time step and error against run time, on one core; tables, CSV files and pictures."""

import argparse
import csv
import os
import platform
import re
import sys
import time
from pathlib import Path

import llvmlite.binding
import numba
import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parent.parent))
from benchmarks.comparison import comparison
from benchmarks.coupled import coupled_benchmarks
from benchmarks.gas import gas_benchmarks
from benchmarks.parvi import parvi_benchmarks
from benchmarks.throughput import STAGES, throughput
from benchmarks.vibrating_bar import error_against_time
from benchmarks.work import peak, work
from fempm import compat

PARTS = ("solids", "gas", "coupled", "parvi", "gnn")
BOXES = {1: 4e-5, 2: 0.0068, 3: 0.058}  # dimension -> mesh size: 100,000 to 230,000 particles
QUICK_BOXES = {1: 2e-4, 2: 0.018, 3: 0.1}
GRIDS, QUICK_GRIDS = {2: 240, 3: 30}, {2: 90, 3: 16}  # cells per axis of structured grids
BARS = {"graded": (2.0, 1.0, 0.5, 0.25), "jittered": (1.0, 0.5, 0.25)}
QUICK_BARS = {"graded": (2.0, 1.0, 0.5), "jittered": (1.0, 0.5)}


def machine():
    """Lines on the processor and the versions of what the speed depends on."""
    info = Path("/proc/cpuinfo")
    names = re.findall(r"model name\s*: (.*)", info.read_text()) if info.exists() else []
    model, target = (names or [platform.processor()])[0], llvmlite.binding.get_host_cpu_name()
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    return (
        f"{model} ({target} to LLVM), {os.cpu_count()} cores, load {load} at the start; one core used\n"
        f"Python {platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}, "
        f"DOLFINx {compat.dolfinx_version()}"
    )


def text(value):
    """A number in at most three significant digits unless it is whole."""
    if isinstance(value, float):
        return f"{value:.0f}" if value >= 100 else f"{value:.3g}"
    return str(value)


def table(rows):
    """Rows (dicts with the same keys) in aligned columns."""
    lines = [list(rows[0])] + [[text(v) for v in row.values()] for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines)]
    return "\n".join("  ".join(v.rjust(w) for v, w in zip(line, widths)) for line in lines)


def write_csv(path, rows):
    """Write rows (dicts with the same keys) to a CSV file."""
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def draw_stages(path, rows):
    """CPU time per particle-step, stacked by stage, one panel per dimension."""
    dims = sorted({row["dim"] for row in rows})
    figure = Figure(figsize=(3.8 * len(dims), 3.6), layout="constrained")
    for ax, dim in zip(figure.subplots(1, len(dims), sharey=True, squeeze=False)[0], dims):
        part = [row for row in rows if row["dim"] == dim]
        names = [f"{r['transfer']} {r['gradient']}" for r in part]
        left = np.zeros(len(part))
        for stage in STAGES.values():
            width = np.array([row[f"{stage}_ns"] for row in part]) / 1e3
            ax.barh(names, width, left=left, label=stage)
            left += width
        for y, row in enumerate(part):
            ax.text(left[y], y, f" {row['M/cpu_s']:.2f} M/s", va="center", fontsize=8)
        ax.set(xlim=(0, 1.3 * left.max()), xlabel="CPU time per particle-step in µs")
        n, ring = part[0]["particles"], part[0]["ring"]
        ax.set_title(f"{dim}D, {n:,} particles, mean ring {ring:.1f}", fontsize=10)
    ax.invert_yaxis()
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=len(STAGES))
    figure.savefig(path, dpi=130)


def draw_errors(path, rows):
    """Error over run time, both logarithmic, one line per mesh and gradient."""
    figure = Figure(figsize=(6, 4.4), layout="constrained")
    ax = figure.subplots()
    for mesh, colour in (("graded", "C0"), ("jittered", "C1")):
        for gradient, style in (("plain", "o:"), ("consistent", "s-")):
            line = [row for row in rows if (row["mesh"], row["gradient"]) == (mesh, gradient)]
            seconds = [row["setup_s"] + row["steps_s"] for row in line]
            error, label = [row["error_%"] for row in line], f"{mesh}, {gradient}"
            ax.loglog(seconds, error, style, color=colour, label=label)
            for x, y, row in zip(seconds, error, line):
                ax.annotate(f"{row['h']:g} m", (x, y), (3, 5), textcoords="offset points", fontsize=8)
    ax.set(xlabel="CPU time of setup and steps in s", ylabel="largest RMS displacement error in %")
    ax.set_title("vibrating bar: 1D graded intervals, 2D jittered triangles", fontsize=10)
    ax.margins(0.1)
    ax.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8)
    figure.savefig(path, dpi=130)


def solid_benchmarks(output, quick):
    """Speed of a step in a filled box, its work, other codes, and the bar's error against run time."""
    boxes, repetitions = (QUICK_BOXES, 5) if quick else (BOXES, 15)
    print("\nfilled box in motion; M: 1e6 particle-steps, ns: per particle-step, peak: process so far,")
    print("setup: mesh excluded, with consistent gradient, CPU time; uniform intervals need no correction,")
    print("so both gradients are the same in 1D", flush=True)
    speed = []
    for dim, h in boxes.items():
        part = throughput(dim, h, repetitions)
        print(table(part), flush=True)
        speed += part
    write_csv(output / "throughput.csv", speed)
    draw_stages(output / "throughput.png", speed)

    rate = peak()
    print(
        f"\nwork of the transfers per particle-step; a core multiplies and adds at {1e-9 * rate:.1f} GFlop/s"
    )
    done = [work(row, rate) for row in speed]
    print(table(done))
    write_csv(output / "work.csv", done)

    print("\nneo-Hookean, APIC, 4 particles per triangle, 8 per tetrahedron, 4 and 8 per cell of a grid; M/s")
    others = comparison(speed, QUICK_GRIDS if quick else GRIDS, repetitions)
    print(table(others), flush=True)
    write_csv(output / "comparison.csv", others)

    print("\nvibrating bar, one period, FLIP; seconds: CPU time", flush=True)
    errors = error_against_time(QUICK_BARS if quick else BARS)
    print(table(errors))
    write_csv(output / "error_against_time.csv", errors)
    draw_errors(output / "error_against_time.png", errors)


def main(argv=None):
    formatter = argparse.ArgumentDefaultsHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=formatter)
    parser.add_argument("--output", type=Path, default=Path("results/bench"), help="folder of the files")
    parser.add_argument("--only", choices=PARTS, help="one part of the benchmarks")
    parser.add_argument("--quick", action="store_true", help="smaller scenes, shorter trainings: minutes")
    args = parser.parse_args(argv)
    args.output.mkdir(parents=True, exist_ok=True)
    begin = time.perf_counter()
    (args.output / "machine.txt").write_text(machine() + "\n")
    print(machine())

    if args.only in (None, "solids"):
        solid_benchmarks(args.output, args.quick)
    others = {"gas": gas_benchmarks, "coupled": coupled_benchmarks, "parvi": parvi_benchmarks}
    for name, benchmarks in others.items():
        if args.only in (None, name):
            benchmarks(args.output, args.quick, table, write_csv)
    if args.only in (None, "gnn"):
        from benchmarks.learning import gnn_benchmarks  # loads torch

        gnn_benchmarks(args.output, args.quick, table, write_csv)
    print(f"\nwrote {args.output}/ in {time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
