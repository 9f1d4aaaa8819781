"""Kernels that others call by their address: what a record points to decides what runs.

A law, a reference, a decoder is a C function and the record of what it works on. A compiled pass calls it by
the two addresses, without knowing which one it is, in a few ns. A function in plain Python goes by the same
door, through a callback (`of_python`), in 0.3 us and its own time.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import OPTIONS, compiling, count, foreign, helper

FAILED = -1
"""Status of a function that could not do its work."""
_STATUS = types.int32
_carray: Any = vars(numba)["carray"]
_C_TYPES: dict[Any, Any] = {types.int64: ctypes.c_int64, types.float64: ctypes.c_double}


class Pointed:
    """A compiled function with an address. From Python it is called with arrays in place of records."""

    def __init__(self, address: int, arguments: tuple[Any, ...], function: Callable[..., Any]) -> None:
        self.address = address
        self.plain = function
        """The function as it is written."""
        kinds = [_C_TYPES.get(argument, ctypes.c_void_p) for argument in arguments]
        self.raw = ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(address)
        """The same with the address of each record, in half the time."""

    def __call__(self, *arguments: Any) -> int:
        """Return the status. A record is an array of its dtype; the caller answers for that."""
        given = [each.ctypes.data if isinstance(each, np.ndarray) else each for each in arguments]
        return int(self.raw(*given))


def pointed(*arguments: Any) -> Callable[[Callable[..., int]], Pointed]:
    """Compile a function of records (`compiler.record`), INTEGER and REAL that returns a status, an int.

    Kept in the cache and refused as `compiler.kernel`. A record is its address alone: nothing checks it.
    """

    def decorate(function: Callable[..., int]) -> Pointed:
        with compiling(function) as kept:
            compiled: Any = numba.cfunc(_STATUS(*arguments), cache=kept, **OPTIONS)(function)
        count(function, kept=kept, misses=1 - compiled.cache_hits)
        return Pointed(compiled.address, arguments, function)

    return decorate


class Callee(NamedTuple):
    """What a record holds of a function and of what it works on; `keeps` keeps both in memory."""

    address: int
    context: int
    keeps: Any


def context_of(dtype: np.dtype[np.void], **values: Any) -> np.ndarray[Any, np.dtype[np.void]]:
    """Return a record of a dtype with these values; an array that does not fit in goes by its address."""
    context = np.zeros((), dtype)
    for name, value in values.items():
        by_address = isinstance(value, np.ndarray) and not dtype[name].shape
        context[name] = data_at(value) if by_address else value
    return context


def of_python(function: Callable[..., int], *kinds: Any) -> tuple[int, Any]:
    """Return the address of a Python function of INTEGER and REAL, and what keeps it alive.

    The function must not raise: it returns FAILED instead, and keeps what it met.
    """
    callback = ctypes.CFUNCTYPE(ctypes.c_int32, *(_C_TYPES[kind] for kind in kinds))(function)
    address = ctypes.cast(callback, ctypes.c_void_p).value
    assert address is not None
    return address, callback


def data_at(array: np.ndarray[Any, Any]) -> int:
    """Return the address of an array's data: its owner must live as long as the address is used."""
    return int(array.ctypes.data)


def record_at(argument: Any) -> Any:
    """Return what makes, inside a kernel, a record of a type (`compiler.record`) from its address."""

    def at(_context: Any, _address: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            return builder.inttoptr(values[0], context.get_value_type(argument))

        return argument(types.int64), generate

    return intrinsic(at)


def _address_of(_context: Any, record: Any) -> Any:
    def generate(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.ptrtoint(values[0], ir.IntType(64))

    return types.int64(record), generate


address_of: Any = intrinsic(_address_of)
"""address_of(record): inside a kernel, where it is."""


def records_at(argument: Any) -> Any:
    """Return a function (address, count) that gives a kernel the array of records or numbers there."""
    pointer: Any = types.CPointer(argument)  # type: ignore[no-untyped-call]
    to_elements = record_at(pointer)

    def at(address: int, count: int) -> Any:
        return _carray(to_elements(address), (count,))

    return helper(at)


reals_at: Callable[[int, int], Array] = records_at(types.float64)
"""reals_at(address, count): inside a kernel, the float64 vector at an address."""
integers_at: Callable[[int, int], Ints] = records_at(types.int64)
"""integers_at(address, count): inside a kernel, the int64 vector at an address."""
_to_reals = record_at(types.CPointer(types.float64))  # type: ignore[no-untyped-call]


@helper
def matrix_at(address: int, rows: int, columns: int) -> Array:
    """Return, inside a kernel, the float64 matrix at an address."""
    values: Array = _carray(_to_reals(address), (rows, columns))
    return values


call: Any = foreign
"""call(address, arguments): inside a kernel, call a function by its address."""
