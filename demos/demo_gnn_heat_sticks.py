"""Two sticks and a gap that heat cannot cross: levels by distance leak, bi-stride's do not (thesis 4.6).

A stick with a given temperature at one end and a given heat flux at the other has a linear temperature. Both
networks learn it from single sticks, of either direction, and then see two sticks in a row."""

import argparse

import numpy as np
import torch
from heat_sticks import DEPTH, NODES, errors, joined, scene, stick

from gnn.models import make_model


def learn(model, steps, rng):
    """Train on single sticks anywhere along the axis, of both directions."""
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        batch, inputs, heat = joined([scene([stick(NODES * rng.random(), k % 2)]) for k in range(8)])
        loss = torch.mean((model(batch, inputs) - heat) ** 2)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return float(loss.detach()) ** 0.5


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1500, help="of the training")
    parser.add_argument(
        "--output", default="results/gnn_heat_sticks", help="picture to write, without ending"
    )
    args = parser.parse_args(argv)
    sizes = {"num_inputs": 11, "num_outputs": 1, "dim": 1, "depth": DEPTH, "latent": 32}
    found = {}
    for name in ("bsms", "ms_gnn_grid"):
        torch.manual_seed(0)
        model, rng = make_model(name, **sizes), np.random.default_rng(0)
        left = learn(model, args.steps, rng)
        found[name] = errors(model, rng)
        print(f"{name}: error of a single stick {left:.2g}; at the gap, by the direction of the sticks:")
        print("  " + ", ".join(f"{pair}: {e:.2g}" for pair, e in found[name].items()))
    ratio = max(found["ms_gnn_grid"].values()) / max(found["bsms"].values())
    print(f"levels by distance are {ratio:.0f} times as wrong at the gap as those by bi-stride")
    return {"errors": found, "ratio": ratio}


if __name__ == "__main__":
    main()
