"""Ctrl-C waits until a kernel is complete: half a kernel would crash the process."""

import os
import signal

import numba
import pytest

from drivers.compiled.compiler import REAL, kernel, undisturbed


def press() -> None:
    os.kill(os.getpid(), signal.SIGINT)


@pytest.fixture(autouse=True)
def foreground():
    """Handle SIGINT as in a terminal: it is ignored in the background of a shell."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_during_the_compilation_of_a_kernel_takes_effect_after_it(monkeypatch):
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
