"""What `hil check` says of limits far beyond what is needed: each at both sides; no shipped file has one."""

import re

import numpy as np
import pytest

from hil.app.check.loose import loose_limits
from hil.app.check.operating import speed_change
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.app.reachability import span_s, walk
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.build import build_trajectory

pytestmark = pytest.mark.usefixtures("unproven")


@pytest.fixture(scope="module")
def virtual():
    c = load("virtual")
    platform = build_platform(c.platform)
    model = Model(platform, leg_spin=c.platform.leg_spin)
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    w = walk(platform, model, trajectory, span_s(trajectory), 1.0 / c.loop.rate_Hz, c.plant)
    return c, w, speed_change(c, w, trajectory, model, span_s(trajectory))


def warned(virtual, **limits):
    c, w, change = virtual
    return list(loose_limits(c.model_copy(update={"limits": c.limits.model_copy(update=limits)}), w, change))


# By hand. Forces: the path needs 16022 N, 5.7 kN within 250 ms, 1.129 m/s, a condition of 4.83. At rest the
# error dynamics leave 8 m/s^2 / (20 rad/s)^2 = 20 mm of a stroke of 1.45 m. The loop is 1 + 0.8 + 0.5 ms late.
# A change of force by 2 x 25 kN is one from end to end. Readings 1e-5 m, brakes 1e-4 m, one tick: x 20 each.
BORDERS = {
    "force_N": (64000.0, 64200.0, "16022"),
    "force_step_N": (13500.0, 15000.0, "3590"),
    "force_window_N": (36000.0, 39000.0, "9320"),
    "speed_m_s": (4.5, 4.54, "1.129"),
    "acceleration_m_s2": (94.0, 125.0, None),
    "condition": (4.8 * 40, 4.9 * 40, "4.83"),
    "following_error_m": (0.0799, 0.0801, "0.02"),
    "following_error_s": (20 * 2.29e-3, 20 * 2.31e-3, "0.0023"),
    "consistency_m": (1.99e-4, 2.01e-4, "1e-05"),
    "standstill_m": (1.99e-3, 2.01e-3, "0.0001"),
    "stale_fault_ticks": (20, 21, "1"),
    "missed_stop_ticks": (20, 21, "1"),
}


@pytest.mark.parametrize("name", BORDERS)
def test_a_limit_far_above_need_is_warned_about_with_a_proposal(virtual, name):
    tight, loose, needed = BORDERS[name]
    assert warned(virtual, **{name: tight}) == []
    (line,) = warned(virtual, **{name: loose})
    found = re.match(
        rf"limits\.{name} (\S+) is (\S+) times the (\S+) \S.* needed .*; "
        r"it would show a failure late, give (\S+)$",
        line,
    )
    assert found is not None, line
    given, times, said, proposed = map(float, found.groups())
    assert given == pytest.approx(loose, rel=1e-4)
    assert times == pytest.approx(loose / said, rel=0.02)
    assert said < proposed < loose
    assert needed is None or said == pytest.approx(float(needed), rel=0.01)
    assert warned(virtual, **{name: proposed}) == []


def platform_mass_kg(c):
    """Return what a leg alone feels of the platform at home: 1 / (J M^-1 J^T)_ii, kg, the most of any."""
    platform, home = build_platform(c.platform), c.platform.home
    p, R = np.array(home.position_m), np.eye(3)
    J = jacobian(platform, p, R)
    return 1.0 / np.diag(J @ np.linalg.solve(Model(platform).mass_matrix(p, R), J.T)).min()


def test_a_deceleration_that_no_force_gives_is_warned_about(virtual):
    """By hand: a leg alone feels 1 / (J M^-1 J^T)_ii; 25 kN bear 3.6 kN of weight at the path's start."""
    c, w, _ = virtual
    able = (25000.0 - np.abs(w.rest).max()) / platform_mass_kg(c)
    assert warned(virtual, deceleration_m_s2=3.9 * able) == []
    (line,) = warned(virtual, deceleration_m_s2=4.1 * able)
    assert line.startswith(f"limits.deceleration_m_s2 {4.1 * able:g} is 4.1 times the {able:.3g} m/s^2")
    proposed = float(line.rsplit(" ", 1)[1])
    assert 0.9 * able < proposed <= able
