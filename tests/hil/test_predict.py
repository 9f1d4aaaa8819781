"""Forces in transit to the legs, and the predicted state, against equations integrated by scipy."""

import json
from math import exp
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from hil.contracts.records import altered, record_of
from hil.estimation.predictor import Predictor, ahead
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.force_path import ForcePath, decay
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian, leg_lengths

T = 1e-3
COMMANDS = np.random.default_rng(3).normal(0.0, 1e4, (12, 6))


def exact_mean(transport, lag, k):
    """Mean force from k T to (k + 1) T on a grid of 1 us; command n acts from n T + transport on."""
    fine = 1000
    steps = fine * (k + 1)
    t = (np.arange(steps) + 0.5) * T / fine
    index = np.floor((t - transport) / T + 1e-9).astype(int)
    u = np.where(index[:, None] < 0, 0.0, COMMANDS[np.clip(index, 0, None)])
    if lag > 0.0:
        a = exp(-T / fine / lag)
        u = lfilter([1.0 - a], [1.0, -a], u, axis=0)
    return u[-fine:].mean(axis=0)


@pytest.mark.parametrize("lag", [0.0, 0.8e-3, 3e-3])
@pytest.mark.parametrize("transport", [0.0, 0.5e-3, 1e-3, 1.7e-3, 2.25e-3])
def test_mean_delayed_force_between_two_measurements_is_exact(transport, lag):
    path = ForcePath(T, transport, lag)
    path.advance()
    for k, command in enumerate(COMMANDS):
        path.send(command)
        mean = path.advance()
        np.testing.assert_allclose(mean, exact_mean(transport, lag, k), atol=20.0 if lag else 1e-8)


def test_mean_force_of_a_delayed_step_through_the_drive_lag_is_exact():
    """Step of 100 N after 0.4 ms through a lag of 0.5 ms: mean over the first ms by quadrature."""
    path = ForcePath(T, 0.4e-3, 0.5e-3)
    path.send(np.full(6, 100.0))
    expected = quad(lambda t: 100.0 * (1.0 - exp(-(t - 0.4e-3) / 0.5e-3)), 0.4e-3, T)[0] / T
    np.testing.assert_allclose(path.advance(), expected, rtol=1e-12)
    np.testing.assert_allclose(path.force, 100.0 * (1.0 - exp(-0.6 / 0.5)), rtol=1e-12)


def test_skipped_periods_of_the_predictor_hold_the_last_force_command():
    skipping, sending = ForcePath(T, 0.4e-3, 0.5e-3), ForcePath(T, 0.4e-3, 0.5e-3)
    means = []
    for path in (skipping, sending):
        path.send(COMMANDS[0])
        path.advance()
        path.send(COMMANDS[1])
    for _ in range(3):
        means.append(sending.advance())
        sending.send(COMMANDS[1])
    np.testing.assert_allclose(skipping.advance(3), np.mean(means, axis=0), rtol=1e-12)
    np.testing.assert_allclose(skipping.force, sending.force, rtol=1e-12)


def test_prediction_horizon_is_split_at_the_arrival_times_of_force_commands():
    path = ForcePath(T, 1.6e-3, 0.0)
    cut = path.segments(2.1e-3)
    assert [s.sent for s in cut] == [1, 0], "the next command is assumed to equal the last one"
    assert [s.duration_s for s in cut] == pytest.approx([0.6e-3, 1.5e-3])
    assert sum(s.duration_s for s in path.segments(0.2e-3)) == pytest.approx(0.2e-3)
    assert path.segments(0.0) == ()


def test_compiled_decay_function_agrees_with_the_exponential():
    for x in (0.0, 1e-9, 0.05, 0.3, 1.0, 7.0, 40.0):
        assert decay(x) == pytest.approx(exp(-x), rel=1e-13)
    assert decay(1e30) == 0.0, "the decay over a vanishing lag must be zero"


BOOK = json.loads((Path(__file__).parents[1] / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
MODEL = Model(PLATFORM, viscous=300.0)
BUS, LAG, HOLD = 0.5e-3, 0.8e-3, 0.5e-3
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
    """Predictor after a long `force`, then one command with `change` added."""
    predictor = Predictor(MODEL, ForcePath(T, BUS, LAG), HOLD)
    for tick in range(30):
        moved(predictor, tick, state, free=False)
        predictor.path.send(force if tick < 29 else force + change)
    return predictor


def moved(predictor, tick, state, *, free=True):
    """Record of a tick with the state predicted by the predictor."""
    record = altered(state, tick=tick)
    ahead(predictor.record, int(free), record)
    return record


def integrated(state, force, command):
    """p, R, twist after the horizon; T df/dt = command - f, starting at `force`."""

    def derivative(_, x):
        R, twist, f = x[3:12].reshape(3, 3), x[12:18], x[18:]
        dR = np.cross(twist[3:], R.T).T
        dtwist = MODEL.forward_dynamics(x[:3], R, twist, f, WRENCH)
        return np.concatenate([twist[:3], dR.ravel(), dtwist, (command - f) / LAG])

    x = np.concatenate([state["p"], state["R"].ravel(), state["twist"], force])
    x = solve_ivp(derivative, (0.0, BUS + LAG + HOLD), x, rtol=1e-11, atol=1e-13).y[:, -1]
    return x[:3], x[3:12].reshape(3, 3), x[12:18]


@pytest.mark.parametrize("case", MOVING, ids=lambda c: f"t={c['t']:.2f}")
def test_prediction_agrees_with_integration_of_forces_in_transit(case):
    state, force = state_of(case), np.array(case["force"])
    found = moved(predictor_at(state, force, CHANGE), 30, state)
    arrived = force + CHANGE * (1.0 - exp(-(T - BUS) / LAG))
    p, R, twist = integrated(state, arrived, force + CHANGE)
    assert np.abs(found["p"] - state["p"]).max() > 5e-4, "the prediction must differ from the measurement"
    np.testing.assert_allclose(found["p"], p, rtol=0, atol=1e-6)
    assert Rotation.from_matrix(found["R"] @ R.T).magnitude() < 1e-6
    np.testing.assert_allclose(found["twist"], twist, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found["q"], leg_lengths(PLATFORM, found["p"], found["R"]), atol=1e-13)
    np.testing.assert_allclose(found["J"], jacobian(PLATFORM, found["p"], found["R"]), atol=1e-13)
    np.testing.assert_allclose(found["dq"], found["J"] @ found["twist"], atol=1e-13)
    assert (found["wrench"] == WRENCH).all()


@pytest.mark.parametrize("skipped", [1, 5])
def test_force_commands_in_transit_become_older_over_skipped_periods(skipped):
    """The drives keep the last command, whose full effect arrives later than one period."""
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


def test_the_predictor_moves_nothing_on_closed_brakes():
    state = state_of(MOVING[0])
    found = moved(predictor_at(state, CHANGE, CHANGE), 30, state, free=False)
    assert found.tobytes() == altered(state, tick=30).tobytes()
