"""Section `platform`: circles, CAD figures, shapes and payload."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.errors import ConfigurationError
from hil.app.compose import build_scene
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform, platform_dict

LAB = load("lab").text
VIRTUAL = load("virtual").text
BOOK = json.loads((Path(__file__).parents[2] / "data/book_platform.json").read_text())["geometry"]


def section(text, key, new):
    """Replace the block under a key of `platform:` (two spaces deep) by new lines."""
    lines, out, inside = text.splitlines(), [], False
    for line in lines:
        if inside and (line.startswith("    ") or not line.strip()):
            continue
        inside = line.startswith(f"  {key}:")
        out.append(f"  {key}:{new}" if inside else line)
    assert f"  {key}:{new}" in out
    return "\n".join(out) + "\n"


def body(text):
    """The virtual bench with another moving platform."""
    return section(VIRTUAL, "platform", f"\n    {text}")


def resolved(text):
    return platform_dict(loads(text, "my.yaml").platform)["platform"]


def problem(text):
    with pytest.raises(ConfigurationError) as caught:
        loads(text, "my.yaml")
    assert len(caught.value.problems) == 1, caught.value.problems
    return caught.value.problems[0]


def test_joints_given_by_circles_give_the_joints_of_the_textbook_platform():
    text = section(VIRTUAL, "base_joints_m", " {radius_m: 2, angles_deg: [0, 60, 120, 180, 240, 300]}")
    text = section(
        text, "platform_joints_m", " {radius_m: 1, pair_centres_deg: [30, 150, 270], pair_spacing_m: 0}"
    )
    loaded = loads(text, "my.yaml")
    robot = build_platform(loaded.platform)
    assert robot.base_joints == pytest.approx(np.array(BOOK["base_joints"]), abs=2e-15)
    assert robot.platform_joints == pytest.approx(np.array(BOOK["platform_joints"]), abs=2e-15)
    scene = build_scene(loaded)
    assert np.array(scene.base_joints) == pytest.approx(robot.base_joints)


def test_joint_pairs_and_body_shapes_give_the_shipped_laboratory_platform():
    """The figures of configs/lab.yaml, with the sources in its comments, to its rounding."""
    text = section(
        LAB, "base_joints_m", " {radius_m: 0.75, pair_centres_deg: [0, 120, 240], pair_half_angle_deg: 10}"
    )
    text = section(
        text,
        "platform_joints_m",
        " {radius_m: 0.6, pair_centres_deg: [60, 180, 300], pair_half_angle_deg: 10, pairs_begin: second_leg}",
    )
    text = section(
        text,
        "platform",
        """
    mass_kg: 80
    com_m: [0, 0, 0.025]
    shape: {type: cylinder, radius_m: 0.6, length_m: 0.05}
    payload:
      - {mass_kg: 220, com_m: [0, 0, 0.3], shape: {type: box, size_m: [0.6, 0.6, 0.5]}}""",
    )
    was, now = (platform_dict(loads(t, "my.yaml").platform) for t in (LAB, text))
    for key in ("base_joints", "platform_joints"):
        assert np.array(now[key]) == pytest.approx(np.array(was[key]), abs=1e-6)
    assert now["platform"]["mass"] == 300
    assert now["platform"]["com"] == pytest.approx(was["platform"]["com"], abs=1e-4)
    assert np.array(now["platform"]["inertia"]) == pytest.approx(
        np.array(was["platform"]["inertia"]), abs=6e-3
    )


M, C = 50.0, np.array([0.02, -0.03, 0.15])
R_CAD, ORIGIN = Rotation.from_rotvec([0.3, 0.9, -0.5]), np.array([0.4, -0.1, 0.7])
PRINCIPAL = np.diag([2.0, 2.5, 3.2])
R_PRINCIPAL = Rotation.from_rotvec([-0.2, 0.4, 0.6])
TRUE = R_PRINCIPAL.as_matrix() @ PRINCIPAL @ R_PRINCIPAL.as_matrix().T
"""About the centre of mass, platform axes; C in the platform frame."""


def numbers(x):
    return json.dumps(np.asarray(x).tolist())


def vector_deg(rotation):
    return numbers(np.rad2deg(rotation.as_rotvec()))


def steiner(d):
    return M * (d @ d * np.eye(3) - np.outer(d, d))


def forms():
    """The same body as different CAD tools print it."""
    cad = R_CAD.as_matrix()
    c_cad = cad.T @ (C - ORIGIN)
    I_cad = cad.T @ TRUE @ cad
    sym = (I_cad + I_cad.T) / 2
    at_origin = sym + steiner(c_cad)
    frame = f"frame: {{origin_m: {numbers(ORIGIN)}, rotation_vector_deg: {vector_deg(R_CAD)}}}"
    head = f"mass_kg: {M}\n    com_m: {numbers(c_cad)}\n    {frame}\n    "
    flipped = np.where(np.eye(3, dtype=bool), at_origin, -at_origin)
    return {
        "centre of mass": f"{head}inertia_kg_m2: {numbers(sym)}",
        "CAD origin": f"{head}inertia_kg_m2: {numbers(at_origin)}\n    inertia_about: {{point_m: [0, 0, 0]}}",
        "CAD origin, positive products": f"{head}inertia_kg_m2: {numbers(flipped)}\n    inertia_about: {{point_m: [0, 0, 0]}}\n    products: positive_integral",
        "principal axes": f"mass_kg: {M}\n    com_m: {numbers(C)}\n    inertia_kg_m2: {numbers(PRINCIPAL)}\n    inertia_about: {{rotation_vector_deg: {vector_deg(R_PRINCIPAL)}}}",
    }


@pytest.mark.parametrize("form", forms())
def test_all_CAD_notations_of_a_body_give_the_same_mass_centre_and_inertia(form):
    now = resolved(body(forms()[form]))
    assert now["mass"] == M
    assert now["com"] == pytest.approx(C, abs=1e-13)
    assert np.array(now["inertia"]) == pytest.approx(TRUE, abs=1e-12)


def test_payload_in_its_own_frame_is_rotated_and_moved():
    turn = "{origin_m: [0.3, 0, 0.2], rotation_vector_deg: [0, 90, 0]}"  # its z along platform x
    text = body(
        "mass_kg: 10\n    com_m: [0, 0, 0]\n    shape: {type: sphere, radius_m: 0.1}\n    payload:\n"
        f"      - {{mass_kg: 10, com_m: [0, 0, 0], shape: {{type: cylinder, radius_m: 0.05, length_m: 0.4}}, frame: {turn}}}"
    )
    now = resolved(text)
    assert now["com"] == pytest.approx([0.15, 0, 0.1])
    own = np.diag([10 * 0.05**2 / 2] + [10 * (3 * 0.05**2 + 0.4**2) / 12] * 2) + np.eye(3) * 0.4 * 10 * 0.1**2
    d = np.array([0.15, 0, 0.1])
    assert np.array(now["inertia"]) == pytest.approx(own + 20 * (d @ d * np.eye(3) - np.outer(d, d)))
    assert now["mass"] == 20


HEAD = "mass_kg: 10\n    com_m: [0, 0, 1]\n    "
BAD = [
    (HEAD + "inertia_kg_m2: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n    inertia_about: {point_m: [0, 0, 0]}", "[[1, 0", "platform.platform.inertia_kg_m2: got principal moments -9, -9, 1 kg m^2"),
    (HEAD + "payload: []", "mass_kg", "platform.platform: allowed: either inertia_kg_m2 or shape"),
    (HEAD + "shape: {type: box, size_mm: [1, 2, 3]}", "size_mm", "platform.platform.shape.size_mm: wrong unit: the key is size_m (in m)"),
    (HEAD + "shape: {type: point}", "{type: point}", "platform.platform.inertia_kg_m2: got [0.0, 0.0, 0.0], allowed is three principal moments > 0"),
    (HEAD + "shape: {type: sphere, radius_m: 1}\n    products: positive_integral", "mass_kg", "platform.platform: products has no meaning with shape"),
    (HEAD + "shape: {type: cylinder, radius_m: 1, length_m: 1, inner_radius_m: 1}", "{type", "platform.platform.shape: inner_radius_m leaves no wall"),
    (HEAD + "shape: {type: sphere, radius_m: 1}\n    payload:\n      - {mass_kg: 1, com_m: [0, 0, 0], inertia_kg_m2: [[1, 0, 0], [0, 1, 0], [0, 0, 9]]}", "[[1, 0, 0], [0, 1, 0], [0, 0, 9]]", "platform.platform.payload[0].inertia_kg_m2: got principal moments 1, 1, 9"),
]  # fmt: skip
BAD_CIRCLES = [
    ("{angles_deg: [0, 60, 120, 180, 240, 300]}", "platform.base_joints_m.radius_m: missing, allowed: a number greater than 0"),
    ("{radius_m: 2}", "platform.base_joints_m: allowed: either angles_deg or pair_centres_deg"),
    ("{radius_m: 2, pair_centres_deg: [0, 120, 240]}", "platform.base_joints_m: pair_centres_deg needs exactly one of pair_half_angle_deg and pair_spacing_m"),
    ("{radius_m: 2, angles_deg: [0, 60, 120, 180, 240, 300], pairs_begin: second_leg}", "platform.base_joints_m: angles_deg excludes keys of pairs"),
    ("{radius_m: 2, angles_deg: [0, 0, 0, 180, 180, 180]}", "platform.base_joints_m: got legs 0 and 1 with both joints in common"),
]  # fmt: skip


def located(whole, needle, message, after=""):
    """A text, the line of `needle` in it, and the expected message."""
    return whole, whole[: whole.index(needle, whole.index(after))].count("\n") + 1, message


WRONG = [located(body(text), needle, message, "\n  platform:") for text, needle, message in BAD]
WRONG += [
    located(section(VIRTUAL, "base_joints_m", f" {text}"), text, message) for text, message in BAD_CIRCLES
]


@pytest.mark.parametrize(("whole", "line", "message"), WRONG, ids=[message for *_, message in WRONG])
def test_invalid_platform_is_reported_with_its_line(whole, line, message):
    at, _, what = problem(whole).partition(": ")
    assert what.startswith(message)
    if not any(words in message for words in ("platform.platform: ", "moments > 0")):
        assert at.split(":")[1] == str(line)
