"""How far the first compilation is: which kernel of how many, and the time left.

How many follows from the sources: the kernels of all files that a program imports, less those in the cache.
What a function imports counts for the program's own file only; where more comes, the total grows.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

from drivers.compiled import cache

_KERNEL = re.compile(r"^@(?:kernel|direct|pointed)\(", re.MULTILINE)


class Progress(NamedTuple):
    """Where a compilation is."""

    done: int
    """Kernels compiled by this process."""
    total: int
    """Kernels that it compiles, as far as that is known."""
    elapsed_s: float
    left_s: float
    """By the sizes of the sources to come and the pace until now; nan before the first kernel."""


class Compilation:
    """Counts the kernels that a process compiles.

    Mutable state: what is to come by file, when it began, how many are compiled.
    """

    def __init__(self, programs: Iterable[Path], tell: Callable[[Progress], None]) -> None:
        self._programs, self._tell = tuple(programs), tell
        self._left: dict[Path, int] = {}
        self._begun = self._done = 0
        self._worked = 0.0
        self._announced = False

    def begin(self) -> None:
        """Find what is to come, once, and tell."""
        if self._announced:
            return
        self._announced = True
        self._left = to_compile(self._programs)
        self._begun = time.monotonic_ns()
        self._tell(self._progress())

    def compiled(self, source: Path) -> None:
        """Count a kernel of a file."""
        self.begin()
        self._done += 1
        self._worked += _work(source)
        if self._left.get(source):
            self._left[source] -= 1
        self._tell(self._progress())

    def _progress(self) -> Progress:
        elapsed_s = 1e-9 * (time.monotonic_ns() - self._begun)
        to_do = sum(count * _work(source) for source, count in self._left.items())
        left_s = elapsed_s * to_do / self._worked if self._worked else float("nan")
        return Progress(self._done, self._done + sum(self._left.values()), elapsed_s, left_s)


def to_compile(programs: Iterable[Path]) -> dict[Path, int]:
    """Return the files with kernels that programs import, each with how many the cache has not."""
    found = {}
    begun = {*programs}.union(*map(cache.imports, programs))
    for source in {each for one in begun for each in cache.sources_of(one, inside=False)}:
        kernels = len(_KERNEL.findall(source.read_text(encoding="utf-8")))
        if kernels:
            kept = sum(1 for _ in cache.folder_of(source).glob("*.nbi"))
            found[source] = max(0, kernels - kept)
    return found


def _work(source: Path) -> float:
    """Return what a kernel of a file costs, in some unit: its share of the source, and a least one."""
    text = source.read_text(encoding="utf-8")
    return 2000.0 + len(text) / max(1, len(_KERNEL.findall(text)))
