"""Atomic access, inside Numba kernels, to 8-byte words of memory that several processes share.

Each operation is sequentially consistent: neither processor nor compiler moves other accesses across it.
"""

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_ORDER = "seq_cst"
_WORD = 8


def _place(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    words = signature.args[0]
    array = context.make_array(words)(context, builder, values[0])
    return cgutils.get_item_pointer(context, builder, words, array, [values[1]])  # type: ignore[no-untyped-call]


def _load(_context: Any, words: Any, _index: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.load_atomic(_place(context, builder, signature, values), _ORDER, _WORD)

    return types.int64(words, types.int64), generate


def _replace(_context: Any, words: Any, _index: Any, _expected: Any, _new: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        place = _place(context, builder, signature, values)
        result = builder.cmpxchg(place, values[2], values[3], _ORDER, _ORDER)
        return builder.extract_value(result, 1)

    return types.boolean(words, types.int64, types.int64, types.int64), generate


def _change(operation: str) -> Any:
    def change(_context: Any, words: Any, _index: Any, _value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return builder.atomic_rmw(
                operation, _place(context, builder, signature, values), values[2], _ORDER
            )

        return types.int64(words, types.int64, types.int64), generate

    return change


load: Any = intrinsic(_load)
"""load(words, index): the word at an index."""
replace: Any = intrinsic(_replace)
"""replace(words, index, expected, new): set the word to `new` if it is `expected`; True if it was."""
store: Any = intrinsic(_change("xchg"))
"""store(words, index, value): set the word; returns its previous value."""
raise_to: Any = intrinsic(_change("max"))
"""raise_to(words, index, value): set the word to the larger of both; returns its previous value."""
lower_to: Any = intrinsic(_change("min"))
"""lower_to(words, index, value): set the word to the smaller of both; returns its previous value."""
