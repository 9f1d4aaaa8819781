"""The last step of a bring-up: six legs by the ordinary controller, with limits that are reduced for it."""

from __future__ import annotations

from functools import cache

import pytest
from click.testing import CliRunner

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.encoder_limits import encoder_limits
from hil.cli import main
from hil.lab.bringup.found import found_text
from hil.lab.bringup.release import six_legs
from plant_fmu.rehearsal.wiring import Wiring
from tests.broad import broad
from tests.hil.lab.bringup.kit import Rehearsal

LIGHT = (
    "--mounting hanging --base-radius 0.2 --platform-radius 0.12 --length-min 0.3 --stroke 0.12 --mass 5 "
    "--leg-mass 0.5 --drive-force 200 --drive-speed 0.3 --drives cubemars --model AK80-9 --travel 0.126 --yes"
)
"""5 kg with drives whose friction is a fifth of the weight that a leg bears."""


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """A function that returns a light robot whose legs stick by so many N."""
    path = tmp_path_factory.mktemp("light") / "light.yaml"
    done = CliRunner().invoke(main, ["new", str(path), *LIGHT.split()])
    assert done.exit_code == 0, done.output

    @cache
    def robot(friction_N):
        changes = {"plant": {"model": {"coulomb_friction_N": friction_N}}}
        return loads(with_changes(path.read_text(encoding="utf-8"), changes), "light.yaml")

    return robot


@pytest.mark.parametrize("friction_N", broad([2.0, 0.5, 6.0], quick=1))
def test_legs_that_stick_come_free_without_a_leap(friction_N, light):
    """Six pushes of 7 N at once took this platform beyond the reduced limit of its speed."""
    c = light(friction_N)
    rehearsal = Rehearsal(c, Wiring())
    found = loads(found_text(c, rehearsal.context, ()), "found.yaml")
    assert found.limits.speed_m_s == pytest.approx(0.25 * c.limits.speed_m_s)
    assert found.limits.following_error_m == pytest.approx(0.002), "a quarter is less"
    ending = six_legs(found, rehearsal.bench)
    assert ending.success, ending.trouble


def slowed(c, share):
    limits = c.limits.model_copy(update={"speed_m_s": share * c.limits.speed_m_s})
    return c.model_copy(update={"limits": limits})


def rise(c):
    return encoder_limits(c, c.loop.rate_Hz).rise_ticks


def test_a_push_rises_the_slower_the_less_speed_is_allowed_and_the_more_a_force_moves(light):
    c = light(2.0)
    assert 1 < rise(slowed(c, 0.5)) < rise(slowed(c, 0.25)) < rise(slowed(c, 0.05)) == 80  # 0.2 s at 400 Hz
    assert rise(slowed(light(6.0), 0.25)) > rise(slowed(c, 0.25))


@pytest.mark.parametrize("name", ["lab", "socketcan", "desktop"])
def test_a_push_comes_at_once_where_that_moves_no_leg_too_fast(name):
    assert rise(load(name)) == 1


def test_a_platform_under_its_rising_pushes_is_below_its_share_of_speed_until_that_is_seen(light):
    """By hand: t_0 until 3 noises of a rate are reached at S r t^2 / 2, and three periods and two lags more."""
    c = slowed(light(2.0), 0.25)
    limits = encoder_limits(c, c.loop.rate_Hz)
    r = limits.push_N.max() / (limits.rise_ticks * limits.period_s)
    S = (limits.mobility / 2.0).sum(axis=1).max()
    late_s = 9.09e-3
    assert S * limits.push_N.max() * late_s > 0.8 * c.limits.speed_m_s, "at once is too fast"
    t = (6.0 * limits.rate_noise_m_s / (S * r)) ** 0.5 + late_s
    assert 0.7 * c.limits.speed_m_s < 0.5 * S * r * t * t <= 0.8 * c.limits.speed_m_s
