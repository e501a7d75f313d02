"""Muon beside torch's, and the schedule of the rate."""

import pytest
import torch

from gnn.config import Config
from gnn.optimizers import Muon, learning_rate, orthogonal


def test_muon_beside_that_of_torch():
    """Three steps with matrices of several shapes; torch's own rounds to bfloat16 (8 bits), ours does not."""
    torch.manual_seed(0)
    start = [torch.randn(shape) for shape in ((8, 8), (8, 19), (19, 8), (8, 8))]
    ours, theirs = ([torch.nn.Parameter(a.clone()) for a in start] for _ in range(2))
    options = {"lr": 0.01, "momentum": 0.95, "weight_decay": 0.1}
    pairs = [(ours, Muon(ours, **options))]
    pairs.append((theirs, torch.optim.Muon(theirs, adjust_lr_fn="match_rms_adamw", **options)))
    for _ in range(3):
        gradients = [torch.randn_like(a) for a in start]
        for parameters, optimizer in pairs:
            for p, g in zip(parameters, gradients):
                p.grad = g.clone()
            optimizer.step()
    for a, b, c in zip(start, ours, theirs):
        assert (b - c).norm() < 0.03 * (b - a).norm()


def test_orthogonal_steps():
    """Singular values between 0.05 and 1 end near one, as far as the polynomial takes them."""
    found = torch.linalg.svdvals(orthogonal(torch.diag(torch.linspace(0.05, 1, 16))[None])[0])
    assert 0.65 < found.min() and found.max() < 1.25


def test_rate_rises_and_falls():
    """Almost zero at first, the peak after the warm-up, half of it in the middle, the last one at the end."""
    c = Config(rate=1.0, last_rate=0.01)
    rates = [learning_rate(c, done) for done in (0.0, 0.03, 0.5, 1.0, 1.2)]
    assert rates == pytest.approx([1e-3, 1, 0.505, 0.01, 0.01], rel=3e-3)
