"""The pipeline through which Numba compiles kernels and helpers: one set of flags for what they call.

Numba keeps what a kernel calls by the types of its arguments and by all flags of the caller. Kernels, those
that let other threads run, functions by address and helpers differ in flags that say nothing of their
callees: each helper would be compiled once for each of these kinds, and all flags compared at each call.
"""

from __future__ import annotations

from typing import Any

from numba.core.compiler import Compiler, Flags

_OWN = ("no_compile", "no_cfunc_wrapper", "release_gil")
"""Flags of a kernel that its callees do not see."""


class _CalleeFlags(Flags):
    """What callees see. Mutable state: the hash, once it is known; the flags do not change."""

    _hash: int | None = None

    def __hash__(self) -> int:
        if self._hash is None:
            self._hash = super().__hash__()  # type: ignore[no-untyped-call]
        return self._hash

    def __eq__(self, other: object) -> bool:
        return self is other or bool(super().__eq__(other))  # type: ignore[no-untyped-call]


_callee_flags: list[_CalleeFlags] = []


class _CallerFlags(Flags):
    """Flags of a kernel or helper."""

    def copy(self) -> Flags:
        """Return the flags for callees: one object for all callers whose flags are equal but for _OWN."""
        shared: Any = _CalleeFlags(self)  # type: ignore[no-untyped-call]
        for name in _OWN:
            shared.discard(name)
        shared.no_cpython_wrapper = True
        for kept in _callee_flags:
            if kept == shared:
                return kept
        _callee_flags.append(shared)
        return shared  # type: ignore[no-any-return]


class KernelPipeline(Compiler):
    """Numba's own, with these flags."""

    def __init__(self, typing: Any, target: Any, library: Any, *given: Any) -> None:
        arguments, result, flags, names = given
        own = _CallerFlags(flags)  # type: ignore[no-untyped-call]
        super().__init__(typing, target, library, arguments, result, own, names)  # type: ignore[no-untyped-call]
