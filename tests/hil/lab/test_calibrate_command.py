"""`hil calibrate`: report and fragment from a CSV file; invalid files are refused with the line."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import platform_dict
from hil.cli import main

LAB = load("lab")
NOMINAL = platform_dict(LAB.platform)
HEADER = ["x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg", *(f"l{i}_m" for i in range(1, 7))]
NOISE = 2e-5


def robot():
    g = np.random.default_rng(11)
    a = np.array(NOMINAL["base_joints"]) + g.normal(0, 2e-3, (6, 3))
    b = np.array(NOMINAL["platform_joints"]) + g.normal(0, 2e-3, (6, 3))
    return a, b, g.normal(0, 3e-3, 6)


def rows(n=40, tilt_deg=9.0):
    """Measured pairs of the perturbed laboratory robot."""
    a, b, offset = robot()
    g = np.random.default_rng(12)
    out = []
    for _ in range(n):
        p = np.array([0, 0, 0.85]) + g.uniform(-0.08, 0.08, 3)
        r = g.uniform(-tilt_deg, tilt_deg, 3)
        R = Rotation.from_rotvec(np.deg2rad(r)).as_matrix()
        legs = [float(np.linalg.norm(p + R @ b[i] - a[i]) + offset[i] + g.normal(0, NOISE)) for i in range(6)]
        out.append([*p.tolist(), *r.tolist(), *legs])
    return out


def write(path, table, header=HEADER):
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *table])
    return path


def hil(*arguments):
    return CliRunner(env={"COLUMNS": "80"}).invoke(main, [str(a) for a in arguments])


def calibrated(tmp_path, table, header=HEADER, config="lab"):
    result = hil(
        "calibrate", config, write(tmp_path / "poses.csv", table, header), "--json", tmp_path / "c.json"
    )
    assert result.exit_code == 0, result.output
    return result.stdout, json.loads((tmp_path / "c.json").read_text())


def refused(tmp_path, table, header=HEADER):
    result = hil("calibrate", "lab", write(tmp_path / "poses.csv", table, header))
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    assert result.stdout == ""
    return result.stderr.replace(str(tmp_path) + "/", "")


def test_hil_calibrate_finds_the_robot_and_writes_its_joints_as_yaml(tmp_path):
    poses = write(tmp_path / "poses.csv", rows())
    out = tmp_path / "joints.yaml"
    result = hil("calibrate", "lab", poses, "--out", out, "--json", tmp_path / "c.json")
    assert result.exit_code == 0, result.output
    a, b, offset = robot()
    figures = json.loads((tmp_path / "c.json").read_text())
    assert figures["success"] is True
    true = np.hstack([a, b, offset[:, None]])
    found = np.hstack(
        [
            figures["base_joints_m"],
            figures["platform_joints_m"],
            np.array(figures["length_offsets_m"])[:, None],
        ]
    )
    z = (found - true) / np.array(figures["std_m"])
    assert np.abs(z).max() < 4  # 42 draws
    assert figures["residual_rms_m"] == pytest.approx(
        NOISE * np.sqrt(figures["degrees_of_freedom"] / 240), rel=0.15
    )
    # the fragment, pasted over the section's joints
    text = LAB.text
    fragment = out.read_text()
    joints = "\n".join(line for line in fragment.splitlines() if not line.startswith(("#", "platform:")))
    start, end = text.index("  base_joints_m:"), text.index("  platform:  ")
    pasted = loads(text[:start] + joints + "\n" + text[end:], "pasted.yaml")
    now = platform_dict(pasted.platform)
    assert np.array(now["base_joints"]) == pytest.approx(np.array(figures["base_joints_m"]), abs=5.1e-8)
    assert np.array(now["platform_joints"]) == pytest.approx(
        np.array(figures["platform_joints_m"]), abs=5.1e-8
    )


@pytest.mark.parametrize("share", [1.0, 1 / 3, 3.0])
def test_hil_calibrate_reads_columns_in_any_order_and_gives_chi_square_for_given_deviations(tmp_path, share):
    table = [[share * NOISE, *row[::-1]] for row in rows()]
    _, figures = calibrated(tmp_path, table, ["length_std_m", *HEADER[::-1]])
    assert figures["chi_square"] / figures["degrees_of_freedom"] == pytest.approx(share**-2, rel=0.3)
    assert (0.001 < figures["p_value"] < 0.999) == (share == 1.0)


def test_hil_calibrate_reports_poses_without_tilt_as_not_observable(tmp_path):
    text, figures = calibrated(tmp_path, rows(tilt_deg=0.0))
    assert "not observable" in " ".join(text.split())
    assert len(figures["undetermined"]) == 18
    assert figures["std_m"][0][0] is None


def test_hil_calibrate_warns_about_poorly_determined_parameters(tmp_path):
    text, figures = calibrated(tmp_path, rows(tilt_deg=2.0))
    assert "warning: weak, uncertain by more than 1 mm: l1: " in " ".join(text.split())
    assert figures["undetermined"] == []
    assert figures["weak_std_m"] == 1e-3
    assert max(figures["std_m"][0]) > 1e-3
    assert figures["weak"]["l1"]


def test_hil_calibrate_reports_an_outlier_with_its_line_despite_blank_lines(tmp_path):
    table = rows()
    table[20][7] += 2e-3
    text, _ = calibrated(tmp_path, [*table[:5], [], [" ", ""], *table[5:15], [], *table[15:]])
    assert "poses.csv:25: l2 is" in text


def changed(row, column, value):
    table = [[*r] for r in rows()]
    table[row][column] = value
    return table


def scaled(columns, factor):
    return [[x * factor if k in columns else x for k, x in enumerate(row)] for row in rows()]


BAD = [
    (rows(7), HEADER, "at least 8"),
    ([], HEADER, "poses.csv: no rows"),
    (changed(4, 9, "nan"), HEADER, "poses.csv:6: l4_m"),
    (changed(4, 9, "1e300"), HEADER, "poses.csv:6: l4_m"),
    (changed(4, 9, "-1.4"), HEADER, "poses.csv:6: l4_m"),
    ([*rows(), [1, 2]], HEADER, "poses.csv:42: 2 values"),
    (changed(3, 3, 200.0), HEADER, "poses.csv:5: rotation vector"),
    (changed(30, 11, 0.1), HEADER, "poses.csv:32: l6_m"),
    (scaled({0, 1, 2}, 1e3), HEADER, "positions are in mm"),
    (scaled({3, 4, 5}, np.pi / 180), HEADER, "are in rad"),
    (rows(), [*HEADER[:11], "l7_m"], "poses.csv:1: column l6_m is missing"),
    (rows(), [*HEADER[:11], "l5_m"], "poses.csv:1: column 'l5_m', allowed, each once"),
    ([[*r, 1e-5] for r in rows()], [*HEADER, "position_std_m"], "need length_std_m"),
    ([[*r, 0.0] for r in rows()], [*HEADER, "length_std_m"], "poses.csv:2: length_std_m"),
    ([*rows(), [0.0, 0.0, 1.5, 0.0, 0.0, 0.0, *[1.5] * 6]], HEADER, "poses.csv:42: out of reach"),
]


@pytest.mark.parametrize(("table", "header", "message"), BAD)
def test_hil_calibrate_refuses_an_invalid_file_with_the_line(tmp_path, table, header, message):
    assert message in refused(tmp_path, table, header)
