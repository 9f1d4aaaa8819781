"""The map of reachable poses against closed forms, quasi Monte Carlo and NumPy's own linear algebra."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize_scalar
from scipy.spatial.transform import Rotation
from scipy.stats import qmc

from hil.robot.geometry import Platform
from hil.study.workspace.limits import KINDS, Limits, Surveyor, WorkspaceError
from hil.study.workspace.orientation import map_orientations, tilt_torsion
from hil.study.workspace.position import PLANES, cut, map_positions
from hil.study.workspace.shapes import largest_cylinder, largest_sphere

BOOK = json.loads((Path(__file__).parents[2] / "data/book_platform.json").read_text())["geometry"]
HOME = np.array([0.0, 0.0, 1.0])
UPRIGHT = np.eye(3)
TURNED = Rotation.from_rotvec([0.2, -0.15, 0.3]).as_matrix()
AT = (0.1, 0.2, 0.3)
NO_MASS = {"mass": 0.0, "com": 0.0, "inertia_axial": 0.0, "inertia_transverse": 0.0}


def light_legs(geometry):
    """The same platform with massless legs, for statics in closed form."""
    return {**geometry, "cylinder": NO_MASS, "rod": NO_MASS}


# Six legs in three parallel pairs, so that each pair holds the platform's origin in one shell about C_k. The
# legs are as long as 1 m; det J is proportional to z^3 (three shells' normals times three couples).
D, E, REACH = 0.6, 0.2, 1.0
CENTRES = np.array([[-D, 0, 0], [D, 0, 0], [0, E, 0]])
OFFSETS = np.array(
    [[-0.3, 0.1, 0], [-0.3, -0.1, 0], [0.3, 0.1, 0], [0.3, -0.1, 0], [0.1, 0.3, 0], [-0.1, 0.3, 0]]
)
PAIRS = light_legs({**BOOK, "base_joints": OFFSETS + CENTRES.repeat(2, 0), "platform_joints": OFFSETS})
PAIRS_HOME = np.array([0.0, 0.0, 0.4])
HALF_LENS = np.pi * (4 * REACH + 2 * D) * (2 * REACH - 2 * D) ** 2 / 12 / 2
"""Two unit spheres 1.2 m apart (the third contains their intersection), cut at z = 0 where det J = 0."""


@pytest.fixture(scope="module")
def pairs():
    return Surveyor(Platform.from_dict(PAIRS), Limits(1e-3, REACH), PAIRS_HOME, UPRIGHT)


@pytest.fixture(scope="module")
def half_lens(pairs):
    return map_positions(pairs, 32)


def jacobian(platform, p, R):
    r = platform.platform_joints @ R.T
    d = p + r - platform.base_joints
    s = d / np.linalg.norm(d, axis=1)[:, None]
    return np.hstack([s, np.cross(r, s)])


def lengths(platform, P, R=UPRIGHT):
    return np.linalg.norm(P[:, None] + platform.platform_joints @ R.T - platform.base_joints, axis=2)


def static_forces(platform, p, R, payload=0.0, at=(0.0, 0.0, 0.0)):
    """Statics with massless legs: J^T tau supports the weights of platform and payload."""
    up, load = -platform.platform.mass * platform.gravity, -payload * platform.gravity
    moment = np.cross(R @ platform.platform.com, up) + np.cross(R @ np.array(at), load)
    return np.linalg.solve(jacobian(platform, p, R).T, np.concatenate([up + load, moment]))


def test_workspace_volume_of_half_a_lens_of_two_spheres_agrees_with_the_closed_form(half_lens):
    assert half_lens.volume == pytest.approx(HALF_LENS, rel=1e-2)
    assert abs(half_lens.volume - HALF_LENS) <= half_lens.volume_error


def test_workspace_extents_of_half_a_lens_of_two_spheres_agree_with_the_closed_form(half_lens):
    rim = np.sqrt(REACH**2 - D**2)
    assert half_lens.extents == pytest.approx(np.array([[D - 1, 1 - D], [-rim, rim], [0, rim]]), abs=5e-3)


def test_workspace_map_does_not_continue_beyond_a_singularity(pairs, half_lens):
    mirrored = half_lens.nodes * [1, 1, -1]
    q = lengths(pairs.platform, mirrored)
    assert ((q > 1e-3) & (q < REACH)).all()
    assert (half_lens.nodes[:, 2] > 0).all()
    at_plane = half_lens.points[half_lens.kinds == KINDS.index("singularity")]
    assert len(at_plane) > 100
    assert np.abs(at_plane[:, 2]).max() < 1e-3
    beyond = pairs.p[2] + half_lens.flood.axes[2] < -half_lens.step
    assert beyond.any()  # the grid goes on there


def test_the_largest_sphere_agrees_with_the_closed_form(pairs):
    sphere = largest_sphere(pairs, 0.02, 1.0)
    assert sphere.radius == pytest.approx(REACH - np.hypot(D, PAIRS_HOME[2]), abs=1e-6)
    assert KINDS[sphere.kind] == "stroke"


def test_the_largest_cylinder_nearly_agrees_with_the_closed_form(pairs):
    # Radius r about z, from the singular plane to the edge of the lens: (r + d)^2 + z^2 = 1.
    best = minimize_scalar(
        lambda r: -np.pi * r**2 * np.sqrt(1 - (r + D) ** 2), bounds=(0, 1 - D), method="bounded"
    )
    cylinder = largest_cylinder(pairs, 0.02, 1.0)
    assert 0.95 * -best.fun < cylinder.volume <= -best.fun * (1 + 1e-6)
    assert cylinder.radius <= np.sqrt(1 - (cylinder.high + PAIRS_HOME[2]) ** 2) - D + 1e-6


def book(limits, geometry=BOOK, R=UPRIGHT, **more):
    return Surveyor(Platform.from_dict(geometry), limits, HOME, R, **more)


def boundary(surveyor, kind, resolution=12):
    """Points of the boundary at one kind of limit."""
    mapped = map_positions(surveyor, resolution)
    met = mapped.points[mapped.kinds == KINDS.index(kind)]
    assert len(met) > 10
    return met


def test_workspace_volume_of_six_shells_agrees_with_quasi_monte_carlo():
    low, high = 1.1, 1.9
    surveyor = book(Limits(low, high))
    mapped = map_positions(surveyor, 40)
    corner, far = np.array([-1.3, -1.3, 0.0]), np.array([1.3, 1.3, 1.9])
    P = corner + (far - corner) * qmc.Sobol(3, seed=1).random_base2(17)
    q = lengths(surveyor.platform, P)
    good = ((q > low) & (q < high)).all(axis=1)
    some = P[good][::50]
    assert len({np.sign(np.linalg.det(jacobian(surveyor.platform, p, UPRIGHT))) for p in some}) == 1
    assert mapped.volume == pytest.approx(good.mean() * np.prod(far - corner), rel=4e-3)


def test_a_leg_is_exactly_at_its_end_on_a_stroke_boundary():
    low, high = 1.1, 1.9
    surveyor = book(Limits(low, high))
    met = boundary(surveyor, "stroke", 16)
    q = lengths(surveyor.platform, met)
    assert np.abs(np.minimum(np.abs(q - low), np.abs(high - q)).min(axis=1)).max() < 1e-9
    assert (q > low - 1e-12).all()
    assert (q < high + 1e-12).all()


@pytest.mark.parametrize("turn", [0.0, 0.12, -0.12])
def test_torsion_and_tilt_of_the_book_platform_agree_with_closed_forms(turn):
    """The range stays when home is rotated, so home is nearer to one end.

    Joints at radius 2 and 1, 30 degrees apart, 1 m above: l^2 = 6 - 4 cos(30 deg + torsion). Leaning towards
    +y lowers no joint at first: l^2 = 6 - 4 cos(30 deg + tilt) for the legs at (0, -1, 0).
    """
    high, R = 2.18, Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix()
    found = map_orientations(book(Limits(0.5, high), R=R))
    angle = np.arccos((6 - high**2) / 4) - np.deg2rad(30)
    assert found.torsion[[0, -1]] == pytest.approx([-angle - turn, angle - turn], abs=1e-9)
    assert [KINDS[k] for k in found.torsion_kinds] == ["stroke", "stroke"]
    if not turn:
        assert found.level[18] == pytest.approx(angle, abs=1e-9), "tilt towards an azimuth of 90 degrees"
        assert found.guaranteed[0] == pytest.approx(0, abs=1e-6)


def test_a_leg_force_is_exactly_at_its_limit_on_a_force_boundary():
    limit, payload, at = 6000.0, 150.0, (0.2, -0.1, 0.3)
    surveyor = book(Limits(0.3, 3.0, force=limit), light_legs(BOOK), payload=payload, payload_at=at)
    met = boundary(surveyor, "force")
    for p in met[::5]:
        tau = static_forces(surveyor.platform, p, UPRIGHT, payload, at)
        assert np.abs(tau).max() == pytest.approx(limit, rel=1e-6)


def test_a_joint_is_exactly_at_its_largest_angle_on_a_joint_boundary():
    base_limit, platform_limit = np.deg2rad([18.0, 19.0])
    platform = Platform.from_dict(BOOK)
    home = jacobian(platform, HOME, UPRIGHT)[:, :3]
    unit = Rotation.from_rotvec([0.05, 0.1, 0.0]).apply(home)
    limits = Limits(0.5, 3.0, base_angle=base_limit, platform_angle=platform_limit)
    met = boundary(book(limits, base_axes=3.0 * unit), "joint angle")
    for p in met[::7]:
        s = jacobian(platform, p, UPRIGHT)[:, :3]
        base = np.arccos((s * unit).sum(axis=1)).max() - base_limit
        other = np.arccos((s * home).sum(axis=1)).max() - platform_limit
        assert max(base, other) == pytest.approx(0, abs=1e-8)


def test_platform_joint_axes_rotate_with_the_platform():
    limit = np.deg2rad(20.0)
    surveyor = book(Limits(0.1, 5.0, platform_angle=limit))
    orientations = map_orientations(surveyor)
    home = jacobian(surveyor.platform, HOME, UPRIGHT)[:, :3]
    R = tilt_torsion(np.array([orientations.azimuth[24]]), orientations.level[24:25], np.zeros(1))[0]
    s = jacobian(surveyor.platform, HOME, R)[:, :3]
    assert KINDS[orientations.kinds[len(orientations.torsion) // 2, 24]] == "joint angle"
    assert np.arccos((s * (home @ R.T)).sum(axis=1)).max() == pytest.approx(limit, abs=1e-8)


def test_workspace_dexterity_agrees_with_numpy():
    surveyor = book(Limits(0.3, 3.0))
    rng = np.random.default_rng(3)
    P = HOME + rng.uniform(-0.3, 0.3, (40, 3))
    R = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (40, 3))).as_matrix()
    radius = np.linalg.norm(surveyor.platform.platform_joints, axis=1).mean()
    condition, least = surveyor.dexterity(P, R)
    for k in range(40):
        J = jacobian(surveyor.platform, P[k], R[k]) / [1, 1, 1, radius, radius, radius]
        assert condition[k] == pytest.approx(np.linalg.cond(J), rel=1e-9)
        assert least[k] == pytest.approx(1 / np.linalg.norm(np.linalg.inv(J), 2), rel=1e-9)


def test_workspace_boundary_at_singularities_is_the_configured_condition_limit():
    surveyor = book(Limits(0.3, 3.0, condition=6.0))
    met = boundary(surveyor, "singularity")
    numbers = np.array([np.linalg.cond(jacobian(surveyor.platform, p, UPRIGHT)) for p in met])
    assert (numbers <= 6.0).all()  # radius 1 m; the bound lies up to a quarter above the number
    assert (numbers >= 6.0 / 1.2511).all()


def test_two_legs_are_a_diameter_apart_on_an_interference_boundary():
    diameter = 1.5  # the book's legs are 1.73 m apart at home, but for those that share a joint
    surveyor = book(Limits(0.6, 2.2, leg_diameter=diameter))
    met = boundary(surveyor, "interference")
    a, b = surveyor.platform.base_joints, surveyor.platform.platform_joints
    for p in met[::5]:
        d = p + b - a
        gaps = []
        for i in range(6):
            for j in range(i):
                if np.linalg.norm(b[i] - b[j]) > 0:
                    found = lsq_linear(np.stack([d[i], -d[j]], axis=1), a[j] - a[i], (0, 1), tol=1e-14)
                    gaps.append(np.sqrt(2 * found.cost))
        assert min(gaps) == pytest.approx(diameter, abs=1e-6)


def test_a_section_has_the_nodes_of_its_plane_and_boundary_points():
    surveyor = book(Limits(0.77, 2.18, force=25000.0, condition=50.0))
    mapped = map_positions(surveyor, 16)
    for plane in PLANES:
        section = cut(surveyor, mapped, plane)
        u, v = ("xyz".index(name) for name in plane)
        mine = mapped.nodes[np.abs(mapped.nodes[:, 3 - u - v] - HOME[3 - u - v]) < 1e-9]
        i = np.abs(section.u[None] - mine[:, u, None]).argmin(axis=1)
        j = np.abs(section.v[None] - mine[:, v, None]).argmin(axis=1)
        assert np.isfinite(section.condition).sum() == len(mine) > 50
        for k in (7, 23):
            expected = np.linalg.cond(jacobian(surveyor.platform, mine[k], UPRIGHT))
            assert section.condition[i[k], j[k]] == pytest.approx(expected, rel=1e-9)
        P = np.full((len(section.points), 3), HOME)
        P[:, [u, v]] = section.points
        assert len(P) > 20
        assert surveyor.inside(P, UPRIGHT).all()
        assert not surveyor.inside(HOME + (P - HOME) * (1 + 1e-6), UPRIGHT).all()


OUTSIDE = [
    (Limits(1.6, 2.0), "leg lengths 1.5925 to 1.5925 m (allowed 1.6 to 2)"),  # sqrt(6 - 4 cos 30 deg)
    (Limits(1.0, 2.0, force=2000.0), "N (allowed 2000)"),
    (Limits(1.0, 2.0, condition=2.0), "condition of J"),
    (Limits(1.0, 2.0, base_angle=np.deg2rad(30)), "base joint up to 51.10 deg"),  # acos(1 / 1.5925)
]


@pytest.mark.parametrize(("limits", "message"), OUTSIDE)
def test_home_outside_a_limit_is_refused_with_value_and_limit(limits, message):
    upwards = np.tile([0.0, 0.0, 1.0], (6, 1))
    book(Limits(1.0, 2.0, 20000.0, 3.0, np.deg2rad(52)), base_axes=upwards)
    with pytest.raises(WorkspaceError, match=re.escape(message)) as caught:
        book(limits, base_axes=upwards)
    assert str(caught.value).count("allowed") <= 2, "the other limits are kept"


def test_orientations_at_an_unreachable_position_are_refused(pairs, half_lens):
    with pytest.raises(WorkspaceError, match="not reached from home: the straight line meets the limit sing"):
        map_orientations(pairs, (0.0, 0.0, -0.4), half_lens)


@pytest.mark.parametrize("R", [UPRIGHT, TURNED], ids=["upright", "turned"])
def test_home_supports_exactly_the_largest_payload_at_any_rotation(R):
    loaded = book(Limits(0.3, 3.0, force=20000.0), light_legs(BOOK), R, payload_at=AT)
    tau = static_forces(loaded.platform, HOME, R, loaded.largest_payload(), AT)
    assert np.abs(tau).max() == pytest.approx(20000.0, rel=1e-9)
