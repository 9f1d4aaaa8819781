"""Borders of what makes a path: how near is the same, how far a turn may go, how much is searched and tabulated."""

import io
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import ConfigurationError, LogError
from hil.config.reference import (
    AxisLimits,
    HoldReference,
    LiveReference,
    MultisineAxis,
    SampledReference,
    TimeOptimalReference,
)
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.multisine import peak, pick_lines
from hil.trajectory.path import axis_limits, require_half_turn
from hil.trajectory.tabulated import TabulatedTrajectory
from hil.trajectory.time_optimal import plan, planned_trajectory
from hil.trajectory.waypoints import require_closed
from tests.hil.test_trajectory_sampled import HEADER, write
from tests.judged import ANYWHERE
from tests.live_reference import LIVE_REFERENCE

HOME = Pose(position_m=(0.1, -0.2, 1.0), rotation_vector_deg=(3.0, -4.0, 5.0))
LIMITS = {
    "velocity_m_s": [0.1, 0.2, 0.3],
    "velocity_deg_s": [10.0, 20.0, 30.0],
    "acceleration_m_s2": [1.0, 2.0, 3.0],
    "acceleration_deg_s2": [40.0, 50.0, 60.0],
    "jerk_m_s3": 9.0,
    "jerk_deg_s3": 700.0,
}


def time_optimal(*points):
    poses = [{"position_m": p, "rotation_vector_deg": r} for p, r in points]
    settings = {"type": "time_optimal", "points": poses, "limits": LIMITS}
    return TimeOptimalReference.model_validate(settings)


# -- the same ------------------------------------------------------------------------------------------------


def test_a_path_that_ends_within_a_nanometre_of_its_start_closes_and_one_twice_as_far_off_does_not():
    chi = np.zeros((3, 6))
    chi[-1, 2] = 1e-9
    require_closed(chi, 2, "path")
    chi[-1, 2] = 2e-9
    with pytest.raises(ConfigurationError, match=r"path: periods is 2, but the path ends 2e-09 m or rad"):
        require_closed(chi, 2, "path")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_points_within_a_nanometre_of_each_other_are_the_same_pose_and_ten_nanometres_are_a_move(sign):
    here = ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    away = ((0.1, 0.0, 1.0), (0.0, 0.0, 0.0))
    for twin in (((0.1, sign * 1e-9, 1.0), (0, 0, 0)), ((0.1, 0, 1.0), (0, 0, sign * 5e-8))):
        with pytest.raises(ConfigurationError, match=r"points\[2\]: the same pose as the point before it"):
            build_trajectory(time_optimal(here, away, twin), HOME, None)
    near = ((0.1, sign * 1e-8, 1.0), (0.0, 0.0, 0.0))
    path = build_trajectory(time_optimal(here, away, near), HOME, None)
    assert path.duration_s is not None
    assert path.sample(path.duration_s).p[1] == pytest.approx(sign * 1e-8, rel=1e-6)


@pytest.mark.parametrize("word", range(6))
def test_a_move_of_one_word_alone_goes_there_at_its_own_largest_velocity(word):
    end = np.zeros(6)
    end[word] = 0.2 if word < 3 else 20.0
    path = build_trajectory(
        time_optimal(((0, 0, 0), (0, 0, 0)), (end[:3].tolist(), end[3:].tolist())), HOME, None
    )
    assert path.duration_s is not None
    sample = path.sample(path.duration_s)
    found = np.r_[sample.p, np.rad2deg(Rotation.from_matrix(sample.R).as_rotvec())]
    np.testing.assert_allclose(found, end, rtol=0, atol=1e-12)
    twist = path.sample(path.duration_s / 2).twist
    limit = [0.1, 0.2, 0.3, *np.deg2rad([10.0, 20.0, 30.0])][word]
    np.testing.assert_allclose(twist, limit * np.eye(6)[word], rtol=0, atol=1e-12)


# -- turns and limits ----------------------------------------------------------------------------------------


def test_half_a_turn_is_allowed_and_no_more():
    require_half_turn(np.pi, "here")
    with pytest.raises(
        ConfigurationError, match=r"here: the rotation vector reaches 180\.006 deg; at most 180"
    ):
        require_half_turn(np.pi + 1e-4, "here")
    pose = Pose(position_m=(0.0, 0.0, 1.0), rotation_vector_deg=(0.0, -180.0, 0.0))
    R = build_trajectory(HoldReference(type="hold", pose=pose), HOME, None).sample(0.0).R
    np.testing.assert_allclose(R, np.diag([-1.0, 1.0, -1.0]), atol=1e-15)


@pytest.mark.parametrize("row", [0, 1, 2])
def test_no_row_of_a_file_may_turn_by_more_than_a_half_about_whatever_axis(tmp_path, row):
    rows = [[k, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0] for k in range(3)]
    rows[row][4:] = -110.0, 110.0, 110.0
    write(tmp_path, HEADER + "".join(",".join(map(str, r)) + "\n" for r in rows))
    settings = SampledReference(type="sampled", path="path.csv", periods=1)
    with pytest.raises(ConfigurationError, match=r"path\.csv: the rotation vector reaches 190\.526 deg"):
        build_trajectory(settings, HOME, tmp_path)


def test_the_last_row_of_a_file_tells_how_long_it_is(tmp_path):
    times = (5.0, 6.0, 7.0, 86_405.5)
    write(tmp_path, HEADER + "".join(f"{t},0,0,1,0,0,0\n" for t in times))
    with pytest.raises(ConfigurationError, match=r"t_s goes from 5 to 86405\.5, allowed: a path of 86400 s"):
        build_trajectory(SampledReference(type="sampled", path="path.csv"), HOME, tmp_path)


def test_a_long_wrong_header_is_shown_by_its_first_200_signs(tmp_path):
    write(tmp_path, "n" * 300 + "\n")
    with pytest.raises(ConfigurationError, match=r"given: n{200}\.$"):
        build_trajectory(SampledReference(type="sampled", path="path.csv"), HOME, tmp_path)


def test_limits_are_rows_of_velocity_acceleration_and_jerk_in_metres_and_radians():
    found = axis_limits(AxisLimits.model_validate(LIMITS))
    degrees = [[10.0, 20.0, 30.0], [40.0, 50.0, 60.0], [700.0] * 3]
    np.testing.assert_array_equal(found[:, :3], [[0.1, 0.2, 0.3], [1.0, 2.0, 3.0], [9.0] * 3])
    np.testing.assert_allclose(found[:, 3:], np.array(degrees) * np.pi / 180.0, rtol=1e-15)


def test_a_live_reference_that_is_only_looked_at_has_ticks_of_a_millisecond():
    settings = LiveReference.model_validate(LIVE_REFERENCE)
    looked, timed = (build_trajectory(settings, HOME, None, period) for period in (None, 1e-3))
    for live in (looked, timed):
        assert isinstance(live, LiveTrajectory)
        live.aim(np.array([0.2, 0.0, 1.1, 0.0, 0.0, 0.1]))
        live.advance(150, ANYWHERE)
    np.testing.assert_array_equal(looked.sample(0.0).p, timed.sample(0.0).p)
    assert looked.sample(0.0).twist.any()


def test_a_hold_keeps_copies_that_kernels_can_read():
    p, R = (
        np.array([1, 2, 3]),
        np.asfortranarray(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
    )
    hold = HoldTrajectory(p, R)
    p[:] = 0
    R[:] = 0.0
    sample = hold.sample(0.0)
    np.testing.assert_array_equal(sample.p, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(sample.R, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert all(part.dtype == np.float64 and part.flags.c_contiguous for part in sample)
    assert sample.twist.shape == sample.dtwist.shape == (6,)
    assert not sample.twist.any()
    assert not sample.dtwist.any()


# -- lines ---------------------------------------------------------------------------------------------------


def axis(band, lines):
    return MultisineAxis(axis="x_m", band_Hz=band, lines=lines, amplitude=0.05)


def test_both_ends_of_a_band_are_multiples_of_the_period_whatever_their_last_digit():
    """0.07 x 100 is 7.000000000000001, 0.29 x 100 is 28.999999999999996."""
    assert pick_lines(axis((0.07, 0.29), 23), 100.0, set(), "axes[0]") == list(range(7, 30))
    with pytest.raises(ConfigurationError, match="allowed: at most 23"):
        pick_lines(axis((0.07, 0.29), 24), 100.0, set(), "axes[0]")
    assert pick_lines(axis((0.075, 0.285), 21), 100.0, set(), "axes[0]") == list(range(8, 29))


@pytest.mark.parametrize("beyond", [1.5e-9, 5e-7])
def test_a_multiple_that_lies_outside_of_a_band_is_no_line_of_it(beyond):
    inside = (7.0 + beyond) / 100.0, (29.0 - beyond) / 100.0
    assert pick_lines(axis(inside, 21), 100.0, set(), "axes[0]") == list(range(8, 29))


def test_the_hundred_thousandth_multiple_is_as_near_to_the_end_of_a_band_as_the_first():
    """35.2 x 3000 is 105600.00000000001, 37.3 x 3000 is 111899.99999999999."""
    assert pick_lines(axis((35.2, 37.3), 2), 3000.0, set(), "axes[0]") == [105_600, 111_900]


def test_of_the_lines_of_other_axes_only_those_in_the_band_are_counted():
    with pytest.raises(ConfigurationError, match=r"at most 4, .* there less 2 that other axes have"):
        pick_lines(axis((0.5, 1.0), 5), 10.0, {4, 5, 10, 11, 12}, "axes[0]")


def test_one_line_is_the_lowest_that_is_free_and_two_are_both_ends():
    assert pick_lines(axis((0.5, 2.0), 1), 10.0, set(), "axes[0]") == [5]
    assert pick_lines(axis((0.5, 2.0), 1), 10.0, {5, 6, 8}, "axes[0]") == [7]
    assert pick_lines(axis((0.5, 2.0), 2), 10.0, {5, 20}, "axes[0]") == [6, 19]
    assert pick_lines(axis((0.5, 0.5), 1), 10.0, set(), "axes[0]") == [5]


def test_as_many_lines_as_are_searched_in_seconds_are_taken_and_the_next_band_is_refused():
    lines = pick_lines(axis((1.0, 20_000.0), 10), 10.0, set(), "axes[0]")
    assert (len(lines), lines[0], lines[-1]) == (10, 10, 200_000)
    with pytest.raises(ConfigurationError, match=r"10 lines up to 2e\+05 times .*, allowed: up to 20000 Hz"):
        pick_lines(axis((1.0, 20_000.005), 10), 10.0, set(), "axes[0]")


@pytest.mark.parametrize("phase", [0.0, np.pi])
def test_the_peak_of_one_line_is_its_own_over_the_cosine_of_the_grid(phase):
    found = peak(np.array([1]), np.array([phase]))
    assert found == pytest.approx(1.0 / np.cos(np.pi / 64), rel=1e-12)


def test_the_peak_is_that_of_either_sign_and_of_the_sum():
    """sin - cos 2: from -1.125 above to -2 below."""
    found = peak(np.array([1, 2]), np.array([0.0, -np.pi / 2]))
    assert 2.0 <= found <= 2.0 * 1.0013


# -- tables and plans ----------------------------------------------------------------------------------------


def test_a_table_ends_a_tick_behind_the_path_and_what_it_lacks_is_evaluated():
    class Counted:
        duration_s = 1.0

        def __init__(self):
            self.asked = []

        def sample(self, t):
            self.asked.append(t)
            return HoldTrajectory(np.array([t, 0.0, 0.0]), np.eye(3)).sample(t)

    counted = Counted()
    table = TabulatedTrajectory(counted, 0.25)
    assert counted.asked == [0.0, 0.25, 0.5, 0.75, 1.0, 1.25]
    assert table.duration_s == 1.0
    counted.asked.clear()
    for t in (0.0, 0.25, 1.0, 1.25):
        assert table.sample(t).p[0] == t
    assert counted.asked == []
    off = [1.5, -0.25, 0.3, np.nextafter(0.5, 1.0)]
    for t in off:
        assert table.sample(t).p[0] == t
    assert counted.asked == off


def recorded(table, **how):
    file = io.BytesIO()
    np.save(file, table, **how)
    return file.getvalue()


GOOD = plan(time_optimal(((0, 0, 1), (0, 0, 0)), ((0.1, 0, 1), (0, 0, 5))))
TABLE = np.load(io.BytesIO(GOOD))


@pytest.mark.parametrize(
    ("file", "complaint"),
    [
        (recorded(TABLE[:, :-1]), r"allowed: \(n, 37\) of float64"),
        (recorded(np.column_stack([TABLE, TABLE[:, 0]])), r"allowed: \(n, 37\) of float64"),
        (recorded(TABLE[:0]), r"\(0, 37\) of float64.* 0 numbers are there"),
        (recorded(TABLE.ravel()), r"allowed: \(n, 37\) of float64"),
        (recorded(TABLE.astype(np.int64)), r"of int64, allowed: \(n, 37\) of float64"),
        (GOOD[: -8 * 37], f"{re.escape(str(TABLE.shape))} of float64.* {TABLE.size - 37} numbers are there"),
        (GOOD + GOOD[-8 * 37 :], f"{TABLE.size + 37} numbers are there"),
        (GOOD[:-3], "cannot be read"),
        (b"", "cannot be read"),
        (b"no plan", "cannot be read"),
    ],
    ids=["narrow", "wide", "empty", "flat", "integers", "short", "long", "cut", "nothing", "no file"],
)
def test_a_recorded_file_that_is_no_plan_is_refused(file, complaint):
    assert planned_trajectory(GOOD, 1).sample(0.0).p.tolist() == [0.0, 0.0, 1.0]
    with pytest.raises(LogError, match=f"the plan of the reference in the log.*{complaint}"):
        planned_trajectory(file, 1)


def test_a_plan_of_one_polynomial_is_taken():
    one = planned_trajectory(recorded(TABLE[:1]), None)
    assert one.period_s == TABLE[0, 0]
    assert one.duration_s is None


def test_a_file_of_poses_needs_the_folder_of_its_configuration_by_name():
    with pytest.raises(
        ConfigurationError, match=r"reference\.path: absent\.csv needs the configuration's folder"
    ):
        build_trajectory(SampledReference(type="sampled", path="absent.csv"), HOME, None)
    with pytest.raises(ConfigurationError, match=r"absent\.csv: cannot be read"):
        build_trajectory(SampledReference(type="sampled", path="absent.csv"), HOME, Path())
