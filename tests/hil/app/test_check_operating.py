"""What `hil check` says of operating: a change of speed against the limits, the key against those who hold it."""

import numpy as np
import pytest

from hil.app.check.operating import _beyond, speed_change
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.app.reachability import span_s, walk
from hil.robot.dynamics import Model
from hil.trajectory.build import build_trajectory
from hil.trajectory.override import Override

pytestmark = pytest.mark.usefixtures("unproven")

RATE_Hz = 1000.0


def parts(c):
    platform = build_platform(c.platform)
    model = Model(platform, leg_spin=c.platform.leg_spin)
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    w = walk(platform, model, trajectory, span_s(trajectory), 1.0 / c.loop.rate_Hz, c.plant)
    return platform, model, trajectory, w


@pytest.fixture(scope="module")
def virtual():
    c = load("virtual")
    platform, model, trajectory, w = parts(c)
    return c, platform, model, trajectory, w, speed_change(c, w, trajectory, model, span_s(trajectory))


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
    c, _, model, trajectory, w, said = virtual
    fastest = float(w.t[np.abs(w.dq).max(axis=1).argmax()])
    found = [stopped(c, model, trajectory, t, up) for t in (fastest - 0.25, fastest - 0.1, 3.0, 7.3, 12.1)]
    friction = said.force_N - max(np.abs(f).max() for f, _ in found)
    assert friction > 0.0
    assert max(np.abs(a).max() for _, a in found) < said.acceleration_m_s2
    steps = max(np.abs(np.diff(f, axis=0)).max() for f, _ in found)
    own = np.abs(np.diff(w.tau[1:-1], axis=0)).max()
    assert steps < own + said.step_N


def test_a_limit_that_breaks_while_the_speed_changes_is_warned_about(virtual):
    c, *_, w, said = virtual
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
