"""Kernels out of the cache: loaded without LLVM's bitcode, and whole all the same for who calls them."""

import importlib.util
import time
from typing import Any

import numba
import pytest
from llvmlite import binding
from numba.core.registry import cpu_target

from drivers.compiled import cache
from drivers.compiled.compiler import OPTIONS, REAL, kernel
from drivers.compiled.library import Library

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


def test_a_loaded_kernel_parses_no_bitcode_and_computes(imported, monkeypatch):
    monkeypatch.setattr(binding, "parse_bitcode", None)
    module = imported()
    assert (module.twice(3.0), module.fourfold(3.0)) == (6.0, 12.0)


def test_a_kernel_compiled_later_calls_a_loaded_one(imported):
    twice = imported().twice

    @kernel(REAL)
    def one_more(x):
        return twice(x) + 1.0

    assert one_more(3.0) == 7.0


def test_a_loaded_kernel_names_all_that_it_defines(imported, monkeypatch):
    engine = cpu_target.target_context.codegen()._engine
    monkeypatch.setattr(engine, "_defined_symbols", set())  # as in a process that has compiled nothing
    module = imported()
    (loaded,) = module.fourfold.overloads.values()
    assert engine.is_symbol_defined(loaded.fndesc.llvm_func_name)
    assert engine.is_symbol_defined(loaded.fndesc.llvm_cpython_wrapper_name)


def test_a_loaded_kernel_raises_what_its_helper_raises(imported):
    module = imported()
    with pytest.raises(ValueError, match="negative"):
        module.fourfold(-1.0)


def test_a_kernel_of_others_calls_a_helper_that_a_kernel_has_called(imported):
    positive = imported().positive

    @kernel(REAL)
    def own(x):
        return positive(x) + 1.0

    foreign = numba.njit("float64(float64)", **OPTIONS)(lambda x: positive(x) - 1.0)
    assert (own(2.0), foreign(2.0)) == (3.0, 1.0)
    for each in (own, foreign):
        with pytest.raises(ValueError, match="negative"):
            each(-1.0)


def test_what_others_compile_stays_as_numba_has_it(imported):
    imported()

    @numba.njit("float64(float64)")
    def foreign(x):
        return x - 1.0

    compiled: Any = foreign
    (only,) = compiled.overloads.values()
    assert not isinstance(only.library, Library)
    assert foreign(1.0) == 0.0


def test_a_loaded_kernel_is_the_machine_code_that_was_kept_of_it_and_no_other(imported, monkeypatch):
    finalize: Any = Library._finalize_final_module
    given: list[bytes | None] = []

    def watched(library):
        given.append(library._compiled_object)
        finalize(library)

    monkeypatch.setattr(Library, "_finalize_final_module", watched)
    module = imported()
    names = []
    for function in (module.twice, module.fourfold):
        (loaded,) = function.overloads.values()
        names.append(loaded.fndesc.llvm_func_name.encode())
    assert [name in (code or b"") for code, name in zip(given, names, strict=True)] == [True, True]
    assert names[1] not in (given[0] or b"")
