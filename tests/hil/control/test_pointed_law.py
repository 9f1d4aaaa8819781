"""Laws called by address: compiled laws, and laws in plain Python behind a callback."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.compiled.compiler import INTEGER, kernel, record
from drivers.compiled.pointed import address_of, of_python
from drivers.tick_columns import TICK, copy_of
from hil.contracts.records import asked, record_of
from hil.control.pd import JointPD
from hil.control.pointed_law import ask, called_by_pointer
from tests.hil.control.test_laws import BOOK, SETTINGS, make, on_reference, sample


@kernel(INTEGER, INTEGER, INTEGER, INTEGER, record(TICK))
def call_law(address, gains, constants, code, tick):
    ask(address, gains, constants, code, address_of(tick))


def by_pointer(law, tick):
    """Call a law as compiled code does; return the owner of its pointer."""
    pointer = called_by_pointer(law)
    call_law(*pointer[:4], tick)
    return pointer.keeps


class Constant:
    """A law with a constant force, after an optional action. State: the ticks received."""

    def __init__(self, first=lambda tick: None, tau=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)):
        self.first, self.tau, self.given = first, tau, []

    def reset(self):
        """Do nothing: the law has no state."""

    def effort(self, tick):
        self.given.append(tick)
        self.first(tick)
        if self.tau is not None:
            tick["tau_law"] = self.tau


@pytest.mark.parametrize("name", SETTINGS)
def test_law_called_by_address_or_from_python_gives_bitwise_equal_forces(name):
    one, other = make(name), make(name)
    for case in BOOK["states"][::4]:
        tick = on_reference(sample(case))
        tick["q"] += 1e-3
        tick["shortfall"] = 50.0
        expected = asked(one, tick)
        assert by_pointer(other, tick) is other
        assert tick["tau_law"].tobytes() == expected.tobytes()


def test_a_python_law_changes_only_tau_law_of_the_tick():
    def spoil(tick):
        for column in TICK.names or ():
            tick[column] = -7

    tick = record_of(tick=5, q=1.5, tau_law=99.0)
    expected = copy_of(tick)
    expected["tau_law"] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert by_pointer(Constant(spoil), tick).raised is None
    assert tick.tobytes() == expected.tobytes()


@pytest.mark.parametrize("error", [ZeroDivisionError("a defect"), KeyboardInterrupt()])
def test_exception_of_a_python_law_gives_nan_force_and_is_stored(error):
    def raising(tick):
        tick["tau_law"] = 5.0
        raise error

    law = Constant(raising)
    pointer = called_by_pointer(law)
    for law.first, raised in ((raising, error), (lambda tick: None, None)):
        tick = record_of(tau_law=99.0)
        call_law(*pointer[:4], tick)
        assert pointer.keeps.raised is raised
        assert np.isnan(tick["tau_law"]).all() == (raised is not None)


def test_callback_of_a_python_law_that_is_interrupted_before_its_first_line_gives_nan_force():
    """Like ctypes on Ctrl-C at the first instruction: status 0, tau_law not filled."""
    address, keeps = of_python(lambda *_: 0, *[INTEGER] * 4)
    tick = record_of(tau_law=99.0)
    call_law(address, 0, 0, 0, tick)
    assert np.isnan(tick["tau_law"]).all()
    del keeps


@pytest.mark.parametrize("tau", [None, np.nan])
def test_undefined_force_of_a_python_law_is_nan_in_that_tick_only(tau):
    law = Constant(tau=tau)
    pointer = called_by_pointer(law)
    for law.tau, answered in ((tau, False), ((1.0,) * 6, True)):
        tick = record_of(tau_law=99.0)
        call_law(*pointer[:4], tick)
        assert pointer.keeps.raised is None
        assert np.isfinite(tick["tau_law"]).all() == answered


def test_effort_overridden_in_python_replaces_the_compiled_function():
    class Doubled(JointPD):
        def effort(self, tick):
            super().effort(tick)
            tick["tau_law"] *= 2.0

    tick = record_of(q_d=1.0)
    by_pointer(Doubled(np.full(6, 1e3), np.zeros(6), np.zeros(6)), tick)
    assert (tick["tau_law"] == 2e3).all()
