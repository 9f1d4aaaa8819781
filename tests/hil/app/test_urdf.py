"""`hil new --from`: a URDF of a robot in general position, and files that do not describe a Stewart platform."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import platform_dict
from hil.cli import main

DATA = Path(__file__).parents[2] / "data"
ROBOTS = json.loads((DATA / "rigid_body_cases.json").read_text())["geometries"]
ROBOT = ROBOTS["pub00_generic"]
HOME = np.array([0.02, -0.03, ROBOT["home_height"]])
TURN = Rotation.from_euler("xyz", [0.05, -0.04, 0.1])
REST = ["--leg-mass", "10", "--drive-force", "60000", "--drive-speed", "0.5"]


def frame(p=(0, 0, 0), R=None):
    turn = (Rotation.identity() if R is None else R).as_euler("xyz")
    return f'<origin xyz="{" ".join(map(str, p))}" rpy="{" ".join(map(str, turn))}"/>'


def link(name, mass=0.0, com=(0, 0, 0), inertia=None, R=None):
    if not mass:
        return f'<link name="{name}"/>'
    axes = Rotation.identity() if R is None else R
    I = axes.as_matrix().T @ np.array(inertia) @ axes.as_matrix()
    moments = " ".join(
        f'i{"xyz"[j]}{"xyz"[k]}="{I[j, k]}"' for j, k in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    )
    return f'<link name="{name}"><inertial>{frame(com, axes)}<mass value="{mass}"/><inertia {moments}/></inertial></link>'


def joint(name, kind, parent, child, origin=None, axis="0 0 1", limits=""):
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{origin or frame()}<axis xyz="{axis}"/>{limits}</joint>'


def half(name):
    part = ROBOT[name]
    return (
        part["mass"],
        part["com"],
        np.diag([part["inertia_transverse"]] * 2 + [part["inertia_axial"] or 0.0]),
    )


def urdf(*, platform="leg", legs=6, stroke=1.0, masses=True):
    """The robot with its legs as chains of a universal joint, a prismatic joint and a ball joint; odd legs slide along -z."""
    a, b = (np.array(ROBOT[key]) for key in ("base_joints", "platform_joints"))
    ends = HOME + TURN.apply(b)
    parts = [
        '<?xml version="1.0" encoding="utf-8"?><robot name="mine">',
        link("world"),
        link("base", 90.0, (0, 0, 0), np.eye(3)),
    ]
    parts.append(joint("fix", "fixed", "world", "base"))
    body = ROBOT["platform"]
    for i in range(legs):
        q = float(np.linalg.norm(ends[i] - a[i]))
        R = Rotation.align_vectors([(ends[i] - a[i]) / q], [[0, 0, 1]])[0]
        m, com, I = half("cylinder")
        n, com_rod, I_rod = half("rod")
        parts += [
            link(f"u{i}"),
            link(f"cylinder{i}", m * masses, (0, 0, com), I),
            link(f"rod{i}", n * masses, (0, 0, q - 0.3 - com_rod), I_rod),
        ]
        parts += [link(f"v{i}"), link(f"w{i}"), link(f"tip{i}")]
        ends_m = (-stroke / 2, stroke / 2 + 0.01 * i)
        lower, upper = (-ends_m[1], -ends_m[0]) if i % 2 else ends_m
        limits = f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'
        parts += [
            joint(f"u{i}", "revolute", "base", f"u{i}", frame(a[i], R), "1 0 0"),
            joint(f"c{i}", "continuous", f"u{i}", f"cylinder{i}", axis="0 1 0"),
            joint(f"s{i}", "prismatic", f"cylinder{i}", f"rod{i}", frame((0, 0, 0.3)), "0 0 -1" if i % 2 else "0 0 1", limits),
            joint(f"v{i}", "revolute", f"rod{i}", f"v{i}", frame((0, 0, q - 0.3)), "1 0 0"),
            joint(f"w{i}", "revolute", f"v{i}", f"w{i}", axis="0 1 0"),
            joint(f"t{i}", "revolute", f"w{i}", f"tip{i}"),
        ]  # fmt: skip
        if i == 3 and platform == "leg":
            to = R.inv()
            parts.append(
                joint("plate", "fixed", f"tip{i}", "plate", frame(to.apply(HOME - ends[i]), to * TURN))
            )
    if platform == "floating":
        parts.append(joint("plate", "floating", "base", "plate", frame(HOME, TURN)))
    if platform:
        turned = Rotation.from_euler("xyz", [0.3, -0.5, 0.7])
        parts.append(link("plate", body["mass"] * masses, body["com"], body["inertia"], turned))
    return "\n".join([*parts, "</robot>"])


def new(folder, text, *words):
    (folder / "robot.urdf").write_text(text)
    words = ("new", str(folder / "r.yaml"), "--from", str(folder / "robot.urdf"), "--yes", *words)
    return CliRunner().invoke(main, list(words))


@pytest.mark.parametrize("platform", ["leg", "floating"])
def test_urdf_gives_joints_strokes_and_bodies_of_the_robot(platform, tmp_path):
    done = new(tmp_path, urdf(platform=platform), *REST[2:], "--mounting", "wall")
    assert done.exit_code == 0, done.output
    c = load(tmp_path / "r.yaml").platform
    found = platform_dict(c)
    np.testing.assert_allclose(found["base_joints"], ROBOT["base_joints"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found["platform_joints"], ROBOT["platform_joints"], rtol=0, atol=1e-6)
    body = ROBOT["platform"]
    assert found["platform"]["mass"] == pytest.approx(body["mass"], rel=1e-6)
    np.testing.assert_allclose(found["platform"]["com"], body["com"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        found["platform"]["inertia"], body["inertia"], atol=1e-6 * np.max(body["inertia"])
    )
    for name in ("cylinder", "rod"):
        for key in ("mass", "com", "inertia_transverse"):
            assert found[name][key] == pytest.approx(ROBOT[name][key], rel=1e-6)
    q = np.linalg.norm(HOME + TURN.apply(ROBOT["platform_joints"]) - np.array(ROBOT["base_joints"]), axis=1)
    assert c.length_min_m == pytest.approx(q.max() - 0.5, abs=1e-6)
    assert c.length_max_m == pytest.approx((q + 0.5 + 0.01 * np.arange(6)).min(), abs=1e-6)


def test_hil_new_requires_mass_options_for_a_urdf_without_masses(tmp_path):
    text = urdf(platform="floating", masses=False)
    done = new(tmp_path, text, *REST[2:])
    assert "no default for --mass, --leg-mass" in done.output
    done = new(tmp_path, text, *REST, "--mass", "1000")
    assert done.exit_code == 0, done.output
    assert (
        "--base-radius" in new(tmp_path, text, *REST, "--mass", "9", "--base-radius", "1", "--force").output
    )
    assert "--stroke" in new(tmp_path, text, *REST, "--mass", "9", "--stroke", "1", "--force").output


WHOLE = urdf()
REFUSED = {
    "doctype": (WHOLE.replace("<robot", '<!DOCTYPE r [<!ENTITY a "b">]><robot', 1), "DOCTYPE"),
    "xml": (WHOLE[:-9], "not XML"),
    "sdf": ("<sdf/>", "first element is sdf, allowed: robot"),
    "five legs": (urdf(legs=5), "5 prismatic joints, allowed: 6"),
    "no platform": (urdf(platform=""), "no platform, allowed: a link below the last joint of a leg"),
    "limits": (urdf(stroke=0.0).replace('upper="0.05"', 'upper="0"'), "joint s0: no limits"),
    "two parents": (WHOLE.replace("</robot>", joint("x", "fixed", "tip0", "plate") + "</robot>"), "two joints lead to it: plate"),
    "circle": (WHOLE.replace('<parent link="base"/><child link="u0"/>', '<parent link="tip0"/><child link="u0"/>'), "children of each other"),
    "aside": (WHOLE.replace('<axis xyz="0 0 1"/><limit', '<axis xyz="0 0.1 1"/><limit', 1), "joint s0: does not slide along the line"),
    "apart": (re.sub(r'(name="c0".*?xyz=")0 0 0', r"\g<1>0 0 0.01", WHOLE, count=1), "(u0, c0) are not in one point"),
    "stroke": (urdf(stroke=99.0), "the legs share no stroke"),
    "unequal": (re.sub(r'(<link name="rod0">.*?mass value=")', r"\g<1>9", WHOLE, count=1), "the six rods have different masses"),
    "number": (re.sub(r'mass value="(?!90)[^"]*"', 'mass value="1e999"', WHOLE), "link plate: <mass value>: allowed: 1 finite numbers"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_urdf_that_is_not_a_stewart_platform_is_refused_with_what_is_missing(name, tmp_path):
    text, message = REFUSED[name]
    done = new(tmp_path, text, *REST[2:])
    assert done.exit_code == 2
    assert message in done.output
    assert not (tmp_path / "r.yaml").exists()
