"""What `hil run` says of its rate where it may not have SCHED_FIFO."""

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
