"""The signals that ask for an end, and what is theirs before and after."""

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
def test_whatever_asks_for_an_end_of_a_run_stops_it_first_and_then_at_once(asked):
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
def test_before_the_loop_it_ends_the_start(asked):
    panel = OperatorPanel()
    with panel.attached(), pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), asked)


def test_the_start_is_ended_once_and_what_comes_while_it_ends_is_only_counted():
    panel = OperatorPanel()
    try:
        _earlier()
    except AssertionError:
        with pytest.raises(KeyboardInterrupt):
            panel.interrupt(2, None)
    try:
        panel.interrupt(2, None)
    except KeyboardInterrupt:
        panel.interrupt(2, None)
    assert panel.interrupts == 3
    panel.running()
    panel.interrupt(2, None)
    assert panel.take() == (Operator.STOP, *[Operator.ESTOP] * 3)
    assert panel.take() == ()


def test_only_the_first_signal_asks_for_a_stop_and_where_force_alone_holds_every_one():
    panel = OperatorPanel()
    panel.interrupts = 2
    assert panel.take(held=True) == (Operator.STOP,) * 2
    panel.interrupts = 3
    assert panel.take() == (Operator.ESTOP,)


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt, SystemExit])
def test_a_run_that_fails_gives_each_signal_back_to_whom_it_was(error):
    theirs: list[object] = []

    def fails():
        with OperatorPanel().attached():
            theirs.extend(map(signal.getsignal, SIGNALS))
            raise error

    with pytest.raises(error):
        fails()
    assert _earlier not in theirs
    assert [signal.getsignal(each) for each in SIGNALS] == [_earlier] * 3
