"""Signals that request an end: first a stop, then an emergency stop; later they return to their owners."""

import os
import signal

import pytest

from hil.loop.panel import OperatorPanel
from hil.signals import Operator

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


def _earlier(*_):
    raise AssertionError("not theirs")


@pytest.fixture(autouse=True)
def _usual():
    """Install earlier signal handlers, and restore the original ones afterwards."""
    before = {each: signal.signal(each, _earlier) for each in SIGNALS}
    yield
    for each, handler in before.items():
        signal.signal(each, handler)


@pytest.mark.parametrize("asked", SIGNALS)
def test_the_first_signal_stops_a_run_and_the_second_is_an_estop(asked):
    panel = OperatorPanel()
    with panel.attached():
        panel.running()
        assert panel.take() == ()
        os.kill(os.getpid(), asked)
        assert panel.take() == (Operator.STOP,)
        os.kill(os.getpid(), asked)
        os.kill(os.getpid(), asked)
        assert panel.take() == (Operator.ESTOP, Operator.ESTOP)
        os.kill(os.getpid(), asked)
        assert panel.take(held=True) == (Operator.STOP,), "a held platform gets no emergency stop"
    assert signal.getsignal(asked) is _earlier


@pytest.mark.parametrize("asked", SIGNALS)
def test_a_signal_before_the_loop_interrupts_the_start(asked):
    panel = OperatorPanel()
    with panel.attached(), pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), asked)


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_a_failed_run_restores_the_earlier_signal_handlers(error):
    theirs: list[object] = []

    def fails():
        with OperatorPanel().attached():
            theirs.extend(map(signal.getsignal, SIGNALS))
            raise error

    with pytest.raises(error):
        fails()
    assert _earlier not in theirs
    assert [signal.getsignal(each) for each in SIGNALS] == [_earlier] * 3
