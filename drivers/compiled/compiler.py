"""How kernels are compiled: Numba, at import, into a cache folder named after the sources.

Numba's own cache notices edits of the file that holds a function, but not of the files whose functions and
constants it uses; so each source file has a folder of its own, keyed by the hash of that file and of all that
it imports from this project. Where the file lies does not count: a second clone or an installed wheel with
the same sources finds what is compiled.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import os
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, Self, TypeVar, cast

import numba
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from drivers.compiled.borrowed import borrowed, only_numbers

# Numba loads scipy.linalg for BLAS if it is there, a tenth of a command's start; no kernel may use BLAS.
sys.modules.setdefault("scipy.linalg.cython_blas", cast("ModuleType", None))
importlib.import_module("numba.np.arraymath")
if sys.modules["scipy.linalg.cython_blas"] is None:
    del sys.modules["scipy.linalg.cython_blas"]

_ROOT = Path(__file__).resolve().parents[2]
_EVERY_RUN = _ROOT / "hil" / "app" / "compose.py"
"""Imports what every run needs."""
_PACKAGES = ("drivers", "hil", "plant_fmu")
_IMPORT = re.compile(
    r"^from ([\w.]+) import \(?([^)\n]*(?:\n[^)\n]*)*?)(?:\)|\n)|^import ([\w.]+)", re.MULTILINE
)

F = TypeVar("F", bound=Callable[..., Any])


def cache_folder() -> Path:
    """Return the folder of all compiled kernels, created for the user alone.

    ``hexapod-hil`` under the first of ``$NUMBA_CACHE_DIR``, ``$XDG_CACHE_HOME`` and ``~/.cache`` that is set;
    where that cannot be written, a folder of this user under the temporary directory.
    """
    parent = (
        os.environ.get("NUMBA_CACHE_DIR")
        or os.environ.get("XDG_CACHE_HOME")
        or os.path.expanduser("~/.cache")  # noqa: PTH111 - Path.home raises where there is none
    )
    user = os.getuid() if hasattr(os, "getuid") else 0
    for folder in (Path(parent) / "hexapod-hil", Path(tempfile.gettempdir()) / f"hexapod-hil-{user}"):
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError:
            continue
        mine = not hasattr(os, "getuid") or folder.stat().st_uid == user  # who can write it can run code here
        if mine and os.access(folder, os.W_OK):
            return folder
    return Path(tempfile.mkdtemp(prefix="hexapod-hil-"))


@functools.cache
def _file_of(module: str) -> Path | None:
    path = _ROOT.joinpath(*module.split("."))
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if module.partition(".")[0] in _PACKAGES and candidate.is_file():
            return candidate
    return None


@functools.cache
def _imports(source: Path) -> frozenset[Path]:
    """Return the project's files that this one imports."""
    found = set()
    for module, names, plain in _IMPORT.findall(source.read_text(encoding="utf-8")):
        modules = [module or plain, *(f"{module}.{name}" for name in re.findall(r"\w+", names))]
        found |= {path for path in map(_file_of, modules) if path is not None}
    return frozenset(found)


def sources_of(source: Path) -> list[Path]:
    """Return the project's files that decide what ``source`` compiles to: it and all it imports."""
    seen: set[Path] = set()
    todo = [source.resolve()]
    while todo:
        path = todo.pop()
        if path not in seen:
            seen.add(path)
            todo += _imports(path)
    return sorted(seen)


@functools.cache
def _content(source: Path) -> bytes:
    """Return what differs where the content of a file does."""
    return hashlib.sha256(source.read_bytes()).digest()


@functools.cache
def folder_of(source: Path) -> Path:
    """Return the cache folder of the kernels of one source file."""
    digest = hashlib.sha256(sys.version.encode())
    for path in sources_of(source):
        digest.update(path.name.encode() + b"\0" + _content(path))
    return CACHE_FOLDER / f"{source.stem}-{digest.hexdigest()[:16]}"


def _has_to_compile() -> bool:
    """Return True if a source of kernels that every run imports has nothing compiled yet.

    What only an option needs is imported, and compiled, where that is taken.
    """
    marked = re.compile(rb"^@(kernel|direct)\(", re.MULTILINE)
    kernels = (path for path in sources_of(_EVERY_RUN) if marked.search(path.read_bytes()))
    return any(next(folder_of(path).glob("*.nbi"), None) is None for path in kernels)


class Locator:
    """Tells Numba where a function is kept and when it is out of date: the folder's name says both."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._folder = folder_of(Path(file).resolve())
        self._line = function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> Self:
        """Return the locator of a function of a file."""
        return cls(function, file)

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._folder)

    def get_source_stamp(self) -> str:
        """Return what differs where the sources do."""
        return self._folder.name

    def get_disambiguator(self) -> str:
        """Return what differs between functions of one name in one file."""
        return str(self._line)

    def ensure_cache_path(self) -> None:
        """Create the folder."""
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)


CACHE_FOLDER = cache_folder()
FIRST_COMPILATION = _has_to_compile()
"""True if the kernels are compiled now (some 45 s once) instead of loaded (0.5 s)."""

VECTOR = types.Array(types.float64, 1, "C", readonly=True)
"""Argument: any C-contiguous float64 vector, writeable or not."""
MATRIX = types.Array(types.float64, 2, "C", readonly=True)
"""Argument: any C-contiguous float64 matrix, writeable or not."""
OUT_VECTOR = types.Array(types.float64, 1, "C")
OUT_MATRIX = types.Array(types.float64, 2, "C")
INTEGERS = types.Array(types.int64, 1, "C", readonly=True)
OUT_INTEGERS = types.Array(types.int64, 1, "C")
BYTES = types.Array(types.uint8, 1, "C", readonly=True)
OUT_BYTES = types.Array(types.uint8, 1, "C")
FLAGS = types.Array(types.boolean, 1, "C", readonly=True)
OUT_FLAGS = types.Array(types.boolean, 1, "C")
OUT_INTEGER_MATRIX = types.Array(types.int64, 2, "C")
"""OUT_...: arguments that the kernel fills."""
DATA = types.Bytes(types.uint8, 1, "C", readonly=True)
"""Argument: `bytes`, as a frame has them."""
REAL = types.float64
INTEGER = types.int64
BOOLEAN = types.boolean
# numpy's error model: division by zero gives inf or nan and never raises inside the loop.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": False}


def kernel(*arguments: Any, unlocked: bool = False) -> Callable[[F], F]:
    """Compile for exactly these argument types when the module is imported; others are refused.

    Nothing can then be compiled inside the loop, whatever it is called with. `unlocked` lets other threads of
    the interpreter run meanwhile.
    """

    def decorate(function: F) -> F:
        settings = vars(numba.config)
        elsewhere = settings["CACHE_LOCATOR_CLASSES"]
        settings["CACHE_LOCATOR_CLASSES"] = f"{__name__}.{Locator.__name__}"
        try:
            compiled: Any = numba.njit(arguments, nogil=unlocked, **_OPTIONS)(function)
        finally:
            settings["CACHE_LOCATOR_CLASSES"] = elsewhere
        return cast("F", compiled)

    return decorate


def direct(*arguments: Any, unlocked: bool = False) -> Callable[[F], F]:
    """As `kernel`, for what the loop calls each tick: no dispatcher, arrays borrowed.

    See `drivers.compiled.borrowed`. It returns numbers only, and other kernels cannot call it. An array
    of another type raises TypeError.
    """

    def decorate(function: F) -> F:
        compiled: Any = kernel(*map(borrowed, arguments), unlocked=unlocked)(function)
        if not hasattr(compiled, "overloads"):  # where Numba is disabled
            return cast("F", compiled)
        (only,) = compiled.overloads.values()
        if not only_numbers(only.signature.return_type):
            raise TypeError(f"{function.__qualname__}: a direct kernel fills arrays and returns numbers")
        return cast("F", only.entry_point)

    return decorate


def helper(function: F) -> F:
    """Compile as a part of the kernels that call it."""
    return cast("F", numba.njit(error_model="numpy", fastmath=False)(function))


def _foreign(_context: Any, address: Any, arguments: Any) -> Any:
    def generate(_target: Any, builder: Any, _signature: Any, values: Any) -> Any:
        given = [builder.extract_value(values[1], i) for i in range(len(arguments))]
        function = ir.FunctionType(ir.IntType(32), [value.type for value in given])
        return builder.call(builder.inttoptr(values[0], function.as_pointer()), given)

    return types.int32(address, arguments), generate


foreign: Any = intrinsic(_foreign)
"""foreign(address, arguments): call, inside a kernel, the C function at `address` with a tuple of arguments.

It returns a C int. Integers pass as what they are, pointers as int64. As with ctypes, a wrong address or
argument crashes the process.
"""
