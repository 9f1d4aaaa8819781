"""Figures of a run, each from constructed rows."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.signals import BusState, Fault, Mode, Refusal, Warn
from drivers.tick_columns import ROW
from hil.record.figures import certificate, figures, picture, pose_errors
from hil.signals import REASONS


def rows_of(count, mode=Mode.TRACKING, **columns):
    rows = np.zeros(count, ROW)
    rows["t_ns"] = 1_000_000 * np.arange(count)
    rows["R"] = rows["R_d"] = np.eye(3)
    rows["mode"] = mode
    rows["lyapunov"] = np.nan
    for name, values in columns.items():
        rows[name] = values
    return rows


def turned(*degrees):
    return Rotation.from_rotvec(degrees, degrees=True).as_matrix()


def test_peak_force_includes_push_and_pull_in_all_modes():
    tau = np.zeros((4, 6))
    tau[0, 0], tau[1, 2], tau[2, 5] = 950.0, 300.0, -900.0
    found = figures(rows_of(4, [Mode.LOADING, *[Mode.TRACKING] * 3], tau=tau))
    assert (found["peak_force_N"], found["tracking"]["peak_force_N"]) == (950.0, 900.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_leg_errors_and_rates_count_in_both_directions(sign):
    q, dq = np.zeros((3, 6)), np.zeros((3, 6))
    q[1, 4], dq[2, 0] = sign * 2e-3, sign * 0.5
    tracking = figures(rows_of(3, q=q, dq=dq))["tracking"]
    assert tracking["peak_leg_error_mm"] == pytest.approx(2.0)
    assert tracking["rms_leg_error_mm"] == pytest.approx(2.0 / np.sqrt(18.0))
    assert tracking["peak_leg_rate_m_s"] == 0.5


def test_pose_errors_are_a_distance_in_mm_and_an_angle_in_degrees():
    p_d, R_d = np.zeros((3, 3)), np.array([np.eye(3)] * 3)
    p_d[1], p_d[2], R_d[2] = [2e-3, -3e-3, 6e-3], [0.0, 5e-3, 0.0], turned(0.0, -2.5, 0.0)
    tracking = figures(rows_of(3, p_d=p_d, R_d=R_d))["tracking"]
    assert tracking["peak_position_error_mm"] == pytest.approx(7.0)
    assert tracking["peak_rotation_error_deg"] == pytest.approx(2.5)


def test_pose_errors_are_reference_minus_measurement_for_each_axis():
    rows = rows_of(
        3, p=[1.0, 2.0, 3.0], p_d=[1.001, 1.998, 3.0], R=turned(0.0, 0.0, 30.0), R_d=turned(0.0, 0.0, 31.0)
    )
    p_mm, r_deg = pose_errors(rows)
    np.testing.assert_allclose(p_mm, [[1.0, -2.0, 0.0]] * 3, atol=1e-9)
    np.testing.assert_allclose(r_deg, [[0.0, 0.0, 1.0]] * 3, atol=1e-9)


def test_ticks_are_counted_for_each_force_limit_that_acted():
    limits = [Warn.FORCE_LIMIT, Warn.FORCE_STEP, Warn.FORCE_WINDOW]
    rows = rows_of(7)
    for k, (limit, ticks) in enumerate(zip(limits, ([0, 1, 2], [2], [5, 6]), strict=True)):
        rows["warnings"][ticks] |= int(limit)
        found = [figures(rows)["limited_ticks"][str(each.name)] for each in limits]
        assert found == [3, 1, 2][: k + 1] + [0] * (2 - k)


@pytest.mark.parametrize(
    ("alarms", "count"),
    [([0, 0, 0, 0], 0), ([1, 1, 0, 0], 1), ([0, 1, 1, 0], 1), ([1, 0, 1, 0], 2), ([0, 0, 0, 1], 1)],
)
def test_certificate_alarm_of_several_ticks_counts_once(alarms, count):
    watched = {"lyapunov": 1.0, "lyapunov_bound": 4.0, "lyapunov_share": 0.5}
    rows = rows_of(4, **watched, warnings=int(Warn.CERTIFICATE) * np.array(alarms))
    assert certificate(rows)["alarms"] == count


def test_certificate_bound_is_the_one_at_the_peak_of_watched_energy():
    rows = rows_of(
        3, lyapunov=[1.0, 3.0, 9.0], lyapunov_bound=[10.0, 20.0, 30.0], lyapunov_share=[0.2, 0.4, np.nan]
    )
    assert certificate(rows) == {
        "peak_V_m2_s4": 9.0, "watched_ticks": 2, "bound_at_peak_m2_s4": 20.0, "largest_share_percent": 40.0, "alarms": 0,
    }  # fmt: skip
    rows = rows_of(4)
    assert "certificate" not in figures(rows)
    rows["lyapunov_share"] = np.nan
    rows["lyapunov"][2] = 5.0
    assert figures(rows)["certificate"] == {"peak_V_m2_s4": 5.0, "watched_ticks": 0, "alarms": 0}


POWERED = {
    Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.UNLOADING,
    Mode.HELD,
}  # fmt: skip


@pytest.mark.parametrize("mode", Mode)
def test_tick_without_feedback_of_a_leg_is_stale_while_powered(mode):
    rows = rows_of(8, mode)
    rows["age"][[1, 4, 7], [0, 3, 5]] = 1, 2, 9
    assert figures(rows)["stale_ticks"] == (3 if mode in POWERED else 0)


def test_skipped_rejected_and_dropped_are_summed_from_the_first_tick():
    found = figures(rows_of(3, skipped=[50, 2, 3], rejected=[1, 0, 4], recorder_dropped=[0, 5, 6]))
    assert (found["skipped_ticks"], found["rejected_frames"], found["dropped_ticks"]) == (5, 5, 6)


def test_delays_have_median_99th_percentile_and_maximum():
    """The compute time in each row is that of the tick before."""
    late = np.arange(101)
    found = figures(rows_of(101, lateness_ns=1000 * late, compute_ns=2000 * np.roll(late, 1)))
    assert found["wake_up_us"] == pytest.approx({"p50": 50.0, "p99": 99.0, "max": 100.0})
    assert found["compute_us"] == pytest.approx({"p50": 99.0, "p99": 196.02, "max": 198.0})


def test_bus_state_counts_after_a_better_state():
    states = [BusState.UNKNOWN, BusState.ACTIVE, BusState.WARNING, BusState.WARNING, BusState.PASSIVE,
              BusState.WARNING, BusState.OFF, BusState.ACTIVE, BusState.OFF]  # fmt: skip
    found = figures(
        rows_of(
            9,
            bus_state=[int(state) for state in states],
            bus_off=[state is BusState.OFF for state in states],
            bus_errors=[1, 0, 0, 0, 0, 0, 0, 2, 0],
            sends_failed=[0, 0, 3, 0, 0, 0, 0, 0, 1],
            bus_overflow=[0, 0, 0, 5, 0, 0, 0, 0, 1],
        )
    )
    assert found["bus"] == {
        "error_frames": 3, "frames_not_taken": 4, "receptions_lost": 6, "off_ticks": 2, "error_warning": 1,
        "error_passive": 1, "bus_off": 2,
    }  # fmt: skip
    assert "bus" not in figures(rows_of(9, bus_state=int(BusState.ACTIVE)))


def test_run_without_ticks_has_empty_figures():
    assert figures(rows_of(0)) == {
        "ticks": 0, "duration_s": 0.0, "final_mode": None, "faults": [], "tracking": {"ticks": 0}, "peak_force_N": 0.0,
        "limited_ticks": {"FORCE_LIMIT": 0, "FORCE_STEP": 0, "FORCE_WINDOW": 0}, "pushes": None, "wake_up_us": {}, "compute_us": {},
        "stale_ticks": 0, "skipped_ticks": 0, "rejected_frames": 0, "dropped_ticks": 0,
    }  # fmt: skip


def test_final_mode_is_the_last_and_times_start_at_the_first_tick():
    rows = rows_of(4, [Mode.IDLE, Mode.TRACKING, Mode.TRACKING, Mode.HELD])
    rows["t_ns"] += 3 * 86_400 * 10**9
    found = figures(rows)
    assert (found["final_mode"], found["ticks"], found["tracking"]["ticks"]) == ("HELD", 4, 2)
    assert (found["first_motion_s"], found["duration_s"]) == pytest.approx((1e-3, 3e-3))
    still = figures(rows_of(2, Mode.IDLE))
    assert "first_motion_s" not in still
    assert still["tracking"] == {"ticks": 0}


def test_faults_of_a_run_include_reset_ones():
    faults = [Fault.NONE, Fault.STALE | Fault.SPEED, Fault.NONE, Fault.BUS, Fault.NONE]
    found = figures(rows_of(5, faults=[int(each) for each in faults]))
    assert sorted(found["faults"]) == ["BUS", "SPEED", "STALE"]
    assert figures(rows_of(2))["faults"] == []


@pytest.mark.parametrize(("taken", "refused"), [(0, 0), (3, 0), (0, 2), (3, 2)])
def test_set_points_are_counted_with_the_reasons_for_refusal(taken, refused):
    rows = rows_of(5, setpoints_taken=[0, 0, 0, 0, taken], setpoints_refused=[0, 0, 0, 0, refused])
    assert ("setpoints" in figures(rows)) is bool(taken or refused)
    rows["setpoints_taken"][-1] = 7
    assert figures(rows)["setpoints"] == {"taken": 7, "refused": refused, "why": None}
    rows["setpoint_refusal"][:2] = int(Refusal.SPEED), int(Refusal.FORCE)
    assert figures(rows)["setpoints"]["why"] == f"{REASONS[Refusal.FORCE]}; {REASONS[Refusal.SPEED]}"


def test_run_is_drawn_as_a_png_picture(tmp_path):
    path = picture(rows_of(4, [Mode.APPROACH, *[Mode.TRACKING] * 3], tau=1.0), tmp_path / "a.png", "a run")
    assert path.read_bytes().startswith(b"\x89PNG")
