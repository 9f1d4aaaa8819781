"""The figures of a run, each from rows that are made up for it."""

import errno
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
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


def test_a_pull_counts_as_a_push_in_the_peak_force():
    tau = np.zeros((4, 6))
    tau[1, 2], tau[2, 5] = 300.0, -900.0
    found = figures(rows_of(4, tau=tau))
    assert found["peak_force_N"] == 900.0
    assert found["tracking"]["peak_force_N"] == 900.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_leg_that_is_too_short_counts_as_one_that_is_too_long(sign):
    q, dq = np.zeros((3, 6)), np.zeros((3, 6))
    q[1, 4], dq[2, 0] = sign * 2e-3, sign * 0.5
    tracking = figures(rows_of(3, q=q, dq=dq))["tracking"]
    assert tracking["peak_leg_error_mm"] == pytest.approx(2.0)
    assert tracking["rms_leg_error_mm"] == pytest.approx(2.0 / np.sqrt(18.0))
    assert tracking["peak_leg_rate_m_s"] == 0.5


def test_forces_outside_of_tracking_are_in_the_peak_of_the_run_alone():
    tau = np.zeros((3, 6))
    tau[0, 0] = -700.0
    rows = rows_of(3, tau=tau)
    rows["mode"][0] = Mode.LOADING
    found = figures(rows)
    assert (found["peak_force_N"], found["tracking"]["peak_force_N"]) == (700.0, 0.0)


@pytest.mark.parametrize(
    ("alarms", "count"),
    [
        ([0, 0, 0, 0], 0),
        ([1, 0, 0, 0], 1),
        ([1, 1, 0, 0], 1),
        ([0, 1, 1, 0], 1),
        ([1, 0, 1, 0], 2),
        ([0, 0, 0, 1], 1),
    ],
)
def test_an_alarm_of_the_certificate_counts_once_from_its_first_tick_to_its_last(alarms, count):
    rows = rows_of(
        4,
        lyapunov=1.0,
        lyapunov_bound=4.0,
        lyapunov_share=0.5,
        warnings=int(Warn.CERTIFICATE) * np.array(alarms),
    )
    assert certificate(rows)["alarms"] == count


def test_the_bound_is_that_of_the_tick_in_which_the_energy_peaks_while_it_is_watched():
    found = certificate(
        rows_of(
            3,
            lyapunov=[1.0, 3.0, 9.0],
            lyapunov_bound=[10.0, 20.0, 30.0],
            lyapunov_share=[0.2, 0.4, np.nan],
        )
    )
    assert found == {
        "peak_V_m2_s4": 9.0,
        "watched_ticks": 2,
        "bound_at_peak_m2_s4": 20.0,
        "largest_share_percent": 40.0,
        "alarms": 0,
    }


POWERED = {
    Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.UNLOADING,
    Mode.HELD,
}  # fmt: skip


@pytest.mark.parametrize("mode", Mode)
def test_a_tick_without_feedback_of_one_leg_is_stale_wherever_the_drives_are_powered(mode):
    rows = rows_of(8, mode)
    rows["age"][[1, 4, 7], [0, 3, 5]] = 1, 2, 9
    assert figures(rows)["stale_ticks"] == (3 if mode in POWERED else 0)


def test_what_a_run_has_missed_is_summed_over_its_ticks_and_what_came_before_the_first_is_not():
    found = figures(
        rows_of(
            3,
            skipped=[50, 2, 3],
            rejected=[1, 0, 4],
            recorder_dropped=[0, 5, 6],
            compute_ns=[9_000_000, 20_000, 40_000],
            lateness_ns=[7_000, 5_000, 6_000],
        )
    )
    assert (found["skipped_ticks"], found["rejected_frames"], found["dropped_ticks"]) == (5, 5, 6)
    assert (found["compute_us"]["p50"], found["compute_us"]["max"]) == (30.0, 40.0)
    assert (found["wake_up_us"]["p50"], found["wake_up_us"]["max"]) == (6.0, 7.0)


def test_what_went_wrong_on_the_bus_is_counted_and_a_state_where_a_better_one_was_before():
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


@pytest.mark.parametrize("column", ["bus_errors", "sends_failed", "bus_overflow", "bus_off", "bus_state"])
def test_one_trouble_on_the_bus_is_told_though_there_was_no_other(column):
    rows = rows_of(3)
    rows[column][1] = BusState.WARNING if column == "bus_state" else 1
    assert sum(figures(rows)["bus"].values()) == 1


def test_a_run_of_no_tick_has_figures_that_say_so():
    assert figures(rows_of(0)) == {
        "ticks": 0, "duration_s": 0.0, "final_mode": None, "faults": [], "tracking": {"ticks": 0}, "peak_force_N": 0.0,
        "limited_ticks": {"FORCE_LIMIT": 0, "FORCE_STEP": 0, "FORCE_WINDOW": 0}, "pushes": None, "wake_up_us": {}, "compute_us": {},
        "stale_ticks": 0, "skipped_ticks": 0, "rejected_frames": 0, "dropped_ticks": 0,
    }  # fmt: skip


def test_each_limit_of_the_force_is_counted_by_the_ticks_in_which_it_acted():
    limits = [Warn.FORCE_LIMIT, Warn.FORCE_STEP, Warn.FORCE_WINDOW]
    rows = rows_of(7)
    for k, (limit, ticks) in enumerate(zip(limits, ([0, 1, 2], [2], [5, 6]), strict=True)):
        rows["warnings"][ticks] |= int(limit)
        found = [figures(rows)["limited_ticks"][str(each.name)] for each in limits]
        assert found == [3, 1, 2][: k + 1] + [0] * (2 - k)


def test_delays_are_told_by_their_middle_their_highest_hundredth_and_the_largest_one():
    late = np.arange(101)
    found = figures(rows_of(101, lateness_ns=1000 * late, compute_ns=2000 * np.roll(late, 1)))
    assert found["wake_up_us"] == pytest.approx({"p50": 50.0, "p99": 99.0, "max": 100.0})
    assert found["compute_us"] == pytest.approx({"p50": 99.0, "p99": 196.02, "max": 198.0})


def test_a_run_ends_in_the_mode_of_its_last_tick_and_moves_from_its_first_tick_of_tracking_on():
    rows = rows_of(4, [Mode.IDLE, Mode.TRACKING, Mode.TRACKING, Mode.HELD])
    found = figures(rows)
    assert (found["final_mode"], found["ticks"], found["tracking"]["ticks"]) == ("HELD", 4, 2)
    assert found["first_motion_s"] == pytest.approx(1e-3)
    still = figures(rows_of(2, Mode.IDLE))
    assert "first_motion_s" not in still
    assert still["tracking"] == {"ticks": 0}


def test_the_certificate_is_told_where_one_tick_was_watched_and_nowhere_else():
    rows = rows_of(4)
    assert "certificate" not in figures(rows)
    rows["lyapunov_share"] = np.nan
    rows["lyapunov"][2] = 5.0
    assert figures(rows)["certificate"] == {"peak_V_m2_s4": 5.0, "watched_ticks": 0, "alarms": 0}


@pytest.mark.parametrize(("taken", "refused"), [(0, 0), (3, 0), (0, 2), (3, 2)])
def test_set_points_are_those_until_the_last_tick_and_why_some_were_refused_is_said(taken, refused):
    rows = rows_of(5, setpoints_taken=[0, 0, 0, 0, taken], setpoints_refused=[0, 0, 0, 0, refused])
    assert ("setpoints" in figures(rows)) is bool(taken or refused)
    rows["setpoints_taken"][-1] = 7
    assert figures(rows)["setpoints"] == {"taken": 7, "refused": refused, "why": None}
    rows["setpoint_refusal"][:2] = int(Refusal.SPEED), int(Refusal.FORCE)
    assert figures(rows)["setpoints"]["why"] == f"{REASONS[Refusal.FORCE]}; {REASONS[Refusal.SPEED]}"


def test_times_count_from_the_first_tick_whatever_the_clock_has_counted_before():
    rows = rows_of(5, t_ns=3 * 86_400 * 10**9 + 1_000_000 * np.arange(5))
    rows["mode"][:2] = Mode.APPROACH
    found = figures(rows)
    assert found["first_motion_s"] == pytest.approx(2e-3)
    assert found["duration_s"] == pytest.approx(4e-3)


def test_a_fault_that_was_reset_is_among_those_of_the_run():
    faults = [Fault.NONE, Fault.STALE | Fault.SPEED, Fault.NONE, Fault.BUS, Fault.NONE]
    found = figures(rows_of(5, faults=[int(each) for each in faults]))
    assert sorted(found["faults"]) == ["BUS", "SPEED", "STALE"]
    assert figures(rows_of(2))["faults"] == []


def test_the_errors_of_the_pose_are_a_distance_in_mm_and_an_angle_in_degrees():
    p_d, R_d = np.zeros((3, 3)), np.array([np.eye(3)] * 3)
    p_d[1], p_d[2] = [2e-3, -3e-3, 6e-3], [0.0, 5e-3, 0.0]
    R_d[2] = Rotation.from_rotvec([0.0, -2.5, 0.0], degrees=True).as_matrix()
    tracking = figures(rows_of(3, p_d=p_d, R_d=R_d))["tracking"]
    assert tracking["peak_position_error_mm"] == pytest.approx(7.0)
    assert tracking["peak_rotation_error_deg"] == pytest.approx(2.5)


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """A function that draws rows; it returns the axes: path, error, force, wake-ups."""

    def draw(rows):
        found: list[Figure] = []
        monkeypatch.setattr(Figure, "savefig", lambda figure, file, **_: found.append(figure))
        picture(rows, tmp_path / "a.png", "a run")
        (figure,) = found
        return figure.axes

    return draw


def test_the_picture_shows_poses_errors_and_forces_in_seconds_from_the_first_tick(drawn):
    p, tau = np.arange(12.0).reshape(4, 3), np.arange(24.0).reshape(4, 6)
    rows = rows_of(4, p=p, p_d=p + 1.0, q=0.5, q_d=0.5 + tau * 1e-3, tau=-tau)
    rows["t_ns"] += 7 * 10**9
    rows["mode"][0] = Mode.APPROACH
    path, error, force, _ = drawn(rows)
    for axes in (path, error, force):
        for line in axes.lines:
            np.testing.assert_allclose(line.get_xdata(), [0.0, 1e-3, 2e-3, 3e-3], atol=1e-12)
    reference = p + 1.0
    reference[0] = np.nan
    for k in range(3):
        np.testing.assert_array_equal(path.lines[2 * k].get_ydata(), p[:, k])
        np.testing.assert_array_equal(path.lines[2 * k + 1].get_ydata(), reference[:, k])
    errors = tau.copy()
    errors[0] = np.nan
    np.testing.assert_allclose(np.transpose([line.get_ydata() for line in error.lines]), errors, atol=1e-9)
    np.testing.assert_array_equal(np.transpose([line.get_ydata() for line in force.lines]), -tau)


def test_the_picture_shows_the_share_of_the_wake_ups_that_came_later(drawn):
    (line,) = drawn(rows_of(4, lateness_ns=[30_000, 10_000, 40_000, 20_000]))[3].lines
    np.testing.assert_allclose(line.get_xdata(), [10.0, 20.0, 30.0, 40.0])
    np.testing.assert_allclose(line.get_ydata(), [1.0, 0.75, 0.5, 0.25])


def test_the_axes_of_the_picture_say_what_they_show_and_in_which_unit(drawn):
    found = [(a.get_title(), a.get_xlabel(), a.get_ylabel()) for a in drawn(rows_of(3))]
    assert found == [
        ("platform origin, measured; dotted: reference", "", "m"),
        ("leg error q_d - q while tracking", "", "mm"),
        ("leg forces sent", "s", "N"),
        ("wake-ups later than", "us", "share of ticks"),
    ]


def test_the_picture_is_1200_by_800_pixels_with_thin_lines_a_pale_grid_and_a_logarithmic_share(
    tmp_path, monkeypatch
):
    found: list[tuple[Figure, dict[str, object]]] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, **how: found.append((figure, how)))
    assert picture(rows_of(3), tmp_path / "a.png", "a run") == tmp_path / "a.png"
    ((figure, how),) = found
    assert (figure.get_size_inches() * how["dpi"]).tolist() == [1200.0, 800.0]
    assert figure.get_suptitle() == "a run"
    path, error, force, wake = figure.axes
    for axes in (error, force):
        assert [line.get_linewidth() for line in axes.lines] == [0.8] * 6
    dotted = path.lines[1::2]
    assert [(line.get_color(), line.get_linestyle(), line.get_linewidth()) for line in dotted] == [
        ("k", ":", 0.8)
    ] * 3
    legend = path.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["x", "y", "z"]
    assert wake.get_yscale() == "log"
    for axes in figure.axes:
        lines = [*axes.get_xgridlines(), *axes.get_ygridlines()]
        assert lines
        assert {(line.get_alpha(), line.get_visible()) for line in lines} == {(0.3, True)}


def test_errors_are_the_reference_less_the_measurement_leg_by_leg_and_axis_by_axis_in_their_order():
    turn = Rotation.from_rotvec([0.0, 0.0, 30.0], degrees=True).as_matrix()
    rows = rows_of(3, p=[1.0, 2.0, 3.0], p_d=[1.001, 1.998, 3.0], q=0.5, q_d=0.503, R=turn)
    rows["R_d"] = Rotation.from_rotvec([0.0, 0.0, 31.0], degrees=True).as_matrix()
    p_mm, r_deg = pose_errors(rows)
    np.testing.assert_allclose(p_mm, [[1.0, -2.0, 0.0]] * 3, atol=1e-9)
    np.testing.assert_allclose(r_deg, [[0.0, 0.0, 1.0]] * 3, atol=1e-9)
    tracking = figures(rows)["tracking"]
    assert tracking["peak_leg_error_mm"] == pytest.approx(3.0)
    assert tracking["peak_position_error_mm"] == pytest.approx(np.sqrt(5.0))
    assert tracking["peak_rotation_error_deg"] == pytest.approx(1.0)


def test_a_picture_that_cannot_be_written_to_its_end_leaves_the_earlier_one_and_nothing_else(
    tmp_path, monkeypatch
):
    (tmp_path / "a.png").write_bytes(b"the earlier one")

    def full(_figure, file, **_):
        Path(file).write_bytes(b"half of it")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", full)
    with pytest.raises(OSError, match="No space left"):
        picture(rows_of(3), tmp_path / "a.png", "a run")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.png", b"the earlier one")]
