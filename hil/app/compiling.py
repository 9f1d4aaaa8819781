"""Progress of the first compilation: which kernel it is at, and how long that may take."""

import itertools
import re
import sys
from functools import cache

import click

from drivers.compiled import cache as kernels
from drivers.terminal_row import rewriting

_KERNEL = re.compile(r"^@(?:kernel|pointed)\(|= (?:kernel|pointed)\(", re.MULTILINE)


@cache
def _most() -> int:
    files = frozenset().union(*map(kernels.files_of, kernels.ROOMS))
    return sum(len(_KERNEL.findall(each.read_text(encoding="utf-8"))) for each in files)


def show_compilation() -> None:
    """Show on standard error how far the compilation is: a row of a terminal, elsewhere one line."""
    numbers = itertools.count(1)

    def show(compiling: bool) -> None:
        number = next(numbers) if compiling else 0
        text = (
            f"compiling the mathematics, once: kernel {number} of at most {_most()}, about a minute of "
            "processor time; Ctrl-C loses little of it ..."
        )
        if sys.stderr.isatty():
            click.echo(rewriting(text if compiling else "", sys.stderr), err=True, nl=False)
        elif number == 1:
            click.echo(text, err=True)

    kernels.progress = show
