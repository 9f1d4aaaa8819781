"""Kernels out of the cache: loaded without LLVM's bitcode, and whole for their callers."""

import importlib.util
import time
from typing import Any

import numba
import pytest
from llvmlite import binding

from drivers.compiled import cache
from drivers.compiled.compiler import OPTIONS, REAL, kernel

SOURCE = """
from drivers.compiled.compiler import REAL, helper, kernel

@helper
def positive(x):
    if x < 0.0:
        raise ValueError("negative")
    return x

@kernel(REAL)
def twice(x):
    return 2.0 * positive(x)

@kernel(REAL)
def fourfold(x):
    return twice(twice(x))
"""


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """Import SOURCE, compiled the first time, out of the cache from then on."""
    folder = tmp_path_factory.mktemp("kernels")
    (folder / "source.py").write_text(SOURCE)

    compiled: list[bool] = []

    def loaded():
        module = again()
        assert not compiled
        return module

    def again():
        spec: Any = importlib.util.spec_from_file_location("kernels_of_this_test", folder / "source.py")
        module = importlib.util.module_from_spec(spec)
        compiled.clear()
        spec.loader.exec_module(module)
        return module

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cache, "CACHE_FOLDER", folder)
        patch.setattr(cache, "progress", compiled.append)
        time.sleep(0.1)
        patch.setattr(cache, "BEGAN_NS", time.time_ns())  # as in a process that began after it was written
        assert again().twice(3.0) == 6.0
        yield loaded


def test_a_loaded_kernel_computes_and_raises_without_bitcode(imported, monkeypatch):
    monkeypatch.setattr(binding, "parse_bitcode", None)
    module = imported()
    assert (module.twice(3.0), module.fourfold(3.0)) == (6.0, 12.0)
    with pytest.raises(ValueError, match="negative"):
        module.fourfold(-1.0)


def test_kernels_of_others_call_a_loaded_kernel_and_its_helper(imported):
    twice, positive = imported().twice, imported().positive

    @kernel(REAL)
    def own(x):
        return twice(positive(x)) + 1.0

    foreign = numba.njit("float64(float64)", **OPTIONS)(lambda x: positive(x) - 1.0)
    assert (own(2.0), foreign(2.0)) == (5.0, 1.0)
    for each in (own, foreign):
        with pytest.raises(ValueError, match="negative"):
            each(-1.0)
