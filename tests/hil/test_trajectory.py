"""Trajectories of every kind: derivatives, ends, periods, tables, refusals, the book's path."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.spatial.transform import Rotation

from drivers.errors import ConfigurationError
from hil.config.reference import ReferenceSettings
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import HoldTrajectory, Trajectory
from hil.trajectory.stopping import StoppingTrajectory
from tests.live_reference import LIVE_REFERENCE

DATA = Path(__file__).parent.parent / "data"
HOME = Pose(position_m=(0.1, -0.2, 1.0), rotation_vector_deg=(3.0, -4.0, 5.0))
BOOK = json.loads((DATA / "book_platform.json").read_text())
KNOTS = BOOK["trajectory"]["knots"]
UNEVEN = [
    {"t": 1.0, "p": [0.0, 0.0, 1.0], "rotvec_deg": [0.0, 0.0, 0.0]},
    {"t": 2.0, "p": [0.1, -0.05, 1.1], "rotvec_deg": [5.0, 0.0, -10.0]},
    {"t": 3.0, "p": [0.05, 0.1, 1.0], "rotvec_deg": [0.0, 12.0, 3.0]},
    {"t": 5.0, "p": [0.0, 0.0, 0.9], "rotvec_deg": [1.0, 2.0, 3.0]},
]


def built(folder=DATA, **settings):
    model = TypeAdapter(ReferenceSettings).validate_python(settings)
    return build_trajectory(model, HOME, folder)


def waypoints(interpolation="quintic", periods=1, knots=KNOTS, **more):
    points = [{"t_s": k["t"], "position_m": k["p"], "rotation_vector_deg": k["rotvec_deg"]} for k in knots]
    return built(type="waypoints", interpolation=interpolation, points=points, periods=periods, **more)


def sinusoids(ramp_s=1.0, duration_s=5.0, parts=None, **more):
    parts = parts or [
        ("x_m", 0.1, 0.7, 0.3),
        ("y_m", 0.05, 1.3, 0.0),
        ("z_m", 0.03, 0.5, 1.0),
        ("rx_deg", 20.0, 0.9, 0.2),
        ("ry_deg", 35.0, 1.1, -0.5),
        ("rz_deg", 15.0, 0.4, 2.0),
        ("rz_deg", 5.0, 2.1, 0.0),
    ]
    components = [{"axis": a, "amplitude": s, "frequency_Hz": f, "phase_rad": p} for a, s, f, p in parts]
    return built(type="sinusoids", components=components, ramp_s=ramp_s, duration_s=duration_s, **more)


def multisine(**more):
    x = {"axis": "x_m", "band_Hz": (0.5, 3.0), "lines": 5, "amplitude": 0.05}
    rz = {
        "axis": "rz_deg",
        "band_Hz": (0.5, 3.0),
        "lines": 4,
        "amplitude": 6.0,
        "phases": "random",
        "seed": 3,
    }
    return built(type="multisine", axes=[x, rz], period_s=4.0, periods=2, ramp_s=1.5, **more)


def time_optimal(knots=UNEVEN, **more):
    limits = {
        "velocity_m_s": 0.2,
        "acceleration_m_s2": [1.0, 2.0, 0.8],
        "jerk_m_s3": 10,
        "velocity_deg_s": 20.0,
        "acceleration_deg_s2": 100.0,
        "jerk_deg_s3": 1000.0,
    }
    points = [{"position_m": k["p"], "rotation_vector_deg": k["rotvec_deg"]} for k in knots]
    return built(type="time_optimal", points=points, limits=limits, **more)


def sampled(**more):
    return built(type="sampled", path="path.csv", **more)


def hold(**more):
    return built(type="hold", **more)


def live(**more):
    return built(**LIVE_REFERENCE, **more)


def move():
    R0 = Rotation.from_rotvec([0.1, 0.2, -0.3]).as_matrix()
    R1 = Rotation.from_rotvec([-0.4, 0.5, 0.9]).as_matrix()
    return GeodesicMove(np.array([0.0, 0.1, 1.0]), R0, np.array([0.2, -0.1, 1.1]), R1, 1.7)


KINDS: dict[str, Any] = {
    "cubic way-points": lambda: waypoints("cubic"),
    "quintic way-points": waypoints,
    "minimum jerk": lambda: waypoints("minimum_jerk", 1, UNEVEN),
    "three periods": lambda: waypoints("quintic", 3),
    "for ever": lambda: waypoints("quintic", None),
    "time-optimal": time_optimal,
    "sinusoids": sinusoids,
    "multisine": multisine,
    "sampled": sampled,
    "move": move,
    "stop of way-points": lambda: StoppingTrajectory(waypoints(), 0.4, 0.9),
    "stop of sinusoids": lambda: StoppingTrajectory(sinusoids(), 2.0, 0.7),
}


def richardson(f, t, h):
    """Derivative of f at t from central differences with steps h and h/2: error O(h^4)."""
    coarse = (f(t + h) - f(t - h)) / (2 * h)
    fine = (f(t + h / 2) - f(t - h / 2)) / h
    return (4 * fine - coarse) / 3


def turned_from(trajectory, R):
    """Rotation vector (3,), base frame, from R to the trajectory's attitude, as a function of time."""
    back = Rotation.from_matrix(R).inv()
    return lambda t: (Rotation.from_matrix(trajectory.sample(t).R) * back).as_rotvec()


def jerk_jumps(trajectory, t, h):
    """True if the third derivative changes between t - 2 h and t + 2 h."""
    a = np.array([trajectory.sample(t + k * h).dtwist[:3] for k in (-2, -1, 0, 1, 2)])
    return np.abs(np.diff(a, n=2, axis=0)).max() > 1e-9


def rests_at(sample, end):
    np.testing.assert_array_equal(sample.p, end.p)
    np.testing.assert_array_equal(sample.R, end.R)
    assert not sample.twist.any()
    assert not sample.dtwist.any()


def test_textbook_trajectory_is_reproduced_at_all_41_states():
    trajectory = waypoints("cubic")
    assert len(BOOK["states"]) == 41
    for state in BOOK["states"]:
        p, R, twist, dtwist = trajectory.sample(state["t"])
        np.testing.assert_allclose(p, state["p"], rtol=0, atol=1e-9)
        np.testing.assert_allclose(R, Rotation.from_rotvec(state["rotvec"]).as_matrix(), rtol=0, atol=1e-9)
        np.testing.assert_allclose(twist, [*state["v"], *state["omega"]], rtol=0, atol=1e-9)
        np.testing.assert_allclose(dtwist, [*state["a"], *state["alpha"]], rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_twist_and_its_rate_agree_with_derivatives_of_the_pose(kind):
    trajectory: Trajectory = KINDS[kind]()
    h = 1e-3
    end = trajectory.duration_s or 2.0
    moved = 0.0
    rows = np.loadtxt(DATA / "path.csv", delimiter=",", skiprows=1)[:, 0]
    jumps = [*range(7), *rows]  # of higher derivatives
    for t in np.linspace(0.013, end - 0.013, 37):
        if kind == "time-optimal" and jerk_jumps(trajectory, t, h):
            continue
        if min(abs(t - jump) for jump in jumps) < 2 * h:
            continue
        here = trajectory.sample(t)
        assert all(x.dtype == np.float64 and x.flags.c_contiguous for x in here), "types of compiled code"
        moved = max(moved, np.abs(here.twist).max())
        v = richardson(lambda s: trajectory.sample(s).p, t, h)
        omega = richardson(turned_from(trajectory, here.R), t, h)
        np.testing.assert_allclose(here.twist, np.r_[v, omega], rtol=0, atol=3e-8)
        rate = richardson(lambda s: trajectory.sample(s).twist, t, h)
        np.testing.assert_allclose(here.dtwist, rate, rtol=0, atol=3e-7)
        np.testing.assert_allclose(here.R @ here.R.T, np.eye(3), rtol=0, atol=1e-14)
    assert moved > 0.1


@pytest.mark.parametrize("kind", [*KINDS, "waves without ramps"])
def test_outside_its_time_a_trajectory_rests_at_its_ends(kind):
    trajectory = sinusoids(ramp_s=0.0) if kind == "waves without ramps" else KINDS[kind]()
    first = trajectory.sample(0.0)
    for t in (-5e-324, -1.0):
        rests_at(trajectory.sample(t), first)
    ends = [first]
    if trajectory.duration_s is not None:
        last = trajectory.sample(trajectory.duration_s)
        for t in (np.nextafter(trajectory.duration_s, 99.0), trajectory.duration_s + 5.0):
            np.testing.assert_allclose(trajectory.sample(t).p, last.p, rtol=0, atol=1e-15)
            rests_at(trajectory.sample(t), trajectory.sample(trajectory.duration_s + 1.0))
        ends.append(last)
    for end in ends:
        assert (np.abs(end.twist).max() < 1e-12) == (kind != "waves without ramps")


@pytest.mark.parametrize(
    "pose", [{"position_m": (-0.05, 0.15, 1.2), "rotation_vector_deg": (-6, 2, 8)}, None]
)
@pytest.mark.parametrize(
    ("kind", "name"), [(hold, "pose"), (sinusoids, "centre"), (multisine, "centre"), (live, "start")]
)
def test_a_reference_begins_at_the_pose_of_its_settings_or_at_home(kind, name, pose):
    sample = kind(**({} if pose is None else {name: pose})).sample(0.0)
    expected = Pose.model_validate(pose or HOME)
    np.testing.assert_allclose(sample.p, expected.position_m, atol=1e-15)
    turn = Rotation.from_matrix(sample.R).as_rotvec(degrees=True)
    np.testing.assert_allclose(turn, expected.rotation_vector_deg, atol=1e-9)


def test_hold_keeps_a_measured_pose_to_the_bit():
    p, R = np.array([0.1, 0.2, 0.3]), Rotation.from_rotvec([0.3, 0.2, 0.1]).as_matrix()
    kept = HoldTrajectory(p.copy(), np.asfortranarray(R)).sample(4.0)
    assert kept.p.tobytes() == p.tobytes()
    assert kept.R.tobytes() == R.tobytes()
    rests_at(kept, kept)
    assert (hold(duration_s=2.0).duration_s, hold().duration_s) == (2.0, None)


def test_quintic_segments_have_no_acceleration_at_their_ends_and_cubic_have():
    quintic, cubic = waypoints("quintic"), waypoints("cubic")
    for t in (0.0, 1.0, 2.0):
        np.testing.assert_allclose(quintic.sample(t).dtwist, 0, atol=1e-12)
        assert np.abs(cubic.sample(t).dtwist[:3]).max() == pytest.approx(3.0)  # 6 x 0.5 m / (1 s)^2


def test_setting_periods_repeats_the_list_of_way_points():
    once, thrice, endless = waypoints("cubic"), waypoints("cubic", 3), waypoints("cubic", None)
    assert (once.duration_s, thrice.duration_s, endless.duration_s) == (2.0, 6.0, None)
    for t in (0.0, 0.25, 1.0, 1.75):
        for k in (0, 1, 2):
            for trajectory in (thrice, endless):
                for a, b in zip(once.sample(t), trajectory.sample(t + 2.0 * k), strict=True):
                    np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)
    assert np.abs(endless.sample(2.0e4 + 0.5).twist).max() == pytest.approx(0.75, abs=1e-9)


@pytest.mark.parametrize("interpolation", ["cubic", "minimum_jerk"])
def test_before_a_late_first_point_the_platform_waits_there(interpolation):
    late = waypoints(interpolation, 1, [dict(k, t=k["t"] + 1.5) for k in KNOTS])
    assert late.duration_s == 3.5
    np.testing.assert_array_equal(late.sample(1.49).p, KNOTS[0]["p"])
    assert not late.sample(1.49).twist.any()
    expected = waypoints(interpolation).sample(0.5).twist
    np.testing.assert_allclose(late.sample(2.0).twist, expected, rtol=0, atol=1e-13)


TURNED = {"position_m": (0.0, 0.0, 1.0), "rotation_vector_deg": (0.0, -165.0, 0.0)}


def knots(index, **change):
    return [dict(k, **(change if i == index else {})) for i, k in enumerate(KNOTS)]


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: waypoints(knots=knots(2, t=1.0)), r"points\[2\].t_s: .* not after"),
        (lambda: waypoints(periods=2, knots=knots(2, p=[0, 0, 1.001])), "periods is 2, .* 0.001 m or rad"),
        (lambda: waypoints(periods=None, knots=knots(2, p=[0, 0, 0.999])), "0.001 m or rad"),
        (lambda: waypoints(knots=knots(1, rotvec_deg=[0, -180.001, 0])), "points.1.*\n.*at most 180 deg"),
        (lambda: time_optimal([UNEVEN[0], UNEVEN[0]]), r"points\[1\]: the same pose"),
        (lambda: time_optimal(periods=2), "periods is 2"),
        (lambda: sinusoids(ramp_s=1.5, duration_s=2.0), "ramp_s: .* at most 1 s"),
        (lambda: sinusoids(parts=[("rx_deg", 190.0, 1.0, 0.0)]), "at most 180 deg"),
        (lambda: sinusoids(parts=[("ry_deg", -20.0, 1.0, 0.0)], centre=TURNED), "at most 180 deg"),
        (lambda: sampled(folder=None), "reference.path: path.csv"),
    ],
)
def test_settings_without_a_valid_path_are_refused(build, words):
    with pytest.raises((ConfigurationError, ValidationError), match=words):
        build()


def test_settings_just_inside_the_limits_are_accepted():
    assert sinusoids(ramp_s=1.0, duration_s=2.0).duration_s == 2.0
    assert sinusoids(parts=[("ry_deg", -14.9, 1.0, 0.0)], centre=TURNED).duration_s == 5.0
    assert waypoints(periods=2, knots=knots(2, p=[0, 0, KNOTS[0]["p"][2] + 9e-10])).duration_s == 4.0
    half = {"position_m": (0.0, 0.0, 1.0), "rotation_vector_deg": (0.0, -180.0, 0.0)}
    np.testing.assert_allclose(hold(pose=half).sample(0.0).R, np.diag([-1.0, 1.0, -1.0]), atol=1e-15)


def test_sinusoids_follow_the_closed_form_between_their_ramps():
    eased, hard = sinusoids(), sinusoids(ramp_s=0.0)
    waves = [
        0.1 * np.sin(2 * np.pi * 0.7 * 2.5 + 0.3),
        0.05 * np.sin(2 * np.pi * 1.3 * 2.5),
        0.03 * np.sin(2 * np.pi * 0.5 * 2.5 + 1.0),
    ]
    np.testing.assert_allclose(eased.sample(2.5).p, np.add(HOME.position_m, waves), rtol=0, atol=1e-14)
    assert hard.sample(0.0).twist[0] == pytest.approx(0.1 * 2 * np.pi * 0.7 * np.cos(0.3))
    for t in (0.5, 4.5):
        half = HOME.position_m + 0.5 * (hard.sample(t).p - HOME.position_m)
        np.testing.assert_allclose(eased.sample(t).p, half, rtol=0, atol=1e-15)
    for t in (0.0, 5.0):
        np.testing.assert_allclose(eased.sample(t).p, HOME.position_m, rtol=0, atol=1e-15)
        np.testing.assert_allclose(eased.sample(t).dtwist, 0, atol=1e-12)


def test_a_move_goes_from_pose_to_pose_by_the_shortest_rotation():
    m = move()
    p, R, twist, _ = m.sample(0.85)
    np.testing.assert_allclose(p, [0.1, 0.0, 1.05], rtol=0, atol=1e-15)
    start, end = Rotation.from_matrix(m.sample(0.0).R), Rotation.from_matrix(m.sample(1.7).R)
    np.testing.assert_allclose(start.as_rotvec(), [0.1, 0.2, -0.3], rtol=0, atol=1e-14)
    np.testing.assert_allclose(end.as_rotvec(), [-0.4, 0.5, 0.9], rtol=0, atol=1e-14)
    turn = (end * start.inv()).as_rotvec()
    half = (Rotation.from_matrix(R) * start.inv()).as_rotvec()
    np.testing.assert_allclose(half, turn / 2, rtol=0, atol=1e-14)
    np.testing.assert_allclose(twist[3:], turn * 1.875 / 1.7, rtol=0, atol=1e-13)
    for t in (0.0, 1.7):
        np.testing.assert_allclose(m.sample(t).dtwist, 0, atol=1e-13)
    assert m.travel_m(0.7) == pytest.approx(0.3 + 0.7 * np.linalg.norm(turn))


def test_a_stop_is_continuous_stays_on_the_path_and_comes_to_rest():
    path = waypoints("quintic", None)
    stop = StoppingTrajectory(path, 0.4, 0.9)
    assert stop.duration_s == pytest.approx(1.3)
    for t in (0.1, 0.4):
        for a, b in zip(stop.sample(t), path.sample(t), strict=True):
            np.testing.assert_array_equal(a, b)
    just_after = stop.sample(0.4 + 1e-9)
    np.testing.assert_allclose(just_after.twist, path.sample(0.4).twist, atol=1e-7)
    np.testing.assert_allclose(just_after.dtwist, path.sample(0.4).dtwist, atol=1e-6)
    rest = path.sample(0.4 + 0.45)
    for t in (1.3, 1.4, 100.0):
        np.testing.assert_allclose(stop.sample(t).p, rest.p, rtol=0, atol=1e-15)
        rests_at(stop.sample(t), stop.sample(1.3))
    a, b = np.array(KNOTS[0]["p"]), np.array(KNOTS[1]["p"])
    line = (b - a) / np.linalg.norm(b - a)
    for t in np.linspace(0, 1.3, 27):
        offset = stop.sample(t).p - a
        np.testing.assert_allclose(offset, (offset @ line) * line, rtol=0, atol=1e-15)
    near_the_end = StoppingTrajectory(waypoints(), 1.9, 2.0)
    np.testing.assert_allclose(near_the_end.sample(3.9).p, KNOTS[2]["p"], atol=1e-15)
