"""The map of reachable poses where the platform, or home itself, is turned: against statics and lengths by NumPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.robot.geometry import Platform
from hil.study.workspace import kernels
from hil.study.workspace.limits import KINDS, Limits, Surveyor
from hil.study.workspace.orientation import map_orientations, tilt_torsion
from tests.hil.study.test_workspace import BOOK, HOME, jacobian, lengths, light_legs, static_forces

TURNED = Rotation.from_rotvec([0.2, -0.15, 0.3]).as_matrix()
AT = (0.1, 0.2, 0.3)


def surveyor(limits, R, geometry=BOOK, **more):
    return Surveyor(Platform.from_dict(geometry), limits, HOME, R, **more)


def test_the_lever_of_a_payload_turns_with_the_platform():
    loaded = surveyor(Limits(0.3, 3.0), np.eye(3), light_legs(BOOK), payload=150.0, payload_at=AT)
    rng = np.random.default_rng(2)
    P = HOME + rng.uniform(-0.1, 0.1, (8, 3))
    R = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (8, 3))).as_matrix()
    found = loaded.survey(P, R)[:, kernels.FORCE : kernels.FORCE + 6]
    expected = [static_forces(loaded.platform, p, turn, 150.0, AT) for p, turn in zip(P, R, strict=True)]
    assert found == pytest.approx(np.array(expected), rel=1e-9)


@pytest.mark.parametrize("R", [np.eye(3), TURNED], ids=["upright", "turned"])
def test_home_holds_the_largest_payload_and_no_more_however_it_is_turned(R):
    loaded = surveyor(Limits(0.3, 3.0, force=20000.0), R, light_legs(BOOK), payload_at=AT)
    tau = static_forces(loaded.platform, HOME, R, loaded.largest_payload(), AT)
    assert np.abs(tau).max() == pytest.approx(20000.0, rel=1e-9)


def test_without_axes_of_its_own_every_joint_is_straight_at_a_turned_home():
    """And elsewhere the angle is that to the leg's direction at home, carried along by the base or the platform."""
    found = surveyor(Limits(0.3, 3.0), TURNED)
    home = jacobian(found.platform, HOME, TURNED)[:, :3]
    p, R = HOME + np.array([0.1, -0.05, 0.1]), Rotation.from_rotvec([-0.1, 0.2, 0.1]).as_matrix()
    s = jacobian(found.platform, p, R)[:, :3]
    for at, turn, legs in ((HOME, TURNED, home), (p, R, s)):
        figures = found.survey(at, turn)[0]
        base = (legs * home).sum(axis=1)
        platform = (legs * (home @ TURNED @ turn.T)).sum(axis=1)
        assert figures[kernels.BASE_COSINE : kernels.BASE_COSINE + 6] == pytest.approx(base, abs=1e-12)
        assert figures[kernels.PLATFORM_COSINE : kernels.PLATFORM_COSINE + 6] == pytest.approx(
            platform, abs=1e-12
        )
    assert base.max() < 1.0 - 1e-4


@pytest.mark.parametrize("turn", [0.12, -0.12])
def test_least_and_largest_torsion_of_a_home_that_is_turned_are_the_closed_form(turn):
    """Of the book platform, l^2 = 6 - 4 cos(30 deg + torsion), the ends stay where they are: home is nearer to one."""
    high = 2.18
    angle = np.arccos((6 - high**2) / 4) - np.deg2rad(30)
    R = Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix()
    found = map_orientations(surveyor(Limits(0.5, high), R), azimuths=4)
    assert found.torsion[[0, -1]] == pytest.approx([-angle - turn, angle - turn], abs=1e-9)
    assert [KINDS[k] for k in found.torsion_kinds] == ["stroke", "stroke"]


def test_tilt_and_torsion_are_taken_from_home_however_it_is_turned():
    """At each end of the map a leg is at an end of its stroke, and just before none is."""
    high = 2.18
    turned = surveyor(Limits(0.5, high), TURNED)
    found = map_orientations(turned, azimuths=8)
    count = 0
    n = len(found.torsion)
    for row in (n // 4, n // 2, 3 * n // 4):
        for k in np.flatnonzero(found.kinds[row] == KINDS.index("stroke")):
            for share, least, most in ((1.0, high - 1e-8, high + 1e-8), (0.97, 0.0, high - 1e-6)):
                given = [
                    np.array([x]) for x in (found.azimuth[k], share * found.tilt[row, k], found.torsion[row])
                ]
                R = TURNED @ tilt_torsion(*given)[0]
                assert least <= lengths(turned.platform, HOME[None], R).max() <= most
            count += 1
    assert count == 9, "the others end where det J = 0"
