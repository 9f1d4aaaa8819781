"""Sampled references: the spline against SciPy, and every way in which a CSV can be wrong."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from drivers.errors import ConfigurationError
from hil.config.reference import SampledReference
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.sampled import spline_coefficients

DATA = Path(__file__).parent.parent / "data"
HOME = Pose(position_m=(0, 0, 1))
HEADER = "t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n"
ROWS = "0,0,0,1,0,0,0\n1,0.1,0,1,0,0,5\n2,0,0,1,0,0,0\n"


def build(folder, name="path.csv", periods=1):
    return build_trajectory(SampledReference(type="sampled", path=name, periods=periods), HOME, folder)


def write(folder, text):
    (folder / "path.csv").write_bytes(text if isinstance(text, bytes) else text.encode())


def test_the_path_is_scipys_clamped_cubic_spline():
    table = np.loadtxt(DATA / "path.csv", delimiter=",", skiprows=1)
    spline = CubicSpline(table[:, 0], table[:, 1:4], bc_type="clamped")
    trajectory = build(DATA)
    assert trajectory.duration_s == table[-1, 0]
    for t in np.linspace(0, table[-1, 0], 211):
        sample = trajectory.sample(float(t))
        np.testing.assert_allclose(sample.p, spline(t), rtol=0, atol=1e-14)
        np.testing.assert_allclose(sample.twist[:3], spline(t, 1), rtol=0, atol=1e-12)
        np.testing.assert_allclose(sample.dtwist[:3], spline(t, 2), rtol=0, atol=1e-10)


def test_two_rows_are_one_segment_from_rest_to_rest(tmp_path):
    write(tmp_path, HEADER + "0,0,0,1,0,0,0\n2,1,0,1,0,0,0\n")
    sample = build(tmp_path).sample(1.0)
    assert sample.p[0] == pytest.approx(0.5)
    assert sample.twist[0] == pytest.approx(0.75)


def test_a_segment_has_six_powers_of_each_word_those_beyond_the_third_zero():
    pieces = spline_coefficients(np.array([0.0, 1.0, 3.0]), np.arange(12.0).reshape(3, 4))
    assert pieces.shape == (2, 6, 4)
    assert not pieces[:, 4:].any()


@pytest.mark.parametrize(
    ("first", "last"), [(0, 86_401), (0, 1e20), (-1e20, 0), (-1.7e308, 1.7e308), (1.6e9, 1.7e9)]
)
def test_a_path_longer_than_a_day_is_refused_with_its_times(tmp_path, first, last):
    write(tmp_path, f"{HEADER}{first},0,0,1,0,0,0\n{last},0,0,1,0,0,0\n")
    with pytest.raises(ConfigurationError, match=r"path\.csv: t_s goes from .* to .*, allowed: .* 86400 s"):
        build(tmp_path)


def test_a_path_of_a_day_is_taken_whenever_it_begins(tmp_path):
    write(tmp_path, f"{HEADER}1e9,0,0,1,0,0,0\n{10**9 + 86_400},0,0,1,0,0,0\n")
    assert build(tmp_path).duration_s == 86_400.0


def test_time_counts_from_the_first_row_and_bom_and_blank_lines_do_not_matter(tmp_path):
    write(
        tmp_path, "\ufeff" + HEADER + ROWS.replace("0,0,0,1", "5,0,0,1", 1).replace("1,0.1", "6,0.1") + "\n"
    )
    with pytest.raises(ConfigurationError, match=r"path.csv:4: t_s 2 is not after 6"):
        build(tmp_path)
    write(tmp_path, "\ufeff" + HEADER + "5,0,0,1,0,0,0\n\n6,0.1,0,1,0,0,5\n7,0,0,1,0,0,0\n\n")
    shifted = build(tmp_path)
    write(tmp_path, HEADER + ROWS)
    for a, b in zip(shifted.sample(0.7), build(tmp_path).sample(0.7), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_path_whose_times_begin_before_zero_begins_with_its_first_row_too(tmp_path):
    write(tmp_path, HEADER + "-3,0,0,1,0,0,0\n-2,0.1,0,1,0,0,5\n-1,0,0,1,0,0,0\n")
    early = build(tmp_path)
    assert early.duration_s == 2.0
    np.testing.assert_array_equal(early.sample(0.0).p, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(early.sample(1.0).p, [0.1, 0.0, 1.0], rtol=0, atol=1e-15)


def test_a_bad_row_is_named_by_its_line_in_the_file_blank_ones_and_bad_ones_before_it_counted(tmp_path):
    write(tmp_path, HEADER + "\n0,0,0,1,0,0,0\n\n\n1,0\n2,0,0,one,0,0,0\r\n\r\n2,0,0,1,0,0\n")
    with pytest.raises(ConfigurationError) as caught:
        build(tmp_path)
    lines = [line.split("path.csv:")[1].split(":")[0] for line in str(caught.value).splitlines()]
    assert lines == ["6", "7", "9"]


def test_periods_repeat_a_closed_path_and_refuse_an_open_one(tmp_path):
    write(tmp_path, HEADER + ROWS)
    twice = build(tmp_path, periods=2)
    assert twice.duration_s == 4.0
    np.testing.assert_allclose(twice.sample(3.0).p, [0.1, 0, 1], rtol=0, atol=1e-15)
    write(tmp_path, HEADER + ROWS.replace("2,0,0,1,0,0,0", "2,0,0,1,0,0,1"))
    assert build(tmp_path).duration_s == 2.0
    with pytest.raises(ConfigurationError, match=r"path.csv: periods is 2, but the path ends 0.0175"):
        build(tmp_path, periods=2)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", r"path.csv:1: the header must be t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg; given: nothing"),
        (ROWS, r"path.csv:1: the header must be .*; given: 0,0,0,1,0,0,0"),
        (HEADER.replace("rx_deg", "rx_rad") + ROWS, r"path.csv:1: .*rx_rad"),
        (HEADER, r"path.csv: 0 row\(s\) of poses; at least 2 must be there"),
        (HEADER + "0,0,0,1,0,0,0\n", r"path.csv: 1 row\(s\)"),
        (HEADER + "0,0,0,1,0,0\n1,0,0,1,0,0,0\n", r"path.csv:2: 6 values; 7 are needed"),
        (
            HEADER + "0,0,0,1,0,0,0\n1,0,zero,1,0,0,0\n",
            r"path.csv:3: y_m must be a finite number; given: 'zero'",
        ),
        (
            HEADER + "0,0,0,1,0,0,0\n1,0,1_0,1,0,0,0\n",
            r"path.csv:3: y_m must be a finite number; given: '1_0'",
        ),
        (
            HEADER + "0,0,0,nan,0,0,0\n1,0,0,1,0,0,0\n",
            r"path.csv:2: z_m must be a finite number; given: 'nan'",
        ),
        (HEADER + "0,0,0,1,0,0,inf\n1,0,0,1,0,0,0\n", r"path.csv:2: rz_deg must be a finite number"),
        (
            HEADER + "0,0,0,1,0,0,0\n1,1e308,0,1,0,0,0\n",
            r"path.csv:3: x_m must be in size 0, and 1e-60 to 1e\+15; given: 1e\+308",
        ),
        (HEADER + "0,0,0,1,0,0,0\n0,0,0,1,0,0,0\n", r"path.csv:3: t_s 0 is not after 0 of the row before"),
        (HEADER + "0,0,0,1,181,0,0\n1,0,0,1,0,0,0\n", r"path.csv: the rotation vector reaches 181 deg"),
        (b"\xff\xfe\x00", r"path.csv: cannot be read as a CSV file"),
        (HEADER + '0,"0\n', r"path.csv:2: 2 values"),
    ],
)
def test_a_bad_file_is_refused_with_file_and_line(tmp_path, text, complaint):
    write(tmp_path, text)
    with pytest.raises(ConfigurationError, match=complaint):
        build(tmp_path)


def test_all_bad_lines_are_named_at_once(tmp_path):
    write(tmp_path, HEADER + "0,0,0,x,0,0,0\n1,0,0,1,0,0,0\n1,0,0,1,0,0,0\n2,0\n3,0,0,1,0,0,0\n")
    with pytest.raises(ConfigurationError) as caught:
        build(tmp_path)
    assert [p.split("path.csv:")[1].split(":")[0] for p in caught.value.problems] == ["2", "4", "5"]


@pytest.mark.parametrize("bad", ["1,0,zero,1,0,0,0", "1,0", "0,0,0,1,0,0,0"])
def test_a_bad_line_is_the_only_trouble_of_a_file_that_has_lines_enough(tmp_path, bad):
    write(tmp_path, HEADER + f"0,0,0,1,0,0,0\n{bad}\n")
    with pytest.raises(ConfigurationError) as caught:
        build(tmp_path)
    (problem,) = caught.value.problems
    assert "path.csv:3: " in problem


def test_a_missing_file_or_a_folder_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"absent.csv: cannot be read"):
        build(tmp_path, "absent.csv")
    with pytest.raises(ConfigurationError, match=r"cannot be read"):
        build(tmp_path, ".")


def test_without_a_folder_a_csv_is_refused():
    with pytest.raises(ConfigurationError, match=r"reference.path: path.csv"):
        build(None)
