"""The machine code of a kernel, called by address: also in a process that does not import Numba (0.2 s).

Such a kernel takes pointers, POINTER and BYTE_POINTER of `drivers.compiled.compiler`, and returns nothing.
"""

from __future__ import annotations

import base64
import ctypes
from collections.abc import Callable, Sequence
from typing import Any


def machine_code(kernel: Any) -> list[str] | None:
    """Name and machine code of a kernel as text, for `loaded` in another process on this machine.

    None where Numba is disabled, or compiles for this process alone.
    """
    if not hasattr(kernel, "overloads"):
        return None
    (only,) = kernel.overloads.values()
    code = only.library.machine_code
    return [only.fndesc.llvm_func_name, base64.b64encode(code).decode()] if code else None


def loaded(text: Sequence[str]) -> Callable[..., None]:
    """Return the function, of C-contiguous arrays, that `machine_code` gave as text."""
    from llvmlite import binding  # noqa: PLC0415 - 20 ms

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    target = binding.Target.from_default_triple().create_target_machine(jit=True)
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), target)
    name, code = text
    engine.add_object_file(binding.ObjectFileRef.from_data(base64.b64decode(code)))
    engine.finalize_object()
    return _function(engine.get_function_address(name), engine)


def native(kernel: Any) -> Callable[..., None]:
    """Return the function, of C-contiguous arrays, that a kernel of this process is."""
    if not hasattr(kernel, "overloads"):  # where Numba is disabled
        return lambda *arrays: kernel(*[array.reshape(-1) for array in arrays])
    (only,) = kernel.overloads.values()
    return _function(only.library.get_pointer_to_function(only.fndesc.llvm_func_name), kernel)


def _function(address: int, owner: object) -> Callable[..., None]:
    returned, raised = ctypes.c_int64(), ctypes.c_int64()
    function = ctypes.CFUNCTYPE(ctypes.c_int)(address)

    def call(*arrays: Any, _owner: object = owner) -> None:
        addresses = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
        function(ctypes.byref(returned), ctypes.byref(raised), *addresses)

    return call
