"""How kernels are compiled: by Numba, at import, for one set of argument types; and these types."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, register_jitable
from numba.np import linalg
from numba.np.numpy_support import as_dtype

import drivers.compiled.assignment  # noqa: F401 - lowers assignments to slices
from drivers.compiled import cache
from drivers.compiled.lean_library import lean_libraries
from drivers.compiled.records import RecordArgument, record_of

F = TypeVar("F", bound=Callable[..., Any])
_CONTIGUOUS, _WRITEABLE = 0x1, 0x400
"""Flags of NumPy's arrays."""


def _import_without_blas() -> None:
    """Import what asks SciPy for a BLAS, which no kernel uses: it would cost each start 0.1 to 0.3 s."""

    def no_blas() -> None:
        raise ImportError("kernels use no BLAS")

    numbas, linalg.ensure_blas = linalg.ensure_blas, no_blas
    import_module("numba.np.arraymath")
    linalg.ensure_blas = numbas


_import_without_blas()

VECTOR = types.Array(types.float64, 1, "C", readonly=True)
"""Argument: any C-contiguous float64 vector, writeable or not."""
MATRIX = types.Array(types.float64, 2, "C", readonly=True)
"""Argument: any C-contiguous float64 matrix, writeable or not."""
OUT_VECTOR = types.Array(types.float64, 1, "C")
OUT_MATRIX = types.Array(types.float64, 2, "C")
INTEGERS = types.Array(types.int64, 1, "C", readonly=True)
OUT_INTEGERS = types.Array(types.int64, 1, "C")
WORDS = types.Array(types.int64, 1, "A", readonly=True, aligned=False)
"""Argument: integers at any distance, at any address."""
MATRIX_OF_INTEGERS = types.Array(types.int64, 2, "C", readonly=True)
FLAGS = types.Array(types.boolean, 1, "C", readonly=True)
OUT_FLAGS = types.Array(types.boolean, 1, "C")
OUT_INTEGER_MATRIX = types.Array(types.int64, 2, "C")
"""OUT_...: arguments that the kernel fills."""
DATA = types.Bytes(types.uint8, 1, "C", readonly=True)
"""Argument: `bytes`, as a frame has them."""
POINTER = types.CPointer(types.int64)  # type: ignore[no-untyped-call]
BYTE_POINTER = types.CPointer(types.uint8)  # type: ignore[no-untyped-call]
"""Arguments of a kernel that is called by its address: see `drivers.compiled.machine_code`."""
REAL = types.float64
INTEGER = types.int64
BOOLEAN = types.boolean


def record(dtype: np.dtype[np.void], *names: str) -> Any:
    """Argument: one element of a structured dtype, which may be written; the kernel sees the columns named.

    Without names it sees all. For `direct` kernels only.
    """
    return record_of(dtype, names or dtype.names or ())


def records(dtype: np.dtype[np.void]) -> Any:
    """Argument: a vector of elements of a structured dtype, writeable or not. For `direct` kernels only."""
    return types.Array(record(dtype), 1, "C", readonly=True)


# numpy's error model: division by zero gives inf or nan and never raises inside the loop.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": False}


@contextmanager
def undisturbed() -> Iterator[None]:
    """Hold Ctrl-C, and the timer that repeats one, back to the end: half a kernel would crash the process."""
    held: list[int] = []
    handlers: dict[int, Any] = {}
    try:
        for number in (signal.SIGINT, signal.SIGALRM):
            if callable(signal.getsignal(number)):
                handlers[number] = signal.signal(number, lambda given, _: held.append(given))
    except ValueError:  # not the main thread, in which alone handlers run
        handlers.clear()
    try:
        yield
    finally:
        for restored, handler in handlers.items():
            signal.signal(restored, handler)
    if held:
        signal.raise_signal(held[0])


@contextmanager
def compiling(function: Callable[..., Any]) -> Iterator[bool]:
    """Compile into the folder of a function's source meanwhile; yield whether that is up to date.

    Where a source was saved since this process began, what is compiled is neither taken from the cache nor
    kept. Ctrl-C waits until the kernel is there.
    """
    kept = cache.is_as_imported(_source(function))
    if not kept:
        cache.announce()
    settings = vars(numba.config)
    elsewhere = settings["CACHE_LOCATOR_CLASSES"]
    settings["CACHE_LOCATOR_CLASSES"] = f"{cache.__name__}.{cache.Locator.__name__}"
    try:
        with undisturbed(), lean_libraries():
            yield kept
    finally:
        settings["CACHE_LOCATOR_CLASSES"] = elsewhere


def count(function: Callable[..., Any], *, kept: bool, misses: int) -> None:
    """Report that a kernel was compiled, unless it came out of the cache."""
    if not kept or misses:
        cache.compiled(_source(function))


def _source(function: Callable[..., Any]) -> Path:
    return Path(function.__code__.co_filename).resolve()


def kernel(*arguments: Any, unlocked: bool = False) -> Callable[[F], F]:
    """Compile for exactly these argument types when the module is imported; others are refused.

    Nothing can then be compiled inside the loop, whatever it is called with. `unlocked` lets other threads of
    the interpreter run meanwhile. See `compiling`.
    """

    def decorate(function: F) -> F:
        with compiling(function) as kept:
            options = OPTIONS | {"no_cfunc_wrapper": True}
            compiled: Any = numba.njit(arguments, nogil=unlocked, cache=kept, **options)(function)
        if hasattr(compiled, "stats"):
            count(function, kept=kept, misses=len(compiled.stats.cache_misses))
        return cast("F", compiled)

    return decorate


def direct(*arguments: Any, unlocked: bool = False) -> Callable[[F], F]:
    """As `kernel`, for what is called with records; other kernels call `compiled_of` it. See `entry`."""

    def decorate(function: F) -> F:
        return entry(kernel(*arguments, unlocked=unlocked)(function))

    return decorate


def entry(compiled: F) -> F:
    """Return the function to call from Python: that of a `kernel` of records goes past Numba's dispatcher.

    Raises TypeError for an array of another type, order or number of dimensions than the kernel was compiled
    for, 0 for a record, or one that is read-only where the kernel writes. Such a kernel returns numbers only.
    """
    made: Any = compiled
    if not hasattr(made, "overloads"):  # where Numba is disabled
        return compiled
    (only,) = made.overloads.values()
    looked, records_taken = [], False
    for place, kind in enumerate(only.signature.args):
        element = kind.dtype if isinstance(kind, types.Array) else kind
        if isinstance(kind, types.Array | RecordArgument):
            dtype = element.of if isinstance(element, RecordArgument) else as_dtype(element)
            flags = _CONTIGUOUS | (_WRITEABLE if kind.mutable else 0)
            looked.append((place, dtype, getattr(kind, "ndim", 0), flags))
            records_taken = records_taken or isinstance(element, RecordArgument)
    if not records_taken:
        return compiled
    call = _looking(only.entry_point, looked, only.signature.args)
    _of_entry[call] = made
    return cast("F", call)


def _looking(entry_point: Callable[..., Any], looked: list[tuple[int, Any, int, int]], kinds: Any) -> Any:
    """Look at arrays first: Numba's entry looks at the size of their elements alone."""

    def call(*given: Any) -> Any:
        for place, dtype, dimensions, flags in looked:
            array = given[place]
            fits = isinstance(array, np.ndarray) and (array.dtype is dtype or array.dtype == dtype)
            if not fits or array.ndim != dimensions or array.flags.num & flags != flags:
                raise TypeError(f"argument {place} of a kernel is no {kinds[place]}")
        return entry_point(*given)

    return call


_of_entry: dict[Any, Any] = {}


def compiled_of(function: Any) -> Any:
    """Return the dispatcher of a `kernel` or of a `direct` one, which other kernels call."""
    return _of_entry.get(function, function)


def helper(function: F) -> F:
    """Compile as a part of the kernels that call it; elsewhere it is the function as it is written."""
    return register_jitable(no_cfunc_wrapper=True, **OPTIONS)(function)


def _foreign(_context: Any, address: Any, arguments: Any) -> Any:
    def generate(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        given = [builder.extract_value(values[1], i) for i in range(len(arguments))]
        function = ir.FunctionType(ir.IntType(32), [value.type for value in given])
        return builder.call(builder.inttoptr(values[0], function.as_pointer()), given)

    return types.int32(address, arguments), generate


foreign: Any = intrinsic(_foreign)
"""foreign(address, arguments): call, inside a kernel, the C function at `address` with a tuple of arguments.

It returns a C int. Integers pass as what they are, pointers as int64. As with ctypes, a wrong address or
argument crashes the process.
"""
