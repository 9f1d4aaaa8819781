"""Where compiled kernels and built FMUs are kept, and which of them are up to date.

Numba's own cache notices edits of the file that holds a function, but not of the files whose functions and
constants it uses; so each source file has a folder of its own, keyed by the hash of that file and of all that
it imports from this project. Where the file lies does not count: a second clone or an installed wheel with
the same sources finds what is compiled. What a process has imported before its source was saved anew is
compiled for that process alone.
"""

from __future__ import annotations

import functools
import hashlib
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from drivers.errors import RunError
from drivers.files import made_folder, own_folder

_ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("drivers", "hil", "plant_fmu")
_GAP = r"(?:[ \t]|\\\n)"
_IMPORT = re.compile(
    rf"(?:^|[;:])([ \t]*)(?:from{_GAP}+([\w.]+){_GAP}+)?import\b{_GAP}*"
    r"(\((?:[^()#]|#[^\n]*)*\)|(?:[^\n;#\\]|\\\n)*)",
    re.MULTILINE,
)
"""Indent, module and names; Python's parser would cost each start 0.2 s."""
_watching: list[Any] = []


def cache_folder() -> Path:
    """Return this user's cache folder, made for the user alone.

    ``hexapod-hil`` under ``$XDG_CACHE_HOME``, where that is an absolute path, else under ``~/.cache``; where
    that cannot be written or is not the user's alone, a folder of this user under the temporary directory.

    Raises RunError where that is none either: what is compiled would be lost, or another's would be run.
    """
    folder, refused = _cache_folder()
    if folder is None:
        raise RunError(
            f"no folder for what is compiled: {'; '.join(refused)}; set XDG_CACHE_HOME to one of your own"
        )
    return folder


def elsewhere() -> str:
    """Say why the cache lies under the temporary directory; empty where it does not."""
    folder, refused = _cache_folder()
    return f"{refused[0]}: what is compiled goes to {folder}" if refused else ""


def _cache_folder() -> tuple[Path | None, list[str]]:
    """Return the first folder that can be used, None without one, and why those before it cannot."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    # Path.home raises where there is none.
    parent = given if Path(given).is_absolute() else os.path.expanduser("~/.cache")  # noqa: PTH111
    user = os.getuid() if hasattr(os, "getuid") else 0
    refused = []
    for folder in (Path(parent) / "hexapod-hil", Path(tempfile.gettempdir()) / f"hexapod-hil-{user}"):
        try:
            own_folder(folder)
        except OSError as error:
            refused.append(f"{folder}: {error.strerror}")
            continue
        if os.access(folder, os.W_OK | os.X_OK):
            return folder, refused
        refused.append(f"{folder}: no right to write there")
    return None, refused


CACHE_FOLDER = cache_folder()


@functools.cache
def file_of(module: str) -> Path | None:
    """Return the file of a module of this project."""
    path = _ROOT.joinpath(*module.split("."))
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if module.partition(".")[0] in _PACKAGES and candidate.is_file():
            return candidate
    return None


@functools.cache
def imports(source: Path, *, inside: bool = True) -> frozenset[Path]:
    """Return the project's files that a source imports, those that its functions import too if `inside`."""
    modules = set()
    for indent, module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
        if indent and not inside:
            continue
        for name in re.findall(r"[\w.]+", re.sub(r"#[^\n]*", "", names)):
            modules |= {module, f"{module}.{name}"} if module else {name}
    return frozenset(path for path in map(file_of, modules) if path is not None)


@functools.cache
def sources_of(source: Path, *, inside: bool = True) -> tuple[Path, ...]:
    """Return the project's files that decide what ``source`` compiles to: it and all it imports."""
    seen: set[Path] = set()
    todo = [source.resolve()]
    while todo:
        path = todo.pop()
        if path not in seen:
            seen.add(path)
            todo += imports(path, inside=inside)
    return tuple(sorted(seen))


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


def _began_ns() -> int:
    """Return when this process began, ns since the epoch; where the system does not tell: now."""
    try:
        began = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        # This clock first: what passes until the next is read makes the process seem older, which is safe.
        now_ns = time.time_ns()
        since_boot_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        # In whole ticks of the clock, rounded down: this too makes the process seem older.
        return now_ns - since_boot_ns + began * 10**9 // os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, ValueError, IndexError):
        return time.time_ns()


_BEGAN_NS = _began_ns()


@functools.cache
def is_as_imported(source: Path) -> bool:
    """Tell whether a file and all it imports are what this process has read: none was written since it began.

    Else machine code of the old source could be kept under the hash of the new one, for good. A stamp of the
    future says nothing: the clock was set back.
    """
    folder_of(source)  # first: what is written after both has neither been hashed nor imported
    now_ns = time.time_ns()
    for path in sources_of(source):
        stat = path.stat()
        if any(_BEGAN_NS <= stamp <= now_ns for stamp in (stat.st_mtime_ns, stat.st_ctime_ns)):
            return False
    return True


def watch(compilation: Any) -> None:
    """Have `begin` called before a kernel that is compiled, and `compiled` with its file after it."""
    _watching[:] = [compilation]


def announce() -> None:
    """Say that a kernel is to be compiled instead of loaded."""
    for each in _watching:
        each.begin()


def compiled(source: Path) -> None:
    """Say that a kernel of a file was compiled."""
    for each in _watching:
        each.compiled(source)


class Locator:
    """Tells Numba where a function is kept and when it is out of date: the folder's name says both."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._folder = folder_of(Path(file).resolve())
        self._line = function.__code__.co_firstlineno
        if _watching and next(self._folder.glob("*.nbi"), None) is None:
            announce()

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
        made_folder(self._folder)
