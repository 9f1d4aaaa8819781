"""Array arguments that a kernel of the loop borrows from its caller.

Numba's extension interface and NumPy's C structures, nothing else. Numba's own array argument makes a memory
object that could outlive the call, 30 ns each where a kernel of the loop has forty of them. A borrowed one is
pointer, shape and strides, after a look at type, dimensions, order, alignment and permission to write;
whether it is long enough, the caller answers for.
"""

from __future__ import annotations

import functools
import sys
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import NativeValue, lower_cast, models, register_model, unbox
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import as_dtype

_TYPE = object.__basicsize__ - 8
_DATA, _NDIM, _SHAPE, _DTYPE, _FLAGS = (object.__basicsize__ + k for k in (0, 8, 16, 40, 48))
"""Where PyArrayObject_fields, part of NumPy's ABI, has them (strides and base lie between)."""
_NUMBER = object.__basicsize__ + 12
"""Where PyArray_Descr has the number of its type: behind typeobj, kind, type, byteorder, a byte of flags."""
_ORDER = object.__basicsize__ + 10
"""Where it has the byte order, one of _NATIVE."""
_NATIVE = "=|" + ("<" if sys.byteorder == "little" else ">")
_C_CONTIGUOUS, _ALIGNED, _WRITEABLE = 0x1, 0x100, 0x400
_NDARRAY = "hil_ndarray"

binding.add_symbol(_NDARRAY, id(np.ndarray))  # by name, so that cached machine code finds it in each process


class Borrowed(types.Array):
    """An array argument in C order that the kernel neither keeps nor returns."""

    def __init__(self, array: types.Array) -> None:
        super().__init__(array.dtype, array.ndim, "C", readonly=not array.mutable)

    def __reduce__(self) -> tuple[type[Borrowed], tuple[types.Array]]:
        """Pickle, for the cache, as it is made."""
        return Borrowed, (self.copy(),)


def _lend(_context: Any, _builder: Any, _given: Any, _taken: Any, view: Any) -> Any:
    """Hand a borrowed array on to a kernel that takes any: it is one, whose owner needs no counting."""
    return view


def borrowed(argument: Any) -> Any:
    """Return the type of an argument, borrowed if it is an array."""
    return Borrowed(argument) if isinstance(argument, types.Array) else argument


def only_numbers(result: Any) -> bool:
    """Tell whether a result holds nothing that could be a view of a borrowed array."""
    if isinstance(result, types.BaseTuple):
        members: Any = result
        return all(map(only_numbers, members.types))
    return isinstance(result, types.Number | types.Boolean | types.NoneType)


def _unbox(argument: Borrowed, given: Any, c: Any) -> NativeValue:
    """Check an object and make the kernel's view of it, or raise TypeError."""
    builder, dtype = c.builder, as_dtype(argument.dtype)
    byte, word, long = ir.IntType(8), ir.IntType(32), ir.IntType(64)

    def read(address: Any, offset: int, kind: Any) -> Any:
        place = builder.gep(builder.bitcast(address, byte.as_pointer()), [long(offset)])
        return builder.load(builder.bitcast(place, kind.as_pointer()))

    def one_of(value: Any, *expected: int) -> Any:
        found = [builder.icmp_unsigned("==", value, ir.Constant(value.type, each)) for each in expected]
        return functools.reduce(builder.or_, found)

    view = c.context.make_array(argument)(c.context, builder)
    ndarray = builder.bitcast(c.pyapi.get_c_object(_NDARRAY), byte.as_pointer())
    fits = cgutils.alloca_once_value(builder, ir.IntType(1)(0))  # type: ignore[no-untyped-call]
    with builder.if_then(builder.icmp_unsigned("==", read(given, _TYPE, byte.as_pointer()), ndarray)):
        described = read(given, _DTYPE, byte.as_pointer())
        needed = _C_CONTIGUOUS | _ALIGNED | (_WRITEABLE if argument.mutable else 0)
        numbers = {kind.num for kind in map(np.dtype, np.typecodes["AllInteger"] + "d?") if kind == dtype}
        looks = (
            one_of(read(given, _NDIM, word), argument.ndim),
            one_of(builder.and_(read(given, _FLAGS, word), word(needed)), needed),
            one_of(read(described, _NUMBER, word), *sorted(numbers)),
            one_of(read(described, _ORDER, byte), *map(ord, _NATIVE)),
        )
        same = functools.reduce(builder.and_, looks)
        builder.store(same, fits)
        with builder.if_then(same):
            sizes = read(given, _SHAPE, long.as_pointer())
            shape = [builder.load(builder.gep(sizes, [long(k)])) for k in range(argument.ndim)]
            strides = [long(dtype.itemsize)]
            for size in reversed(shape[1:]):
                strides.insert(0, builder.mul(strides[0], size))
            data = read(given, _DATA, c.context.get_data_type(argument.dtype).as_pointer())
            populate_array(view, data, shape, strides, dtype.itemsize, None)  # type: ignore[no-untyped-call]
    wrong = builder.not_(builder.load(fits))
    with builder.if_then(wrong, likely=False):
        c.pyapi.err_set_string("PyExc_TypeError", f"an argument of a kernel is no {argument}")
    value = view._getvalue()  # noqa: SLF001 - as every unboxing does
    return NativeValue(value, is_error=wrong)  # type: ignore[no-untyped-call]


def _register(extension: Any, *kinds: Any) -> Any:
    """Return Numba's decorator, of which nothing says its types."""
    return extension(*kinds)


_register(register_model, Borrowed)(models.ArrayModel)
_register(lower_cast, Borrowed, types.Array)(_lend)
_register(unbox, Borrowed)(_unbox)
