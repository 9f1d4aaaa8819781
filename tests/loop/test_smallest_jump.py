"""The smallest jump of an encoder that is found where rates are made of lengths, by hand from the configuration."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from drivers.signals import Doubt, Fault
from hil.app.check.encoders import report_encoders
from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from plant_fmu.faults.kinds import EncoderJump
from tests.broad import broad
from tests.loop.bench import Ran, run
from tests.loop.test_encoders import at_hold

T = 2.5e-3
COUNT_m = 0.02 / 131072
SKEW_s = 50e-6
"""monitor.rate_skew_us, by default."""
LATE = 0.3
"""Periods by which a latch may be late unseen: 6 v d / T is the largest leap that this makes of a rate v."""
BACK = 9
"""Ticks of force that may still act: transport, three time constants of the drives, and the two of a slope."""
LATER = 40
"""Ticks after a jump within which three tenths of it alarm nobody."""


def configuration(name: str, *, still: bool) -> Configuration:
    return at_hold(name) if still else load(name)


@cache
def calm(name: str, still: bool, tick: int) -> Ran:
    return run(configuration(name, still=still), stop_s=(tick + 2) * T)


def smallest_jump_m(c: Configuration, ran: Ran, tick: int, leg: int) -> float:
    """Return the jump that shows as a leap beyond what force, disturbance and noise explain, m.

    A slope through three lengths leaps by 1.5 J / T. The acceleration may vary by a, which changes the leap
    by a T, and by 4/3 a T as slopes lag. What a late SYNC would explain, and no other leg contradicts, is time.
    """
    home = pose_arrays(c.platform.home)
    platform = build_platform(c.platform)
    J = jacobian(platform, *home)
    M = Model(platform, leg_spin=c.platform.leg_spin).mass_matrix(*home)
    forces, rates = ran.rows["tau"][tick - BACK : tick], ran.rows["dq"][tick - 3 : tick]
    a = 2.0 * c.monitor.disturbance_m_s2 + 2.0 * np.abs(J @ np.linalg.inv(M) @ J.T) @ np.ptp(forces, axis=0)
    noise = 2.0 * COUNT_m / T + SKEW_s * (a + np.abs(np.diff(rates, axis=0)).max(axis=0) / T)
    leap = a * T * (1.0 + 4.0 / 3.0) + 4.0 * noise
    speed = np.abs(rates[-1])
    most = [leap[other] / speed[other] for other in range(6) if other != leg and speed[other] > 0.0]
    return float((leap[leg] + speed[leg] * min([6.0 * LATE, *most])) * T / 1.5)


CASES = [
    ("virtual-cia402", False, 800, 1, 0.40e-3, 0.60e-3, -1.0),
    ("virtual-cia402", False, 700, 3, 0.15e-3, 0.25e-3, 1.0),
    ("virtual-cia402", True, 800, 0, 0.15e-3, 0.20e-3, -1.0),
    ("lab-cia402", False, 1300, 2, 0.15e-3, 0.60e-3, 1.0),
    ("lab-cia402", False, 1500, 5, 0.60e-3, 0.90e-3, -1.0),
    ("lab-cia402", True, 1300, 4, 0.15e-3, 0.60e-3, 1.0),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "still", "tick", "leg", "least_m", "most_m", "sign"), CASES)
def test_twice_the_smallest_jump_is_found_at_once_and_three_tenths_alarm_nobody(
    name, still, tick, leg, least_m, most_m, sign
):
    """Half may be found one tick later: the slope comes back then, and leaps by 3.5 J / T for 1.5 J / T."""
    c = configuration(name, still=still)
    jump_m = smallest_jump_m(c, calm(name, still, tick), tick, leg)
    assert least_m < jump_m < most_m

    def jumped(times: float, ticks: int) -> Ran:
        jump = EncoderJump(leg=leg, by_m=times * sign * jump_m, at_s=tick * T)
        return run(c, jump, stop_s=(tick + ticks) * T)

    found = jumped(2.0, 4)
    row = found.rows[found.struck]
    assert row["faults"] & Fault.ENCODER, found.ending
    assert row["tick"] - tick <= 1
    assert (row["legs_doubted"], row["doubt"]) == (1 << leg, Doubt.LEAP)
    half = jumped(0.5, 4).rows
    assert not half["faults"][half["tick"] <= tick].any()
    part = jumped(0.3, LATER)
    assert not part.rows["faults"].any()
    assert not part.rows["legs_doubted"].any()


@pytest.mark.parametrize("leg", broad(range(6), quick=1))
def test_a_jump_of_a_leg_at_rest_is_not_taken_for_time(leg):
    """Its rate, made of the jump itself, would make any jump the way of a latch that was late."""
    c = configuration("virtual-cia402", still=True)
    found = run(c, EncoderJump(leg=leg, by_m=1e-3, at_s=660 * T), stop_s=664 * T)
    row = found.rows[found.struck]
    assert (row["tick"] - 660, row["doubt"]) == (0, Doubt.LEAP), found.ending


def test_what_is_printed_is_the_smallest_jump_of_legs_at_rest():
    """a = 16 m/s^2: (16 x 2.5e-3 x 7/3 + 4 x (1.22e-4 + 50e-6 x 16)) x 2.5e-3 / 1.5 = 0.162 mm."""
    report = Report("virtual-cia402")
    report_encoders(report, load("virtual-cia402"))
    leap = 16.0 * T * 7.0 / 3.0 + 4.0 * (2.0 * COUNT_m / T + SKEW_s * 16.0)
    assert report.figures["encoders"]["jump_m"] == pytest.approx(leap * T / 1.5, rel=1e-6)
    assert any("0.162 mm" in line for line in report.sections["encoders, at rest"])
