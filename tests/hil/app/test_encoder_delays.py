"""The limits of the rules on encoders: when a force acts, when brakes are open, and what friction may hold."""

from __future__ import annotations

import pytest

from hil.app.configuration.configuration import Configuration, load
from hil.app.encoder_limits import encoder_limits, friction_N
from hil.safety import Safety
from plant_fmu.config import BenchPlant

VIRTUAL = load("virtual")
LEGS = range(6)


def with_model(c: Configuration, **model: object) -> Configuration:
    believed = c.controller.believed
    assert believed is not None
    law = c.controller.model_copy(update={"model": believed.model_copy(update=model)})
    return c.model_copy(update={"controller": law})


@pytest.mark.parametrize(("rate_Hz", "ticks"), [(1000.0, 6), (800.0, 6), (400.0, 4), (200.0, 3)])
def test_a_force_acts_as_late_as_the_rate_that_is_run_makes_it(rate_Hz, ticks):
    """A period until the drives have it, one of the tick, and five lags of 0.796 ms: 3.98 ms.

    At 400 Hz 2 x 2.5 + 3.98 ms are 3.6 ticks, at 800 Hz 2 x 1.25 + 3.98 ms are 5.2.
    """
    assert VIRTUAL.loop.rate_Hz == 1000.0
    assert encoder_limits(VIRTUAL, rate_Hz).acting_ticks == ticks


@pytest.mark.parametrize("rate_Hz", [400.0, 250.0])
def test_where_rates_are_differences_a_force_counts_two_ticks_longer(rate_Hz):
    """A slope is made of three lengths."""
    c = load("lab-cia402")
    ticks = {}
    for velocity in ("difference", "pdo"):
        drives = c.drives.model_copy(update={"options": c.drives.options | {"velocity": velocity}})
        limits = encoder_limits(c.model_copy(update={"drives": drives}), rate_Hz)
        assert limits.differences == (velocity == "difference")
        ticks[velocity] = limits.acting_ticks
    assert ticks["difference"] == ticks["pdo"] + 2


@pytest.mark.parametrize(("rate_Hz", "ticks"), [(1000.0, 60), (500.0, 30)])
def test_encoders_are_watched_from_when_the_brakes_have_opened(rate_Hz, ticks):
    engage = VIRTUAL.engage.model_copy(update={"brake_release_s": 0.06, "brake_close_s": 0.2})
    c = VIRTUAL.model_copy(update={"engage": engage})
    assert encoder_limits(c, rate_Hz).open_ticks == ticks


@pytest.mark.parametrize(("section", "key"), [("monitor", "disturbance_m_s2"), ("limits", "force_step_N")])
def test_a_push_that_takes_for_ever_to_be_seen_has_a_number_of_ticks_that_a_limit_holds(section, key):
    c = load("desktop")
    c = c.model_copy(update={section: getattr(c, section).model_copy(update={key: 1e-60})})
    limits = encoder_limits(c, 1000.0)
    assert 1e12 <= limits.push_ticks <= 3e12
    watched = Safety(c.limits, 0.3, 0.5, 1000.0, 900.0, encoders=limits)
    assert watched.limits["push_ticks"] == limits.push_ticks


@pytest.mark.parametrize("roughest", LEGS)
@pytest.mark.parametrize("name", ["virtual", "bench", "socketcan"])
def test_of_frictions_known_leg_by_leg_the_largest_may_hold_a_leg(name, roughest):
    """90 N are more than what is assumed of anybody's drives here, 75 N at most."""
    c = load(name)
    if isinstance(c.plant.model if c.plant else None, BenchPlant):
        c = c.model_copy(update={"controller": VIRTUAL.controller})
    known = with_model(c, coulomb_friction_N=[90.0 if leg == roughest else 2.0 for leg in LEGS])
    assert friction_N(known) == 90.0
