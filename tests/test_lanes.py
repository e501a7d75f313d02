"""Numbers with four lanes: operations, formulas, moves between arrays and registers."""

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from fempm.lane_memory import (
    add_totals,
    borrow,
    entry,
    gather,
    gather_row,
    load,
    occupied,
    scatter,
    scatter_row,
    scratch,
    store,
    take,
    zeros,
)
from fempm.lanes import dot, formula, positive, sqrt, where, zero


@formula
def every_operation(a, b, s):
    """One number per operation, with lanes, numbers and constants mixed."""
    return (
        a + b,
        a - b * s,
        s / a,
        -a / 2.0,
        1.0 - a,
        2 / a,
        sqrt(a * a + s),
        positive(a - b),
        where(positive(a - b), a, b),
        dot((a, s, b), (b, a, s)),
        zero(a),
    )


@njit
def run_wide(a, b, s, out):
    p, axes = (0, 1, 2, 3), (0,)
    store(out, 0, every_operation(gather(a, p, axes), gather(b, p, axes), s))


@njit
def run_single(a, b, s, out):
    store(out, 0, every_operation(a, b, s))


def test_a_formula_is_the_same_for_one_and_for_four():
    a, b, s = np.array([1.5, -0.5, 2.0, 0.25]), np.array([0.5, 1.0, 2.0, -3.0]), 0.75
    wide, single = np.zeros((11, 4)), np.zeros((11, 4))
    run_wide(a, b, s, wide)
    for lane in range(4):
        out = np.zeros(11)
        run_single(a[lane], b[lane], s, out)
        single[:, lane] = out
    expected = [a + b, a - b * s, s / a, -a / 2, 1 - a, 2 / a, np.sqrt(a * a + s), np.maximum(a - b, 0)]
    expected += [np.where(a > b, a, b), a * b + s * a + b * s, 0 * a]
    np.testing.assert_allclose(wide, expected, rtol=1e-14)
    np.testing.assert_allclose(single, expected, rtol=1e-14)


def test_what_is_not_a_number_stays_so():
    out = np.zeros((11, 4))
    run_wide(np.full(4, np.nan), np.ones(4), 1.0, out)
    assert np.isnan(out[:8]).all() and np.isnan(out[9]).all()


@formula
def pruned(a, array):
    """Nothing of the second part without the array."""
    return a, None if array is None else a + 1.0


@njit
def run_optional(array, out):
    number, more = pruned(entry(out, 0), array)
    store(out, 1, more)
    return entry(array, 0), take(array, 0, (0, 1))


def test_none_is_left_out():
    out = np.array([2.0, 7.0])
    assert run_optional(None, out) == (None, None) and out[1] == 7.0
    assert run_optional(np.array([4.0, 5.0]), out) == (4.0, (4.0, 5.0)) and out[1] == 3.0


@njit
def move(x, f, p, axes, count, vectors, matrices, rows, sums):
    """Through registers: vectors, matrices times used lanes, rows; lane sums."""
    x, f, vectors, matrices, rows, sums = borrow((x, f, vectors, matrices, rows, sums))
    table = scratch(64)
    store(table, 0, gather(x, p, axes))
    scatter(vectors, p, load(table, 0, zeros(axes)), axes)
    scatter(matrices, p, gather(f, p, axes), axes)
    for a in range(len(axes)):
        scatter_row(rows, p, a, gather_row(f, p, a, axes), axes)
    add_totals(sums, 1, gather(x, p, axes))
    add_totals(sums, 1 + len(axes), (occupied(count),))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_particles_go_through_registers(dim):
    rng = np.random.default_rng(0)
    x, f = rng.standard_normal((6, dim)), rng.standard_normal((6, dim, dim))
    p = (4, 0, 5, 5)
    vectors, matrices, rows, sums = np.zeros_like(x), np.zeros_like(f), np.zeros_like(f), np.ones(dim + 3)
    move(x, f, p, tuple(range(dim)), 3, vectors, matrices, rows, sums)
    chosen = np.isin(np.arange(6), p)[:, None]
    np.testing.assert_array_equal(vectors, np.where(chosen, x, 0))
    np.testing.assert_array_equal(matrices, np.where(chosen[..., None], f, 0))
    np.testing.assert_array_equal(rows, matrices)
    np.testing.assert_allclose(sums, [1, *(1 + x[list(p)].sum(axis=0)), 4, 1], rtol=1e-14)


def test_arrays_with_gaps_are_refused():
    array = np.arange(8.0)[::2]
    with pytest.raises(TypingError, match="contiguous"):
        run_optional(array, np.zeros(2))
