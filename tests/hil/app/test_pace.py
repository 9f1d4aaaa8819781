"""What `hil run` says of its rate where it may not have SCHED_FIFO, or where that is not kept."""

from math import nan

import pytest

from hil.app import run
from hil.app.configuration import load
from hil.app.output import console


@pytest.fixture
def ordinary(monkeypatch):
    """Deny SCHED_FIFO on a machine whose worst wake-up is as told; return what is printed."""
    said = []
    monkeypatch.setattr(run, "fifo_allowed", lambda _: False)
    monkeypatch.setattr(console, "print", lambda text, **_: said.append(text))

    def machine(rate_Hz, worst_s):
        monkeypatch.setattr(run, "holdable_rate", lambda *_: (rate_Hz, worst_s))
        return said

    return machine


LACK = "no right to SCHED_FIFO (as root, or `ulimit -r 99` / rtprio in limits.conf)"


def test_a_rate_that_is_held_is_not_called_another(ordinary):
    said = ordinary(50.0, 0.001)
    assert run._pace(load("vcan50"), with_plant=False) == (50.0, 0.24)
    assert said == [LACK]


def test_a_lower_rate_is_named_beside_the_configured_one(ordinary):
    said = ordinary(125.0, 0.001)
    assert run._pace(load("virtual"), with_plant=True) == (125.0, 0.2)
    assert said == [f"{LACK}: the loop runs at 125 Hz instead of 1000 Hz, emulated drives' watchdog 200 ms"]


def test_stalls_that_no_rate_outlasts_are_foretold(ordinary):
    said = ordinary(50.0, 0.241)  # twelve periods of 20 ms stop the platform
    run._pace(load("vcan50"), with_plant=False)
    assert said == [f"{LACK}; stalls of 241 ms now: expect a controlled stop, or take load off this machine"]


@pytest.fixture
def fifo(ordinary, monkeypatch):
    """Grant SCHED_FIFO on a machine with such a share of late wake-ups; return what is printed."""

    def machine(late):
        monkeypatch.setattr(run, "fifo_allowed", lambda _: True)
        monkeypatch.setattr(run, "late_share", lambda *_: late)
        return ordinary(125.0, 0.001)

    return machine


def test_a_machine_that_keeps_real_time_runs_at_the_configured_rate(fifo):
    said = fifo(0.01)
    assert run._pace(load("virtual"), with_plant=True) == (1000.0, 0.01)
    assert said == []


def test_with_the_plant_on_a_machine_that_does_not_keep_it_the_loop_is_slowed(fifo):
    said = fifo(0.024)
    assert run._pace(load("virtual"), with_plant=True) == (125.0, 0.2)
    lack = "this machine does not keep SCHED_FIFO, 2.4 % of its wake-ups are 100 us late"
    assert said == [f"{lack}: the loop runs at 125 Hz instead of 1000 Hz, emulated drives' watchdog 200 ms"]


@pytest.mark.parametrize(("name", "with_plant"), [("virtual", False), ("vcan50", True)])
def test_real_drives_and_limits_that_outlast_a_stall_leave_the_rate_as_it_is(fifo, name, with_plant):
    said = fifo(nan)  # not measured
    c = load(name)
    assert run._pace(c, with_plant=with_plant) == (c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)
    assert said == []
