"""Ctrl-C, whenever it comes: what was begun is closed, one line says so, exit code 130."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

import click

INTERRUPTED = 128 + signal.SIGINT
"""Exit code: what a shell shows of a tool that SIGINT has ended."""
_ENOUGH = 3
"""Presses after which nothing is closed any more."""
_AGAIN_S = 0.02
_OURS = frozenset({"hil", "drivers", "plant_fmu"})
_FRAGILE = frozenset({"llvmlite", "numba"})
"""Libraries that, interrupted while they free something, free it again: the process would crash."""


class Interrupts:
    """What Ctrl-C does to a command.

    The first press raises KeyboardInterrupt. While that is on its way, files are closed and processes ended;
    a further press does not disturb it, and neither does one after the result is there. The third one in
    vain ends the process at once. A press that struck where Python drops exceptions, or where a library's
    own code may not bear one, is repeated.
    Mutable state: how many presses were in vain, whether one was not, whether the result is there.
    """

    def __init__(self) -> None:
        self._in_vain = 0
        self._settled = False
        self.raised = False
        """Whether KeyboardInterrupt was raised: libraries make other exceptions of it."""

    def settle(self) -> None:
        """Let a press change nothing from now on: the result is there."""
        self._settled = True

    def pressed(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGINT, and the timer that repeats it."""
        del signum
        if not self._settled and not comes_of_interrupt(sys.exc_info()[1]):
            if bears_no_interrupt(frame):
                signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
                return
            self.raised = True
            raise KeyboardInterrupt
        self._in_vain += 1
        if self._in_vain >= _ENOUGH:
            os._exit(INTERRUPTED)

    def dropped(self, what: Any) -> None:
        """Take the place of `sys.unraisablehook`."""
        if isinstance(what.exc_value, KeyboardInterrupt):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
        else:
            sys.__unraisablehook__(what)

    def printed(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        """Take the place of `sys.excepthook`: what is compiled by Cython prints what it then drops."""
        if not isinstance(error, KeyboardInterrupt):
            sys.__excepthook__(kind, error, trace)

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Route SIGINT here for a whole process; at its end nothing disturbs how Python leaves."""
        self._in_vain, self._settled, self.raised = 0, False, False
        if signal.getsignal(signal.SIGINT) not in {signal.default_int_handler, signal.SIG_DFL}:
            yield  # it is ignored, as in the background of a shell script
            return
        for number in (signal.SIGINT, signal.SIGALRM):
            signal.signal(number, self.pressed)
        hooks = sys.unraisablehook, sys.excepthook
        sys.unraisablehook, sys.excepthook = self.dropped, self.printed
        try:
            yield
        finally:
            for number in (signal.SIGINT, signal.SIGALRM):  # a press that is repeated would end Python's end
                signal.signal(number, signal.SIG_IGN)
            sys.unraisablehook, sys.excepthook = hooks

    @contextmanager
    def also_where_the_terminal_goes(self) -> Iterator[None]:
        """Let SIGTERM and SIGHUP be presses, too: a closed terminal leaves nothing under power."""
        before = {
            number: signal.signal(number, self.pressed)
            for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
        }
        try:
            yield
        finally:
            for number, previous in before.items():
                signal.signal(number, previous)


OF_THIS_PROCESS = Interrupts()


def bears_no_interrupt(frame: FrameType | None) -> bool:
    """Tell whether an import or a fragile library runs here, and no line of this project in it."""
    while frame is not None:
        root = str(frame.f_globals.get("__name__")).partition(".")[0]
        if root in _OURS:
            return False
        if root in _FRAGILE or frame.f_code.co_filename.startswith("<frozen importlib._bootstrap"):
            return True
        frame = frame.f_back
    return False


def comes_of_interrupt(error: BaseException | None) -> bool:
    """Tell whether an exception is a KeyboardInterrupt, or was raised while one was handled."""
    seen = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False


@contextmanager
def one_line_of_interrupt() -> Iterator[None]:
    """Turn a KeyboardInterrupt, and what an import makes of it, into one line and exit code INTERRUPTED.

    The text of the exception says what there is: a log, as far as it goes.
    """
    try:
        yield
    except (SystemExit, click.exceptions.Exit, click.ClickException):
        raise
    except BaseException as error:
        if not (comes_of_interrupt(error) or OF_THIS_PROCESS.raised):
            raise
        OF_THIS_PROCESS.settle()
        _leave(str(error) if isinstance(error, KeyboardInterrupt) else "")


def _leave(there: str) -> None:
    from hil.app.terminal import visible

    below = "\n" if sys.stderr.isatty() else ""  # of a terminal's ^C, and of what counts before it
    click.echo(visible(f"{below}hil: interrupted{there and ' '}{there}"), err=True)
    sys.exit(INTERRUPTED)
