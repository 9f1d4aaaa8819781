"""Arguments of kernels: arrays and records that are read, written or refused."""

from typing import Any

import numpy as np
import pytest
from numba import TypingError

from drivers.compiled.compiler import (
    INTEGERS,
    MATRIX,
    OUT_FLAGS,
    OUT_MATRIX,
    OUT_VECTOR,
    VECTOR,
    kernel,
    record,
    records,
)

POINT = np.dtype([("x", np.float64), ("n", np.int64), ("unseen", np.int64)])


@kernel(VECTOR, MATRIX, INTEGERS, OUT_FLAGS, OUT_VECTOR, OUT_MATRIX, OUT_FLAGS)
def _look(vector: Any, matrix: Any, integers: Any, flags: Any, out: Any, rows: Any, marks: Any) -> int:
    """Copy the first four to the others; the result is the number of their elements."""
    for i in range(vector.shape[0]):
        out[i] = vector[i] + 1000.0 * integers[i]
        marks[i] = flags[i]
    for i in range(matrix.shape[0]):
        rows[i] = matrix[i]
    return int(vector.size + matrix.size + integers.size + flags.size)


def arguments(**changes: Any) -> dict[str, Any]:
    known = {
        "vector": np.arange(4.0),
        "matrix": np.arange(6.0).reshape(2, 3),
        "integers": np.arange(4),
        "flags": np.array([True, False, False, True]),
        "out": np.zeros(4),
        "rows": np.zeros((2, 3)),
        "marks": np.zeros(4, np.bool_),
    }
    return known | changes


def look(given: dict[str, Any]) -> int:
    return _look(*given.values())


def test_compiled_kernel_reads_its_arguments_and_fills_its_output_arrays():
    for kind in (np.int64, np.longlong, "<i8"):
        given = arguments(integers=np.arange(4).astype(kind))
        assert look(given) == 18
        assert given["out"].tolist() == [0.0, 1001.0, 2002.0, 3003.0]
        assert given["rows"].tolist() == given["matrix"].tolist()
        assert given["marks"].tolist() == [True, False, False, True]
    assert look({name: value[:0] for name, value in arguments().items()}) == 0, "empty"
    whole = np.arange(40.0).reshape(5, 2, 4)
    whole.flags.writeable = False
    given = arguments(vector=whole[1, 1], matrix=np.arange(12.0).reshape(4, 3)[1:3])
    look(given)
    assert (given["out"] - 1000.0 * given["integers"]).tolist() == whole[1, 1].tolist(), "a part, read-only"
    assert given["rows"].tolist() == [[3.0, 4.0, 5.0], [6.0, 7.0, 8.0]]


@kernel(OUT_VECTOR)
def _change(vector: Any) -> None:
    vector[0] = 1.0


def test_kernel_cannot_pass_a_read_only_argument_to_a_kernel_that_writes():
    def lends(vector: Any) -> None:
        _change(vector)

    kernel(OUT_VECTOR)(lends)
    with pytest.raises(TypingError):
        kernel(VECTOR)(lends)


@kernel(record(POINT, "x", "n"))
def _count_up(point: Any) -> float:
    point.n += 1
    return float(point.x)


@kernel(record(POINT, "x", "n"))
def _twice(point: Any) -> float:
    return _count_up(point) + _count_up(point)


@kernel(records(POINT))
def _sum(points: Any) -> float:
    total = 0.0
    for point in points:
        total += point.x
    return total


def test_kernel_accepts_records_of_its_declared_type_and_refuses_other_arguments():
    points = np.zeros(4, POINT)
    points["x"], points["n"] = (1.0, 2.0, 4.0, 8.0), 7
    for k, x in enumerate(points["x"].tolist()):
        assert _count_up(points[k : k + 1].reshape(())) == x
    assert _twice(points[1:2].reshape(())) == 4.0
    assert points["n"].tolist() == [8, 10, 8, 8]
    assert points["unseen"].tolist() == [0] * 4
    for wrong in (np.zeros((), np.dtype([("x", np.float64)])), np.zeros((), np.float64), 1.0, None):
        with pytest.raises(TypeError):
            _count_up(wrong)
    assert (_sum(points[1:3]), _sum(points[:0])) == (6.0, 0.0)
    with pytest.raises(TypeError):
        _sum(np.zeros(4))
