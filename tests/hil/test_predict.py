"""The predicted state against the equations of motion, integrated by scipy."""

import json
from math import exp
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from hil.contracts.records import altered, record_of
from hil.estimation.predictor import Predictor, ahead
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.force_path import ForcePath
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian, leg_lengths

BOOK = json.loads((Path(__file__).parents[1] / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
MODEL = Model(PLATFORM, viscous=300.0)
T, BUS, LAG, HOLD = 1e-3, 0.5e-3, 0.8e-3, 0.5e-3
WRENCH = np.array([500.0, -300.0, 200.0, 20.0, 50.0, -40.0])
CHANGE = np.array([2000.0, -1500.0, 800.0, 2500.0, -700.0, 1200.0])
MOVING = [case for case in BOOK["states"][4::8] if any(case["v"])]


def state_of(case):
    p, R = np.array(case["p"]), rotation_from_vector(np.array(case["rotvec"]))
    twist = np.array(case["v"] + case["omega"])
    J = jacobian(PLATFORM, p, R)
    q = leg_lengths(PLATFORM, p, R)
    return record_of(q=q, dq=J @ twist, p=p, R=R, twist=twist, J=J, wrench=WRENCH)


def predictor_at(state, force, change):
    """Return a predictor that has seen `force` for long, then one command with `change` on top."""
    predictor = Predictor(MODEL, ForcePath(T, BUS, LAG), HOLD)
    for tick in range(30):
        moved(predictor, tick, state, free=False)
        predictor.path.send(force if tick < 29 else force + change)
    return predictor


def moved(predictor, tick, state, *, free=True):
    """The record of a tick with the state as the predictor moves it on."""
    record = altered(state, tick=tick)
    ahead(predictor.record, int(free), record)
    return record


def integrated(state, force, command):
    """Return p, R, twist after the horizon; T df/dt = command - f from `force` on."""

    def derivative(_, x):
        R, twist, f = x[3:12].reshape(3, 3), x[12:18], x[18:]
        dR = np.cross(twist[3:], R.T).T
        dtwist = MODEL.forward_dynamics(x[:3], R, twist, f, WRENCH)
        return np.concatenate([twist[:3], dR.ravel(), dtwist, (command - f) / LAG])

    x = np.concatenate([state["p"], state["R"].ravel(), state["twist"], force])
    x = solve_ivp(derivative, (0.0, BUS + LAG + HOLD), x, rtol=1e-11, atol=1e-13).y[:, -1]
    return x[:3], x[3:12].reshape(3, 3), x[12:18]


@pytest.mark.parametrize("case", MOVING, ids=lambda c: f"t={c['t']:.2f}")
def test_prediction_is_the_motion_under_the_forces_on_their_way(case):
    state, force = state_of(case), np.array(case["force"])
    found = moved(predictor_at(state, force, CHANGE), 30, state)
    arrived = force + CHANGE * (1.0 - exp(-(T - BUS) / LAG))
    p, R, twist = integrated(state, arrived, force + CHANGE)
    assert np.abs(found["p"] - state["p"]).max() > 5e-4, "there is something to predict"
    np.testing.assert_allclose(found["p"], p, rtol=0, atol=1e-6)
    assert Rotation.from_matrix(found["R"] @ R.T).magnitude() < 1e-6
    np.testing.assert_allclose(found["twist"], twist, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found["q"], leg_lengths(PLATFORM, found["p"], found["R"]), atol=1e-13)
    np.testing.assert_allclose(found["J"], jacobian(PLATFORM, found["p"], found["R"]), atol=1e-13)
    np.testing.assert_allclose(found["dq"], found["J"] @ found["twist"], atol=1e-13)
    assert (found["wrench"] == WRENCH).all()


@pytest.mark.parametrize("skipped", [1, 5])
def test_commands_under_way_grow_older_over_skipped_periods(skipped):
    """The drives go on with the last command; what it becomes is not there yet after one period."""
    state, force = state_of(MOVING[0]), np.array(MOVING[0]["force"])
    bridged, told = (predictor_at(state, force, CHANGE) for _ in range(2))
    for tick in range(30, 30 + skipped):
        moved(told, tick, state)
        told.path.send(force + CHANGE)
    found, expected = (moved(each, 30 + skipped, state) for each in (bridged, told))
    np.testing.assert_allclose(found["twist"], expected["twist"], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["p"], expected["p"], rtol=0, atol=1e-12)
    too_young = moved(predictor_at(state, force, CHANGE), 30, state)
    assert np.abs(too_young["twist"] - expected["twist"]).max() > 1e-4


def test_behind_closed_brakes_nothing_moves():
    state = state_of(MOVING[0])
    found = moved(predictor_at(state, CHANGE, CHANGE), 30, state, free=False)
    assert found.tobytes() == altered(state, tick=30).tobytes()


def test_reset_repeats_to_the_bit():
    state, force = state_of(MOVING[0]), np.array(MOVING[0]["force"])
    predictor = predictor_at(state, force, CHANGE)
    predictor.reset()
    fresh = Predictor(MODEL, ForcePath(T, BUS, LAG), HOLD)
    for tick in range(5):
        a, b = (moved(each, tick, state) for each in (predictor, fresh))
        assert a.tobytes() == b.tobytes()
        predictor.path.send(force)
        fresh.path.send(force)
