"""Margins of a run to each limit, from artificial rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.sensing.settings import ImuSettings, SensorSettings, TrackerSettings
from drivers.signals import Fault, Mode
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.study.report.margins import margins

RATE_Hz = 1000.0


def rows_of(n, **columns):
    """Rows of a platform that tracks at rest in mid-stroke, with some columns changed."""
    c = load("virtual").platform
    rows = np.zeros(n, ROW)
    rows["tick"], rows["t_ns"], rows["mode"] = np.arange(n), 1_000_000 * np.arange(n), Mode.TRACKING
    rows["q"] = rows["q_d"] = (c.length_min_m + c.length_max_m) / 2
    for name, value in columns.items():
        rows[name] = value
    return rows


def limited(**limits):
    c = load("virtual")
    return c.model_copy(update={"limits": c.limits.model_copy(update=limits)})


def margin(rows, key, name="", c=None, rate_Hz=RATE_Hz):
    """The only margin with this key (or any), with `name` in its name."""
    (found,) = (
        m for m in margins(rows, c or load("virtual"), rate_Hz) if m.key == (key or m.key) and name in m.name
    )
    return found


def nearest(rows, key, name="", c=None, rate_Hz=RATE_Hz):
    """Row, leg and value of that margin."""
    found = margin(rows, key, name, c, rate_Hz)
    return found.row, found.leg, pytest.approx(found.value)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("column", "key", "limit"),
    [
        ("q_d", "limits.following_error_m", {"following_error_m": 0.5, "following_error_s": 0.0}),
        ("dq", "limits.speed_m_s", {"speed_m_s": 0.5}),
        ("tau", "limits.force_N", {"force_N": 0.5}),
        ("ddq_d", "limits.acceleration_m_s2", {"acceleration_m_s2": 0.5}),
    ],
)
def test_a_margin_has_leg_time_value_and_limit_in_both_directions(column, key, limit, sign):
    rows = rows_of(9)
    rows[column][5, 4] += sign * 0.4
    rows[column][6, 2] -= sign * 0.3
    found = margin(rows, key, c=limited(**limit))
    assert (found.value, found.row, found.leg) == (pytest.approx(0.4), 5, 4)
    assert (found.limit, found.used_percent) == (0.5, pytest.approx(80.0))


def test_ticks_in_which_a_safety_rule_does_not_apply_give_no_margin():
    rows = rows_of(100)
    rows["dq"][70:, 0], rows["dq"][10, 1] = 1.9, 0.5
    rows["mode"][70:] = Mode.FAULT
    rows["faults"][70:] = Fault.DRIVE
    assert margin(rows, "limits.speed_m_s").row == 70, "the tick of the fault still counts"
    rows["dq"][70, 0] = 0.0
    found = margin(rows, "limits.speed_m_s")
    assert (found.row, found.leg) == (10, 1)


def test_the_limit_of_a_leg_error_depends_on_the_legs_own_speed():
    limits = load("virtual").limits
    rows = rows_of(10)
    rows["q_d"][3, 0] += 0.9 * limits.following_error_m
    rows["q_d"][7, 5] += 1.1 * limits.following_error_m
    rows["dq_d"][7, 5] = -limits.following_error_m / limits.following_error_s
    found = margin(rows, "limits.following_error_m")
    assert (found.row, found.leg) == (3, 0), "110 % at rest are 55 % at the speed that doubles the limit"
    assert found.used_percent == pytest.approx(90.0)


def test_the_force_change_in_a_window_covers_all_pairs_of_ticks():
    rng = np.random.default_rng(5)
    tau = np.cumsum(rng.normal(0.0, 10.0, (900, 6)), axis=0)
    found = margin(rows_of(900, tau=tau), "limits.force_window_N")
    pairs = [
        (abs(tau[k, leg] - tau[j, leg]), k, leg)
        for leg in range(6)
        for k in range(900)
        for j in range(max(0, k - 250), k)
    ]
    value, row, leg = max(pairs)
    assert (found.value, found.row, found.leg) == (pytest.approx(value), row, leg)


def test_motion_on_closed_brakes_counts_from_the_first_fresh_reading():
    rows = rows_of(60)
    rows["mode"][:30], rows["mode"][50:] = Mode.LOADING, Mode.UNLOADING
    rows["age"][:5] = 3
    rows["q"][:5] = 0.0
    rows["q"][20, 4] += 2e-4
    rows["q"][30:] += 0.1
    rows["q"][55, 1] -= 3e-4
    assert nearest(rows, "limits.standstill_m") == (55, 1, 3e-4)


def test_braking_distance_counts_towards_the_end_that_a_leg_approaches():
    c = load("virtual")
    soft = c.platform.length_max_m - c.limits.stroke_margin_m
    rows = rows_of(10)
    rows["q"][:, 0], rows["q_d"][:, 0] = soft - 0.02, soft - 0.02
    rows["dq"][2, 0], rows["dq"][6, 0] = 0.4, -0.9
    found = margin(rows, "limits.deceleration_m_s2")
    assert (found.row, found.leg) == (2, 0)
    assert found.limit == pytest.approx((2 * c.limits.deceleration_m_s2 * 0.02) ** 0.5)


def test_missed_periods_add_up_until_a_tick_is_on_time():
    rows = rows_of(20)
    rows["skipped"][[5, 6, 9]] = (1, 2, 2)
    assert margin(rows, "limits.missed_stop_ticks").value == 3


def test_ticks_with_rejected_frames_are_counted_within_32_ticks():
    rows = rows_of(200)
    rows["rejected"][[10, 20, 41, 42, 43, 120]] = 4
    assert nearest(rows, "", "frames were refused") == (43, None, 4), (
        "10 is 33 ticks before 43; 20 to 43 are four"
    )


def test_a_force_step_counts_only_between_consecutive_ticks():
    rows = rows_of(400)
    rows["tau"][:, 1] = 100.0
    rows["tau"][200:, 1] = 1000.0
    rows["tau"][300:, 4] = 50.0
    rows["tick"][200:] += 40
    rows["t_ns"] = 1_000_000 * rows["tick"]
    assert nearest(rows, "limits.force_step_N") == (300, 4, 50.0), "40 lost ticks are no step"
    rows["skipped"][200] = 40
    assert nearest(rows, "limits.force_step_N") == (200, 1, 900.0), "a skipped tick holds the force"


def test_the_force_window_is_a_time_even_if_ticks_are_missing():
    rows = rows_of(300)
    rows["tau"][:100, 3] = 700.0
    rows["tick"][110:] += 500
    rows["tau"][115:, 3] = 30.0
    rows["tau"][115:, 0] = 90.0
    assert nearest(rows, "limits.force_window_N") == (100, 3, 700.0)
    rows["tau"][100:110, 3] = 700.0 - 7.0 * np.arange(10)
    rows["tau"][110:, 3] = 600.0
    rows["tau"][111:, 3] = 575.0
    assert margin(rows, "limits.force_window_N").value == 90.0, "500 lost ticks are longer than 250 ms"


def test_margin_of_the_lyapunov_certificate_counts_values_that_last_three_ticks():
    assert load("virtual").monitor.confirm_ticks == 3
    rows = rows_of(60, lyapunov_share=0.1)
    rows["lyapunov_share"][:3] = np.nan
    rows["lyapunov_share"][[10, 11, 30, 31, 32]] = [5.0, 5.0, 0.8, 0.7, 0.9]
    assert nearest(rows, "monitor") == (32, None, 0.7)
    rows["lyapunov_share"] = np.nan
    assert not [m for m in margins(rows, load("virtual"), RATE_Hz) if m.key == "monitor"]


def test_margin_of_the_encoder_check_has_its_leg_and_also_counts_at_rest():
    rows = rows_of(40, encoder_share=np.nan)
    assert not [m for m in margins(rows, load("virtual"), RATE_Hz) if m.key == "monitor.length_noise_m"]
    rows["encoder_share"][:] = 0.25
    rows["encoder_share"][[5, 9], [2, 4]] = 0.5, 0.75
    rows["mode"][:8] = Mode.IDLE
    rows["mode"][9] = Mode.WAITING
    found = margin(rows, "monitor.length_noise_m")
    assert (found.row, found.leg, found.value, found.limit) == (5, 2, 0.5, 1.0)


def fused(**settings):
    c = load("virtual")
    fusion = c.estimation.fusion.model_copy(update={"may_lose_legs": [1, 4]} | settings)
    return c.model_copy(
        update={"estimation": c.estimation.model_copy(update={"pose": "fused", "fusion": fusion})}
    )


def test_the_uncertainty_of_a_fused_position_covers_all_three_directions():
    rows = rows_of(30)
    rows["pose_std"][12] = [2e-3, 1e-3, 2e-3, 9.0, 9.0, 9.0]
    found = margin(rows, "", "standard deviation", fused(position_std_max_m=6e-3))
    assert (found.row, found.value, found.used_percent) == (12, pytest.approx(3e-3), pytest.approx(50.0))


def test_margin_with_a_lost_encoder_is_the_longest_time_without_the_tracker():
    rows = rows_of(100)
    rows["tracker"][[20, 60]] = 1
    rows["tracker"][30] = -1
    rows["legs_lost"][40:90] = 1 << 4
    found = margin(rows, "", "tracker", fused(), 250.0)
    assert (found.row, found.value) == (59, pytest.approx(39 / 250.0))
    rows["legs_lost"][40:90] = 1 << 2
    assert margin(rows, "", "tracker", fused()).value == 0.0, "leg 2 may not be lost and faults as stale"


@pytest.mark.parametrize(
    ("lost", "mode", "faults", "age"),
    [
        (1 << 4, Mode.TRACKING, 0, 2),
        (1 << 3, Mode.TRACKING, 0, 900),
        (1 << 4 | 1 << 1, Mode.TRACKING, 0, 900),
        (1 << 4, Mode.UNLOADING, 0, 900),
        (1 << 4, Mode.FAULT, Fault.STALE, 900),
    ],
    ids=["may be lost", "may not", "too many", "proves a brake", "was the fault"],
)
def test_feedback_age_of_a_leg_that_may_be_lost_gives_no_margin(lost, mode, faults, age):
    rows = rows_of(30)
    rows["age"][10, 0] = 2
    rows["age"][20] = [900 * (lost >> leg & 1) for leg in range(6)]
    rows["legs_lost"][20] = lost
    rows["mode"][20], rows["faults"][20:] = mode, faults
    assert margin(rows, "limits.stale_fault_ticks", c=fused()).value == age


def test_margin_of_encoder_slip_counts_deviations_that_last_three_ticks():
    rows = rows_of(60, legs_used=0b111111)
    rows["innovation_q"][5] = 1.0
    rows["legs_used"][20:22] = rows["legs_used"][30:] = 0b011111
    rows["innovation_q"][20:, 5] = -9e-5
    rows["innovation_q"][31:34, 5] = 8e-5, -7e-5, 6e-5
    rows["innovation_q"][34:, 5] = 1.0
    rows["legs_slipped"][33:] = 1 << 5
    assert nearest(rows, "", "against the fused pose", fused()) == (32, 5, 7e-5)


@pytest.mark.parametrize(
    ("of_controller", "key"), [(25000.0, "limits.force_N"), (40000.0, "drives.force_limit_N")]
)
def test_margin_of_the_force_is_to_the_smaller_of_both_force_limits(of_controller, key):
    rows = rows_of(9)
    rows["tau"][3, 2] = -5000.0
    assert margin(rows, key, c=limited(force_N=of_controller)).limit == min(of_controller, 30000.0)


def test_a_leg_length_counts_from_mid_stroke_to_the_nearer_end():
    rows = rows_of(9)
    rows["q"][2, 3], rows["q"][5, 0] = 0.80, 2.10
    found = margin(rows, "platform.length_max_m")
    assert (found.row, found.leg) == (2, 3)
    assert found.used_percent == pytest.approx(100 * 0.675 / 0.725)


def test_margins_are_listed_with_the_nearest_limit_first():
    rows = rows_of(5000)
    rows["stretched_ns"][[1000, 3000]] = 400_000_000, 3_000_000
    used = [m.used_percent for m in margins(rows, load("virtual"), RATE_Hz)]
    assert used == sorted(used, reverse=True)
    stretch = margin(rows, "limits.stretch_percent")
    assert (stretch.row, stretch.value) == (1000, 4e8)
    assert stretch.limit == pytest.approx(5e8 + 0.05 * 1e9)


@pytest.mark.parametrize("settings", [{"tracker": TrackerSettings()}, {"imu": ImuSettings()}], ids=list("ti"))
def test_rejected_frames_have_no_margin_if_sensors_are_on_the_bus(settings: dict[str, Any]):
    """Rejected frames of sensors never fault, and a log does not distinguish them from those of drives."""
    rows = rows_of(200, rejected=1)
    assert margin(rows, "", "frames were refused").used_percent == 400.0
    c = load("virtual").model_copy(update={"sensors": SensorSettings(**settings)})
    assert not [m for m in margins(rows, c, RATE_Hz) if "frames were refused" in m.name]
