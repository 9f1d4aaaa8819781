"""The same law over an ideal and a real path, with and without delay compensation, and precise references.

The cost of a delay: with exact inverse dynamics a force that is late by T disturbs e'' + 2 wn e' + wn^2 e by
T times the jerk of the reference, so the error is proportional to T. The ideal path is late by half a period,
due to the hold, and its error is known from other sources; the others follow from their delays. On `virtual`
SYNC to force takes 0.5 ms (rates are latched at 0.1 ms, force at 0.6 ms), the drives' force loop of 200 Hz
lags 0.796 ms.
"""

from __future__ import annotations

import json
from functools import cache
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load, loads
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from tests.loop.bench import changed, run, succeeded

DATA = Path(__file__).parents[1] / "data"
ROWS = json.loads((DATA / "book_closed_loop.json").read_text())["rows"]
ZOH_IDEAL_MM = ROWS["joint_IDC_exact_wn20_1kHz_ZOH"]["peak_leg_err_mm"]
HOLD_S = 0.5e-3
"""A force held for a period of 1 ms is late by half of it."""
BUS_S = (75.0 + 6 * 64.6 + 60.0 + 105.6) * 1e-6
"""SYNC of 2 bytes, six feedbacks of 12, the controller's 60 us, a command of 32 bytes, at 1 and 5 Mbit/s."""
LAG_S = 1 / (2 * pi * 200.0)
"""First-order force loop of 200 Hz."""
ENCODERS: dict[str, Any] = {"plant": {"drives": {"encoder_resolution_m": 1e-6}}}


@pytest.mark.long
def test_tracking_error_grows_with_the_delay_of_the_loop():
    benches = {
        "ideal": load("ideal"),
        "encoders of 1 um": changed("ideal", **ENCODERS),
        "and bus time": changed("ideal", **ENCODERS, bus={"layout": "fd"}),
        "and drives of 200 Hz": changed("virtual", reference={"periods": 1}),
    }
    peaks = [succeeded(c).summary["tracking"]["peak_leg_error_mm"] for c in benches.values()]
    ideal, encoders, bus, drives = peaks
    assert ideal == pytest.approx(ZOH_IDEAL_MM, rel=0.10)
    assert ideal < encoders < bus < drives
    assert encoders - ideal < 2e-3, "an encoder step of 1 um"
    for peak, delay_s in ((bus, HOLD_S + BUS_S), (drives, HOLD_S + BUS_S + LAG_S)):
        assert peak == pytest.approx(ZOH_IDEAL_MM * delay_s / HOLD_S, rel=0.05)


def test_constant_pose_is_held_within_encoder_steps():
    pose = {"position_m": [0.05, -0.05, 1.02]}
    rows = succeeded(changed("virtual", reference={"type": "hold", "pose": pose, "duration_s": 1})).tracking
    error = np.abs(rows["p"] - pose["position_m"]).max(axis=1)
    assert error.max() < 50e-6, "left over from the approach"
    assert error[rows["reference_time_s"] > 0.8].max() < 2e-6, "two steps of the encoder"


def test_way_points_of_a_quintic_path_are_reached():
    points = [(0, [0, 0, 1]), (1.0, [0.1, -0.1, 1.05]), (2.2, [-0.1, 0.05, 0.95]), (3.0, [0, 0, 1])]
    reference = {
        "interpolation": "quintic",
        "periods": 1,
        "points": [{"t_s": t, "position_m": p} for t, p in points],
    }
    rows = succeeded(changed("virtual", reference=reference)).tracking
    half_way = (0.5, [0.05, -0.05, 1.025])
    for instant, p in (*points, half_way):
        here = rows["p"][int(np.argmin(np.abs(rows["reference_time_s"] - instant)))]
        assert np.abs(here - p).max() < (0.5e-3 if instant == half_way[0] else 0.1e-3)


def test_path_of_a_csv_file_is_followed_and_its_log_replays_without_the_file(tmp_path):
    def circle(t):
        return 0.04 * (1 - np.cos(np.pi * t / 2)), 0.05 * np.sin(np.pi * t / 2) ** 2

    lines = ["t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg"]
    for t in np.arange(0.0, 4.1, 0.2):
        x, y = circle(t)
        lines.append(f"{t:.1f},{x:.9f},{y:.9f},1,0,{20 * x:.9f},0")
    (tmp_path / "path.csv").write_text("\n".join(lines))
    text = changed("virtual", reference={"type": "sampled", "path": str(DATA / "path.csv")}).text
    c = loads(text.replace(str(DATA / "path.csv"), "path.csv"), "sampled.yaml", tmp_path)
    rows = succeeded(c).tracking
    assert rows["reference_time_s"][-1] > 3.99
    x, y = circle(rows["reference_time_s"])
    assert np.abs(rows["p"] - np.stack([x, y, np.ones_like(x)], axis=1)).max() < 0.1e-3
    simulate(c, log=tmp_path / "a.mcap", duration_s=1.5, check_replay=False)
    (tmp_path / "path.csv").unlink()
    assert replay_log(tmp_path / "a.mcap")[0].exact


# -- delay compensation --------------------------------------------------------------------------------------


FAR: dict[str, list[float]] = {"position_m": [0.25, 0.5, 0.75], "rotation_vector_deg": [5, 10, 15]}
HOME: dict[str, list[float]] = {"position_m": [0, 0, 1]}
TRUE = {"bus_ms": 0.5, "drive_lag_ms": 0.8, "hold_ms": 0.5}


def bench(name: str, delay: dict[str, float] | None, hold_s: float = 0.1) -> Any:
    """The book's path after a hold."""
    times = [0, 1, 2] if not hold_s else [0, hold_s, 1 + hold_s, 2 + hold_s]
    poses = [HOME, FAR, HOME] if not hold_s else [HOME, HOME, FAR, HOME]
    points = [{"t_s": t} | pose for t, pose in zip(times, poses, strict=True)]
    law = {"delay_compensation": delay} if delay else {}
    return changed(name, controller=law, reference={"periods": 1, "points": points})


RUNS: dict[str, tuple[str, dict[str, float] | None]] = {
    "bus": ("virtual", None),
    "bus, compensated": ("virtual", TRUE),
    "bus, twice the delay": ("virtual", {key: 2 * value for key, value in TRUE.items()}),
}


@cache
def rows(name: str) -> Any:
    return succeeded(bench(*RUNS[name])).rows


def peak_mm(found: Any) -> float:
    moving = found[found["mode"] == Mode.TRACKING]
    return 1e3 * float(np.abs(moving["q_d"] - moving["q"]).max())


@pytest.mark.long
def test_delay_compensation_reduces_the_tracking_error_caused_by_the_bus_to_a_third():
    without, compensated = peak_mm(rows("bus")), peak_mm(rows("bus, compensated"))
    assert without <= 0.15
    assert compensated <= min(0.05, without / 3)


@pytest.mark.long
def test_tracking_error_left_by_delay_compensation_comes_from_the_jump_of_the_acceleration():
    """The jump falls between two ticks. Where the path is smooth, from 0.6 s to 1.1 s, an eighth of the error
    remains.
    """

    def smooth_mm(name: str) -> float:
        t = rows(name)["reference_time_s"]
        return peak_mm(rows(name)[(t > 0.6) & (t < 1.1)])

    assert smooth_mm("bus") == peak_mm(rows("bus"))
    assert smooth_mm("bus, compensated") < smooth_mm("bus") / 8
    assert peak_mm(rows("bus, compensated")) > 2 * smooth_mm("bus, compensated")


@pytest.mark.long
def test_compensation_of_twice_the_delay_tracks_worse_than_no_compensation():
    wrong = peak_mm(rows("bus, twice the delay"))
    assert wrong > peak_mm(rows("bus"))
    assert wrong > 3 * peak_mm(rows("bus, compensated"))


def test_safety_and_log_use_present_state_and_reference_although_the_law_uses_predicted_ones():
    """The same path in both runs, tick by tick, and the recorded pose is the measured one."""
    a, b = rows("bus"), rows("bus, compensated")
    np.testing.assert_array_equal(a["tick"], b["tick"])
    moving = (a["mode"] == Mode.TRACKING) & (b["mode"] == Mode.TRACKING)
    for column in ("q_d", "dq_d", "ddq_d"):
        assert a[column][moving].tobytes() == b[column][moving].tobytes()
    assert np.abs(a["q"][moving] - b["q"][moving]).max() < 0.2e-3


def test_start_and_end_of_motion_have_no_bump_with_delay_compensation():
    """The jump of the first acceleration, 2.5 kN, is commanded a tick early: 1.8 ms ahead lies on the path."""
    ran = run(bench("virtual", TRUE, hold_s=0.0), stop_s=2.2)
    assert ran.ending.success, ran.ending
    mode, steps = ran.rows["mode"], np.abs(np.diff(ran.rows["tau"], axis=0)).max(axis=1)
    begins = ran.first(Mode.TRACKING)
    assert steps[begins - 2] > 2000.0, "from the tick before the last of the approach to the last"
    assert max(steps[begins - 3], steps[begins - 1], steps[begins]) < 100.0
    calm = np.isin(mode[1:], [Mode.RELEASING, Mode.APPROACH, Mode.STOPPING, Mode.PARKING])
    calm[begins - 2] = False
    assert {*mode[1:][calm]} == {Mode.RELEASING, Mode.APPROACH, Mode.STOPPING, Mode.PARKING}
    assert steps[calm].max() < 60.0
