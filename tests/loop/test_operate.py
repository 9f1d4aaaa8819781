"""The operator's commands in the closed loop: effects, recording, replay."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load
from hil.loop.replay import replay
from hil.signals import Operator, Order
from tests.broad import broad
from tests.loop.bench import new_cycle
from tests.loop.operator_runs import WITHIN, Changed, modes, simulated

BRISK = {"setup_speed_m_s": 0.5, "setup_speed_deg_s": 50}
PARKING = ["STOPPING", "PARKING", "UNLOADING", "PARKED"]
AS_ALWAYS = ["WAITING", "IDLE", "LOADING", "RELEASING", "APPROACH", "TRACKING"]


@pytest.fixture(scope="module")
def operated(tmp_path_factory):
    commands = [
        *[(3.0, "hold"), (4.0, "start"), (4.5, "speed 40"), (6.0, "speed 100")],
        *[(7.0, "hold"), (7.2, "start"), (8.0, "park")],
    ]
    return simulated(tmp_path_factory.mktemp("operate"), commands, operator=BRISK)


def test_run_with_hold_speed_start_and_park_commands_ends_at_its_first_pose_and_replays(operated):
    run, rows = operated
    assert run.success, run.summary
    assert run.summary["replay"]["different_ticks"] == 0
    assert run.summary["commands"] == {"given": 7, "refused": 0, "not_reached": 0}
    assert modes(rows) == AS_ALWAYS + PARKING
    np.testing.assert_allclose(rows["p_d"][-1], [0, 0, 1], atol=1e-4)
    assert set(run.summary["limited_ticks"].values()) == {0}


def test_hold_command_stops_the_reference_on_its_path_and_start_resumes_it_there(operated):
    _, rows = operated
    held = rows[3510:4000]
    assert (held["mode"] == Mode.TRACKING).all()
    assert not held["twist_d"].any()
    assert len(set(held["reference_time_s"])) == 1
    assert np.abs(held["q_d"] - held["q"]).max() < 1e-4
    along = np.diff(rows["reference_time_s"][4510:6000]) / 1e-3
    assert along[-1] == pytest.approx(0.4)
    x, direction = rows["p_d"][1300:8500] - [0, 0, 1], np.array([0.25, 0.5, -0.25])
    assert np.abs(np.cross(x, direction)).max() < 1e-9, "never off the path"


@pytest.mark.parametrize(
    ("tick", "orders"),
    broad(
        [(4500, (Order(Operator.SPEED, (0.4 + 1e-6,)),)), (3000, ()), (2999, (Order(Operator.HOLD),))],
        quick=1,
    ),
)
def test_replay_detects_a_changed_operator_command(operated, tick, orders):
    run, _ = operated
    verdict = replay(Changed(run.log, tick, orders), new_cycle(load("virtual")))
    assert tick <= verdict.first[0].tick <= tick + WITHIN


def test_motion_stops_in_time_when_the_enabling_key_is_released_and_resumes_after_a_new_start(tmp_path):
    held = [(0.02 * k, "key") for k in range(150)]
    again = [(4.0 + 0.02 * k, "key") for k in range(200)]
    run, rows = simulated(
        tmp_path, [*held, (3.8, "start"), *again, (5.0, "start")], duration_s=6.0, operator={"deadman_s": 0.1}
    )
    assert run.success
    assert run.summary["replay"]["different_ticks"] == 0
    t = rows["reference_time_s"]
    last_key, tracking = 2980, rows["mode"] == Mode.TRACKING
    slower = np.flatnonzero(tracking[1:] & (np.diff(t) < (1 - 1e-6) * 1e-3) & (rows["tick"][1:] > 1300))
    assert slower[0] + 1 == last_key + 100 + 1
    assert (np.diff(t[3585:5000]) == 0.0).all(), "a start without the key, a key without a start"
    assert t[5600] > t[5000]


def test_run_set_to_stay_parks_and_can_be_armed_again_also_after_an_emergency_stop(tmp_path):
    commands = [
        *[(0.5, "arm"), (2.0, "park"), (4.8, "reset"), (5.2, "arm"), (6.8, "estop")],
        *[(7.5, "reset"), (8.0, "arm"), (10.5, "stop"), (12.0, "end")],
    ]
    run, rows = simulated(tmp_path, commands, operator=BRISK | {"stays": True})
    assert run.success, run.summary["trouble"]
    assert run.summary["commands"]["not_reached"] == 0
    assert run.summary["replay"]["different_ticks"] == 0
    once = AS_ALWAYS[1:]
    assert modes(rows) == ["WAITING", *once, *PARKING, "WAITING", *once, "FAULT", "WAITING", *once, *PARKING]


SHORT = {"reference": {"periods": 1}, "engage": {"stop_s": 3.0}}
"""A path that ends at tick 3208, and a stop during which path time advances by 1.5 s."""


PARKS = [
    ("asked", {}, [(0.9, "park")], PARKING, 5000),
    ("automatic", {}, [(1.2, "park")], PARKING, 5000),
    ("automatic", SHORT, [(3.15, "park"), (5.0, "start")], ["TRACKING", *PARKING[1:]], 30_000),
    ("automatic", SHORT, [(3.15, "park")], ["TRACKING", *PARKING], 30_000),
]


@pytest.mark.parametrize(("start", "sections", "commands", "ends", "within"), broad(PARKS, quick=1))
def test_park_command_in_the_approach_or_just_before_the_path_ends_parks_the_platform(
    tmp_path, start, sections, commands, ends, within
):
    settings = BRISK | {"start": start}
    run, rows = simulated(tmp_path, commands, duration_s=30.0, operator=settings, **sections)
    assert run.success, run.summary["trouble"]
    assert run.summary["replay"]["different_ticks"] == 0
    assert rows["tick"][-1] < within, "parked, not stopped by the end of the run"
    assert modes(rows)[-len(ends) :] == ends
    if not sections:
        np.testing.assert_allclose(rows["p_d"][-1], [0, 0, 1], atol=1e-4)


# -- jogs ----------------------------------------------------------------------------------------------------


SLOW = {"setup_speed_m_s": 0.2, "setup_speed_deg_s": 20}
LEFT, LEG, BACK = 3999, slice(5150, 6500), 7500
COMMANDS = [
    *[(3.0, "hold"), (4.0, "jog x 1 for 0.5"), (5.2, "jog leg3 -0.7 for 0.6"), (6.5, "jog rz -1 for 0.3")],
    *[(7.5, "start"), (9.6, "hold"), (10.5, "jog z 1 for 0.4"), (11.5, "park")],
]
PLATFORM = load("virtual").platform
BASE, MOVING = np.array(PLATFORM.base_joints_m), np.array(PLATFORM.platform_joints_m)


def lengths(rows):
    joints = rows["p_d"][:, None, :] + np.einsum("nij,kj->nki", rows["R_d"], MOVING)
    return np.linalg.norm(joints - BASE, axis=2)


@pytest.fixture(scope="module")
def jogged(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("jog"), COMMANDS, operator=SLOW)


def test_run_with_jog_commands_returns_to_its_path_parks_and_replays(jogged):
    run, rows = jogged
    assert run.success, run.summary["trouble"]
    assert run.summary["replay"]["different_ticks"] == 0
    assert modes(rows)[-5:] == ["TRACKING", "STOPPING", "PARKING", "UNLOADING", "PARKED"]
    np.testing.assert_allclose(rows["p_d"][-1], [0, 0, 1], atol=1e-4)
    assert np.abs(rows["q_d"] - rows["q"])[1300:-500].max() < 5e-4


def test_jog_of_one_leg_changes_the_length_of_that_leg_only(jogged):
    _, rows = jogged
    q = lengths(rows[LEG])
    assert np.abs(np.delete(q - q[0], 3, axis=1)).max() < 1e-9
    # 0.6 s of words, of which the last counts 0.1 s longer less their 20 ms; starting costs what braking adds
    assert q[-1, 3] - q[0, 3] == pytest.approx(-0.7 * 0.2 * 0.68, abs=2e-3)
    assert np.abs(rows["dq_d"][LEG]).max() == pytest.approx(0.7 * 0.2)


def test_start_command_after_a_jog_resumes_the_path_where_it_was_left(jogged):
    _, rows = jogged
    left = rows[LEFT]
    again = np.flatnonzero((rows["tick"] > BACK) & (rows["reference_time_s"] == left["reference_time_s"]))
    assert len(again)
    np.testing.assert_allclose(rows["p_d"][again[0]], left["p_d"], atol=1e-12)
    assert np.abs(rows["p_d"][BACK - 50] - left["p_d"]).max() > 0.02
    on = rows[again[0] : 9600]
    assert on["reference_time_s"][-1] > left["reference_time_s"] + 0.2
    assert (np.diff(on["reference_time_s"]) >= 0.0).all()


def test_jog_of_a_leg_stops_before_the_soft_end_of_its_stroke(tmp_path):
    run, rows = simulated(
        tmp_path, [(1.6, "hold"), (2.4, "jog leg0 1 for 6"), (9.5, "park")], operator=SLOW, check_replay=False
    )
    assert run.success, run.summary["trouble"]
    assert set(run.summary["limited_ticks"].values()) == {0}
    q = lengths(rows)
    assert q.max() < 2.2 - 0.02 - 1e-3
    assert not rows["twist_d"][9400].any()


def test_release_of_the_enabling_key_ends_a_jog(tmp_path):
    run, rows = simulated(
        tmp_path,
        [(0.0, "key for 4"), (2.0, "hold"), (3.0, "jog x -1 for 3")],
        duration_s=6.0,
        operator=SLOW | {"deadman_s": 0.1},
        check_replay=False,
    )
    assert run.success
    assert rows["twist_d"][3600:4080, 0].max() == pytest.approx(-0.2)
    assert rows["twist_d"][4090, 0] > -0.2
    assert not rows["twist_d"][4700:5900].any()
