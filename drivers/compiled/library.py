"""Linking and caching of kernels: machine code, the names in it, and LLVM's bitcode apart.

Numba optimises each helper alone, makes machine code of it, which nobody calls, and optimises it again in
each of its callers. Here a helper is linked as it was lowered, and optimised once, in the kernel.

Numba parses the bitcode of each kernel that it loads, for the names in it and for kernels that may inline it.
Here the names are stored, and the bitcode is parsed when a kernel that calls this one is compiled.
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
from collections.abc import Callable
from typing import Any

from llvmlite import binding
from numba import __version__
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompileResult

from drivers.compiled import cache
from drivers.files import made_folder, whole_file

# ruff: noqa: SLF001 - Numba has no public interface for this

_DIGEST = hashlib.sha256().digest_size
_ENTRIES = "_ZN7cpython", "cfunc."
"""Prefixes of the names of functions that Python or C calls."""


class Library(JITCodeLibrary):
    """Numba code library of a kernel or helper. Mutable state: bitcode, linked libraries."""

    bitcode = b""
    _helps = False
    codegen = property(lambda library: library)
    """Object whose `set_env` Numba calls."""

    def finalize(self) -> None:
        """Link a kernel to machine code; a helper, never called from Python or C, is kept as bitcode."""
        if any(each.name.startswith(_ENTRIES) for each in self._final_module.functions):
            super().finalize()  # type: ignore[no-untyped-call]
            return
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = self._helps = True

    def set_env(self, name: str, environment: Any) -> None:
        """Set a kernel's Numba environment; a helper has no machine code that could refer to one."""
        if not self._helps:
            self._codegen.set_env(name, environment)  # type: ignore[attr-defined]

    def _get_module_for_linking(self) -> Any:
        if self.bitcode:
            self._shared_module, self.bitcode = binding.parse_bitcode(self.bitcode), b""
        return super()._get_module_for_linking()  # type: ignore[no-untyped-call]

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        name, code, names, bitcode = state
        library = codegen.create_library(name)
        library.bitcode = bitcode
        library.enable_object_caching()
        library._set_compiled_object(code)
        library._finalize_final_module()
        codegen._engine._defined_symbols.update(names)
        return library


class Kept:
    """Cache of one kernel, with the interface that Numba expects. Mutable state: its machine code."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        self.code = b""

    def load_overload(self, signature: Any, target: Any) -> CompileResult | None:
        """Load the compiled kernel from its file; None if the file is missing or damaged."""
        target.refresh()
        file = self._file(signature, target)
        try:
            kept = file.read_bytes() if file else b""
            whole = hashlib.sha256(kept[_DIGEST:]).digest() == kept[:_DIGEST]
            library, rest = pickle.loads(kept[_DIGEST:] if whole else b"")  # noqa: S301 - of this user alone
            self.code = library[1]
        except Exception:  # noqa: BLE001 - whatever a damaged file raises
            cache.progress(True)
            return None
        return CompileResult._rebuild(target, library, *rest)  # type: ignore[no-untyped-call, no-any-return]

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store the compiled kernel, unless a source changed meanwhile or the file cannot be written."""
        names = [each.name for each in result.library.get_defined_functions()]
        (name, _, (self.code, bitcode)), *rest = result._reduce()
        file = self._file(signature, result.target_context)
        if file and cache.is_as_read(cache.source_of(self._function)):
            with contextlib.suppress(OSError), whole_file(made_folder(file.parent) / file.name) as new:
                kept = pickle.dumps(((name, self.code, names, bitcode), rest))
                new.write_bytes(hashlib.sha256(kept).digest() + kept)
        cache.progress(False)

    def _file(self, signature: Any, target: Any) -> Any:
        return cache.place_of(self._function, f"{signature} {__version__} {target.codegen().magic_tuple()}")
