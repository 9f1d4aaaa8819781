"""Jogs in the closed loop: recorded, replayed to the bit, judged by the configuration's limits, and left again."""

import numpy as np
import pytest

from hil.app.configuration.configuration import load
from hil.loop.replay import replay
from hil.signals import JOG_NAMES, Operator, Order
from tests.live_reference import LIVE_REFERENCE
from tests.loop.bench import new_cycle
from tests.loop.operated import Changed, modes, simulated

BRISK = {"setup_speed_m_s": 0.2, "setup_speed_deg_s": 20}
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
    return simulated(tmp_path_factory.mktemp("jog"), COMMANDS, operator=BRISK)


def test_a_run_with_jogs_goes_back_goes_on_parks_and_replays_to_the_bit(jogged):
    run, rows = jogged
    assert run.success, run.summary["trouble"]
    assert run.summary["replay"]["different_ticks"] == 0
    assert modes(rows)[-5:] == ["TRACKING", "STOPPING", "PARKING", "UNLOADING", "PARKED"]
    np.testing.assert_allclose(rows["p_d"][-1], [0, 0, 1], atol=1e-4)
    assert np.abs(rows["q_d"] - rows["q"])[1300:-500].max() < 5e-4


def test_the_leg_that_is_jogged_moves_alone(jogged):
    _, rows = jogged
    q = lengths(rows[LEG])
    assert np.abs(np.delete(q - q[0], 3, axis=1)).max() < 1e-9
    # 0.6 s of words, of which the last counts 0.1 s longer less their 20 ms; starting costs what braking adds
    assert q[-1, 3] - q[0, 3] == pytest.approx(-0.7 * 0.2 * 0.68, abs=2e-3)
    assert np.abs(rows["dq_d"][LEG]).max() == pytest.approx(0.7 * 0.2)


def test_start_goes_on_from_where_the_path_was_left(jogged):
    _, rows = jogged
    left = rows[LEFT]
    again = np.flatnonzero((rows["tick"] > BACK) & (rows["reference_time_s"] == left["reference_time_s"]))
    assert len(again)
    np.testing.assert_allclose(rows["p_d"][again[0]], left["p_d"], atol=1e-12)
    assert np.abs(rows["p_d"][BACK - 50] - left["p_d"]).max() > 0.02
    on = rows[again[0] : 9600]
    assert on["reference_time_s"][-1] > left["reference_time_s"] + 0.2
    assert (np.diff(on["reference_time_s"]) >= 0.0).all()


@pytest.mark.long
@pytest.mark.parametrize(("axis", "fraction"), [("x", 1.0 - 1e-6), ("y", 1.0)])
def test_a_replay_notices_a_jog_that_is_another(jogged, axis, fraction):
    run, _ = jogged
    orders = (Order(Operator.JOG, (float(JOG_NAMES.index(axis)), fraction)),)
    changed = Changed(run.log, 4000, orders)
    assert 4000 <= replay(changed, new_cycle(load("virtual"))).first[0].tick <= 4010


def test_a_jog_stops_before_the_soft_end_of_the_stroke(tmp_path):
    run, rows = simulated(
        tmp_path,
        [(1.6, "hold"), (2.4, "jog leg0 1 for 6"), (9.5, "park")],
        operator=BRISK,
        check_replay=False,
    )
    assert run.success, run.summary["trouble"]
    assert set(run.summary["limited_ticks"].values()) == {0}
    q = lengths(rows)
    assert q.max() < 2.2 - 0.02 - 1e-3
    assert not rows["twist_d"][9400].any()


@pytest.mark.long
def test_a_stop_in_a_jog_ends_the_run_there_and_armed_again_it_jogs_again(tmp_path):
    commands = [
        *[(0.5, "arm"), (1.8, "hold"), (2.6, "jog y 1 for 1"), (3.0, "stop"), (5.0, "reset"), (5.4, "arm")],
        *[(8.0, "hold"), (9.0, "jog y -1 for 0.3"), (10.0, "start"), (11.0, "end")],
    ]
    run, rows = simulated(tmp_path, commands, operator=BRISK | {"stays": True})
    assert run.success, run.summary["trouble"]
    assert run.summary["replay"]["different_ticks"] == 0
    assert modes(rows).count("PARKED") == 2
    parked = rows["p_d"][4800]
    assert 0.05 < parked[1] - rows["p_d"][2590][1] < 0.2
    assert rows["twist_d"][9200][1] < -0.05


def test_the_key_that_is_let_go_of_ends_a_jog(tmp_path):
    run, rows = simulated(
        tmp_path,
        [(0.0, "key for 4"), (2.0, "hold"), (3.0, "jog x -1 for 3")],
        duration_s=6.0,
        operator=BRISK | {"deadman_s": 0.1},
        check_replay=False,
    )
    assert run.success
    assert rows["twist_d"][3600:4080, 0].max() == pytest.approx(-0.2)
    assert rows["twist_d"][4090, 0] > -0.2
    assert not rows["twist_d"][4700:5900].any()


def test_a_live_reference_is_not_jogged(tmp_path):
    run, rows = simulated(
        tmp_path,
        [(1.5, "hold"), (2.0, "jog x 1 for 0.5")],
        duration_s=3.0,
        reference=LIVE_REFERENCE,
        check_replay=False,
    )
    assert run.success
    assert not rows["twist_d"][1300:2900].any()
