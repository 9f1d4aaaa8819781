"""Assignments to slices inside kernels give the results of NumPy."""

import numpy as np
import pytest

from drivers.compiled import compiler as c
from drivers.compiled.compiler import helper, kernel

STATE = np.dtype([("before", "<f8"), ("R", "<f8", (3, 3)), ("x", "<f8", 3), ("legs", "<i8", 3)])


@helper
def assign(a, b, m, k, n):
    a[:] = b
    m[1] = b
    m[2, :] = b
    m[3, 1:3] = b[1:3]
    m[-1, -2:] = b[1]
    m[:2] = k[4:]
    m[:, 1] = 7.0
    m[4, ::2] = b[:3]
    m[:, 3] = k[2]
    m[5, :3] = k[:3, 2]
    m[2:4, 4:] = k[:2, :2]
    n[1:3] = 4
    n[-1:] = True
    n[3:3] = 9
    a[b > 4.0] = -1.0


@helper
def shift(a, m):
    a[1:] = a[:-1]
    a[:2] = a[3:5]
    m[1:] = m[:-1]
    m[:, 0] = m[0]


@kernel(c.OUT_VECTOR, c.VECTOR, c.OUT_MATRIX, c.MATRIX, c.OUT_INTEGERS)
def assigned(a, b, m, k, n):
    assign(a, b, m, k, n)


@kernel(c.OUT_VECTOR, c.OUT_MATRIX)
def shifted(a, m):
    shift(a, m)


@kernel(c.record(STATE), c.OUT_VECTOR, c.INTEGER)
def columns(state, values, count):
    state.R[1] = state.x
    state.R[:, 2] = values[:3]
    state.x[:] = values[:count]
    state.legs[:] = state.x
    values[:3] = state.R[0]
    return 0


def arrays():
    k, n = np.arange(36.0).reshape(6, 6), np.zeros(5, np.int64)
    return np.zeros(6), np.arange(6.0) + 1.0, np.zeros((6, 6)), k, n


def test_compiled_array_assignment_equals_numpy_for_every_index_and_value():
    compiled, plain = arrays(), arrays()
    assigned(*compiled)
    assign(*plain)
    for found, expected in zip(compiled, plain, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_compiled_array_assignment_is_right_if_source_and_target_overlap():
    (_, a, _, m, _), (_, b, _, k, _) = arrays(), arrays()
    shifted(a, m)
    shift(b, k)
    np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(m, k)


def test_compiled_assignment_writes_columns_of_records_in_place():
    state, values = np.zeros((), STATE), np.arange(5.0) + 1.0
    with pytest.raises(ValueError, match="shape"):
        columns(state, values, 4)
    assert state["x"].tolist() == [0.0, 0.0, 0.0]
    state["x"] = 5.0, 6.0, 7.0
    columns(state, values, 3)
    assert state["R"].tolist() == [[0.0, 0.0, 1.0], [5.0, 6.0, 2.0], [0.0, 0.0, 3.0]]
    assert (state["x"].tolist(), state["legs"].tolist()) == ([1.0, 2.0, 3.0], [1, 2, 3])
    assert (values.tolist(), float(state["before"])) == ([0.0, 0.0, 1.0, 4.0, 5.0], 0.0)
