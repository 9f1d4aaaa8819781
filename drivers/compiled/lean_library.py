"""How kernels are linked, and lie in the cache: machine code, its names, and LLVM's bitcode set aside.

Numba optimises each helper by itself and makes machine code of it, which nobody calls, and optimises it once
more in each of its callers. Here a helper is linked as it was lowered: all that a kernel holds is optimised
once, in the kernel.

Numba parses the bitcode of each kernel that it loads, for the names in it and for kernels that may inline it.
The names are kept beside the code, and the bitcode is parsed when a kernel that calls this one is compiled;
else half of the time in which kernels are loaded would go there.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator
from typing import Any

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

_KIND = "machine code, names, bitcode"


class LeanLibrary(JITCodeLibrary):
    """One kernel or helper. Mutable state: a kernel's bitcode, until it is parsed; what is linked to it."""

    _bitcode: bytes | None = None
    machine_code = b""
    """As the cache keeps it; empty where it does not."""

    def add_linking_library(self, library: Any) -> None:
        """Link another one to it, at the end."""
        self._reload_init.update(library._reload_init)  # noqa: SLF001
        self._linking_libraries.append(library)

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function of a kernel. A helper has none that anybody calls: 0."""
        own: Any = self._final_module
        if self._finalized or any(each.name == name for each in own.functions):
            return int(super().get_pointer_to_function(name))  # type: ignore[no-untyped-call]
        return 0

    def _get_module_for_linking(self) -> Any:
        """Return the kernel, or the helper, as LLVM has it, for a kernel that inlines it."""
        if self._bitcode is not None:
            self._shared_module = binding.parse_bitcode(self._bitcode)
            self._bitcode = None
        if self._finalized:
            return super()._get_module_for_linking()  # type: ignore[no-untyped-call]
        if self._shared_module is None:
            module = self._final_module.clone()
            for each in dict.fromkeys(self._linking_libraries):
                module.link_in(each._get_module_for_linking(), preserve=True)  # noqa: SLF001
            for function in module.functions:
                if not function.is_declaration and function.linkage == binding.Linkage.external:
                    function.linkage = "linkonce_odr"
            self._shared_module = module
        return self._shared_module

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


def _set_environment(codegen: Any, name: str, environment: Any) -> None:
    """Give a kernel its environment, as Numba does; a helper has no machine code that could hold one."""
    if codegen._engine.get_global_value_address(name):  # noqa: SLF001
        type(codegen).set_env(codegen, name, environment)


@contextlib.contextmanager
def lean_libraries() -> Iterator[None]:
    """Compile and load kernels as LeanLibrary meanwhile; what others compile with Numba is not touched."""
    codegen: Any = cpu_target.target_context.codegen()
    codegen._library_class = LeanLibrary  # noqa: SLF001 - over the attribute of its class
    codegen.set_env = functools.partial(_set_environment, codegen)
    try:
        yield
    finally:
        del codegen._library_class  # noqa: SLF001
        del codegen.set_env


def makes_lean_libraries() -> bool:
    """Tell whether what is compiled now is a kernel of this project."""
    return cpu_target.target_context.codegen()._library_class is LeanLibrary  # noqa: SLF001
