"""From rest into motion and back to rest: without a bump from any pose, under any law, stopped at any moment."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.signals import DriveState, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load, loads
from hil.app.sim.command import simulate
from hil.app.sim.lockstep import Lockstep
from hil.record.log import Log
from hil.signals import Operator
from tests.broad import broad
from tests.loop import unrecorded

QUINTIC = """\
reference:
  type: waypoints
  interpolation: quintic
  points:
    - {t_s: 0, position_m: [0.02, 0, 1]}
    - {t_s: 1, position_m: [0.05, -0.04, 1.05], rotation_vector_deg: [2, 3, -2]}

"""
LAWS = {
    "inverse dynamics": "controller:\n  law: inverse_dynamics\n  wn_rad_s: 20\n\n",
    "pd": "controller:\n  law: pd\n  kp_N_m: 2.0e+6\n  kv_N_s_m: 5.0e+4\n\n",
}
DESIGNED = Path(__file__).parents[1] / "data" / "controller.yaml"
GAINS = "kp_N_m: 2.0e+6, kv_N_s_m: 5.0e+4"
OTHER_LAWS = {
    "pid": f"controller: {{law: pid, {GAINS}, ki_N_m_s: 2.0e+7, integral_limit_N: 8000}}\n\n",
    "pd_gravity": f"controller: {{law: pd_gravity, {GAINS}}}\n\n",
    "cartesian_pd": "controller: {law: cartesian_pd, kp_position_N_m: 1.0e+7, kv_position_N_s_m: 2.0e+5, "
    "kp_rotation_N_m_rad: 1.0e+7, kv_rotation_N_m_s_rad: 1.0e+5}\n\n",
    "feedforward_pd online": f"controller: {{law: feedforward_pd, {GAINS}}}\n\n",
    "feedforward_pd offline": f"controller: {{law: feedforward_pd, {GAINS}, evaluation: offline}}\n\n",
    "pose_inverse_dynamics": "controller: {law: pose_inverse_dynamics, wn_rad_s: 20}\n\n",
    "partial_linearisation": "controller: {law: partial_linearisation, wn_rad_s: 20}\n\n",
    "state_space": f"controller: {{law: state_space, controller_file: {DESIGNED}}}\n\n",
}
"""From one pose only; what a law does at entry depends little on the pose."""
POSES = {
    "home": ([0.0, 0.0, 1.0], [0.0, 0.0, 0.0]),
    "10 cm aside, 8 degrees about y": ([0.1, 0.0, 1.0], [0.0, 8.0, 0.0]),
    "10 cm up, 8 degrees about z": ([0.0, 0.0, 1.1], [0.0, 0.0, 8.0]),
    "aside, down and skew": ([-0.06, 0.08, 0.95], [5.0, -4.0, 5.0]),
}
LOAD_S, PERIOD_S = 0.3, 1e-3
STEEPEST = 1.875
"""Largest slope of the quintic 10 x^3 - 15 x^4 + 6 x^5, at x = 1/2."""


def bench(law="inverse dynamics", pose="home"):
    text = load("virtual").text
    for first, last, new in (
        ("controller:", "engage:", (LAWS | OTHER_LAWS)[law]),
        ("reference:", "limits:", QUINTIC),
    ):
        a, b = text.index("\n" + first) + 1, text.index("\n" + last) + 1
        text = text[:a] + new + text[b:]
    p, r = POSES[pose]
    text += f"  initial_position_m: {p}\n  initial_rotation_vector_deg: {r}\n"
    return loads(text, "engage.yaml", Path())


SKEW = "aside, down and skew"
SOME = [("inverse dynamics", SKEW), ("pid", SKEW)]
EVERY = [*itertools.product(LAWS, POSES), *itertools.product(OTHER_LAWS, [SKEW])]
ENTRIES = [*SOME, *(pytest.param(entry, marks=pytest.mark.long) for entry in EVERY if entry not in SOME)]


@pytest.fixture(scope="module", params=ENTRIES, ids=": ".join)
def engaged(request, tmp_path_factory):
    if request.param[1] != SKEW:  # a replay takes the poses as it finds them: one of each law shows that
        summary, rows = unrecorded.run(bench(*request.param))
        assert summary["success"], summary
        return summary, rows
    path = tmp_path_factory.mktemp("engage") / "run.mcap"
    summary = simulate(bench(*request.param), log=path)
    assert summary["success"], summary
    assert summary["replay"]["exact"]
    return summary, Log.open(path).rows()


def test_no_force_jumps_from_the_first_newton_to_the_last(engaged):
    """The steepest change is the ramp's own, to which encoder steps and the motion's own forces add a little.

    While the brakes close the law still acts: they end the last mm/s at once, which 5e4 N s/m sees.
    """
    summary, rows = engaged
    holding = np.abs(rows["tau"][rows["mode"] == Mode.RELEASING]).max()
    ramp = STEEPEST * holding * PERIOD_S / LOAD_S
    assert 15.0 < ramp < 50.0
    step = np.abs(np.diff(rows["tau"], axis=0)).max(axis=1)
    closing = rows["mode"][1:] == Mode.PARKING
    assert step[~closing].max() < 1.5 * ramp
    assert step[closing].max() < 100.0
    assert not any(summary["limited_ticks"].values())


def test_no_leg_moves_while_the_brakes_open(engaged):
    _, rows = engaged
    rest = rows["q"][rows["mode"] == Mode.LOADING][0]
    opening = rows[(rows["mode"] == Mode.LOADING) | (rows["mode"] == Mode.RELEASING)]
    assert np.abs(opening["q"] - rest).max() < 50e-6


def test_no_leg_moves_while_the_brakes_close(engaged):
    _, rows = engaged
    closing = rows[np.isin(rows["mode"], (Mode.PARKING, Mode.UNLOADING, Mode.PARKED))]
    assert np.abs(closing["q"] - closing["q"][0]).max() < 50e-6


def test_the_approach_starts_at_the_measured_pose_and_ends_at_the_references_first(engaged):
    _, rows = engaged
    approach = rows[rows["mode"] == Mode.APPROACH]
    measured = rows["p"][rows["mode"] == Mode.LOADING][0]
    assert np.abs(approach["p_d"][0] - measured).max() < 20e-6
    tracking = rows[rows["mode"] == Mode.TRACKING]
    assert np.abs(tracking["p_d"][0] - [0.02, 0, 1]).max() < 1e-12
    assert (
        np.abs(
            np.diff(rows["q_d"][(rows["mode"] >= Mode.RELEASING) & (rows["mode"] <= Mode.TRACKING)], axis=0)
        ).max()
        < 0.5e-3
    )


def test_pd_enters_at_the_holding_force_and_gives_it_up_slowly():
    """A law without gravity feed-forward asks for nothing at zero error: the entry offset carries the platform."""
    lockstep, close = both_ends(bench("pd", "home"))
    try:
        rows = [until(lockstep, Mode.APPROACH)]
        rows += [lockstep.step()[2].row for _ in range(700)]
    finally:
        close()
    # home_static of the book: 3618.6 N in each leg.
    assert np.abs(rows[0]["tau"] - 3618.6).max() < 20.0
    assert np.abs(rows[0]["tau_law"]).max() < 20.0
    assert np.abs(rows[-1]["tau"] - rows[-1]["tau_law"]).max() == 0.0
    sag = 3618.6 / 2e6
    assert np.abs(rows[-1]["q"] - rows[-1]["q_d"]).max() == pytest.approx(sag, rel=0.1)


# -- stops ---------------------------------------------------------------------------------------------------


def both_ends(configuration):
    rate = configuration.loop.rate_Hz
    cycle = build_cycle(configuration, rate, configuration.drives.watchdog_ms * 1e-3)
    nodes, plant = build_nodes(configuration)
    lockstep = Lockstep(cycle, nodes, (BitTiming.of(configuration.bus),), configuration.loop.window_s(rate))
    return lockstep, plant.close


def until(lockstep, mode, limit=10_000):
    """Step until the controller is in `mode`; engage on the way. Return the row of its first tick."""
    operator: tuple[Operator, ...] = (Operator.RESET,)
    for _ in range(limit):
        _, _, out = lockstep.step(operator)
        now = lockstep.cycle.mode
        if now is mode:
            return out.row
        assert now is not Mode.FAULT, lockstep.cycle.faults
        operator = (Operator.ENGAGE,) if now is Mode.IDLE else ()
    raise AssertionError(f"{mode.name} not reached")


@pytest.mark.parametrize(
    ("law", "share"),
    broad(
        [("inverse dynamics", 0.5), ("inverse dynamics", 0.02), ("inverse dynamics", 0.9), ("pd", 0.5)],
        quick=1,
    ),
    ids=["in the middle", "early", "late", "pd"],
)
@pytest.mark.parametrize(
    ("mode", "ticks"),
    [
        (Mode.LOADING, 600),
        (Mode.RELEASING, 100),
        (Mode.APPROACH, 500),
        (Mode.TRACKING, 1000),
        (Mode.STOPPING, 400),
        (Mode.PARKING, 100),
        (Mode.UNLOADING, 400),
    ],
    ids=lambda x: getattr(x, "name", ""),
)
def test_a_stop_in_any_mode_parks_and_the_platform_stays_where_it_is(law, mode, ticks, share):
    lockstep, close = both_ends(bench(law, "10 cm aside, 8 degrees about y"))
    try:
        before = Mode.TRACKING if mode is Mode.STOPPING else mode
        row = until(lockstep, before)
        if mode is Mode.STOPPING:
            for _ in range(300):
                lockstep.step()
            row = lockstep.step((Operator.STOP,))[2].row
        rows = [row]
        for _ in range(round(share * ticks)):
            rows.append(lockstep.step()[2].row)
        assert lockstep.cycle.mode is mode
        rows.append(lockstep.step((Operator.STOP,))[2].row)
        for _ in range(2000):
            rows.append(lockstep.step()[2].row)
            if lockstep.cycle.mode is Mode.PARKED:
                break
        assert lockstep.cycle.mode is Mode.PARKED
        assert not lockstep.cycle.faults
        parking = next(i for i, r in enumerate(rows) if r["mode"] in (Mode.PARKING, Mode.UNLOADING))
        closing = np.array([r["q"] for r in rows[parking:]])
        assert np.abs(closing - closing[0]).max() < 50e-6, "brakes close at rest"
        # on the way to rest and to zero force nothing jumps
        tau = np.array([r["tau"] for r in rows])
        assert np.abs(np.diff(tau, axis=0)).max() < 120.0
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
    finally:
        close()


def test_a_stop_before_the_start_never_opens_a_brake():
    lockstep, close = both_ends(bench())
    try:
        until(lockstep, Mode.IDLE)
        start = lockstep.nodes.snapshot().length
        lockstep.step((Operator.STOP,))
        assert lockstep.cycle.mode is Mode.PARKED
        for _ in range(500):
            _, _, out = lockstep.step((Operator.ENGAGE,))
            assert not out.row["tau"].any()
        after = lockstep.nodes.snapshot()
        assert (after.brake == 1.0).all()
        assert np.abs(after.length - start).max() < 1e-9
    finally:
        close()
