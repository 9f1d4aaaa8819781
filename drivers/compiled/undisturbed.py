"""Work in which no signal's handler may raise: Numba and LLVM would leave half a kernel, and then crash."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_RAISING = (signal.SIGINT, signal.SIGALRM)
"""Ctrl-C, and the timer that repeats one."""


@contextmanager
def undisturbed() -> Iterator[None]:
    """Hold Ctrl-C back: its handler is called at the end, once."""
    held: list[int] = []
    handlers = {number: signal.getsignal(number) for number in _RAISING}
    replaced = [number for number, handler in handlers.items() if callable(handler)]
    try:
        for number in replaced:
            signal.signal(number, lambda signum, _: held.append(signum))
    except ValueError:  # not the main thread, in which alone handlers run
        replaced = []
    try:
        yield
    finally:
        for number in replaced:
            signal.signal(number, handlers[number])
    handler = handlers[signal.Signals(held[0])] if held else None
    if callable(handler):
        handler(held[0], sys._getframe())  # noqa: SLF001 - where it strikes, as the interpreter says it
