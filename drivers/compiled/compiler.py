"""Compilation of kernels by Numba, at import, for one set of argument types, and those types."""

from __future__ import annotations

import functools
import operator
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba import extending, types
from numba.core import boxing, cgutils
from numba.core.registry import cpu_target
from numba.np import arrayobj, linalg
from numba.np.numpy_support import from_dtype

from drivers.compiled.library import Kept, Library

_numpy: Any = arrayobj
_tools: Any = cgutils
_extending: Any = extending
F = TypeVar("F", bound=Callable[..., Any])
_dispatchers: list[Any] = []
"""Dispatchers of kernels that are called by their entry; Numba keeps only weak references."""


def _no_blas() -> None:
    raise ImportError("kernels use no BLAS")


# Numba imports SciPy's BLAS there, which takes 0.1 to 0.3 s of each start
_ensure_blas, linalg.ensure_blas = linalg.ensure_blas, _no_blas
import_module("numba.np.arraymath")
linalg.ensure_blas = _ensure_blas

VECTOR = types.Array(types.float64, 1, "C", readonly=True)
"""Argument: any C-contiguous float64 vector, writeable or not."""
MATRIX = types.Array(types.float64, 2, "C", readonly=True)
"""Argument: any C-contiguous float64 matrix, writeable or not."""
OUT_VECTOR = types.Array(types.float64, 1, "C")
OUT_MATRIX = types.Array(types.float64, 2, "C")
INTEGERS = types.Array(types.int64, 1, "C", readonly=True)
OUT_INTEGERS = types.Array(types.int64, 1, "C")
WORDS = types.Array(types.int64, 1, "A", readonly=True, aligned=False)
"""Argument: integers at any stride, at any address."""
MATRIX_OF_INTEGERS = types.Array(types.int64, 2, "C", readonly=True)
OUT_FLAGS = types.Array(types.boolean, 1, "C")
OUT_INTEGER_MATRIX = types.Array(types.int64, 2, "C")
"""OUT_...: arguments that the kernel fills."""
DATA = types.Bytes(types.uint8, 1, "C", readonly=True)
"""Argument: `bytes`, such as the data of a frame."""
POINTER = types.CPointer(types.int64)  # type: ignore[no-untyped-call]
BYTE_POINTER = types.CPointer(types.uint8)  # type: ignore[no-untyped-call]
"""Arguments of a `pointed` function: any array, as int64 or bytes."""
REAL = types.float64
INTEGER = types.int64
BOOLEAN = types.boolean
# numpy's error model: division by zero gives inf or nan and never raises inside the loop.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": False, "no_cfunc_wrapper": True}


class RecordArgument(types.Record):
    """Numba type of an argument that is an element of a structured dtype, passed by address."""


def record(dtype: np.dtype[np.void], *names: str) -> Any:
    """Numba type of an argument: one element of a structured dtype, writeable, limited to the named columns.

    Without names all columns. Python callers pass a zero-dimensional array; only its size is checked.
    """
    seen: Any = from_dtype(dtype[list(names or dtype.names or ())])
    fields = [(name, field._asdict()) for name, field in seen.fields.items()]
    return RecordArgument(fields, seen.size, aligned=False)


def records(dtype: np.dtype[np.void]) -> Any:
    """Numba type of an argument: a one-dimensional array of a structured dtype, writeable or not."""
    return types.Array(record(dtype), 1, "C", readonly=True)


def _unbox(kind: Any, given: Any, c: Any) -> Any:
    whole: Any = types.Array(kind, 1, "C")
    seen: Any = boxing.unbox_array(whole, given, c)
    place = c.context.make_array(whole)(c.context, c.builder, seen.value).data
    c.context.nrt.decref(c.builder, whole, seen.value)
    return _extending.NativeValue(place, is_error=seen.is_error)


_extending.register_model(RecordArgument)(_extending.models.RecordModel)
_extending.unbox(RecordArgument)(_unbox)
# a column may be passed to a kernel that takes any array, without reference counting
_extending.lower_cast(types.NestedArray, types.Array)(lambda _context, _builder, _given, _taken, view: view)


def _assign(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Assignment to a slice or row inside a kernel, compiled to a memory move or a loop.

    Numba's own code copies arrays that may overlap and puts the shapes into its error message: some hundred
    instructions in each kernel. Other assignments, and those of other packages, remain Numba's.
    """
    array, index, values = signature.args
    fills = isinstance(values, types.Number | types.Boolean)
    dimensions = array.ndim - isinstance(index, types.Integer)
    copies = isinstance(values, types.Array) and (values.dtype, values.ndim) == (array.dtype, dimensions)
    whole = array.layout == getattr(values, "layout", "C") == "C" and not getattr(index, "has_step", False)
    ours = isinstance(array.dtype, types.Number) and context.codegen()._library_class is Library  # noqa: SLF001
    if not (ours and whole and dimensions and (fills or copies)):
        return _numpy.setitem_array(context, builder, signature, arguments)
    target = _numpy.make_array(array)(context, builder, arguments[0])
    place = _numpy.normalize_indices(context, builder, (index,), (arguments[1],))
    data, shape, _ = _numpy.basic_indexing(context, builder, array, target, *place)
    count = functools.reduce(builder.mul, shape)
    if fills:
        value = context.cast(builder, arguments[2], values, array.dtype)
        with _tools.for_range(builder, count) as loop:
            _numpy.store_item(context, builder, array, value, builder.gep(data, [loop.index]))
        return None
    source = _numpy.make_array(values)(context, builder, arguments[2])
    for own, other in zip(shape, _tools.unpack_tuple(builder, source.shape), strict=True):
        with builder.if_then(builder.icmp_signed("!=", own, other), likely=False):
            message = ("cannot assign an array of another shape to a slice",)
            context.call_conv.return_user_exc(builder, ValueError, message)
    size = context.get_abi_sizeof(context.get_data_type(array.dtype))
    _tools.raw_memmove(builder, data, source.data, count, size)
    return None


for _index in (types.SliceType, types.Integer):
    _extending.lower_builtin(operator.setitem, types.Array, _index, types.Any)(_assign)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Delay Ctrl-C and time-out signals to the end of the block: half a kernel would crash the process.

    A signal mask would not help: the operating system delivers the signal to any thread that does not block
    it.
    """
    held: list[int] = []
    handlers: dict[int, Any] = {}
    with suppress(ValueError):  # not the main thread, the only one that runs handlers
        for number in (signal.SIGINT, getattr(signal, "SIGALRM", signal.SIGINT)):  # Windows has none
            if callable(signal.getsignal(number)):
                handlers[number] = signal.signal(number, lambda given, _: held.append(given))
    try:
        yield
    finally:
        for restored, handler in handlers.items():
            signal.signal(restored, handler)
    if held:
        signal.raise_signal(held[0])


def compiled(made: Any, function: Callable[..., Any], *signature: Any) -> Kept:
    """Compile a Numba dispatcher's function for argument types `signature`, or load it from the cache."""
    made._cache = kept = Kept(function)  # noqa: SLF001 - Numba's own checks only the function's file
    codegen: Any = cpu_target.target_context.codegen()
    with undisturbed():
        codegen._library_class = Library  # noqa: SLF001 - overrides that of its class: code of other packages stays Numba's
        try:
            made.compile(*signature)
        finally:
            del codegen._library_class  # noqa: SLF001
    return kept


def kernel(*arguments: Any, unlocked: bool = False) -> Callable[[F], F]:
    """Decorator that compiles a function for exactly these argument types when its module is imported.

    So no call can compile anything inside the loop. `unlocked` releases the GIL during calls. A kernel of
    records returns numbers only; Numba then checks only the size of its arrays' elements: the caller is
    responsible for their type, order and dimensions.
    """

    def decorate(function: F) -> F:
        made: Any = numba.njit(nogil=unlocked, **OPTIONS)(function)
        if made is function:  # Numba is disabled
            return function
        compiled(made, function, arguments)
        made.disable_compile()
        elements = [each.dtype if isinstance(each, types.Array) else each for each in arguments]
        if not any(isinstance(each, RecordArgument) for each in elements):
            return cast("F", made)
        _dispatchers.append(made)
        (only,) = made.overloads.values()
        # Numba's dispatcher would look up the type of a record at each call, which takes 40 us
        cpu_target.typing_context.insert_global(only.entry_point, types.Dispatcher(made))
        return cast("F", only.entry_point)

    return decorate


def helper(function: F) -> F:
    """Decorator: compile the function as part of kernels that call it; Python calls it as it is."""
    return cast("F", _extending.register_jitable(**OPTIONS)(function))
