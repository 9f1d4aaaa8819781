"""The signals that ask for an end: stop first, then emergency stop, and their owners afterwards."""

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
    """Somebody has these signals already; afterwards they are as before."""
    before = {each: signal.signal(each, _earlier) for each in SIGNALS}
    yield
    for each, handler in before.items():
        signal.signal(each, handler)


@pytest.mark.parametrize("asked", SIGNALS)
def test_a_signal_stops_a_run_first_and_then_at_once(asked):
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
        assert panel.take(held=True) == (Operator.STOP,), "only the force holds the platform"
    assert signal.getsignal(asked) is _earlier


@pytest.mark.parametrize("asked", SIGNALS)
def test_before_the_loop_a_signal_ends_the_start(asked):
    panel = OperatorPanel()
    with panel.attached(), pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), asked)


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_a_run_that_fails_gives_each_signal_back_to_its_owner(error):
    theirs: list[object] = []

    def fails():
        with OperatorPanel().attached():
            theirs.extend(map(signal.getsignal, SIGNALS))
            raise error

    with pytest.raises(error):
        fails()
    assert _earlier not in theirs
    assert [signal.getsignal(each) for each in SIGNALS] == [_earlier] * 3
