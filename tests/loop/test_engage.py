"""From rest into motion and back to rest: without a bump, from any pose, under any law, with a stop in any
mode.
"""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.signals import DriveState, Mode
from hil.app.configuration.configuration import Configuration
from hil.signals import Operator
from tests.broad import broad
from tests.loop.bench import Ran, bench, changed, run, until

QUINTIC = {
    "type": "waypoints",
    "interpolation": "quintic",
    "periods": 1,
    "points": [
        {"t_s": 0, "position_m": [0.02, 0, 1]},
        {"t_s": 1, "position_m": [0.05, -0.04, 1.05], "rotation_vector_deg": [2, 3, -2]},
    ],
}
GAINS = {"kp_N_m": 2.0e6, "kv_N_s_m": 5.0e4}
LAWS: dict[str, dict[str, Any]] = {
    "inverse dynamics": {"law": "inverse_dynamics", "wn_rad_s": 20},
    "pd": {"law": "pd", **GAINS},
}
OTHER_LAWS: dict[str, dict[str, Any]] = {
    "pid": {"law": "pid", **GAINS, "ki_N_m_s": 2.0e7, "integral_limit_N": 8000},
    "pd_gravity": {"law": "pd_gravity", **GAINS},
    "cartesian_pd": {
        "law": "cartesian_pd", "kp_position_N_m": 1.0e7, "kv_position_N_s_m": 2.0e5,
        "kp_rotation_N_m_rad": 1.0e7, "kv_rotation_N_m_s_rad": 1.0e5,
    },
    "feedforward_pd online": {"law": "feedforward_pd", **GAINS},
    "feedforward_pd offline": {"law": "feedforward_pd", **GAINS, "evaluation": "offline"},
    "pose_inverse_dynamics": {"law": "pose_inverse_dynamics", "wn_rad_s": 20},
    "partial_linearisation": {"law": "partial_linearisation", "wn_rad_s": 20},
    "state_space": {
        "law": "state_space", "controller_file": Path(__file__).parents[1] / "data" / "controller.yaml"
    },
}  # fmt: skip
"""From one pose only: the entry of a law depends little on the pose."""
POSES = {
    "home": ([0.0, 0.0, 1.0], [0.0, 0.0, 0.0]),
    "10 cm aside, 8 degrees about y": ([0.1, 0.0, 1.0], [0.0, 8.0, 0.0]),
    "10 cm up, 8 degrees about z": ([0.0, 0.0, 1.1], [0.0, 0.0, 8.0]),
    "aside, down and skew": ([-0.06, 0.08, 0.95], [5.0, -4.0, 5.0]),
}
LOAD_S, PERIOD_S = 0.3, 1e-3
STEEPEST = 1.875
"""Largest slope of the quintic 10 x^3 - 15 x^4 + 6 x^5, at x = 1/2."""


def at(law: str = "inverse dynamics", pose: str = "home") -> Configuration:
    p, r = POSES[pose]
    start = {"initial_position_m": p, "initial_rotation_vector_deg": r}
    return changed("virtual", controller=(LAWS | OTHER_LAWS)[law], reference=QUINTIC, plant=start)


SKEW = "aside, down and skew"
SOME = [("inverse dynamics", SKEW), ("pid", SKEW)]
EVERY = [*itertools.product(LAWS, POSES), *itertools.product(OTHER_LAWS, [SKEW])]
ENTRIES = [*SOME, *(pytest.param(entry, marks=pytest.mark.long) for entry in EVERY if entry not in SOME)]


@pytest.fixture(scope="module", params=ENTRIES, ids=": ".join)
def engaged(request: pytest.FixtureRequest) -> Ran:
    ran = run(at(*request.param))
    assert ran.ending.success, ran.ending
    return ran


def test_leg_forces_have_no_step_from_brake_opening_through_motion_to_brake_closing(engaged):
    """The steepest change is the ramp's own; encoder steps and the motion's forces add a little.

    While the brakes close the law still acts: they end the last mm/s at once, to which 5e4 N s/m reacts.
    """
    rows = engaged.rows
    holding = np.abs(rows["tau"][rows["mode"] == Mode.RELEASING]).max()
    ramp = STEEPEST * holding * PERIOD_S / LOAD_S
    assert 15.0 < ramp < 50.0
    step = np.abs(np.diff(rows["tau"], axis=0)).max(axis=1)
    closing = rows["mode"][1:] == Mode.PARKING
    assert step[~closing].max() < 1.5 * ramp
    assert step[closing].max() < 100.0
    assert not any(engaged.summary["limited_ticks"].values())


def test_no_leg_moves_while_the_brakes_open_and_close(engaged):
    rows = engaged.rows
    rest = rows["q"][rows["mode"] == Mode.LOADING][0]
    opening = rows[(rows["mode"] == Mode.LOADING) | (rows["mode"] == Mode.RELEASING)]
    assert np.abs(opening["q"] - rest).max() < 50e-6
    closing = rows[np.isin(rows["mode"], (Mode.PARKING, Mode.UNLOADING, Mode.PARKED))]
    assert np.abs(closing["q"] - closing["q"][0]).max() < 50e-6


def test_approach_moves_the_platform_from_the_measured_pose_to_the_start_of_the_reference(engaged):
    rows = engaged.rows
    approach = rows[rows["mode"] == Mode.APPROACH]
    measured = rows["p"][rows["mode"] == Mode.LOADING][0]
    assert np.abs(approach["p_d"][0] - measured).max() < 20e-6
    tracking = rows[rows["mode"] == Mode.TRACKING]
    assert np.abs(tracking["p_d"][0] - [0.02, 0, 1]).max() < 1e-12
    moving = (rows["mode"] >= Mode.RELEASING) & (rows["mode"] <= Mode.TRACKING)
    assert np.abs(np.diff(rows["q_d"][moving], axis=0)).max() < 0.5e-3


def test_pd_law_without_gravity_compensation_starts_at_the_holding_force_and_fades_it_out():
    """A law without gravity feed-forward asks for no force at zero error: the entry offset carries the
    platform.
    """
    with bench(at("pd")) as lockstep:
        rows = [until(lockstep, Mode.APPROACH)]
        rows += [lockstep.step()[2].row for _ in range(700)]
    # home_static of the book: 3618.6 N in each leg.
    assert np.abs(rows[0]["tau"] - 3618.6).max() < 20.0
    assert np.abs(rows[0]["tau_law"]).max() < 20.0
    assert np.abs(rows[-1]["tau"] - rows[-1]["tau_law"]).max() == 0.0
    sag = 3618.6 / 2e6
    assert np.abs(rows[-1]["q"] - rows[-1]["q_d"]).max() == pytest.approx(sag, rel=0.1)


# -- stops ---------------------------------------------------------------------------------------------------


STOPS = {
    Mode.LOADING: 600,
    Mode.RELEASING: 100,
    Mode.APPROACH: 500,
    Mode.TRACKING: 1000,
    Mode.STOPPING: 400,
    Mode.PARKING: 100,
    Mode.UNLOADING: 400,
}
"""Duration of each mode in ticks."""
MOMENTS = [("inverse dynamics", mode, 0.5) for mode in STOPS]
MOMENTS += [
    (("inverse dynamics", "pd")[n % 2], mode, (0.02, 0.9)[n // 2 % 2]) for n, mode in enumerate(STOPS)
]
MOMENTS += [
    (("pd", "inverse dynamics")[n % 2], mode, (0.9, 0.02)[n // 2 % 2]) for n, mode in enumerate(STOPS)
]


@pytest.mark.parametrize(("law", "mode", "share"), broad(MOMENTS, quick=len(STOPS)))
def test_stop_command_in_any_mode_parks_the_platform_at_its_present_pose(law, mode, share):
    with bench(at(law, "10 cm aside, 8 degrees about y")) as lockstep:
        row = until(lockstep, Mode.TRACKING if mode is Mode.STOPPING else mode)
        if mode is Mode.STOPPING:
            for _ in range(300):
                lockstep.step()
            row = lockstep.step((Operator.STOP,))[2].row
        rows = [row]
        rows += [lockstep.step()[2].row for _ in range(round(share * STOPS[mode]))]
        assert lockstep.cycle.mode is mode
        rows.append(lockstep.step((Operator.STOP,))[2].row)
        while lockstep.cycle.mode is not Mode.PARKED:
            rows.append(lockstep.step()[2].row)
            assert len(rows) < 5000
        assert not lockstep.cycle.faults
        parking = next(i for i, r in enumerate(rows) if r["mode"] in (Mode.PARKING, Mode.UNLOADING))
        closing = np.array([r["q"] for r in rows[parking:]])
        assert np.abs(closing - closing[0]).max() < 50e-6, "brakes close at rest"
        tau = np.array([r["tau"] for r in rows])
        assert np.abs(np.diff(tau, axis=0)).max() < 120.0, "nothing jumps on the way to rest and to no force"
        for _ in range(50):
            lockstep.step()
        parked = lockstep.nodes.snapshot()
        assert [DriveState(int(s)) for s in parked.state] == [DriveState.OFF] * 6
        assert (parked.brake == 1.0).all()
        assert (parked.command == 0.0).all()
        for _ in range(300):
            lockstep.step()
        later = lockstep.nodes.snapshot()
        assert np.abs(later.length - parked.length).max() < 1e-6, "the brakes hold the platform"
        assert np.abs(later.rate).max() < 1e-6


def test_stop_command_before_the_start_never_opens_a_brake():
    with bench(at()) as lockstep:
        until(lockstep, Mode.IDLE)
        start = lockstep.nodes.snapshot().length
        lockstep.step((Operator.STOP,))
        assert lockstep.cycle.mode is Mode.PARKED
        for _ in range(500):
            assert not lockstep.step((Operator.ENGAGE,))[2].row["tau"].any()
        after = lockstep.nodes.snapshot()
        assert (after.brake == 1.0).all()
        assert np.abs(after.length - start).max() < 1e-9
