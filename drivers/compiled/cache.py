"""Which file a compiled kernel is kept in: its folder has the hash of all sources that the kernel may use.

These are the sources of its room and of the rooms below; of a module outside the project those of its package
and of all rooms. Where they lie does not count: a second clone or an installed wheel finds what is compiled.
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
"""Rooms with kernels, and those next below that their kernels use; a room inside another comes behind it."""
_PLACES = {
    room: (f"{_ROOT / room.replace('.', '/')}/", f"{_ROOT / room.replace('.', '/')}.py") for room in ROOMS
}
_SOURCES = {".py", ".dbc", ".eds"}
_EARLIER_NS = 50_000_000
"""By which a source may be read before this package is imported, or the stamp of a file be late."""


def _room_of(file: Path) -> str | None:
    return next((room for room in reversed(_PLACES) if str(file).startswith(_PLACES[room])), None)


@functools.cache
def files_of(room: str) -> frozenset[Path]:
    """Return the sources of a room and of those below."""
    path = _ROOT / room.replace(".", "/")
    own = [each for each in [*path.rglob("*"), path.with_suffix(".py")] if _room_of(each) == room]
    return frozenset(filter(_is_source, own)).union(*map(files_of, ROOMS[room]))


def _is_source(file: Path) -> bool:
    return file.suffix in _SOURCES and file.is_file()  # editors leave links there that lead nowhere


@functools.cache
def _sources_of(file: Path) -> frozenset[Path]:
    """Return the sources that decide what the kernels of a file compile to."""
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
    """Return the folder of the kernels of a file; None where this process may have read another source."""
    digest = hashlib.sha256(sys.version.encode())
    for each in sorted(_sources_of(file)):
        digest.update(_content(each))
    return CACHE_FOLDER / f"kernels-{digest.hexdigest()[:16]}" if is_as_read(file) else None


def is_as_read(file: Path) -> bool:
    """Tell whether no source of a file's kernels was saved since this process began to read them.

    Else machine code of the old source could be kept under the hash of the new one. A stamp of the future
    tells nothing: the clock was set back.
    """
    began_ns, now_ns = BEGAN_NS - _EARLIER_NS, time.time_ns()
    return not any(began_ns <= each.stat().st_ctime_ns <= now_ns for each in _sources_of(file))


def place_of(function: Callable[..., Any], kind: str) -> Path | None:
    """Return where a kernel is kept that is compiled for `kind`; None: nowhere."""
    file = source_of(function)
    folder = _folder_of(file)
    if folder is None or function.__closure__:
        return None
    name = f"{function.__module__}.{function.__qualname__}-{function.__code__.co_firstlineno}"
    return folder / f"{name}-{hashlib.sha256(kind.encode() + _content(file)).hexdigest()[:8]}.kernel"


def source_of(function: Callable[..., Any]) -> Path:
    """Return the file of a function."""
    return Path(function.__code__.co_filename).resolve()


def progress(compiling: bool) -> None:
    """Take note that a kernel is about to be compiled, or was; who shows that replaces this function."""
