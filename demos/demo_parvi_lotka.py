"""Rates of predators and prey (Lotka-Volterra) from noisy counts by a gas, beside SVGD (MPM-ParVI)."""

from pathlib import Path

from parvi_posteriors import TRUE, gas_and_svgd, on_grid, score

from fempm.cli import print_files, scene_arguments
from fempm.parvi_picture import draw_marginals
from fempm.parvi_score import normal_start

NAMES = ("ln rate of prey", "ln rate of predators")


def main(argv=None):
    args = scene_arguments(
        __doc__, argv, until=15.0, n=(400, "particles"), steps=(200, "steps of SVGD, 0 to leave it out")
    )
    found, results = gas_and_svgd(score, normal_start(TRUE, 0.1), args, 0.02)
    mean, deviation = on_grid(found.positions.mean(axis=0), 6 * found.positions.std(axis=0))
    print(f"by quadrature: mean {mean.round(4)}, sd {deviation.round(4)}; true ln rates {TRUE.round(4)}")
    print("          mean off in sd, sd off in %, CPU s")
    out = {}
    for name, (x, seconds) in results.items():
        off = (x.mean(axis=0) - mean) / deviation, 100 * (x.std(axis=0) / deviation - 1)
        print(f"{name:10} {off[0].round(3)} {off[1].round(1)} {seconds:.1f}")
        out[name] = {"mean": off[0], "deviation": off[1]}
    Path(args.output).parent.mkdir(parents=True, exist_ok=True)
    print_files(
        [draw_marginals(f"{args.output}.png", found.positions, NAMES, results.get("SVGD", (None,))[0])]
    )
    return out


if __name__ == "__main__":
    main()
