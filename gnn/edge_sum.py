"""Sums of messages over the edges of each node, on a processor: `EdgeSum` and its kernels.

Chunk by chunk of edges, which stays in the cache of a core: products of matrices by torch, and all there is
between two of them in one pass by Numba.
"""

import numpy as np
import torch
from numba import njit

EPS = 1e-5  # in the normalisation of the layers

sums = {"reassoc", "contract", "nsz"}  # in any order, but nan stays nan
options = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": sums}


@njit(**options)
def add_nodes(senders, receivers, p, q, out):
    """Make `out` (m, k) of edges relu(out + p of receivers + q of senders)."""
    zero = out.dtype.type(0)
    for e in range(len(out)):
        i, j = receivers[e], senders[e]
        for c in range(out.shape[1]):
            z = out[e, c] + p[i, c] + q[j, c]
            out[e, c] = zero if z < zero else z


@njit(**options)
def add_bias(bias, k):
    """Make k (m, n) relu(k + bias)."""
    zero = k.dtype.type(0)
    for e in range(len(k)):
        for c in range(k.shape[1]):
            z = k[e, c] + bias[c]
            k[e, c] = zero if z < zero else z


@njit(**options)
def normalised_sums(bias, y, bounds, scales, out):
    """Add the bias to y (m, k) and normalise its rows; make `out` (n, k) their sums between two of `bounds`.

    Rows have mean zero: so the LayerNorm is a product with one over their root mean square, `scales` (m,).
    """
    for i in range(len(out)):
        for c in range(out.shape[1]):
            out[i, c] = 0
        for e in range(bounds[i] - bounds[0], bounds[i + 1] - bounds[0]):
            square = y.dtype.type(0)
            for c in range(y.shape[1]):
                y[e, c] += bias[c]
                square += y[e, c] * y[e, c]
            scale = y.dtype.type(1 / np.sqrt(square / y.shape[1] + EPS))
            scales[e] = scale
            for c in range(y.shape[1]):
                y[e, c] *= scale
                out[i, c] += y[e, c]


@njit(**options)
def unnormalise(receivers, gradient, own, y, scales, out, total):
    """Make `out` (m, k) the gradient before the normalisation of y, and add it to `total` (k,).

    From the gradients of the sums (n, k) and of the edges' rows, `own` (m, k) or (0, k) where there are none.
    """
    for e in range(len(out)):
        i, along, scale = receivers[e], y.dtype.type(0), scales[e]
        for c in range(y.shape[1]):
            out[e, c] = gradient[i, c]
        if len(own):
            for c in range(y.shape[1]):
                out[e, c] += own[e, c]
        for c in range(y.shape[1]):
            along += out[e, c] * y[e, c]
        along = y.dtype.type(along / y.shape[1])
        for c in range(y.shape[1]):
            out[e, c] = scale * (out[e, c] - along * y[e, c])
            total[c] += out[e, c]


@njit(**options)
def through_relu(k, gradient, total):
    """Make the gradient (m, n) of relu(z) = k that of z, in place, and add it to `total` (n,)."""
    zero = k.dtype.type(0)
    for e in range(len(k)):
        for c in range(k.shape[1]):
            g = gradient[e, c] if k[e, c] > zero else zero
            gradient[e, c] = g
            total[c] += g


@njit(**options)
def through_nodes(senders, receivers, h, gradient, dp, dq):
    """Make the gradient (m, k) of relu(z) = h that of z, in place, and add it to those of p and q."""
    zero = h.dtype.type(0)
    for e in range(len(h)):
        i, j = receivers[e], senders[e]
        for c in range(h.shape[1]):
            g = gradient[e, c] if h[e, c] > zero else zero
            gradient[e, c] = g
            dp[i, c] += g
        for c in range(h.shape[1]):
            dq[j, c] += gradient[e, c]


class EdgeSum(torch.autograd.Function):
    """Sums over the edges of each receiver of a network's normalised output, from its first layer on.

    That has values of the edges, `x` (E, k), times `weight`, and p and q of receiver and sender. The output
    of each edge comes back too where `wanted`, else None. What has a row per edge is stored after the second
    layer and at the end, nothing else. Weights and bias of the last layer must have mean zero over its
    outputs.
    """

    @staticmethod
    def forward(ctx, edges, keep, wanted, x, p, q, weight, second, bias, last, last_bias):
        size = len(edges.receivers) if keep or wanted else edges.longest
        hidden, values = p.new_empty(size, len(second)), p.new_empty(size, len(last))
        h, scales = p.new_empty(edges.longest, p.shape[1]), p.new_empty(size)
        out = p.new_empty(edges.num_nodes, len(last))
        biases = bias.detach().numpy(), last_bias.detach().numpy()
        for n, e in edges.chunks:
            rows = e if keep or wanted else slice(e.stop - e.start)
            k, y = hidden[rows], values[rows]
            own = first_layer(edges, e, x, weight, p, q, h)
            add_bias(biases[0], torch.mm(own, second.t(), out=k).numpy())
            torch.mm(k, last.t(), out=y)
            bounds = edges.bounds[n.start : n.stop + 1]
            normalised_sums(biases[1], y.numpy(), bounds, scales[rows].numpy(), out[n].numpy())
        ctx.edges = edges
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(x, p, q, weight, second, bias, last, last_bias, hidden, values, scales)
        return out, values if wanted else None

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient, own):
        edges, of_edges = ctx.edges, ctx.needs_input_grad[3]
        *inputs, hidden, values, scales = ctx.saved_tensors
        x, p, q, weight, second, _, last, _ = inputs
        gradient = p.new_zeros(edges.num_nodes, len(last)) if gradient is None else gradient.contiguous()
        own = p.new_empty(0, len(last)) if own is None else own.contiguous()
        grads = [torch.zeros_like(a) for a in inputs[1:]]
        dp, dq, dweight, dsecond, dbias, dlast, dlast_bias = grads
        dx = torch.empty_like(x) if of_edges else None
        h, at_first, at_second, at_last = (
            p.new_empty(edges.longest, w) for w in map(len, (p.T, second.T, dbias, last))
        )
        for _, e in edges.chunks:
            rows, ends = slice(e.stop - e.start), [a[e] for a in edges.arrays]
            first, g, g2, g1 = (
                first_layer(edges, e, x, weight, p, q, h),
                at_last[rows],
                at_second[rows],
                at_first[rows],
            )
            k, mine = hidden[e], own[e] if len(own) else own
            sums = gradient.numpy(), mine.numpy(), values[e].numpy(), scales[e].numpy()
            unnormalise(ends[1], *sums, g.numpy(), dlast_bias.numpy())
            dlast.addmm_(g.t(), k)
            through_relu(k.numpy(), torch.mm(g, last, out=g2).numpy(), dbias.numpy())
            dsecond.addmm_(g2.t(), first)
            torch.mm(g2, second, out=g1)
            through_nodes(*ends, first.numpy(), g1.numpy(), dp.numpy(), dq.numpy())
            dweight.addmm_(g1.t(), x[e])
            if of_edges:
                torch.mm(g1, weight, out=dx[e])
        return None, None, None, dx, *grads


def first_layer(edges, e, x, weight, p, q, out):
    """What a slice of edges has after the first layer, in the first rows of `out`."""
    own = torch.mm(x[e], weight.t(), out=out[: e.stop - e.start])
    senders, receivers = edges.arrays
    add_nodes(senders[e], receivers[e], p.detach().numpy(), q.detach().numpy(), own.numpy())
    return own
