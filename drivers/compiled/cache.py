"""Place of a compiled kernel in the cache: its folder name is a hash of all sources that the kernel may use.

These are the sources of the kernel's package and of the packages below; for a module outside the project
those of its package and of all of ours. Their location does not count: a second clone or an installed wheel
finds the compiled kernels.
"""

from __future__ import annotations

import functools
import hashlib
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drivers import BEGAN_NS
from drivers.files import cache_folder

CACHE_FOLDER = cache_folder()
_ROOT = Path(__file__).resolve().parents[2]
ROOMS = {
    "drivers": (),
    "drivers.can": ("drivers",),
    "drivers.cia402": ("drivers",),
    "drivers.mit": ("drivers",),
    "drivers.moteus": ("drivers.can",),
    "drivers.odrive": ("drivers",),
    "plant_fmu": ("drivers.cia402", "drivers.mit", "drivers.moteus", "drivers.odrive"),
    "hil.config": ("drivers",),
    "hil.signals": ("drivers",),
    "hil.mathematics": ("drivers",),
    "hil.robot": ("hil.mathematics",),
    "hil.study.workspace": ("hil.robot",),
    "hil.design.stability": ("hil.robot", "hil.control", "hil.safety"),
    "hil.trajectory": ("hil.config", "hil.mathematics"),
    "hil.control": ("hil.robot", "hil.trajectory"),
    "hil.estimation": ("hil.config", "hil.robot"),
    "hil.safety": ("hil.config", "hil.mathematics"),
    "hil.record": ("drivers.can", "hil.robot", "hil.signals", "hil.trajectory"),
    "hil.loop": ("hil.control", "hil.estimation", "hil.safety", "hil.record"),
    "hil.app": ("hil.loop", "plant_fmu"),
}
"""Rooms with kernels, and the rooms next below that their kernels use; a room inside another comes after it.
"""
_PLACES = {
    room: (f"{_ROOT / room.replace('.', '/')}/", f"{_ROOT / room.replace('.', '/')}.py") for room in ROOMS
}
_SOURCES = {".py", ".dbc", ".eds"}
_EARLIER_NS = 50_000_000
"""Tolerance: a source may be read before this package is imported, and a file's time stamp may be late."""


def _room_of(file: Path) -> str | None:
    return next((room for room in reversed(_PLACES) if str(file).startswith(_PLACES[room])), None)


@functools.cache
def files_of(room: str) -> frozenset[Path]:
    """Source files of a package of this project and of the packages that it may import."""
    path = _ROOT / room.replace(".", "/")
    own = [each for each in [*path.rglob("*"), path.with_suffix(".py")] if _room_of(each) == room]
    return frozenset(filter(_is_source, own)).union(*map(files_of, ROOMS[room]))


def _is_source(file: Path) -> bool:
    return file.suffix in _SOURCES and file.is_file()  # editors leave links there that lead nowhere


@functools.cache
def _sources_of(file: Path) -> frozenset[Path]:
    room = _room_of(file)
    if room:
        return files_of(room)
    top = file.parent
    while (top.parent / "__init__.py").exists():
        top = top.parent
    own = top.rglob("*.py") if (top / "__init__.py").exists() else top.glob("*.py")
    return frozenset(filter(_is_source, own)).union(*map(files_of, ROOMS))


@functools.cache
def _content(file: Path) -> bytes:
    return file.name.encode() + hashlib.sha256(file.read_bytes()).digest()


@functools.cache
def _folder_of(file: Path) -> Path | None:
    """Cache folder for the kernels of a file; None if this process may have read an older source."""
    digest = hashlib.sha256(sys.version.encode())
    for each in sorted(_sources_of(file)):
        digest.update(_content(each))
    return CACHE_FOLDER / f"kernels-{digest.hexdigest()[:16]}" if is_as_read(file) else None


def is_as_read(file: Path) -> bool:
    """True if no source of a file's kernels was changed since this process began to read them.

    Otherwise machine code of the old source could be stored under the hash of the new one. A time stamp in
    the future is ignored: the clock was set back.
    """
    began_ns, now_ns = BEGAN_NS - _EARLIER_NS, time.time_ns()
    return not any(began_ns <= each.stat().st_ctime_ns <= now_ns for each in _sources_of(file))


def place_of(function: Callable[..., Any], kind: str) -> Path | None:
    """Cache file of a kernel; kind: its argument types and Numba version; None if it cannot be cached."""
    file = source_of(function)
    folder = _folder_of(file)
    if folder is None or function.__closure__:
        return None
    name = f"{function.__module__}.{function.__qualname__}-{function.__code__.co_firstlineno}"
    return folder / f"{name}-{hashlib.sha256(kind.encode() + _content(file)).hexdigest()[:8]}.kernel"


def source_of(function: Callable[..., Any]) -> Path:
    """Python file in which a function is defined."""
    return Path(function.__code__.co_filename).resolve()


def progress(compiling: bool) -> None:
    """Called with True before a kernel is compiled and False after; replaceable, to show progress."""
