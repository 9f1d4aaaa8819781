"""How compiled kernels lie in the cache: machine code and the names it defines; LLVM's bitcode waits aside.

Numba parses the bitcode of each kernel that it loads, for the names in it and for kernels that may inline it.
The names are kept beside the code, and the bitcode is parsed when a kernel that calls this one is compiled;
else half of the time in which kernels are loaded would go there.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

_KIND = "machine code, names, bitcode"


class LeanLibrary(JITCodeLibrary):
    """The machine code of one kernel. Mutable state: the bitcode, until it is parsed."""

    _bitcode: bytes | None = None
    machine_code = b""
    """As the cache keeps it; empty where it does not."""

    def _get_module_for_linking(self) -> Any:
        """Return the kernel as LLVM has it, for a kernel that inlines it."""
        if self._bitcode is not None:
            self._shared_module = binding.parse_bitcode(self._bitcode)
            self._bitcode = None
        return super()._get_module_for_linking()  # type: ignore[no-untyped-call]

    def serialize_using_object_code(self) -> tuple[str, str, tuple[bytes, tuple[str, ...], bytes]]:
        """Return what the cache keeps."""
        name, _, (code, bitcode) = super().serialize_using_object_code()  # type: ignore[no-untyped-call]
        self.machine_code, module = code, self._get_module_for_linking()
        named = [*module.functions, *module.global_variables]
        return name, _KIND, (code, tuple(each.name for each in named if not each.is_declaration), bitcode)

    @classmethod
    def _unserialize(cls, codegen: Any, state: tuple[str, str, Any]) -> Any:
        """Load what the cache kept."""
        name, kind, data = state
        if kind != _KIND:
            return super()._unserialize(codegen, state)  # type: ignore[no-untyped-call]
        library = codegen.create_library(name)
        code, names, library._bitcode = data  # noqa: SLF001
        library.machine_code = code
        library.enable_object_caching()
        library._set_compiled_object(code)  # noqa: SLF001
        library._finalize_final_module()  # noqa: SLF001
        codegen._engine._defined_symbols.update(names)  # noqa: SLF001
        return library


@contextlib.contextmanager
def lean_libraries() -> Iterator[None]:
    """Compile and load kernels as LeanLibrary meanwhile; what others compile with Numba is not touched."""
    codegen = cpu_target.target_context.codegen()
    codegen._library_class = LeanLibrary  # noqa: SLF001 - over the attribute of its class
    try:
        yield
    finally:
        del codegen._library_class  # noqa: SLF001


def makes_lean_libraries() -> bool:
    """Tell whether what is compiled now is a kernel of this project."""
    return cpu_target.target_context.codegen()._library_class is LeanLibrary  # noqa: SLF001
