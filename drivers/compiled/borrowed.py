"""Arguments that a kernel of the loop borrows from its caller: arrays, and records of a known type.

Numba's own array argument makes a memory object that could outlive the call, 30 ns each. A borrowed one is
pointer, shape and strides, after a look at type, dtype, dimensions, order and permission to write;
whether it is long enough, the caller answers for. A borrowed record is the pointer alone: its dtype says
where each column is, and a kernel sees those that it names.
"""

from __future__ import annotations

import functools
import sys
import zlib
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import NativeValue, lower_cast, models, register_model, unbox
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import as_dtype, from_dtype

_TYPE = object.__basicsize__ - 8
_DATA, _NDIM, _SHAPE, _DTYPE, _FLAGS = (object.__basicsize__ + k for k in (0, 8, 16, 40, 48))
"""Where PyArrayObject_fields, part of NumPy's ABI, has them (strides and base lie between)."""
_NUMBER, _ORDER = object.__basicsize__ + 12, object.__basicsize__ + 10
"""Where PyArray_Descr has the number of its type, and its byte order, one of _NATIVE."""
_NATIVE = "=|" + ("<" if sys.byteorder == "little" else ">")
_C_CONTIGUOUS, _ALIGNED, _WRITEABLE = 0x1, 0x100, 0x400
_BYTE, _INT, _LONG = ir.IntType(8), ir.IntType(32), ir.IntType(64)


_named: dict[str, Any] = {}


def _symbol(name: str, thing: Any) -> str:
    """Name an object to compiled code, so that cached machine code finds it in each process.

    The first one stays: a dtype that comes out of the cache equals it and is another object.
    """
    if name not in _named:
        _named[name] = thing
        binding.add_symbol(name, id(thing))
    return name


_NDARRAY = _symbol("hil_ndarray", np.ndarray)


class Borrowed(types.Array):
    """An array argument in C order that the kernel neither keeps nor returns."""

    def __init__(self, array: types.Array) -> None:
        super().__init__(array.dtype, array.ndim, "C", readonly=not array.mutable)
        self.label = str(self)

    def __reduce__(self) -> tuple[type[Borrowed], tuple[types.Array]]:
        """Pickle, for the cache, as it is made."""
        return Borrowed, (self.copy(),)


class BorrowedRecord(types.Record):
    """One element of a structured dtype, of which the kernel sees the columns `names` alone."""

    ndim, mutable = 0, True

    def __init__(self, dtype: np.dtype[np.void], names: tuple[str, ...]) -> None:
        seen: Any = from_dtype(dtype[list(names)])
        self._made_of = dtype, names
        self.symbol = _symbol(f"hil_dtype_{zlib.crc32(repr(dtype).encode())}", dtype)
        self.label = f"record of {len(dtype.names or ())} columns from {names[0]} on, {dtype.itemsize} bytes"
        super().__init__([(name, field._asdict()) for name, field in seen.fields.items()], seen.size, False)

    def __reduce__(self) -> tuple[type[BorrowedRecord], tuple[np.dtype[np.void], tuple[str, ...]]]:
        """Pickle, for the cache, as it is made."""
        return BorrowedRecord, self._made_of


def _lend(_context: Any, _builder: Any, _given: Any, _taken: Any, view: Any) -> Any:
    """Hand a borrowed array, or a column, on to a kernel that takes any: its owner needs no counting."""
    return view


def borrowed(argument: Any) -> Any:
    """Return the type of an argument, borrowed if it is an array."""
    return Borrowed(argument) if isinstance(argument, types.Array) else argument


def only_numbers(result: Any) -> bool:
    """Tell whether a result holds nothing that could be a view of a borrowed argument."""
    if isinstance(result, types.BaseTuple):
        members: Any = result
        return all(map(only_numbers, members.types))
    return isinstance(result, types.Number | types.Boolean | types.NoneType)


def _read(builder: Any, address: Any, offset: int, kind: Any) -> Any:
    place = builder.gep(builder.bitcast(address, _BYTE.as_pointer()), [_LONG(offset)])
    return builder.load(builder.bitcast(place, kind.as_pointer()))


def _unbox(argument: Any, given: Any, c: Any) -> NativeValue:
    """Look at an object, and return what the kernel sees of it, or raise TypeError."""
    builder = c.builder
    needed = _C_CONTIGUOUS | _ALIGNED | (_WRITEABLE if argument.mutable else 0)

    def one_of(value: Any, *expected: int) -> Any:
        found = [builder.icmp_unsigned("==", value, ir.Constant(value.type, each)) for each in expected]
        return functools.reduce(builder.or_, found)

    def is_object(offset: int, name: str) -> Any:
        expected = builder.bitcast(c.pyapi.get_c_object(name), _BYTE.as_pointer())
        return builder.icmp_unsigned("==", _read(builder, given, offset, _BYTE.as_pointer()), expected)

    def is_dtype() -> Any:
        """Compare the dtype: records have one object for it, an array's may be any that says the same."""
        of = argument.dtype if isinstance(argument, types.Array) else argument
        if isinstance(of, BorrowedRecord):
            return is_object(_DTYPE, of.symbol)
        dtype, described = as_dtype(argument.dtype), _read(builder, given, _DTYPE, _BYTE.as_pointer())
        numbers = {kind.num for kind in map(np.dtype, np.typecodes["AllInteger"] + "d?") if kind == dtype}
        number = one_of(_read(builder, described, _NUMBER, _INT), *sorted(numbers))
        return builder.and_(number, one_of(_read(builder, described, _ORDER, _BYTE), *map(ord, _NATIVE)))

    empty = c.context.get_constant_null(argument)
    view = cgutils.alloca_once_value(builder, empty)  # type: ignore[no-untyped-call]
    fits = cgutils.alloca_once_value(builder, ir.IntType(1)(0))  # type: ignore[no-untyped-call]
    with builder.if_then(is_object(_TYPE, _NDARRAY)):
        looks = (
            is_dtype(),
            one_of(_read(builder, given, _NDIM, _INT), argument.ndim),
            one_of(builder.and_(_read(builder, given, _FLAGS, _INT), _INT(needed)), needed),
        )
        same = functools.reduce(builder.and_, looks)
        builder.store(same, fits)
        with builder.if_then(same):
            builder.store(_view(argument, given, c), view)
    wrong = builder.not_(builder.load(fits))
    with builder.if_then(wrong, likely=False):
        c.pyapi.err_set_string("PyExc_TypeError", f"an argument of a kernel is no {argument.label}")
    return NativeValue(builder.load(view), is_error=wrong)  # type: ignore[no-untyped-call]


def _view(argument: Any, given: Any, c: Any) -> Any:
    """Return a record's address, or an array's pointer, shape and strides."""
    builder = c.builder
    if isinstance(argument, types.Record):
        return _read(builder, given, _DATA, c.context.get_value_type(argument))
    size = c.context.get_abi_sizeof(c.context.get_data_type(argument.dtype))
    sizes = _read(builder, given, _SHAPE, _LONG.as_pointer())
    shape = [builder.load(builder.gep(sizes, [_LONG(k)])) for k in range(argument.ndim)]
    strides = [_LONG(size)]
    for extent in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], extent))
    data = _read(builder, given, _DATA, c.context.get_data_type(argument.dtype).as_pointer())
    array = c.context.make_array(argument)(c.context, builder)
    populate_array(array, data, shape, strides, size, None)  # type: ignore[no-untyped-call]
    return array._getvalue()  # noqa: SLF001 - as every unboxing does


def _register(extension: Any, *kinds: Any) -> Any:
    """Return Numba's decorator, of which nothing says its types."""
    return extension(*kinds)


_register(register_model, Borrowed)(models.ArrayModel)
_register(register_model, BorrowedRecord)(models.RecordModel)
_register(lower_cast, Borrowed, types.Array)(_lend)
_register(lower_cast, types.NestedArray, types.Array)(_lend)
_register(unbox, Borrowed)(_unbox)
_register(unbox, BorrowedRecord)(_unbox)
