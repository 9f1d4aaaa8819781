"""`hil workspace`: summary, picture, JSON, and refusals."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load, loads
from hil.cli import main
from hil.study.workspace.command import build_surveyor
from hil.study.workspace.limits import KINDS
from hil.study.workspace.position import map_positions

LAB = load("lab").text
ANGLES = "  length_max_m: 1.2\n"


def hil(*arguments):
    return CliRunner().invoke(main, ["workspace", *map(str, arguments)])


def edited(*changes):
    text = LAB
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("workspace")
    result = hil("lab", "--resolution", 12, "--picture", folder / "lab.png", "--json", folder / "lab.json")
    assert result.exit_code == 0, result.output
    return folder, result.output


def test_hil_workspace_prints_all_figures_and_writes_them_to_json(mapped):
    folder, output = mapped
    summary = json.loads((folder / "lab.json").read_text())
    assert summary["success"]
    assert summary["kind"] == "workspace"
    assert summary["resolution"] == 12
    positions = summary["positions"]
    assert positions["volume_m3"] == pytest.approx(0.1169, rel=0.05)  # at resolution 160
    assert set(positions["boundary_points"]) == set(KINDS)
    assert sum(positions["boundary_points"].values()) > 100
    assert sum(positions["boundary_shares"].values()) == pytest.approx(1)
    assert [set(entry) for entry in positions["convergence"]] == [{"step_m", "volume_m3"}] * 3
    for low, high in positions["extents_m"].values():
        assert low < high
    home = load("lab").platform.home.position_m[2]
    low, high = positions["extents_m"]["z"]
    assert low < home - summary["largest_sphere"]["radius_m"] < home < high
    cylinder, (bottom, top) = summary["largest_cylinder"], summary["largest_cylinder"]["z_m"]
    assert low - 1e-6 <= bottom < home < top <= high + 1e-6
    assert cylinder["volume_m3"] == pytest.approx(np.pi * cylinder["radius_m"] ** 2 * (top - bottom))
    for words in (
        f"{bottom:.3f}",
        "volume",
        "largest sphere",
        "condition of J",
        "tilt",
        "torsion",
        "boundary",
    ):
        assert words in output
    assert summary["limits"]["length_m"] == [0.76, 1.19]  # soft ends: 10 mm inside the hard ones
    assert summary["limits"]["base_joint_angle_deg"] is None


def test_workspace_map_respects_the_joint_angle_limits_of_the_configuration():
    more = "  base_joint_angle_max_deg: 8\n  platform_joint_angle_max_deg: 100\n"
    c = loads(edited((ANGLES, ANGLES + more)), "my.yaml")
    surveyor = build_surveyor(c)
    kinds = map_positions(surveyor, 10).kinds
    assert (kinds == KINDS.index("joint angle")).mean() > 0.5
    assert surveyor.limits.base_angle == pytest.approx(np.deg2rad(8))


def test_home_beyond_a_joint_angle_is_refused_with_its_line():
    upwards = "[" + ", ".join(["[0, 0, 1]"] * 6) + "]"
    text = edited((ANGLES, f"{ANGLES}  base_joint_angle_max_deg: 5\n  base_joint_axes: {upwards}\n"))
    line = text[: text.index("\n  home:")].count("\n") + 2
    with pytest.raises(ConfigurationError) as caught:
        build_surveyor(loads(text, "my.yaml"))
    (problem,) = caught.value.problems
    assert problem.startswith(f"my.yaml:{line}:3: platform.home: home, p = [0.0, 0.0, 0.85] m, is outside")
    assert "deg from its axis (allowed 5)" in problem


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("base_joint_angle_max_deg: 190", "platform.base_joint_angle_max_deg: out of range"),
        ("base_joint_angle_max_deg: 0", "platform.base_joint_angle_max_deg: out of range"),
        (
            "platform_joint_axes: [" + ", ".join(["[0, 0, 0]"] * 6) + "]",
            "platform_joint_axes has a direction",
        ),
    ],
)
def test_invalid_joint_limits_are_refused(line, message):
    with pytest.raises(ConfigurationError, match=message):
        loads(edited((ANGLES, f"{ANGLES}  {line}\n")), "my.yaml")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--payload", 5000), "(allowed 2500)"),
        (("--resolution", 8, "--position", 0, 0, 2), "the straight line meets the limit stroke"),
    ],
)
def test_a_payload_or_position_beyond_the_limits_is_refused(tmp_path, words, said):
    result = hil("lab", *words, "--picture", tmp_path / "x.png")
    assert result.exit_code == 2
    assert said in " ".join(result.output.split())
    assert not (tmp_path / "x.png").exists()
