"""What the first compilation says while it lasts: a line that counts on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Callable
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import Any

import click

from drivers.compiled.cache import elsewhere, watch
from drivers.compiled.progress import Compilation, Progress
from drivers.terminal_row import rewriting

EVERY_S = 10.0
"""From one plain line to the next."""
_LOADS = "hil.app.check.command"
"""What a command imports, beside its own, that loads a configuration to move."""


def show_compilation(command: Callable[..., Any]) -> None:
    """Say on standard error how far the compilation is, if this process compiles anything.

    command: what the process is to do; the kernels of what its module imports are to come.
    """
    programs = [sys.modules[command.__module__].__file__]
    if "load" in command.__globals__:
        spec = find_spec(_LOADS)
        programs.append(spec.origin if spec is not None else None)
    watch(Compilation([Path(each) for each in programs if each], Display().show))


class Display:
    """Where a compilation is, for who waits for it. Mutable state: when the last plain line was written."""

    def __init__(self) -> None:
        self._last_s = 0.0

    def show(self, at: Progress) -> None:
        """Write where it begins and how it goes on: on a terminal each kernel, else a line now and then."""
        if not at.done and elsewhere():
            click.echo(f"hil: {elsewhere()}", err=True)
        if sys.stderr.isatty():
            over = at.done >= at.total
            click.echo(rewriting("" if over else line(at), sys.stderr), err=True, nl=False)
        elif not at.done or at.elapsed_s - self._last_s >= EVERY_S:
            self._last_s = at.elapsed_s
            click.echo(line(at), err=True)


def line(at: Progress) -> str:
    """Return how far a compilation is, in words."""
    left = f"about {at.left_s:.0f} s left" if isfinite(at.left_s) else "about a minute of processor time"
    done = f"compiling the mathematics, once: {at.done} of {at.total} kernels"
    return f"{done}, {left}; Ctrl-C loses little of it ..."
