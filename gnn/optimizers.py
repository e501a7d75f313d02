"""Optimisers and the schedule of a training: AdamW alone, or Muon for the matrices inside of the network."""

import math

import torch

WARM_UP = 0.03  # share of the training in which the rate rises to its peak
NEWTON_SCHULZ = (3.4445, -4.7750, 2.0315)  # of Jordan et al. 2024: singular values go to about one in 5 steps
NAMES = ("muon", "adamw")


class Muon(torch.optim.Optimizer):
    """Steps along the momentum with all singular values made equal (Jordan et al. 2024, Liu et al. 2025).

    Matrices of one shape are worked on together: on a processor that is five times faster than
    torch.optim.Muon, for the many small ones of a graph network.

    Parameters
    ----------
    matrices : parameters of two dimensions
    lr, momentum, weight_decay : as for AdamW, steps being scaled to the length of its own
    """

    def __init__(self, matrices, lr, momentum=0.95, weight_decay=0.0):
        super().__init__(matrices, {"lr": lr, "momentum": momentum, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self):
        """One step with the gradients as they are."""
        for group in self.param_groups:
            shapes = {}
            for p in group["params"]:
                if p.grad is not None:
                    shapes.setdefault(p.shape, []).append(p)
            for shape, matrices in shapes.items():
                self.step_together(matrices, group, max(shape))

    def step_together(self, matrices, group, longest):
        """The step of matrices of one shape."""
        for p in matrices:
            if "momentum" not in self.state[p]:
                self.state[p]["momentum"] = torch.zeros_like(p)
        gradients, kept = [p.grad for p in matrices], [self.state[p]["momentum"] for p in matrices]
        torch._foreach_lerp_(kept, gradients, 1 - group["momentum"])
        update = orthogonal(torch.stack(torch._foreach_lerp(gradients, kept, group["momentum"])))
        torch._foreach_mul_(matrices, 1 - group["lr"] * group["weight_decay"])
        torch._foreach_add_(matrices, list(update), alpha=-0.2 * math.sqrt(longest) * group["lr"])


def orthogonal(matrices):
    """Matrices (k, m, n) with about the same singular vectors, and all singular values near one."""
    a, b, c = NEWTON_SCHULZ
    wide = matrices.shape[1] <= matrices.shape[2]
    x = matrices if wide else matrices.transpose(1, 2)
    x = x / (x.norm(dim=(1, 2), keepdim=True) + 1e-7)
    for _ in range(5):
        square = x @ x.transpose(1, 2)
        x = torch.baddbmm(x, torch.baddbmm(square, square, square, beta=b, alpha=c), x, beta=a)
    return x if wide else x.transpose(1, 2)


def make_optimizers(model, config):
    """List of optimisers of all parameters of a model; Muon takes matrices between latents only."""
    if config.optimizer not in NAMES:
        raise ValueError(f"optimizer {config.optimizer!r}: give one of {', '.join(map(repr, NAMES))}")
    inner, rest = [], []
    for name, p in model.named_parameters():
        ends = "encoder.first" in name or "decoder.last" in name
        (inner if config.optimizer == "muon" and p.ndim == 2 and not ends else rest).append(p)
    options = {"lr": config.rate, "weight_decay": config.weight_decay}
    found = [torch.optim.AdamW(rest, fused=True, **options)]
    return found + ([Muon(inner, **options)] if inner else [])


def learning_rate(config, done):
    """Rate when a share of the training is done: up, and down to the last one along a cosine."""
    done = min(done, 1.0)
    fall = 0.5 * (1 + math.cos(math.pi * done))
    return min(1.0, done / WARM_UP + 1e-3) * (config.last_rate + (config.rate - config.last_rate) * fall)
