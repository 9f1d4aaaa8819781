"""A kernel called by its symbol: the same result, conversions of its arguments and errors, and its caller's cache."""

import subprocess
import sys

import numpy as np
import pytest

from drivers.compiled.apart import apart
from drivers.compiled.compiler import REAL, VECTOR, direct, kernel, record

STATE = np.dtype([("x", "<f8", 3)])


@kernel(VECTOR, REAL)
def scaled(x, k):
    if k < 0.0:
        raise ValueError("k is negative")
    return x * k


_scaled = apart(scaled)


@direct(record(STATE), REAL)
def halve(state, k):
    found = _scaled(state.x, k)
    for i in range(3):
        state.x[i] = found[i]
    return 0


def state():
    made = np.zeros((), STATE)
    made["x"] = [2.0, 4.0, 6.0]
    return made


def test_a_kernel_is_called_with_a_column_of_a_record_and_returns_an_array():
    made = state()
    for _ in range(1000):
        made["x"] = [2.0, 4.0, 6.0]
        halve(made, 0.5)
    assert made["x"].tolist() == [1.0, 2.0, 3.0]


def test_what_the_kernel_raises_comes_through():
    with pytest.raises(ValueError, match="negative"):
        halve(state(), -1.0)


def test_a_caller_out_of_the_cache_finds_the_kernel_in_another_process():
    code = "from tests.drivers.test_apart import halve, state; s = state(); halve(s, 0.5); print(s['x'].tolist())"
    for _ in range(2):
        ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert ran.stdout.strip() == "[1.0, 2.0, 3.0]"
