"""How kernels are compiled: Numba, at import, into a cache folder named after the sources.

Rule of the room: the only importer of Numba. Numba's own cache notices edits of the file that holds a
function, but not of the files whose functions and constants it uses; so each source file has a folder of
its own, keyed by the hash of that file and of all that it imports from this project.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import os
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba import types

_HERE = Path(__file__).resolve().parent
_PACKAGES = ("hil", "drivers")
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


def _file_of(module: str) -> Path | None:
    path = _HERE.parent.joinpath(*module.split("."))
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
def folder_of(source: Path) -> Path:
    """Return the cache folder of the kernels of one source file."""
    digest = hashlib.sha256(sys.version.encode())
    for path in sources_of(source):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return CACHE_FOLDER / f"{source.stem}-{digest.hexdigest()[:16]}"


def _has_to_compile() -> bool:
    """Return True if some source of kernels has nothing compiled yet."""
    return any(next(folder_of(path).glob("*/*.nbi"), None) is None for path in _kernel_sources())


def _kernel_sources() -> list[Path]:
    marked = re.compile(rb"^@kernel\(", re.MULTILINE)
    return [path for path in sorted(_HERE.rglob("*.py")) if marked.search(path.read_bytes())]


CACHE_FOLDER = cache_folder()
FIRST_COMPILATION = _has_to_compile()
"""True if the kernels are compiled now (some 20 s once) instead of loaded (0.5 s)."""

VECTOR = types.Array(types.float64, 1, "C", readonly=True)
"""Argument: any C-contiguous float64 vector, writeable or not."""
MATRIX = types.Array(types.float64, 2, "C", readonly=True)
"""Argument: any C-contiguous float64 matrix, writeable or not."""
OUT_VECTOR = types.Array(types.float64, 1, "C")
OUT_MATRIX = types.Array(types.float64, 2, "C")
"""Arguments that the kernel fills."""
REAL = types.float64
INTEGER = types.int64
# numpy's error model: division by zero gives inf or nan and never raises inside the loop.
_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": False}


def kernel(*arguments: Any) -> Callable[[F], F]:
    """Compile for exactly these argument types when the module is imported; other types are refused.

    Nothing can then be compiled inside the loop, whatever it is called with.
    """

    def decorate(function: F) -> F:
        settings = vars(numba.config)
        elsewhere = settings["CACHE_DIR"]
        settings["CACHE_DIR"] = str(folder_of(Path(inspect.getfile(function)).resolve()))
        try:
            return cast("F", numba.njit(arguments, **_OPTIONS)(function))
        finally:
            settings["CACHE_DIR"] = elsewhere

    return decorate


def helper(function: F) -> F:
    """Compile as a part of the kernels that call it."""
    return cast("F", numba.njit(error_model="numpy", fastmath=False)(function))
