"""Payload with ranges: its corners, and their effect on check, safety and stability."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from hil.app.check.command import inspect
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.payload_box import corners
from hil.app.configuration.platform import build_platform, platform_body, pose_arrays
from hil.app.derive_encoder_limits import encoder_limits
from hil.app.stability.command import judge
from hil.app.unknown_payload import unknown_payload
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from tests.hil.app.texts import edited
from tests.loop import bench

OWN = "    inertia_kg_m2: [[570, 0, 0], [0, 285, 0], [0, 0, 285]]   # about the centre of mass\n"
POINT = "mass_kg: 40, com_m: [0.05, 0, 0.2], shape: {type: point}"
BOX = POINT + ", mass_range_kg: [0, 80], com_range_m: [[-0.1, 0.2], [0, 0], [0.1, 0.3]]"


def robot(payload="", *, name="virtual", changes=()):
    """A shipped configuration with one or several payloads, each as a flow mapping of YAML."""
    text = edited(*changes, base=load(name).text)
    if payload:
        bodies = [payload] if isinstance(payload, str) else payload
        text = text.replace(OWN, OWN + "    payload:\n" + "".join(f"      - {{{body}}}\n" for body in bodies))
    return loads(text, "carries.yaml", load(name).folder)


def carried(mass, x, y, z):
    return robot(f"mass_kg: {mass}, com_m: [{x}, {y}, {z}], shape: {{type: point}}" if mass else "")


CORNERS = [(0, 0, 0, 0), *((80, x, 0, z) for x in (-0.1, 0.2) for z in (0.1, 0.3))]


def test_each_corner_of_a_payload_range_is_the_robot_with_that_payload():
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


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (f"{POINT}, mass_range_kg: [50, 80]", "mass_kg lies outside its range, allowed: 50 to 80, given: 40"),
        (
            f"{POINT}, com_range_m: [[0, 1], [0, 0], [0, 0.1]]",
            "com_m lies outside its range, allowed: 0 to 0.1",
        ),
        (f"{POINT}, mass_range_kg: [80, 0]", "the lower end first, then the upper end, given: 80, 0"),
        (f"{POINT}, mass_range_kg: [-1, 80]", "mass_range_kg"),
        ("mass_kg: 0, com_m: [0, 0, 0], shape: {type: point}", "mass_kg 0 needs shape and mass_range_kg"),
        ([f"{POINT}, mass_range_kg: [0, 80]"] * 2, "bodies 0, 1 have ranges, allowed: one body"),
    ],
)
def test_invalid_payload_ranges_are_refused(payload, words):
    with pytest.raises(ConfigurationError, match="(?s)" + words.replace("(", r"\(").replace("[", r"\[")):
        robot(payload)


def test_check_refuses_a_payload_range_that_violates_a_limit():
    peak = inspect(robot(POINT)).figures["reference"]["force_max_N"]
    limit = [(f"force_N: {load('virtual').limits.force_N:.0f}", f"force_N: {peak + 300:.0f}")]
    with pytest.raises(
        ConfigurationError, match=r"payload: with 80 kg at .* force above limits.force_N"
    ) as found:
        inspect(robot(BOX, changes=limit))
    assert "no payload" not in str(found.value)
    assert "narrow mass_range_kg" in str(found.value)
    assert str(found.value).count("limits.force_N") == 1, "one line for each limit"


def test_encoder_limits_include_the_leg_accelerations_of_every_payload_in_the_range():
    """Motion at home of robots with other payloads under the forces for the model's payload."""
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
def test_stability_bound_holds_in_closed_loop_for_every_corner_of_the_payload_range():
    c = robot(BOX, changes=[("periods: 10", "periods: 1")])
    verdict = judge(c)
    assert verdict.status == "conditional"
    bound = np.array(verdict.figures["ultimate_bound"])
    least, largest = verdict.figures["gamma_eigenvalues"]
    assert 0.9 < least < 1.0 < largest < 1.1
    ratios = []
    for stated in CORNERS:
        ran = bench.run(c, plant_of=carried(*stated))
        assert ran.ending.success, ran.ending
        worst = np.abs(ran.rows["q_d"] - ran.rows["q"]).max(axis=0)
        assert (worst <= bound).all(), stated
        ratios.append((bound / worst).min())
    assert min(ratios) < 4.0
