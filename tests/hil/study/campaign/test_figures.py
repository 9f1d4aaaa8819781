"""Metrics of ticks against figures computed by hand, in blocks of any part of the ticks."""

import numpy as np
import pytest

from drivers.signals import Fault, Mode, Warn
from drivers.tick_columns import ROW
from hil.study.campaign.figures import BLOCK, METRICS, Measurement

N = BLOCK + 37
"""Ticks: one block and a part of the next."""


def ticks():
    """Rows at rest at p_d = p, R_d = R = 1, tracking from tick 10 on, and true lengths."""
    rows = np.zeros(N, ROW)
    rows["mode"] = np.where(np.arange(N) < 10, Mode.APPROACH, Mode.TRACKING)
    rows["R"] = rows["R_d"] = np.eye(3)
    rows["lyapunov_share"] = np.nan
    rows["reference_time_s"] = 1e-3 * np.arange(N)
    rows["q"] = rows["q_d"] = 1.0
    return rows, np.ones((N, 6))


def figures(rows, lengths, *, travels=False):
    measured = Measurement(travels=travels)
    full = [measured.take(row, length) for row, length in zip(rows, lengths, strict=True)]
    assert sum(full) == N // BLOCK
    return measured.figures()


def test_peaks_and_means_of_errors_cover_only_tracking_ticks():
    rows, lengths = ticks()
    rows["q"][5, 0] = 2.0  # still on the way to the reference
    rows["q"][20, 3] = 0.998
    rows["q"][BLOCK + 20, 2] = 1.001
    lengths[30, 1] = 1.003
    rows["p_d"][40, 0], rows["p"][40, 1] = 3e-3, 4e-3
    rows["dq"][50, 5] = -0.7
    c, s = np.cos(0.1), np.sin(0.1)
    rows["R"][60] = [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    found = figures(rows, lengths)
    assert found["peak_leg_error_mm"] == pytest.approx(2.0)
    assert found["rms_leg_error_mm"] == pytest.approx(np.sqrt((2.0**2 + 1.0**2) / (6 * (N - 10))))
    assert found["peak_true_leg_error_mm"] == pytest.approx(3.0)
    assert found["rms_true_leg_error_mm"] == pytest.approx(np.sqrt(9.0 / (6 * (N - 10))))
    assert found["peak_position_error_mm"] == pytest.approx(5.0)
    assert found["rms_position_error_mm"] == pytest.approx(5.0 / np.sqrt(N - 10))
    assert found["peak_rotation_error_deg"] == pytest.approx(np.rad2deg(0.1))
    assert found["peak_leg_rate_m_s"] == pytest.approx(0.7)
    assert found["tracked_s"] == rows["reference_time_s"][-1]


def test_peak_force_covers_the_whole_run_and_force_variation_continues_across_blocks():
    rows, lengths = ticks()
    rows["tau"][3, 2] = -500.0  # before it tracks
    rows["tau"][BLOCK:, 1] = 40.0  # a jump between two blocks
    rows["tau"][BLOCK + 5, 1] = 60.0
    found = figures(rows, lengths)
    assert found["peak_force_N"] == 500.0
    assert found["force_variation_N"] == 40.0 + 2 * 20.0


def test_limited_and_stale_ticks_and_the_certificate_are_counted():
    rows, lengths = ticks()
    rows["warnings"][7] = Warn.FORCE_LIMIT
    rows["warnings"][[8, N - 1]] = Warn.FORCE_STEP | Warn.FORCE_WINDOW
    rows["age"][30:33, 4] = 1
    rows["mode"][0], rows["age"][0] = Mode.IDLE, 9  # without power nothing is expected
    rows["lyapunov_share"][[4, 70]] = 0.5, 0.25
    found = figures(rows, lengths)
    assert (found["limited_ticks"], found["stale_ticks"], found["faulted"]) == (3, 3, 0)
    assert found["certificate_percent"] == 50.0


POWERED = {
    Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.UNLOADING,
    Mode.HELD,
}  # fmt: skip
"""Modes with powered drives, in which feedback of every leg is expected."""


@pytest.mark.parametrize("mode", Mode)
def test_a_tick_without_feedback_of_a_leg_is_stale_in_every_powered_mode(mode):
    rows, lengths = ticks()
    rows["mode"] = mode
    rows["age"][[4, 70, N - 1], [0, 3, 5]] = 1, 2, 9
    assert figures(rows, lengths)["stale_ticks"] == (3 if mode in POWERED else 0)


def test_travel_counts_from_the_first_latched_fault_if_the_run_continues():
    rows, lengths = ticks()
    lengths[:50, 0] = 5.0
    rows["faults"][50:] = Fault.DRIVE
    lengths[50:BLOCK, 0], lengths[BLOCK:, 0] = 1.5, 1.51
    lengths[BLOCK + 9, 0] = 1.52
    assert figures(rows, lengths, travels=True)["travel_mm"] == pytest.approx(20.0)
    found = figures(rows, lengths)
    assert found["travel_mm"] is None
    assert found["faulted"] == 1


def test_metrics_that_were_not_measured_are_none():
    rows, lengths = ticks()
    rows["mode"] = Mode.LOADING
    found = figures(rows, lengths)
    assert set(found) == set(METRICS)
    assert {name for name, value in found.items() if value is not None} == {
        "faulted", "peak_force_N", "limited_ticks", "stale_ticks",
    }  # fmt: skip


def test_a_non_finite_metric_counts_as_not_measured_and_fails_its_limit():
    """A peak, a mean and a sum: none may appear as a figure in the table, or break the page."""
    rows, lengths = ticks()
    rows["q"][20, 3] = np.nan
    lengths[30, 1] = 1e200  # its square is infinite
    rows["tau"][40, 2] = np.inf
    found = figures(rows, lengths)
    names = ("peak_leg_error_mm", "rms_leg_error_mm", "rms_true_leg_error_mm", "force_variation_N")
    assert [found[name] for name in names] == [None] * 4
    assert found["peak_true_leg_error_mm"] > 1e199
