"""Assignments to whole arrays and slices inside kernels, as the move of memory or the loop that they are.

Numba's own code for `into[:] = values` handles every index, copies what may overlap, and puts the shapes
into the message of its error: some hundred instructions, and its functions for strings, in each kernel. Here
are the cases in which target and values lie without gaps; what is left, and what others compile, is Numba's.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin
from numba.np import arrayobj

from drivers.compiled.lean_library import makes_lean_libraries

_numpy: Any = arrayobj
_tools: Any = cgutils


def _without_gaps(array: Any, indices: tuple[Any, ...]) -> bool:
    """Tell whether an index leaves one piece of an array: numbers, then at most one slice of step 1."""
    *first, last = indices
    is_last = isinstance(last, types.Integer) or (isinstance(last, types.SliceType) and not last.has_step)
    return array.layout == "C" and is_last and all(isinstance(each, types.Integer) for each in first)


def _is_copy(array: Any, indices: tuple[Any, ...], values: Any) -> bool:
    """Tell whether values are an array of the type and dimensions of the target."""
    numbers = sum(isinstance(each, types.Integer) for each in indices)
    same = isinstance(values, types.Array) and values.dtype == array.dtype
    return same and values.layout == "C" and values.ndim == array.ndim - numbers


def _assign(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    array, index, values = signature.args
    is_tuple = isinstance(index, types.BaseTuple)
    indices: Any = tuple(index) if is_tuple else (index,)
    numbers = isinstance(array.dtype, types.Number | types.Boolean)
    fills = isinstance(values, types.Number | types.Boolean)
    simple = makes_lean_libraries() and numbers and indices and _without_gaps(array, indices)
    if not simple or not (fills or _is_copy(array, indices, values)):
        return _numpy.setitem_array(context, builder, signature, arguments)
    given = _tools.unpack_tuple(builder, arguments[1], count=len(indices)) if is_tuple else (arguments[1],)
    target = _numpy.make_array(array)(context, builder, arguments[0])
    given = _numpy.normalize_indices(context, builder, indices, given)
    data, shape, _ = _numpy.basic_indexing(context, builder, array, target, *given)
    if fills:
        value = context.cast(builder, arguments[2], values, array.dtype)
        with _tools.for_range(builder, _count(builder, shape)) as loop:
            place = builder.gep(data, [loop.index])
            _numpy.store_item(context, builder, array, value, place)
        return None
    source = _numpy.make_array(values)(context, builder, arguments[2])
    extents = _tools.unpack_tuple(builder, source.shape, values.ndim)
    for own, other in zip(shape, extents, strict=True):
        with builder.if_then(builder.icmp_signed("!=", own, other), likely=False):
            message = ("cannot assign an array of another shape to a slice",)
            context.call_conv.return_user_exc(builder, ValueError, message)
    size = context.get_abi_sizeof(context.get_data_type(array.dtype))
    _tools.raw_memmove(builder, data, source.data, _count(builder, shape), size)
    return None


def _count(builder: Any, shape: Any) -> Any:
    count = ir.Constant(ir.IntType(64), 1)
    for extent in shape:
        count = builder.mul(count, extent)
    return count


_register: Any = lower_builtin
_register(operator.setitem, types.Array, types.Any, types.Any)(_assign)
