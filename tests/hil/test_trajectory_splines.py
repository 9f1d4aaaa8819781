"""Splines: minimum jerk and CSV files against SciPy, and errors of a CSV file with their lines."""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, make_interp_spline

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.config.reference import SampledReference, WaypointReference
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.sampled import read_poses, roughness

DATA = Path(__file__).parent.parent / "data"
HOME = Pose(position_m=(0, 0, 1))
T = np.array([0.0, 0.7, 1.9, 2.2, 4.0])
Y = np.random.default_rng(1).uniform(-0.2, 0.2, (5, 6))
HEADER = "t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n"
ROWS = "0,0,0,1,0,0,0\n1,0.1,0,1,0,0,5\n2,0,0,1,0,0,0\n"


def build(folder, text=None, periods=1):
    """Path of a CSV file in a folder."""
    if text is not None:
        (folder / "path.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return build_trajectory(SampledReference(type="sampled", path="path.csv", periods=periods), HOME, folder)


def is_the_spline(trajectory, spline, end):
    for t in np.linspace(0, end, 211):
        sample = trajectory.sample(float(t))
        for order, part in enumerate((sample.p, sample.twist[:3], sample.dtwist[:3])):
            np.testing.assert_allclose(part, spline(t, order)[:3], rtol=0, atol=1e-13 * 10**order)


def test_a_minimum_jerk_path_agrees_with_scipys_quintic_spline():
    points = [
        {"t_s": s, "position_m": chi[:3], "rotation_vector_deg": np.rad2deg(chi[3:])}
        for s, chi in zip(T.tolist(), Y.tolist(), strict=True)
    ]
    settings = {"type": "waypoints", "interpolation": "minimum_jerk", "points": points}
    path = build_trajectory(WaypointReference.model_validate(settings), HOME, None)
    rest = [(1, np.zeros(6)), (2, np.zeros(6))]
    is_the_spline(path, make_interp_spline(T, Y, k=5, bc_type=(rest, rest)), 4.0)


def test_a_sampled_path_agrees_with_scipys_clamped_cubic_spline():
    table = np.loadtxt(DATA / "path.csv", delimiter=",", skiprows=1)
    path = build(DATA)
    assert path.duration_s == table[-1, 0]
    is_the_spline(path, CubicSpline(table[:, 0], table[:, 1:4], bc_type="clamped"), path.duration_s)


def test_two_rows_give_one_segment_from_rest_to_rest(tmp_path):
    sample = build(tmp_path, HEADER + "0,0,0,1,0,0,0\n2,1,0,1,0,0,0\n").sample(1.0)
    assert (sample.p[0], sample.twist[0]) == pytest.approx((0.5, 0.75))


def test_time_starts_at_the_first_row_and_blank_lines_are_ignored(tmp_path):
    plain = build(tmp_path, HEADER + ROWS)
    for first in (5, -3):
        rows = f"{first},0,0,1,0,0,0\n\n{first + 1},0.1,0,1,0,0,5\n{first + 2},0,0,1,0,0,0\n\n"
        shifted = build(tmp_path, "\ufeff" + HEADER + rows)
        assert shifted.duration_s == 2.0
        for a, b in zip(shifted.sample(0.7), plain.sample(0.7), strict=True):
            np.testing.assert_array_equal(a, b)


def test_a_path_may_last_a_day(tmp_path):
    rows = f"1e9,0,0,1,0,0,0\n{10**9 + 86_400},0,0,1,0,0,0\n"
    assert build(tmp_path, HEADER + rows).duration_s == 86_400.0


def test_periods_repeat_a_closed_path_and_an_open_one_is_refused(tmp_path):
    twice = build(tmp_path, HEADER + ROWS, periods=2)
    assert twice.duration_s == 4.0
    np.testing.assert_allclose(twice.sample(3.0).p, [0.1, 0, 1], rtol=0, atol=1e-15)
    with pytest.raises(ConfigurationError, match=r"path.csv: periods is 2, .* 0.0175"):
        build(tmp_path, HEADER + ROWS.replace("2,0,0,1,0,0,0", "2,0,0,1,0,0,1"), periods=2)


REST = "0,0,0,1,0,0,0\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", r":1: the header must .* given: nothing"),
        (ROWS, r":1: the header must .*; given: 0,0,0,1,0,0,0"),
        (HEADER.replace("rx_deg", "rx_rad") + ROWS, r":1: .*rx_rad"),
        (HEADER.replace("z_m", "x_m") + ROWS, r":1: .* once"),
        (HEADER.replace(",", ";") + ROWS.replace(",", ";"), r":1: .* semicolon"),
        (HEADER, r": 0 row\(s\)"),
        (HEADER + REST, r": 1 row\(s\)"),
        (HEADER + "0,0,0,1,0,0\n" + ROWS, r":2: 6 values; 7 are needed"),
        (HEADER + REST + "1,0,zero,1,0,0,0\n", r":3: y_m must be a finite number; given: 'zero'"),
        (HEADER + REST + "1,0,1_0,1,0,0,0\n", r":3: y_m must be a finite number"),
        (HEADER + "0,0,0,nan,0,0,0\n" + ROWS, r":2: z_m must be a finite number"),
        (HEADER + "0,0,0,1,0,0,inf\n" + ROWS, r":2: rz_deg must be a finite number"),
        (HEADER + REST + "1,1e308,0,1,0,0,0\n", r":3: x_m must have a magnitude"),
        (HEADER + REST + REST, r":3: t_s 0 is not after 0"),
        (HEADER + "0,0,0,1,181,0,0\n1,0,0,1,0,0,0\n", r": the rotation vector reaches 181 deg"),
        (HEADER + REST + "86401,0,0,1,0,0,0\n", r": t_s goes from 0 to 86401, .* 86400 s"),
        (HEADER + "-1.7e308,0,0,1,0,0,0\n1.7e308,0,0,1,0,0,0\n", r": t_s goes from"),
        (b"\xff\xfe\x00", r": cannot be read as a CSV file"),
    ],
)
def test_invalid_path_file_is_refused_with_file_and_line(tmp_path, text, complaint):
    with pytest.raises(ConfigurationError, match=r"path\.csv" + complaint):
        build(tmp_path, text)


def test_columns_of_a_path_file_are_found_by_name_and_rows_of_commas_are_skipped(tmp_path):
    plain = build(tmp_path, HEADER + ROWS)
    words = [row.split(",") for row in (HEADER + ROWS).splitlines()]
    text = "\n".join(",".join([*reversed(row), "note"]) for row in words) + "\n,,,,,,,\n,,\n"
    for a, b in zip(build(tmp_path, text).sample(0.7), plain.sample(0.7), strict=True):
        np.testing.assert_array_equal(a, b)


def test_path_file_is_parsed_once_while_its_content_is_unchanged(tmp_path):
    """240,000 rows take seconds, and one command builds its path three times; size and times may stay."""
    path = tmp_path / "path.csv"
    path.write_text(HEADER + ROWS)
    t, chi = read_poses(path, at_least=2)
    assert read_poses(path, at_least=2)[1] is chi
    stamp = path.stat().st_mtime_ns
    path.write_text((HEADER + ROWS).replace("0.1", "0.2"))
    os.utime(path, ns=(stamp, stamp))
    assert not np.array_equal(read_poses(path, at_least=2)[1], chi)
    with pytest.raises(ValueError, match="read-only"):
        t[0] = 1.0


def test_rough_rows_of_a_sampled_path_are_explained_and_smooth_ones_are_not():
    """Two rows 1 us and 2 mm apart; white noise of 2 um at 1 ms: 6 x 2e-6 / 1e-6 = 12 m/s^2."""
    t: Array = np.linspace(0.0, 3.999, 4000)
    chi = np.zeros((4000, 6))
    chi[:, 0] = 0.01 * np.sin(2 * np.pi * 0.25 * t) ** 3
    assert roughness(t, np.round(chi, 8)) == ""
    assert roughness(t[::500], chi[::500]) == ""
    noisy = chi + np.random.default_rng(1).normal(0, 2e-6, (4000, 1)) * np.eye(6)[1]
    assert re.search(r"y_m has noise of about (1.9|2|2.1)e-06 m .* 1[123] m/s\^2", roughness(t, noisy))
    close = np.array([0.0, 1.0, 1.000001, 2.0, 3.0])
    rows = np.zeros((5, 6))
    rows[1:3, 0] = 0.005, 0.007
    assert "rows 2 and 3 are 1 us and, along x_m, 2 mm apart" in roughness(close, rows)


@pytest.mark.parametrize("jitter", [0.0, 0.2], ids=["even", "uneven"])
@pytest.mark.parametrize("rows_a_period", [3.5, 4.0, 6.0, 10.0, 50.0, 500.0])
def test_noise_of_a_sampled_path_is_found_for_white_noise_but_not_for_clean_sines(rows_a_period, jitter):
    """A sine of 10 mm at 0.1 Hz, in rows of some ms to some s; white noise of 1 mm, 0.1 of the amplitude."""
    rng, h = np.random.default_rng(3), 10.0 / rows_a_period
    t = h * (np.arange(600) + rng.uniform(-jitter, jitter, 600))
    chi = 0.01 * np.sin(2 * np.pi * 0.1 * t)[:, None] * np.eye(6)[2]
    assert roughness(t, chi) == ""
    warning = roughness(t, chi + rng.normal(0, 1e-3, (600, 1)) * np.eye(6)[2])
    found = re.search(r"z_m has noise of about (\S+) m", warning)
    assert (rows_a_period < 10) or (found and 0.7e-3 < float(found[1]) < 1.3e-3), warning


def test_all_invalid_lines_of_a_path_file_are_listed_by_line_number(tmp_path):
    text = HEADER + "\n0,0,0,x,0,0,0\n\n1,0,0,1,0,0,0\n1,0,0,1,0,0,0\n2,0\r\n3,0,0,1,0,0,0\n"
    with pytest.raises(ConfigurationError) as caught:
        build(tmp_path, text)
    assert [p.split("path.csv:")[1].split(":")[0] for p in caught.value.problems] == ["3", "6", "7"]


def test_missing_path_file_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"path.csv: cannot be read"):
        build(tmp_path)
