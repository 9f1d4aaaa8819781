"""`hil calibrate`: from a CSV file to a report and a fragment that can be pasted; wrong files are named by line."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import platform_dict
from hil.cli import main
from hil.lab.calibrate.command import read_pairs, run_calibration

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


def test_the_robot_is_found_and_the_fragment_replaces_the_joints(tmp_path):
    poses = write(tmp_path / "poses.csv", rows())
    out = tmp_path / "joints.yaml"
    result = hil("calibrate", "lab", poses, "--out", out, "--json", tmp_path / "c.json")
    assert result.exit_code == 0, result.output
    assert max(map(len, result.stdout.splitlines())) <= 80
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
    assert "subtract it in the drive" in fragment
    # nothing is ever overwritten
    again = hil("calibrate", "lab", poses, "--out", out)
    assert again.exit_code == 2
    assert "exists and is not overwritten" in again.stderr
    assert out.read_text() == fragment


def test_columns_may_come_in_any_order_and_deviations_give_a_chi_square(tmp_path):
    plain, _ = calibrated(tmp_path, rows())
    assert "chi-square" not in plain
    turned = [[NOISE, *row[::-1]] for row in rows()]
    text, figures = calibrated(tmp_path, turned, ["length_std_m", *HEADER[::-1]])
    assert "chi-square" in text
    assert 0.001 < figures["p_value"] < 0.999
    (tmp_path / "c.json").unlink()
    small = [[*row, NOISE / 3] for row in rows()]
    text, figures = calibrated(tmp_path, small, [*HEADER, "length_std_m"])
    assert figures["chi_square"] / figures["degrees_of_freedom"] == pytest.approx(9, rel=0.3)
    assert "larger than chance allows" in " ".join(text.split())
    (tmp_path / "c.json").unlink()
    large = [[*row, NOISE * 3] for row in rows()]
    text, figures = calibrated(tmp_path, large, [*HEADER, "length_std_m"])
    assert figures["chi_square"] / figures["degrees_of_freedom"] == pytest.approx(1 / 9, rel=0.3)
    assert "smaller than chance allows" in " ".join(text.split())


def test_deviations_of_lengths_positions_and_angles_are_taken_in_their_units(tmp_path):
    deviations = ["length_std_m", "position_std_m", "rotation_std_deg"]
    table = [[*row, 2e-5, 3e-5, 0.06 * (n + 1)] for n, row in enumerate(rows(8))]
    measured = read_pairs(write(tmp_path / "poses.csv", table, [*HEADER, *deviations])).measured
    assert measured.length_std == pytest.approx(np.full(8, 2e-5))
    assert measured.position_std == pytest.approx(np.full(8, 3e-5))
    assert measured.rotation_std == pytest.approx(0.06 * np.pi / 180 * np.arange(1, 9))
    assert measured.rotation_vector == pytest.approx(np.pi / 180 * np.array(table)[:, 3:6])


def test_each_joint_of_the_fragment_stands_with_its_own_standard_deviations(tmp_path):
    report = run_calibration("lab", write(tmp_path / "poses.csv", rows()))
    std_mm = 1e3 * np.array(report.figures["std_m"])
    section, found = "", []
    for line in report.fragment.splitlines():
        section = line.strip() if line.startswith("  ") and line.endswith("_m:") else section
        if "# l" in line and "+-" in line:
            found.append((section, int(line.partition("# l")[2][0]), line.partition("+- ")[2].split()))
    joints = {"base_joints_m:": slice(0, 3), "platform_joints_m:": slice(3, 6)}
    assert [(section, leg) for section, leg, _ in found] == [(s, leg) for s in joints for leg in range(1, 7)]
    for section, leg, words in found:
        assert [float(word) for word in words] == pytest.approx(std_mm[leg - 1, joints[section]], abs=5.1e-4)
    assert np.abs(std_mm[:, :3] - std_mm[:, 3:6]).max() > 0.01, "they are not those of the other joint"


def test_what_offsets_alone_would_leave_is_what_each_leg_leaves_about_its_own_mean(tmp_path):
    table = rows()
    _, figures = calibrated(tmp_path, table)
    given = np.array(table)
    R = Rotation.from_rotvec(np.deg2rad(given[:, 3:6])).as_matrix()
    joints = given[:, None, :3] + np.einsum("kij,lj->kli", R, NOMINAL["platform_joints"])
    left = given[:, 6:] - np.linalg.norm(joints - np.array(NOMINAL["base_joints"]), axis=2)
    rms = np.sqrt(np.mean(left.var(axis=0)))
    assert figures["residual_rms_offsets_alone_m"] == pytest.approx(rms, rel=1e-9)
    assert rms < 0.7 * left.std(), "one offset for all legs leaves more"


def test_poses_without_tilt_are_named(tmp_path):
    text, figures = calibrated(tmp_path, rows(tilt_deg=0.0))
    assert (
        "l1, l2, l3, l4, l5, l6: not observable with these poses: base x + platform x; base y + platform y; "
        "base z + platform z." in " ".join(text.split())
    )
    assert "tilt about all axes" in " ".join(text.split())
    assert len(figures["undetermined"]) == 18
    assert figures["std_m"][0][0] is None
    assert "?" in text


@pytest.mark.parametrize("slip", [2e-3, -2e-3])
def test_a_slip_is_named_by_its_line(tmp_path, slip):
    """A line that holds nothing counts as a line of the file."""
    table = rows()
    table[20][7] += slip
    text, _ = calibrated(tmp_path, table)
    assert "poses.csv:22: l2 is" in text
    (tmp_path / "c.json").unlink()
    text, _ = calibrated(tmp_path, [*table[:5], [], [" ", ""], *table[5:15], [], *table[15:]])
    assert "poses.csv:25: l2 is" in text


def test_a_refusal_names_the_line_of_a_file_with_blank_lines(tmp_path):
    table = changed(30, 11, 0.1)
    table[4][6] = "abc"
    gaps = [*table[:2], [], [""], *table[2:]]
    assert "poses.csv:8: l1_m: allowed: a finite number" in refused(tmp_path, gaps)
    gaps[6][6] = table[3][6]
    assert "poses.csv:34: l6_m is 0.1000 where the pose asks for" in refused(tmp_path, gaps)


def changed(row, column, value):
    table = [[*r] for r in rows()]
    table[row][column] = value
    return table


def scaled(columns, factor):
    return [[x * factor if k in columns else x for k, x in enumerate(row)] for row in rows()]


BAD = [
    (rows(7), HEADER, "7 poses, allowed: at least 8"),
    ([], HEADER, "poses.csv: no rows"),
    (changed(4, 9, "nan"), HEADER, "poses.csv:6: l4_m: allowed: a finite number, given: 'nan'"),
    (changed(4, 9, "1e300"), HEADER, "poses.csv:6: l4_m: allowed in size: 0, and 1e-60 to 1e+15, given: 1e+300"),
    (changed(4, 9, "-1e-61"), HEADER, "poses.csv:6: l4_m: allowed in size: 0, and 1e-60 to 1e+15, given: -1e-61"),
    (changed(4, 9, "-1.4"), HEADER, "poses.csv:6: l4_m: allowed: greater than 0, given: -1.4"),
    (changed(4, 9, "0"), HEADER, "poses.csv:6: l4_m: allowed: greater than 0, given: 0"),
    (changed(4, 9, "1_4"), HEADER, "poses.csv:6: l4_m: allowed: a finite number, given: '1_4'"),
    (changed(4, 9, "abc"), HEADER, "poses.csv:6: l4_m: allowed: a finite number, given: 'abc'"),
    ([*rows(), [1, 2]], HEADER, "poses.csv:42: 2 values, allowed: 12"),
    (changed(3, 3, 200.0), HEADER, "poses.csv:5: rotation vector of 20"),
    (changed(30, 11, 0.1), HEADER, "poses.csv:32: l6_m is 0.1000 where the pose asks for"),
    (changed(30, 11, 1.3), HEADER, "poses.csv:32: l6_m is 1.3000 where the pose asks for"),
    (scaled({0, 1, 2}, 1e3), HEADER, "would if these were positions in mm instead of m"),
    (scaled(set(range(6, 12)), 1e3), HEADER, "would if these were lengths in mm instead of m"),
    (scaled({3, 4, 5}, np.pi / 180), HEADER, "would if these were rotation vectors in rad instead of deg"),
    (rows(), ["x_mm", *HEADER[1:]], "poses.csv:1: missing columns x_m"),
    (rows(), [*HEADER[:11], "l7_m"], "poses.csv:1: missing columns l6_m"),
    (rows(), [*HEADER[:11], "l5_m"], "poses.csv:1: column l5_m is there twice"),
    ([[*r, 1e-5] for r in rows()], [*HEADER, "position_std_m"], "need length_std_m, too"),
    ([[*r, 0.0] for r in rows()], [*HEADER, "length_std_m"], "poses.csv:2: length_std_m: allowed: greater than 0, given: 0"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "header", "message"), BAD)
def test_a_wrong_file_is_refused_with_the_place(tmp_path, table, header, message):
    assert message in refused(tmp_path, table, header)


@pytest.mark.parametrize("height_m", [1.5, 0.45])
def test_a_pose_out_of_reach_is_named(tmp_path, height_m):
    a, b, offset = robot()
    p = np.array([0.0, 0.0, height_m])
    legs = np.linalg.norm(p + b - a, axis=1) + offset
    message = refused(tmp_path, [*rows(), [*p, 0, 0, 0, *legs]])
    assert "poses.csv:42: out of reach: the pose asks" in message
    assert "stroke 0.75 to 1.2 m" in message


def test_files_that_are_not_there_or_in_the_way_are_refused(tmp_path):
    result = hil("calibrate", "lab", tmp_path / "none.csv")
    assert result.exit_code == 2
    assert "No such file" in result.stderr
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00")
    result = hil("calibrate", "lab", tmp_path / "bytes.csv")
    assert result.exit_code == 2
    assert "cannot be read as a CSV file" in result.stderr
    poses = write(tmp_path / "poses.csv", rows())
    result = hil("calibrate", "lab", poses, "--out", tmp_path / "no/where.yaml")
    assert result.exit_code == 2
    assert "there is no folder" in result.stderr
    result = hil("calibrate", "lab", poses, "--out", tmp_path / "x", "--json", tmp_path / "x")
    assert result.exit_code == 2
    assert not (tmp_path / "x").exists()
