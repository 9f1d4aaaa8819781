"""Progress of the first compilation: which kernel it is at, and how long that may take."""

import re
import sys
import time
from functools import cached_property

import click

from drivers.cache_folder import elsewhere
from drivers.compiled.cache import ROOMS, files_of, watch
from drivers.terminal_row import rewriting

EVERY_S = 10.0
"""From one plain line to the next."""
_KERNEL = re.compile(r"^@(?:kernel|pointed)\(|= (?:kernel|pointed)\(", re.MULTILINE)


def show_compilation() -> None:
    """Say on standard error how far the compilation is, if this process compiles anything."""
    watch(Display().show)


class Display:
    """Where a compilation is. Mutable state: how many kernels it has begun; when a plain line is due."""

    def __init__(self) -> None:
        self._begun, self._due_s = 0, 0.0

    @cached_property
    def _most(self) -> int:
        files = frozenset().union(*map(files_of, ROOMS))
        return sum(len(_KERNEL.findall(each.read_text(encoding="utf-8"))) for each in files)

    def show(self, compiling: bool) -> None:
        """Before a kernel is compiled and after it: write a row that goes with it, or a line now and then."""
        if compiling and not self._begun and elsewhere():
            click.echo(f"hil: {elsewhere()}", err=True)
        self._begun += compiling
        text = (
            f"compiling the mathematics, once: kernel {self._begun} of at most {self._most}, about a minute "
            "of processor time; Ctrl-C loses little of it ..."
        )
        if sys.stderr.isatty():
            click.echo(rewriting(text if compiling else "", sys.stderr), err=True, nl=False)
        elif compiling and time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + EVERY_S
            click.echo(text, err=True)
