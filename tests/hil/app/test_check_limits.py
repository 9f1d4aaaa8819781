"""`hil check` on limits: what a hold, a start and a deceleration take, against rigid bodies by hand."""

from __future__ import annotations

import numpy as np
import pytest

from hil.app.check.subject import looked_at
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.override import Override


@pytest.fixture(scope="module")
def virtual():
    return looked_at(load("virtual"))


def test_a_leg_feels_the_mass_of_the_platform_that_it_moves_alone(virtual):
    """1 / (J M^-1 J^T)_ii at home, kg, the most of any leg."""
    platform, home = build_platform(virtual.c.platform), virtual.c.platform.home
    p, R = np.array(home.position_m), np.eye(3)
    J = jacobian(platform, p, R)
    alone = 1.0 / np.diag(J @ np.linalg.solve(Model(platform).mass_matrix(p, R), J.T)).min()
    assert virtual.leg_mass_kg == pytest.approx(alone)


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
def test_a_hold_or_start_on_the_path_stays_within_the_printed_bounds(virtual, up):
    c, model, trajectory, w, said = virtual.c, virtual.model, virtual.trajectory, virtual.walk, virtual.slowed
    fastest = float(w.t[np.abs(w.dq).max(axis=1).argmax()])
    found = [stopped(c, model, trajectory, t, up) for t in (fastest - 0.25, fastest - 0.1, 3.0, 7.3, 12.1)]
    friction = said.force_N - max(np.abs(f).max() for f, _ in found)
    assert friction > 0.0
    assert max(np.abs(a).max() for _, a in found) < said.acceleration_m_s2
    steps = max(np.abs(np.diff(f, axis=0)).max() for f, _ in found)
    own = np.abs(np.diff(w.tau[1:-1], axis=0)).max()
    assert steps < own + said.step_N
