"""How often Numba compiles what kernels call."""

from typing import Any

import numba
from numba import types
from numba.core import event

from drivers.compiled.compiler import helper
from drivers.compiled.pipeline import KernelPipeline

OPTIONS: dict[str, Any] = {"pipeline_class": KernelPipeline, "error_model": "numpy"}


@helper
def doubled(x):
    return 2.0 * x


@helper
def fourfold(x):
    return doubled(doubled(x))


def eightfold(x):
    return doubled(fourfold(x))


def test_kernels_of_all_kinds_share_one_compilation_of_each_helper():
    listener = event.RecordingListener()
    with event.install_listener("numba:compile", listener):
        plain = numba.njit(["float64(float64)"], **OPTIONS)(eightfold)
        unlocked = numba.njit(["float64(float64)"], nogil=True, **OPTIONS)(eightfold)
        by_address = numba.cfunc(types.float64(types.float64), **OPTIONS)(eightfold)
    begun = [each.data["dispatcher"].py_func for _, each in listener.buffer if each.is_start]
    assert (begun.count(doubled), begun.count(fourfold)) == (1, 1)
    assert (plain(1.0), unlocked(1.0), by_address.ctypes(1.0)) == (8.0, 8.0, 8.0)
