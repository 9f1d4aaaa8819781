"""What `hil check` says of operating: a change of speed against the limits, the key against those who hold it."""

import re

import numpy as np
import pytest

from hil.app.check.command import inspect
from hil.app.check.operating import PAGE_REPEAT_S, _beyond, _jogged, _key, jog_demand, speed_change
from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.app.operate import REPEAT_S
from hil.app.reachability import span_s, walk
from hil.app.watch.command import assets
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from hil.control.uncertainty import UncertaintySettings
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.build import build_trajectory
from hil.trajectory.override import Override

pytestmark = pytest.mark.usefixtures("unproven")

RATE_Hz = 1000.0


def parts(c):
    platform = build_platform(c.platform)
    model = Model(platform, leg_spin=c.platform.leg_spin)
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    w = walk(platform, model, trajectory, span_s(trajectory), 1.0 / c.loop.rate_Hz, c.plant)
    return platform, model, trajectory, w


@pytest.fixture(scope="module")
def virtual():
    c = load("virtual")
    platform, model, trajectory, w = parts(c)
    return c, platform, model, trajectory, w, speed_change(c, w, trajectory, model, span_s(trajectory))


def stopped(c, model, trajectory, at_s, up=False):
    """Force (n, 6) and leg acceleration (n, 6) of the rigid body while the speed changes, from the override itself."""
    override, period = Override(1.0 / RATE_Hz, c.engage.stop_s), 1.0 / RATE_Hz
    override.place(0, at_s) if up else override.settle(0, 1.0)
    if not up:
        override.record["s"] = at_s
    override.aim(0, 1.0 if up else 0.0)
    forces, rates, still = [], [], np.zeros(6)
    for tick in range(round(1.2 * c.engage.stop_s * RATE_Hz)):
        override.advance(tick)
        s = trajectory.sample(override.time(tick))
        sigma, dsigma = override.sigma, override.dsigma
        twist, dtwist = sigma * s.twist, sigma**2 * s.dtwist + dsigma * s.twist
        forces.append(model.inverse_dynamics(s.p, s.R, twist, dtwist, still))
        a, b = model.platform.base_joints, model.platform.platform_joints
        legs = s.p + b @ s.R.T - a
        n = legs / np.linalg.norm(legs, axis=1)[:, None]
        rates.append((n * (twist[:3] + np.cross(twist[3:], b @ s.R.T))).sum(axis=1))
    return np.array(forces), np.diff(rates, axis=0) / period


@pytest.mark.parametrize("up", [False, True])
def test_no_hold_and_no_start_on_the_path_is_beyond_what_is_said_and_the_worst_is_near_it(virtual, up):
    c, _, model, trajectory, w, said = virtual
    fastest = float(w.t[np.abs(w.dq).max(axis=1).argmax()])
    found = [stopped(c, model, trajectory, t, up) for t in (fastest - 0.25, fastest - 0.1, 3.0, 7.3, 12.1)]
    friction = said.force_N - max(np.abs(f).max() for f, _ in found)
    assert friction > 0.0
    assert max(np.abs(a).max() for _, a in found) < said.acceleration_m_s2
    steps = max(np.abs(np.diff(f, axis=0)).max() for f, _ in found)
    own = np.abs(np.diff(w.tau[1:-1], axis=0)).max()
    assert steps < own + said.step_N


def test_the_added_acceleration_is_that_of_a_controlled_stop(virtual):
    c, *_, w, said = virtual
    assert said.added_m_s2 == pytest.approx(1.5 / c.engage.stop_s * np.abs(w.dq).max())


def test_a_limit_that_holds_on_the_path_and_not_while_its_speed_changes_is_warned_of(virtual):
    c, *_, w, said = virtual
    for name, own, least in (
        ("acceleration_m_s2", np.abs(w.ddq).max(), said.acceleration_m_s2),
        ("force_N", np.abs(w.tau).max(), said.force_N),
        ("force_step_N", np.abs(np.diff(w.forces()[1], axis=0)).max(), None),
    ):
        most = own + said.step_N if least is None else least
        assert own < most
        for limit, warns in ((0.9 * own + 0.1 * most, True), (1.001 * most, False)):
            limits = c.limits.model_copy(update={name: limit})
            found = list(_beyond(c.model_copy(update={"limits": limits}), w, said))
            assert len(found) == warns, (name, found)
            assert all(f"limits.{name}" in each and "engage.stop_s" in each for each in found)


def test_what_a_change_of_speed_feels_is_the_force_at_its_bounds_over_the_inertia(virtual):
    c, platform, model, trajectory, w, said = virtual
    felt = []
    for t in w.t[1:-1:40].tolist():
        s = trajectory.sample(t)
        J, M = jacobian(platform, s.p, s.R), model.mass_matrix(s.p, s.R)
        for way in (1.5, -1.5):
            slowing = s.dtwist + way / c.engage.stop_s * s.twist
            tau = model.inverse_dynamics(s.p, s.R, s.twist, slowing, np.zeros(6))
            felt.append(np.abs(J @ np.linalg.solve(M, J.T @ tau)).max())
    assert said.felt_m_s2 == pytest.approx(max(felt), rel=0.01)


@pytest.mark.parametrize(("share", "warns"), [(0.99, True), (1.01, False)])
def test_what_a_robust_law_counts_on_is_compared_with_what_a_change_of_speed_feels(virtual, share, warns):
    c, *_, w, said = virtual
    stated = UncertaintySettings(
        disturbance_m_s2=1.0, model_error=0.1, acceleration_m_s2=share * said.felt_m_s2
    )
    law = RobustInverseDynamicsSettings(
        law="robust_inverse_dynamics", wn_rad_s=20.0, uncertainty=stated, boundary_layer_m_s=0.05
    )
    found = list(_beyond(c.model_copy(update={"controller": law}), w, said))
    assert len(found) == warns
    assert all("controller.uncertainty.acceleration_m_s2" in each for each in found)


def test_the_report_says_it():
    report = inspect(load("desktop"))
    assert report.sections["operating"][-1] == "key              none is needed"
    assert "change of speed" in report.sections["operating"][0]
    assert not any("change of speed" in each for each in report.warnings)


DEADMAN = [
    (0.3, True, set()),
    (0.15, True, set()),
    (0.14, True, {"page"}),
    (0.06, False, set()),
    (0.059, False, {"late"}),
    (0.02, False, {"each time"}),
    (0.0029, False, {"each time", "too few"}),
]


@pytest.mark.parametrize(("deadman_s", "page", "said"), DEADMAN)
def test_a_key_that_its_clients_or_the_loop_cannot_hold_is_warned_of(deadman_s, page, said):
    c = load("virtual")
    watch = c.watch.model_copy(update={"operate": page})
    text = "\n".join(_key(c.model_copy(update={"watch": watch}), deadman_s))
    words = {
        "page": "the page of",
        "late": "comes late or is lost",
        "each time": "rest each time",
        "too few": "too few",
    }
    assert all(words[each] in text for each in said), text
    assert bool(text) == bool(said)


def test_the_intervals_are_those_of_the_clients():
    assert REPEAT_S == 0.02
    script = assets()["/operate.js"][0].decode()
    assert re.findall(r"HELD_MS = (\d+)", script) == [f"{1e3 * PAGE_REPEAT_S:g}"]


def test_jogs_that_would_be_refused_for_their_change_of_force_are_warned_of():
    """By hand: 1.5 x 0.5 m/s / 0.5 s each way are 3 m/s^2 in all, of 1150 kg and more on six legs."""
    c = load("virtual")
    quiet = inspect(c)
    assert not [each for each in quiet.warnings if each.startswith("a jog")]
    least_N = 3.0 * 1150.0 / 6.0
    brisk = c.operator.model_copy(update={"setup_speed_m_s": 0.5})
    found = inspect(c.model_copy(update={"operator": brisk}))
    jogged_N = found.figures["jog_change_N"]
    assert least_N < jogged_N < 12000.0
    assert quiet.figures["jog_change_N"] < 0.5 * jogged_N
    assert f"changes a force by up to {jogged_N:.0f} N within 250 ms (limit 12000)" in "\n".join(found.lines)
    rate = found.figures["jog_rate_m_s"]
    assert f"moves a leg at up to {rate:.3g} m/s (limit {c.limits.speed_m_s:g})" in "\n".join(found.lines)
    tight = c.limits.model_copy(update={"force_window_N": jogged_N - 1.0})
    (warning,) = [
        each
        for each in inspect(c.model_copy(update={"operator": brisk, "limits": tight})).warnings
        if each.startswith("a jog")
    ]
    assert f"limits.force_window_N is {jogged_N - 1.0:g}: it is refused there" in warning


def test_a_jog_faster_than_a_leg_may_be_is_warned_of():
    """Straight up with 0.3 m/s: a leg's rate is that times its slope, at home 0.3 m/s x height over length."""
    c = load("virtual")
    platform, home = build_platform(c.platform), c.platform.home
    legs = np.array(home.position_m) + platform.platform_joints - platform.base_joints
    least = 0.3 * np.abs(legs[:, 2] / np.linalg.norm(legs, axis=1)).max()
    for limit, spoken in ((0.9 * least, True), (0.3 * 1.2, False)):
        limits = c.limits.model_copy(update={"speed_m_s": limit})
        operator = c.operator.model_copy(update={"setup_speed_m_s": 0.3, "setup_speed_deg_s": 1.0})
        fast = c.model_copy(update={"limits": limits, "operator": operator})
        trajectory = build_trajectory(c.reference, home, c.folder)
        jog = jog_demand(fast, trajectory, Model(platform, leg_spin=c.platform.leg_spin), 1.0)
        assert least <= jog.rate_m_s * (1 + 1e-9) <= 0.3 * 1.2
        said = [line for line in _jogged(fast, jog) if "limits.speed_m_s" in line]
        assert bool(said) == spoken
