"""The operator's commands in the closed loop: what they do, that they are recorded, that they replay."""

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load
from hil.loop.replay import replay
from hil.signals import Operator, Order
from tests.broad import broad
from tests.live_reference import LIVE_REFERENCE
from tests.loop.bench import new_cycle
from tests.loop.operated import WITHIN, Changed, modes, simulated

BRISK = {"setup_speed_m_s": 0.5, "setup_speed_deg_s": 50}
PARKING = ["STOPPING", "PARKING", "UNLOADING", "PARKED"]
AS_ALWAYS = ["WAITING", "IDLE", "LOADING", "RELEASING", "APPROACH", "TRACKING"]


@pytest.fixture(scope="module")
def operated(tmp_path_factory):
    commands = [
        *[
            (3.0, "hold"),
            (4.0, "start"),
            (4.5, "speed 40"),
            (6.0, "speed 100"),
            (7.0, "hold"),
            (7.2, "start"),
        ],
        (8.0, "park"),
    ]
    return simulated(tmp_path_factory.mktemp("operate"), commands, operator=BRISK)


def test_hold_speed_start_and_park_end_parked_at_the_first_pose_and_replay_to_the_bit(operated):
    run, rows = operated
    assert run.success, run.summary
    assert run.summary["replay"]["different_ticks"] == 0
    assert run.summary["commands"] == {"given": 7, "refused": 0, "not_reached": 0}
    assert modes(rows) == AS_ALWAYS + PARKING
    np.testing.assert_allclose(rows["p_d"][-1], [0, 0, 1], atol=1e-4)
    assert set(run.summary["limited_ticks"].values()) == {0}


def test_on_hold_the_reference_rests_on_the_path_and_goes_on_from_there(operated):
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
def test_a_replay_notices_an_order_that_is_another(operated, tick, orders):
    run, _ = operated
    verdict = replay(Changed(run.log, tick, orders), new_cycle(load("virtual")))
    assert tick <= verdict.first[0].tick <= tick + WITHIN


def test_without_the_key_the_stop_begins_in_time_and_only_a_new_start_ends_it(tmp_path):
    held = [(0.02 * k, "key") for k in range(150)]
    again = [(4.0 + 0.02 * k, "key") for k in range(200)]
    run, rows = simulated(
        tmp_path,
        [*held, (3.8, "start"), *again, (5.0, "start")],
        duration_s=6.0,
        operator={"deadman_s": 0.1},
    )
    assert run.success
    assert run.summary["replay"]["different_ticks"] == 0
    t = rows["reference_time_s"]
    last_key, tracking = 2980, rows["mode"] == Mode.TRACKING
    slower = np.flatnonzero(tracking[1:] & (np.diff(t) < (1 - 1e-6) * 1e-3) & (rows["tick"][1:] > 1300))
    assert slower[0] + 1 == last_key + 100 + 1
    assert (np.diff(t[3585:5000]) == 0.0).all(), "a start without the key, a key without a start"
    assert t[5600] > t[5000]


def test_a_run_that_stays_is_parked_armed_and_recovered_from_an_emergency_stop(tmp_path):
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


@pytest.mark.long
@pytest.mark.parametrize("word", broad(["stop", "estop"], quick=1))
def test_a_stop_on_the_way_back_to_the_first_pose_ends_it_there(tmp_path, word):
    run, rows = simulated(tmp_path, [(2.2, "park"), (3.5, word)], check_replay=False)
    assert run.success == (word == "stop")
    assert np.abs(rows["p_d"][3500] - [0, 0, 1]).max() > 0.05, "it was under way"
    assert np.abs(rows["p_d"][-1] - rows["p_d"][3500]).max() < 0.05


SHORT = {"reference": {"periods": 1}, "engage": {"stop_s": 3.0}}
"""A path that ends at tick 3208, and a stop in which 1.5 s of path time go by."""


PARKS = [
    ("asked", {}, [(0.9, "park")], PARKING, 5000),
    ("automatic", {}, [(1.2, "park")], PARKING, 5000),
    ("automatic", SHORT, [(3.15, "park"), (5.0, "start")], ["TRACKING", *PARKING[1:]], 30_000),
    ("automatic", SHORT, [(3.15, "park")], ["TRACKING", *PARKING], 30_000),
]


@pytest.mark.parametrize(("start", "sections", "commands", "ends", "within"), broad(PARKS, quick=1))
def test_a_park_in_the_approach_and_just_before_the_end_of_the_path_parks(
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


@pytest.mark.long
def test_a_hold_in_the_approach_and_on_the_way_back_is_one_too(tmp_path):
    run, rows = simulated(
        tmp_path,
        [(0.9, "hold"), (2.2, "start"), (4.0, "park"), (5.0, "hold"), (6.0, "start")],
        check_replay=False,
    )
    assert run.success
    assert not rows["twist_d"][1500:2200].any()
    assert rows["mode"][2000] == Mode.APPROACH
    assert not rows["twist_d"][5680:6000].any(), "held while the speed rises: up to a third longer"
    assert rows["mode"][5900] == Mode.STOPPING
    np.testing.assert_allclose(rows["p_d"][-1], [0, 0, 1], atol=1e-4)


def test_a_live_reference_is_held_slowed_and_parked_and_refuses_set_points_on_hold(tmp_path):
    commands = [
        *[(1.5, "setpoint 0.2 0 1"), (2.0, "hold"), (3.2, "setpoint 0 0 1"), (3.4, "start")],
        *[(3.5, "speed 20"), (3.6, "setpoint 0.2 0 1"), (5.5, "park")],
    ]
    run, rows = simulated(tmp_path, commands, duration_s=60.0, reference=LIVE_REFERENCE, operator=BRISK)
    assert run.success, run.summary
    assert run.summary["replay"]["different_ticks"] == 0
    assert run.summary["setpoints"]["taken"] == 2
    assert run.summary["setpoints"]["refused"] == 1
    v = np.abs(rows["twist_d"])
    assert v[1500:2000].max() > 0.2
    assert not v[2900:3600].any()
    assert v[3600:5500].max() == pytest.approx(0.06)
    assert np.abs(np.diff(rows["dtwist_d"][1210:5500, :3], axis=0)).max() <= 10 * 1e-3 * (1 + 1e-9)
    assert modes(rows)[-5:] == ["TRACKING", *PARKING]
    np.testing.assert_allclose(rows["p_d"][-1], [0, 0, 1], atol=1e-4)
