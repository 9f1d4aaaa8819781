"""The machine code of a function, for a process that does not import Numba (0.2 s)."""

from __future__ import annotations

import base64
import ctypes
from collections.abc import Callable, Sequence
from typing import Any


def machine_code(function: Any) -> list[str]:
    """Name and machine code of a `pointed` function of arrays as text, for `loaded` on this machine."""
    name, code = function.machine_code
    return [name, base64.b64encode(code).decode()]


def loaded(text: Sequence[str]) -> Callable[..., int]:
    """Return the function, of C-contiguous arrays, that `machine_code` gave as text."""
    from llvmlite import binding  # noqa: PLC0415 - 20 ms

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple().create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), target)
    name, code = text
    engine.add_object_file(binding.ObjectFileRef.from_data(base64.b64decode(code)))
    engine.finalize_object()
    function = ctypes.CFUNCTYPE(ctypes.c_int32)(engine.get_function_address(name))

    def call(*arrays: Any, _engine: object = engine) -> int:
        return int(function(*[ctypes.c_void_p(array.ctypes.data) for array in arrays]))

    return call
