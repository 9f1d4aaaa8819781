"""A payload known by ranges: its corners, and what model, check, safety and stability make of them."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect
from hil.app.check.silence import reacted_to
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.payload_box import corners
from hil.app.configuration.platform import build_platform, platform_body, pose_arrays
from hil.app.encoder_limits import encoder_limits
from hil.app.reachability import Walk
from hil.app.stability.command import judge
from hil.app.stability.subject import Stated, Subject
from hil.app.unknown_payload import UnknownPayload, unknown_payload
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from tests.loop import unrecorded

OWN = "    inertia_kg_m2: [[570, 0, 0], [0, 285, 0], [0, 0, 285]]   # about the centre of mass\n"
POINT = "mass_kg: 40, com_m: [0.05, 0, 0.2], shape: {type: point}"
BOX = POINT + ", mass_range_kg: [0, 80], com_range_m: [[-0.1, 0.2], [0, 0], [0.1, 0.3]]"
TENSOR = (
    "mass_kg: 100, com_m: [0.1, 0.2, 0.3], inertia_kg_m2: [[9, 1, 0], [1, 8, 2], [0, 2, 7]], "
    "products: positive_integral, frame: {origin_m: [0, 0.1, 0.4], rotation_vector_deg: [10, 20, 30]}, "
    "inertia_about: {rotation_vector_deg: [0, 0, 45]}"
)


def robot(payload="", *, name="virtual", changes=()):
    """Return a shipped configuration with this payload, as a flow mapping of YAML, or several."""
    text = load(name).text
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    if payload:
        bodies = [payload] if isinstance(payload, str) else payload
        text = text.replace(OWN, OWN + "    payload:\n" + "".join(f"      - {{{body}}}\n" for body in bodies))
    return loads(text, "carries.yaml", load(name).folder)


def carried(mass, x, y, z):
    return robot(f"mass_kg: {mass}, com_m: [{x}, {y}, {z}], shape: {{type: point}}" if mass else "")


CORNERS = [(0, 0, 0, 0), *((80, x, 0, z) for x in (-0.1, 0.2) for z in (0.1, 0.3))]


def test_each_corner_is_the_robot_with_that_payload():
    found = corners(robot(BOX).platform)
    assert found[0].words == "the model's payload"
    assert len(found) == 1 + len(CORNERS)
    for corner, stated in zip(found[1:], CORNERS, strict=True):
        body, expected = platform_body(corner.settings), platform_body(carried(*stated).platform)
        assert body.mass == expected.mass
        np.testing.assert_allclose(body.com, expected.com, atol=1e-15)
        np.testing.assert_allclose(body.inertia, expected.inertia, rtol=1e-14, atol=1e-12)
    assert found[1].words == "no payload"
    assert found[2].words == "80 kg at (-0.1, 0, 0.1) m"


@pytest.mark.long
def test_the_least_inertia_may_be_inside_the_box_and_is_looked_at():
    """More than the model has anywhere: Gamma is largest where the least mass rides next to the centre of mass."""
    heavy = (
        "mass_kg: 120, com_m: [0.2, 0.1, 0.2], shape: {type: point}, mass_range_kg: [60, 120], "
        "com_range_m: [[-0.3, 0.3], [-0.2, 0.2], [-0.1, 0.3]]"
    )
    c = robot(heavy)
    subject = Subject(c, Stated())
    x = np.array([0.0, 0.0, 0.0, 1.0, 0.3, 0.2])

    def energy(model):
        home = pose_arrays(c.platform.home)
        return float(x @ model.mass_matrix(*home) @ x)

    rng = np.random.default_rng(4)
    ranges = c.platform.platform.payload[0].com_range_m
    somewhere = [
        Model(build_platform(carried(60.0, *(float(rng.uniform(*r)) for r in ranges)).platform))
        for _ in range(200)
    ]
    least = min(map(energy, somewhere))
    at_corners = [
        Model(build_platform(carried(60.0, a, b, d).platform))
        for a in ranges[0]
        for b in ranges[1]
        for d in ranges[2]
    ]
    corner = min(map(energy, at_corners))
    assert least < corner
    assert min(map(energy, subject.robots)) - least < 0.1 * (corner - least)


def test_without_ranges_there_is_one_robot_and_nothing_unknown():
    c = robot(POINT)
    assert len(corners(c.platform)) == 1
    assert unknown_payload(c)[1:4] == (0.0, 0.0, 0.0)


def test_a_tensor_grows_with_the_mass_wherever_it_is_given():
    nominal = platform_body(robot(TENSOR).platform)
    half, double = (
        platform_body(corner.settings)
        for corner in corners(robot(f"{TENSOR}, mass_range_kg: [50, 200]").platform)[1:]
    )
    own = platform_body(robot().platform)
    np.testing.assert_allclose(2 * half.mass - own.mass, nominal.mass, rtol=1e-14)
    two = platform_body(robot([TENSOR, TENSOR]).platform)
    assert double.mass == two.mass
    np.testing.assert_allclose(double.com, two.com, rtol=1e-14)
    np.testing.assert_allclose(double.inertia, two.inertia, rtol=1e-13)


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (f"{POINT}, mass_range_kg: [50, 80]", "mass_kg lies outside its range, allowed: 50 to 80, given: 40"),
        (
            f"{POINT}, com_range_m: [[0, 1], [0, 0], [0, 0.1]]",
            "com_m lies outside its range, allowed: 0 to 0.1",
        ),
        (f"{POINT}, mass_range_kg: [80, 0]", "the lower end, then the upper one, given: 80, 0"),
        (f"{POINT}, mass_range_kg: [-1, 80]", "mass_range_kg"),
        ("mass_kg: 0, com_m: [0, 0, 0], shape: {type: point}", "mass_kg 0 needs shape and mass_range_kg"),
        ([f"{POINT}, mass_range_kg: [0, 80]"] * 2, "bodies 0, 1 have ranges, allowed: one body"),
    ],
)
def test_ranges_that_say_nothing_are_refused(payload, words):
    with pytest.raises(ConfigurationError, match="(?s)" + words.replace("(", r"\(").replace("[", r"\[")):
        robot(payload)


def test_a_range_of_no_width_is_none():
    assert len(corners(robot(f"{POINT}, mass_range_kg: [40, 40]").platform)) == 1


def test_a_payload_that_the_model_does_not_have_has_mass_zero():
    c = robot("mass_kg: 0, com_m: [0, 0, 0], shape: {type: point}, mass_range_kg: [0, 80]")
    body, own = platform_body(c.platform), platform_body(robot().platform)
    assert (body.mass, body.com.tolist(), body.inertia.tolist()) == (
        own.mass,
        own.com.tolist(),
        own.inertia.tolist(),
    )
    assert [corner.words for corner in corners(c.platform)[1:]] == ["80 kg at (0, 0, 0) m"]


@pytest.mark.long
def test_check_prints_the_forces_of_every_corner():
    figures = inspect(robot(BOX)).figures["payload"]
    alone = [inspect(carried(*stated)).figures for stated in CORNERS]
    assert figures["force_max_N"] == pytest.approx(
        max(f["reference"]["force_max_N"] for f in alone), rel=1e-9
    )
    assert figures["force_min_N"] == pytest.approx(
        min(f["reference"]["force_min_N"] for f in alone), rel=1e-9
    )
    static = np.array([f["home"]["static_forces_N"] for f in alone])
    assert figures["static_force_max_N"] == pytest.approx(static.max(), rel=1e-9)
    assert figures["static_force_min_N"] == pytest.approx(static.min(), rel=1e-9)


def test_check_refuses_a_payload_under_which_a_limit_breaks_and_says_which():
    peak = inspect(robot(POINT)).figures["reference"]["force_max_N"]
    limit = [(f"force_N: {load('virtual').limits.force_N:.0f}", f"force_N: {peak + 300:.0f}")]
    with pytest.raises(
        ConfigurationError, match=r"payload: with 80 kg at .* force above limits.force_N"
    ) as found:
        inspect(robot(BOX, changes=limit))
    assert "no payload" not in str(found.value)
    assert "narrow mass_range_kg" in str(found.value)
    assert str(found.value).count("limits.force_N") == 1, "one line for each limit"
    alone = []
    for stated in CORNERS[1:]:
        body = f"mass_kg: {stated[0]}, com_m: {list(stated[1:])}, shape: {{type: point}}"
        with pytest.raises(ConfigurationError, match=r"limits\.force_N") as one:
            inspect(robot(body, changes=limit))
        alone.append(float(str(one.value).split("at t = ")[1].split(" s")[0]))
    assert f"at t = {min(alone):.3f} s" in str(found.value)
    assert min(alone) < max(alone)


@pytest.mark.long
def test_what_breaks_a_bound_is_named():
    """Two tonnes that nobody told the law of; and of less, where the bound is largest."""
    heavy = POINT + ", mass_range_kg: [0, 2000], com_range_m: [[-0.1, 0.2], [0, 0], [0.1, 0.3]]"
    refused = judge(robot(heavy))
    assert refused.status == "not proven"
    assert ", with 2000 kg at (" in refused.claim
    lines = judge(robot(BOX)).lines
    assert any(line.startswith("disturbance") and ", with 80 kg at (" in line for line in lines)
    assert any(line.startswith("pushes") for line in lines)
    assert ", with" not in " ".join(judge(robot(POINT)).lines)


def test_safety_allows_for_what_the_payload_does_to_the_legs():
    """At home the forces for the model's payload move each other one: by forward dynamics of its robot."""
    c = robot(BOX)
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    tau = Model(build_platform(c.platform)).inverse_dynamics(*home, still, still)
    legs, twists = [], []
    for stated in CORNERS:
        platform = build_platform(carried(*stated).platform)
        twists.append(Model(platform).forward_dynamics(*home, still, tau))
        legs.append(jacobian(platform, *home) @ twists[-1])
    unknown = unknown_payload(c)
    assert unknown.leg == pytest.approx(np.abs(legs).max(), rel=1e-9)
    assert unknown.position == pytest.approx(np.abs(twists)[:, :3].max(), rel=1e-9)
    assert unknown.rotation == pytest.approx(np.abs(twists)[:, 3:].max(), rel=1e-9)
    limits, plain = encoder_limits(c, 1e3), encoder_limits(robot(POINT), 1e3)
    assert limits.disturbance_m_s2 == pytest.approx(plain.disturbance_m_s2 + unknown.leg)
    assert (limits.push_N > plain.push_N).all()
    lightest = encoder_limits(robot(), 1e3)
    assert (limits.mobility >= lightest.mobility * (1 - 1e-12)).all()


@pytest.mark.long
def test_the_bound_holds_for_every_corner_and_is_met_by_the_real_loop():
    c = robot(BOX, changes=[("periods: 10", "periods: 1")])
    verdict = judge(c)
    assert verdict.status == "conditional"
    bound = np.array(verdict.figures["ultimate_bound"])
    least, largest = verdict.figures["gamma_eigenvalues"]
    assert 0.9 < least < 1.0 < largest < 1.1
    ratios = []
    for stated in CORNERS:
        summary, rows = unrecorded.run(c, plant_of=carried(*stated))
        assert summary["success"], summary
        worst = np.abs(rows["q_d"] - rows["q"]).max(axis=0)
        assert (worst <= bound).all(), stated
        ratios.append((bound / worst).min())
    assert min(ratios) < 4.0


def test_a_run_starts_with_it():
    assert build_cycle(robot(BOX), 1e3, 0.01)


def test_a_leg_bears_what_the_heaviest_payload_asks_of_it_whether_it_pushes_or_pulls():
    """By the statics of each corner's robot at home; a platform that hangs pulls."""
    c = robot(BOX)
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    for gravity in ((0.0, 0.0, -9.81), (0.0, 0.0, 9.81), (20.0, 5.0, 0.0)):
        turned = c.platform.model_copy(update={"gravity_m_s2": gravity})
        held = []
        for stated in ((40, 0.05, 0, 0.2), *CORNERS):
            settings = carried(*stated).platform.model_copy(update={"gravity_m_s2": gravity})
            held.append(Model(build_platform(settings)).inverse_dynamics(*home, still, still))
        sizes = np.abs(held)
        found = unknown_payload(c.model_copy(update={"platform": turned})).holding_N
        np.testing.assert_allclose(found, sizes.max(axis=0), rtol=1e-9)
        assert (found > sizes[0]).any(), "more than the model's payload asks for"


def test_a_pose_is_allowed_what_the_payload_does_to_positions_and_to_rotations_each_its_own():
    monitor = robot().monitor.model_copy(update={"disturbance_m_s2": 10.0, "disturbance_rad_s2": 20.0})
    unknown = UnknownPayload(np.eye(6)[None], leg=1.0, position=2.0, rotation=3.0, holding_N=np.zeros(6))
    pose, legs = unknown.allowed_of_the_pose(monitor), unknown.allowed(monitor)
    assert (pose.disturbance_m_s2, pose.disturbance_rad_s2) == (12.0, 23.0)
    assert (legs.disturbance_m_s2, legs.disturbance_rad_s2) == (11.0, 20.0)


def test_after_silence_a_leg_falls_as_with_the_payload_that_falls_fastest():
    """On a walk at rest; legs have masses of their own, so what rides decides how fast a leg falls."""
    c = robot("mass_kg: 40, com_m: [0.05, 0, 0.2], shape: {type: point}, mass_range_kg: [0, 900]")
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    falls = []
    for mass in (40, 0, 900):
        platform = build_platform(carried(mass, 0.05, 0, 0.2).platform)
        twist = Model(platform).forward_dynamics(*home, still, still)
        falls.append(float(np.abs(jacobian(platform, *home) @ twist).max()))
    nothing, t = np.zeros((2, 6)), np.zeros(2)
    at_rest = Walk(t, nothing + 1.6, nothing, nothing, nothing, nothing, t, t, True, False)
    assert max(falls) > falls[0], "not the model's own"
    assert reacted_to(c, at_rest).a == pytest.approx(max(falls), rel=1e-9)


def test_the_place_of_least_inertia_is_looked_for_in_the_axes_of_the_payload():
    """A quarter turn about z of a frame at (0.1, 0.2, 0) m: the platform's own centre is (-0.2, 0.1, 0) m in it."""
    turned = (
        "mass_kg: 40, com_m: [0, 0, 0], shape: {type: point}, mass_range_kg: [20, 80], "
        "com_range_m: [[-1, 1], [-1, 1], [-1, 0.5]], "
        "frame: {origin_m: [0.1, 0.2, 0], rotation_vector_deg: [0, 0, 90]}"
    )
    ends = {(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 0.5)}
    places = [corner.settings.platform.payload[0].com_m for corner in corners(robot(turned).platform)[1:]]
    inner = [place for place in places if place not in ends]
    np.testing.assert_allclose(inner, [(-0.2, 0.1, 0.0)], atol=1e-12)
