"""Calls of a kernel as a function of its own: a caller neither compiles it again nor takes it in.

A kernel that calls another one is linked with it, and LLVM optimises both once more, which for the dynamics
takes longer than the caller itself. A call apart goes through a symbol, which each process binds when it
imports the kernel, before any that calls it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

from llvmlite import binding
from numba.core import cgutils
from numba.extending import intrinsic

from drivers.compiled.compiler import compiled_of

F = TypeVar("F", bound=Callable[..., Any])


def apart(kernel: F) -> F:
    """Return what calls a compiled kernel by its symbol, inside other kernels; elsewhere call the kernel."""
    compiled = compiled_of(kernel)
    if not hasattr(compiled, "overloads"):  # where Numba is disabled
        return kernel
    (only,) = compiled.overloads.values()
    arguments, result = only.signature.args, only.signature.return_type
    symbol = f"{compiled.__module__}.{compiled.__qualname__}"
    binding.add_symbol(symbol, only.library.get_pointer_to_function(only.fndesc.llvm_func_name))

    def typed(_context: Any, *_given: Any) -> Any:
        def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            convention = context.call_conv
            kind = convention.get_function_type(result, arguments)
            function = cgutils.get_or_insert_function(builder.module, kind, symbol)  # type: ignore[no-untyped-call]
            status, value = convention.call_function(builder, function, result, arguments, values)
            with cgutils.if_unlikely(builder, status.is_error):  # type: ignore[no-untyped-call]
                convention.return_status_propagate(builder, status)
            return value

        return result(*arguments), generate

    own = inspect.signature(compiled.py_func)
    context = inspect.Parameter("_context", inspect.Parameter.POSITIONAL_OR_KEYWORD)
    vars(typed)["__signature__"] = own.replace(parameters=[context, *own.parameters.values()])
    return cast("F", intrinsic(typed))
