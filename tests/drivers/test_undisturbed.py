"""Ctrl-C waits until a kernel is whole: half of one would crash the process."""

import os
import signal

import numba
import pytest

from drivers.compiled.compiler import REAL, kernel, undisturbed


def press() -> None:
    os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture(autouse=True)
def foreground():
    """Let SIGINT be as in a terminal: it is ignored in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_press_strikes_when_the_kernel_is_whole(monkeypatch):
    compiled = []

    class Made:
        def compile(self, _):
            press()
            compiled.append(1)
            press()
            compiled.append(2)

    monkeypatch.setattr(numba, "njit", lambda **_: lambda _: Made())
    with pytest.raises(KeyboardInterrupt):
        kernel(REAL)(lambda x: 2.0 * x)
    assert compiled == [1, 2]
    with pytest.raises(KeyboardInterrupt), undisturbed():
        press()
