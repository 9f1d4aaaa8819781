"""Wrench observer on motions integrated by scipy: it is a first-order filter of the wrench."""

import json
from math import exp, pi
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.signals import DriveState
from hil.contracts.records import altered, record_of
from hil.estimation.observer import WrenchObserver
from hil.estimation.observer import observe as take_on
from hil.robot.dynamics import Model
from hil.robot.force_path import ForcePath
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian, leg_lengths

BOOK = json.loads((Path(__file__).parents[1] / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
HOME = np.array([0.0, 0.0, 1.0])
T, BANDWIDTH = 1e-3, 20.0
WRENCH = np.array([800.0, -500.0, 300.0, 100.0, -80.0, 60.0])
RUN, READY, OFF = [DriveState.RUN] * 6, [DriveState.READY] * 6, [DriveState.OFF] * 6
HOLDING = np.full(6, 3618.625746)
"""Static leg force at home, N, confirmed by independent engines."""
PUSH = np.array([300.0, -200.0, 500.0, 100.0, -400.0, 250.0])


def moved(model, wrench, count=60):
    """States every T under forces that change every T, and these forces."""
    forces = [HOLDING + PUSH * np.sin(0.05 * k) for k in range(count)]
    x = np.concatenate([HOME, np.eye(3).ravel(), np.zeros(6)])
    states = [x]
    for force in forces:

        def derivative(_, x, force=force):
            R, twist = x[3:12].reshape(3, 3), x[12:]
            dtwist = model.forward_dynamics(x[:3], R, twist, force, wrench)
            return np.concatenate([twist[:3], np.cross(twist[3:], R.T).T.ravel(), dtwist])

        x = solve_ivp(derivative, (0.0, T), x, rtol=1e-11, atol=1e-13).y[:, -1]
        states.append(x)
    return [state_of(x) for x in states], forces


def state_of(x):
    p, R, twist = x[:3], x[3:12].reshape(3, 3).copy(), x[12:]
    J = jacobian(PLATFORM, p, R)
    return record_of(q=leg_lengths(PLATFORM, p, R), dq=J @ twist, p=p, R=R, twist=twist, J=J)


def observer(model=None):
    return WrenchObserver(model or Model(PLATFORM), ForcePath(T, 0.0, 0.0), BANDWIDTH)


def observe(observer, tick, state, drive_state=RUN, *, seen=True):
    take_on(observer.record, int(seen), altered(state, tick=tick, drive_state=drive_state))
    return observer.residual.copy()


def follow(observer, states, forces, drive_state=RUN):
    found = []
    for k, state in enumerate(states):
        found.append(observe(observer, k, state, drive_state))
        if k < len(forces):
            observer.path.send(forces[k])
    return np.array(found)


@pytest.fixture(scope="module")
def pushed():
    return moved(Model(PLATFORM), WRENCH)


def test_estimate_of_a_constant_wrench_rises_like_a_first_order_lag(pushed):
    found = follow(observer(), *pushed)
    assert not found[0].any(), "the first estimate must be zero"
    for k in (1, 5, 20, 60):
        np.testing.assert_allclose(found[k], WRENCH * (1 - exp(-2 * pi * BANDWIDTH * k * T)), atol=0.05)


def test_motion_without_an_external_wrench_gives_a_zero_wrench_estimate():
    states, forces = moved(Model(PLATFORM), np.zeros(6))
    assert np.abs(states[-1]["twist"]).max() > 0.005, "the platform must move"
    assert np.abs(follow(observer(), states, forces)).max() < 0.05


def test_only_friction_outside_the_model_counts_as_external_wrench():
    states, forces = moved(Model(PLATFORM, viscous=5000.0), np.zeros(6))
    assert np.abs(follow(observer(Model(PLATFORM, viscous=5000.0)), states, forces)).max() < 0.1
    assert np.abs(follow(observer(), states, forces)).max() > 10.0


def test_the_observer_bridges_a_skipped_tick():
    """The drives kept the last force, which is constant here."""
    model = Model(PLATFORM)
    still = state_of(np.concatenate([HOME, np.eye(3).ravel(), np.zeros(6)]))
    one, other = observer(model), observer(model)
    for k in range(10):
        for each in (one, other):
            observe(each, k, still)
            each.path.send(HOLDING + 100.0)
    for k in range(10, 15):
        observe(one, k, still)
        one.path.send(HOLDING + 100.0)
    np.testing.assert_allclose(observe(other, 15, still), observe(one, 15, still), rtol=1e-9)


def test_wrench_estimate_is_kept_on_closed_brakes_and_reset_without_force(pushed):
    states, forces = pushed
    each = observer()
    seen = follow(each, states, forces)[-1]
    one_shut = [*RUN[:5], DriveState.READY]
    for n, drive_state in enumerate([one_shut, READY, READY]):
        np.testing.assert_array_equal(observe(each, 100 + n, states[0], drive_state), seen)
    for k, state in enumerate((DriveState.BOOT, DriveState.OFF, DriveState.FAULT)):
        tick = 103 + 10 * k
        assert not observe(each, tick, states[0], [*RUN[:k], state, *RUN[k + 1 :]]).any()
        assert not observe(each, tick + 1, states[0], READY).any()
        assert not observe(each, tick + 2, states[0]).any(), "the first open tick has nothing to compare with"
        assert observe(each, tick + 3, states[1]).any()
    each.reset()
    assert follow(each, *pushed)[-1].tobytes() == seen.tobytes()


def test_ticks_without_a_measured_pose_leave_the_wrench_estimate_unchanged(pushed):
    """The estimate continues at the first measured tick."""
    states, forces = pushed
    each, kept = observer(), np.zeros(6)
    for k, state in enumerate(states):
        found = observe(each, k, state, seen=not 20 <= k < 40)
        kept = found if k == 19 else kept
        if 20 <= k <= 40:
            np.testing.assert_array_equal(found, kept)
        each.path.send(forces[min(k, len(forces) - 1)])
    left = exp(-2 * pi * BANDWIDTH * T * (len(states) - 1 - 40))
    np.testing.assert_allclose(found, WRENCH + (kept - WRENCH) * left, atol=0.05)
