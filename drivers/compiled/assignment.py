"""Assignments to slices and rows inside kernels, compiled to a memory move or a loop.

Numba's own code copies arrays that may overlap and puts the shapes into its error message: some hundred
instructions in each kernel. Other assignments, and those of other packages, remain Numba's.
"""

from __future__ import annotations

import functools
import operator
from typing import Any

from numba import extending, types
from numba.core import cgutils
from numba.np import arrayobj

from drivers.compiled.library import Library

_numpy: Any = arrayobj
_tools: Any = cgutils
_extending: Any = extending


def _assign(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
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
