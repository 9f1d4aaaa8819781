"""Kernels that are called by address: the pointer in a record decides which function runs.

A law, a reference, a decoder is a C function and the record that it works on. A compiled caller uses the two
addresses without knowing which function it calls, in a few ns. A function in plain Python is called in the
same way, through a callback (`of_python`), in 0.3 us plus its own time.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.ccallback import CFunc
from numba.extending import intrinsic

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import OPTIONS, compiled, helper

FAILED = -1
"""Status that a function returns when it fails."""
_carray: Any = vars(numba)["carray"]
_C_TYPES: dict[Any, Any] = {types.int64: ctypes.c_int64, types.float64: ctypes.c_double}


@dataclass(frozen=True)
class Pointed:
    """A compiled function that other kernels call through its address."""

    address: int
    machine_code: tuple[str, bytes]
    """Name of the function, and the object file that contains it."""
    raw: Callable[..., int]
    """The function, with numbers and addresses as arguments."""

    def __call__(self, *arguments: Any) -> int:
        """Call the function from Python; returns its status. Records are passed as unchecked arrays."""
        return self.raw(*[each.ctypes.data if isinstance(each, np.ndarray) else each for each in arguments])


def pointed(*arguments: Any) -> Callable[[Callable[..., int]], Pointed]:
    """Decorator that compiles a function of records (`compiler.record`), INTEGER and REAL to a C function.

    The function returns a status, an int. Cached as by `compiler.kernel`. Only the address of a record is
    passed: its type is not checked.
    """

    def decorate(function: Callable[..., int]) -> Pointed:
        made: Any = CFunc(function, (arguments, types.int32), {}, OPTIONS)
        kept = compiled(made, function)
        kinds = [_C_TYPES.get(each, ctypes.c_void_p) for each in arguments]
        raw = ctypes.CFUNCTYPE(ctypes.c_int32, *kinds)(made.address)
        return Pointed(made.address, (made.native_name, kept.code), raw)

    return decorate


class Callee(NamedTuple):
    """Addresses of a function and of the record that it works on; `keeps` keeps both in memory."""

    address: int
    context: int
    keeps: Any


def context_of(dtype: np.dtype[np.void], **values: Any) -> np.ndarray[Any, np.dtype[np.void]]:
    """Record of a dtype with these field values; an array given for a scalar field stores its address."""
    context = np.zeros((), dtype)
    for name, value in values.items():
        by_address = isinstance(value, np.ndarray) and not dtype[name].shape
        context[name] = data_at(value) if by_address else value
    return context


def of_python(function: Callable[..., int], *kinds: Any) -> tuple[int, Any]:
    """Address of a Python function of INTEGER and REAL, and the object that keeps it alive.

    The function must not raise: it returns FAILED instead, and keeps the error.
    """
    callback = ctypes.CFUNCTYPE(ctypes.c_int32, *(_C_TYPES[kind] for kind in kinds))(function)
    return ctypes.cast(callback, ctypes.c_void_p).value or 0, callback


def data_at(array: np.ndarray[Any, Any]) -> int:
    """Address of an array's data; the caller keeps the array alive while it uses the address."""
    return int(array.ctypes.data)


def record_at(argument: Any) -> Any:
    """Numba helper that views memory at an address, inside a kernel, as a record of a type."""

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.inttoptr(values[0], context.get_value_type(argument))

    return intrinsic(lambda _context, _address: (argument(types.int64), generate))


def _address_of(_context: Any, record: Any) -> Any:
    def generate(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        return builder.ptrtoint(values[0], ir.IntType(64))

    return types.int64(record), generate


address_of: Any = intrinsic(_address_of)
"""address_of(record): inside a kernel, its address."""


def records_at(argument: Any) -> Any:
    """Numba helper (address, shape) that views memory, inside a kernel, as an array of records or numbers."""
    to_elements = record_at(types.CPointer(argument))  # type: ignore[no-untyped-call]
    return helper(lambda address, shape: _carray(to_elements(address), shape))


reals_at: Callable[[int, int | tuple[int, int]], Array] = records_at(types.float64)
"""reals_at(address, shape): inside a kernel, the float64 vector or matrix at an address."""
integers_at: Callable[[int, int], Ints] = records_at(types.int64)
"""integers_at(address, count): inside a kernel, the int64 vector at an address."""


def _call(_context: Any, address: Any, arguments: Any) -> Any:
    def generate(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        given = [builder.extract_value(values[1], i) for i in range(len(arguments))]
        function = ir.FunctionType(ir.IntType(32), [value.type for value in given])
        return builder.call(builder.inttoptr(values[0], function.as_pointer()), given)

    return types.int32(address, arguments), generate


call: Any = intrinsic(_call)
"""call(address, arguments): inside a kernel, call the C function at an address with a tuple; returns a C int.

Integers pass unchanged, pointers as int64. A wrong address or argument crashes the process.
"""
