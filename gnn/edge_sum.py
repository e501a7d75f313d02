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
def first_layer(edges, begin, p, q, weight, out):
    """Make `out` (m, k) relu(p of receivers + q of senders + offsets . weight) of edges from `begin` on."""
    (senders, receivers, offsets), zero = edges, out.dtype.type(0)
    for e in range(len(out)):
        i, j = receivers[begin + e], senders[begin + e]
        for c in range(out.shape[1]):
            out[e, c] = p[i, c] + q[j, c]
        for a in range(offsets.shape[1]):
            length = offsets[begin + e, a]
            for c in range(out.shape[1]):
                out[e, c] += length * weight[a, c]
        for c in range(out.shape[1]):
            out[e, c] = zero if out[e, c] < zero else out[e, c]


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
    """Add the bias to y (m, k); `out` (n, k) becomes sums of its normalised rows between two of `bounds`.

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
                out[i, c] += scale * y[e, c]


@njit(**options)
def unnormalise(receivers, gradient, y, scales, out, total):
    """Make `out` (m, k) the gradient of y from that of its normalised sums (n, k); add it to `total` (k,)."""
    for e in range(len(out)):
        i, along, scale = receivers[e], y.dtype.type(0), scales[e]
        for c in range(y.shape[1]):
            along += gradient[i, c] * y[e, c]
        along = y.dtype.type(along * scale * scale / y.shape[1])
        for c in range(y.shape[1]):
            out[e, c] = scale * (gradient[i, c] - along * y[e, c])
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
def through_first_layer(edges, begin, h, gradient, dp, dq, dweight):
    """Add what the gradient (m, k) of h, which `first_layer` returned, is of p, q and weight; changes it."""
    (senders, receivers, offsets), zero = edges, h.dtype.type(0)
    for e in range(len(h)):
        i, j = receivers[begin + e], senders[begin + e]
        for c in range(h.shape[1]):
            g = gradient[e, c] if h[e, c] > zero else zero
            gradient[e, c] = g
            dp[i, c] += g
        for c in range(h.shape[1]):
            dq[j, c] += gradient[e, c]
        for a in range(offsets.shape[1]):
            length = offsets[begin + e, a]
            for c in range(h.shape[1]):
                dweight[a, c] += length * gradient[e, c]


class EdgeSum(torch.autograd.Function):
    """Sums over the edges of each receiver of a network's normalised output, from its first layer on.

    What has a row per edge is stored after the second layer and after the last, nothing else. Weights and
    bias of the last layer must have mean zero over its outputs.
    """

    @staticmethod
    def forward(ctx, edges, keep, p, q, weight, second, bias, last, last_bias):
        size = len(edges.receivers) if keep else edges.longest
        hidden, values = p.new_empty(size, len(second)), p.new_empty(size, len(last))
        h, scales = p.new_empty(edges.longest, p.shape[1]), p.new_empty(size)
        out = p.new_empty(edges.num_nodes, len(last))
        nodes = p.detach().numpy(), q.detach().numpy(), weight.detach().t().contiguous().numpy()
        biases = bias.detach().numpy(), last_bias.detach().numpy()
        for n, e in edges.chunks:
            rows = e if keep else slice(e.stop - e.start)
            own = h[: e.stop - e.start]
            first_layer(edges.arrays, e.start, *nodes, own.numpy())
            k, y = hidden[rows], values[rows]
            add_bias(biases[0], torch.mm(own, second.t(), out=k).numpy())
            torch.mm(k, last.t(), out=y)
            bounds = edges.bounds[n.start : n.stop + 1]
            normalised_sums(biases[1], y.numpy(), bounds, scales[rows].numpy(), out[n].numpy())
        ctx.edges = edges
        ctx.save_for_backward(p, q, weight, second, bias, last, last_bias, hidden, values, scales)
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        edges, gradient = ctx.edges, gradient.contiguous().numpy()
        *inputs, hidden, values, scales = ctx.saved_tensors
        p, q, weight, second, _, last, _ = inputs
        grads = [torch.zeros_like(x) for x in inputs]
        dp, dq, dweight, dsecond, dbias, dlast, dlast_bias = grads
        widths = p.shape[1], p.shape[1], len(second), len(last)
        h, at_first, at_second, at_last = (p.new_empty(edges.longest, width) for width in widths)
        nodes = p.numpy(), q.numpy(), weight.t().contiguous().numpy()
        by_offset = p.new_zeros(weight.T.shape)
        of_first = dp.numpy(), dq.numpy(), by_offset.numpy()
        for _, e in edges.chunks:
            rows = slice(e.stop - e.start)
            own, g, g2, g1 = h[rows], at_last[rows], at_second[rows], at_first[rows]
            k, y, scale, receivers = hidden[e], values[e], scales[e], edges.arrays[1][e]
            first_layer(edges.arrays, e.start, *nodes, own.numpy())
            unnormalise(receivers, gradient, y.numpy(), scale.numpy(), g.numpy(), dlast_bias.numpy())
            dlast.addmm_(g.t(), k)
            through_relu(k.numpy(), torch.mm(g, last, out=g2).numpy(), dbias.numpy())
            dsecond.addmm_(g2.t(), own)
            torch.mm(g2, second, out=g1)
            through_first_layer(edges.arrays, e.start, own.numpy(), g1.numpy(), *of_first)
        dweight += by_offset.t()
        return None, None, *grads
