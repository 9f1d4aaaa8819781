"""`hil check` on limits: far above need, exceeded while the speed changes, or by set-points."""

from __future__ import annotations

import re
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.arrays import Array
from hil.app.check.loose import loose_limits
from hil.app.check.operating import _beyond, speed_change
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.app.reachability import span_s, walk
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.build import build_trajectory
from hil.trajectory.override import Override

pytestmark = pytest.mark.usefixtures("unproven")


@pytest.fixture(scope="module")
def path():
    """The configuration `virtual`, its model, its trajectory, a walk along it, and what a change of speed asks for."""
    c = load("virtual")
    platform = build_platform(c.platform)
    model = Model(platform, leg_spin=c.platform.leg_spin)
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    w = walk(platform, model, trajectory, span_s(trajectory), 1.0 / c.loop.rate_Hz, c.plant)
    return c, model, trajectory, w, speed_change(c, w, trajectory, model, span_s(trajectory))


@pytest.fixture(scope="module")
def virtual(path):
    c, _, _, w, change = path
    return c, w, change


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


RATE_Hz = 1000.0


def stopped(c, model, trajectory, at_s, up=False):
    """Force (n, 6) and leg acceleration (n, 6) of the rigid body while the speed changes, from the override itself."""
    override, period = Override(1.0 / RATE_Hz, c.engage.stop_s), 1.0 / RATE_Hz
    override.place(0, at_s) if up else override.settle(0, 1.0)
    if not up:
        override.record["s"] = at_s
    override.aim(0, 1.0 if up else 0.0)
    forces, rates, still = [], [], np.zeros(6)
    for tick in range(round(1.2 * c.engage.stop_s * RATE_Hz)):
        override.advance(tick)
        s = trajectory.sample(override.time(tick))
        sigma, dsigma = override.sigma, override.dsigma
        twist, dtwist = sigma * s.twist, sigma**2 * s.dtwist + dsigma * s.twist
        forces.append(model.inverse_dynamics(s.p, s.R, twist, dtwist, still))
        a, b = model.platform.base_joints, model.platform.platform_joints
        legs = s.p + b @ s.R.T - a
        n = legs / np.linalg.norm(legs, axis=1)[:, None]
        rates.append((n * (twist[:3] + np.cross(twist[3:], b @ s.R.T))).sum(axis=1))
    return np.array(forces), np.diff(rates, axis=0) / period


@pytest.mark.parametrize("up", [False, True])
def test_a_hold_or_start_on_the_path_stays_within_the_printed_bounds(path, up):
    c, model, trajectory, w, said = path
    fastest = float(w.t[np.abs(w.dq).max(axis=1).argmax()])
    found = [stopped(c, model, trajectory, t, up) for t in (fastest - 0.25, fastest - 0.1, 3.0, 7.3, 12.1)]
    friction = said.force_N - max(np.abs(f).max() for f, _ in found)
    assert friction > 0.0
    assert max(np.abs(a).max() for _, a in found) < said.acceleration_m_s2
    steps = max(np.abs(np.diff(f, axis=0)).max() for f, _ in found)
    own = np.abs(np.diff(w.tau[1:-1], axis=0)).max()
    assert steps < own + said.step_N


def test_a_limit_that_breaks_while_the_speed_changes_is_warned_about(path):
    c, *_, w, said = path
    for name, own, least in (
        ("acceleration_m_s2", np.abs(w.ddq).max(), said.acceleration_m_s2),
        ("force_N", np.abs(w.tau).max(), said.force_N),
        ("force_step_N", np.abs(np.diff(w.forces()[1], axis=0)).max(), None),
    ):
        most = own + said.step_N if least is None else least
        assert own < most
        for limit, warns in ((0.9 * own + 0.1 * most, True), (1.001 * most, False)):
            limits = c.limits.model_copy(update={name: limit})
            found = list(_beyond(c.model_copy(update={"limits": limits}), w, said))
            assert len(found) == warns, (name, found)
            assert all(f"limits.{name}" in each and "engage.stop_s" in each for each in found)


C = load("virtual")


def lengths(pose: dict[str, list[float]], moved: Array) -> Array:
    """Return the leg lengths (6,) m of the robot of `virtual`, moved and turned from a pose, m and rad."""
    a, b = np.array(C.platform.base_joints_m), np.array(C.platform.platform_joints_m)
    R = Rotation.from_rotvec(moved[3:]) * Rotation.from_rotvec(pose["rotation_vector_deg"], degrees=True)
    found: Array = np.linalg.norm(np.array(pose["position_m"]) + moved[:3] + R.apply(b) - a, axis=1)
    return found


def fastest(pose: dict[str, list[float]], words: Array) -> float:
    """Return the largest rate of a leg where each axis moves at its own, one way or the other."""
    h = 1e-6
    ways = (np.array(signs) * words for signs in product((1.0, -1.0), repeat=6))
    return max(float(np.abs(lengths(pose, h * v) - lengths(pose, -h * v)).max()) / (2 * h) for v in ways)
