"""Records as arguments of kernels: one element of a structured dtype, of which a kernel sees some columns.

It is the address alone; `drivers.compiled.compiler.entry` looks at what is given. The record lives in its
owner's array, which the caller holds.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.core import boxing
from numba.extending import NativeValue, lower_cast, models, register_model, unbox
from numba.np.numpy_support import from_dtype


class RecordArgument(types.Record):
    """A record that a kernel may write; of: the dtype of the whole."""

    of: np.dtype[np.void]


def record_of(dtype: np.dtype[np.void], names: tuple[str, ...]) -> RecordArgument:
    """Return the type of a record with these columns of a dtype."""
    seen: Any = from_dtype(dtype[list(names)])
    fields = [(name, field._asdict()) for name, field in seen.fields.items()]
    record = RecordArgument(fields, seen.size, aligned=False)
    record.of = dtype
    return record


def _unbox(kind: Any, given: Any, c: Any) -> NativeValue:
    whole: Any = types.Array(kind, 1, "C")
    seen: Any = boxing.unbox_array(whole, given, c)
    place = c.context.make_array(whole)(c.context, c.builder, seen.value).data
    c.context.nrt.decref(c.builder, whole, seen.value)
    return NativeValue(place, is_error=seen.is_error)  # type: ignore[no-untyped-call]


def _lend(_context: Any, _builder: Any, _given: Any, _taken: Any, view: Any) -> Any:
    """Hand a column on to a kernel that takes any array: its owner needs no counting."""
    return view


def _register(extension: Any, *kinds: Any) -> Any:
    """Return Numba's decorator, of which nothing says its types."""
    return extension(*kinds)


_register(register_model, RecordArgument)(models.RecordModel)
_register(unbox, RecordArgument)(_unbox)
_register(lower_cast, types.NestedArray, types.Array)(_lend)
