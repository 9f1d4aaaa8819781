"""What `hil check` says of limits far beyond what is needed: each at both sides; no shipped file has one."""

import re

import numpy as np
import pytest

from hil.app.check.command import inspect
from hil.app.check.loose import loose_limits
from hil.app.check.operating import speed_change
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.platform import build_platform
from hil.app.reachability import span_s, walk
from hil.config.reference import LiveReference
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.build import build_trajectory
from tests.broad import broad
from tests.hil.app.test_configs import NAMES

pytestmark = pytest.mark.usefixtures("unproven")

OFTEN = ["virtual", "bench", "vcan50"]


@pytest.fixture(scope="module")
def virtual():
    c = load("virtual")
    platform = build_platform(c.platform)
    model = Model(platform, leg_spin=c.platform.leg_spin)
    trajectory = build_trajectory(c.reference, c.platform.home, c.folder)
    w = walk(platform, model, trajectory, span_s(trajectory), 1.0 / c.loop.rate_Hz, c.plant)
    return c, w, speed_change(c, w, trajectory, model, span_s(trajectory))


def warned(virtual, **limits):
    c, w, change = virtual
    return list(loose_limits(c.model_copy(update={"limits": c.limits.model_copy(update=limits)}), w, change))


# By hand. Forces: the path needs 16022 N, 5.7 kN within 250 ms, 1.129 m/s, a condition of 4.83. At rest the
# error dynamics leave 8 m/s^2 / (20 rad/s)^2 = 20 mm of a stroke of 1.45 m. The loop is 1 + 0.8 + 0.5 ms late.
# A change of force by 2 x 25 kN is one from end to end. Readings 1e-5 m, brakes 1e-4 m, one tick: x 20 each.
BORDERS = {
    "force_N": (64000.0, 64200.0, "16022"),
    "force_step_N": (13500.0, 15000.0, "3590"),
    "force_window_N": (36000.0, 39000.0, "9320"),
    "speed_m_s": (4.5, 4.54, "1.129"),
    "acceleration_m_s2": (94.0, 125.0, None),
    "condition": (4.8 * 40, 4.9 * 40, "4.83"),
    "following_error_m": (0.0799, 0.0801, "0.02"),
    "following_error_s": (20 * 2.29e-3, 20 * 2.31e-3, "0.0023"),
    "consistency_m": (1.99e-4, 2.01e-4, "1e-05"),
    "standstill_m": (1.99e-3, 2.01e-3, "0.0001"),
    "stale_fault_ticks": (20, 21, "1"),
    "missed_stop_ticks": (20, 21, "1"),
}


@pytest.mark.parametrize("name", BORDERS)
def test_a_limit_far_beyond_what_is_needed_is_warned_of_with_need_ratio_and_proposal(virtual, name):
    tight, loose, needed = BORDERS[name]
    assert warned(virtual, **{name: tight}) == []
    (line,) = warned(virtual, **{name: loose})
    found = re.match(
        rf"limits\.{name} (\S+) is (\S+) times the (\S+) \S.* needed .*; "
        r"it would show a failure late, give (\S+)$",
        line,
    )
    assert found is not None, line
    given, times, said, proposed = map(float, found.groups())
    assert given == pytest.approx(loose, rel=1e-4)
    assert times == pytest.approx(loose / said, rel=0.02)
    assert said < proposed < loose
    assert needed is None or said == pytest.approx(float(needed), rel=0.01)
    assert warned(virtual, **{name: proposed}) == []


@pytest.mark.parametrize("name", ["stale_fault_ticks", "missed_stop_ticks"])
def test_a_number_of_ticks_that_is_proposed_is_whole(virtual, name):
    """20 times the one tick that is needed: the root is 4.47."""
    (line,) = warned(virtual, **{name: 300})
    assert line.endswith(", give 5")


def test_what_a_jog_asks_for_is_needed_too(virtual):
    c, w, change = virtual
    given = {"force_window_N": 72000.0, "speed_m_s": 8.0}
    assert len(warned(virtual, **given)) == 2
    limited = c.model_copy(update={"limits": c.limits.model_copy(update=given)})
    assert list(loose_limits(limited, w, change, (18100.0, 2.01))) == []
    for jogged, name, least in (
        ((17900.0, 2.01), "force_window_N 72000 is 4.0 times the 1.79e+04 N", 17900.0),
        ((18100.0, 1.99), "speed_m_s 8 is 4.0 times the 1.99 m/s", 1.99),
    ):
        (line,) = loose_limits(limited, w, change, jogged)
        assert line.startswith(f"limits.{name} that are needed")
        assert float(line.rsplit(" ", 1)[1]) > least, "what is proposed serves the jog"


def test_a_limit_that_is_proposed_refuses_no_jog_from_the_reference():
    c = load("virtual")
    changes = {
        "operator": {"setup_speed_m_s": 0.3},
        "engage": {"stop_s": 0.05},
        "limits": {"force_window_N": 1e6},
    }
    brisk = loads(with_changes(c.text, {"name": c.name} | changes), "brisk.yaml", c.folder)
    found = inspect(brisk)
    (line,) = [each for each in found.warnings if each.startswith("limits.force_window_N ")]
    assert float(line.rsplit(" ", 1)[1]) > found.figures["jog_change_N"]


def platform_mass_kg(c):
    """Return what a leg alone feels of the platform at home: 1 / (J M^-1 J^T)_ii, kg, the most of any."""
    platform, home = build_platform(c.platform), c.platform.home
    p, R = np.array(home.position_m), np.eye(3)
    J = jacobian(platform, p, R)
    return 1.0 / np.diag(J @ np.linalg.solve(Model(platform).mass_matrix(p, R), J.T)).min()


def test_a_deceleration_that_no_force_gives_is_warned_of(virtual):
    """By hand: a leg alone feels 1 / (J M^-1 J^T)_ii; 25 kN bear 3.6 kN of weight at the path's start."""
    c, w, _ = virtual
    able = (25000.0 - np.abs(w.rest).max()) / platform_mass_kg(c)
    assert warned(virtual, deceleration_m_s2=3.9 * able) == []
    (line,) = warned(virtual, deceleration_m_s2=4.1 * able)
    assert line.startswith(f"limits.deceleration_m_s2 {4.1 * able:g} is 4.1 times the {able:.3g} m/s^2")
    proposed = float(line.rsplit(" ", 1)[1])
    assert 0.9 * able < proposed <= able


def test_changes_of_force_that_no_leg_can_be_asked_for_are_warned_of_whatever_is_stated(virtual):
    c, w, change = virtual
    stated = c.monitor.model_copy(update={"disturbance_m_s2": 1e4})
    violent = c.model_copy(update={"monitor": stated}), w, change
    assert warned(violent, force_step_N=49900.0, force_window_N=49900.0) == []
    assert len(warned(violent, force_step_N=50100.0, force_window_N=50100.0)) == 2


def test_a_live_reference_needs_what_its_setpoints_may_ask_for(virtual):
    """At rest the approach is fastest, 1.875 x 0.2 m/s, and 2 m/s beyond it; a leg at 0.6 m/s needs them."""
    c, w, _ = virtual
    resting = w._replace(dq=np.zeros_like(w.dq), ddq=np.zeros_like(w.ddq))
    for velocity_m_s, loose in ((0.01, True), (0.6, False)):
        limits = {
            "velocity_m_s": velocity_m_s,
            "velocity_deg_s": 1.0,
            "acceleration_m_s2": 1.0,
            "acceleration_deg_s2": 1.0,
            "jerk_m_s3": 10.0,
            "jerk_deg_s3": 10.0,
        }
        reference = LiveReference.model_validate({"type": "live", "limits": limits})
        found = list(loose_limits(c.model_copy(update={"reference": reference}), resting, None))
        assert any("limits.speed_m_s" in each for each in found) == loose, found


@pytest.mark.parametrize("name", broad([*OFTEN, *(name for name in NAMES if name not in OFTEN)], quick=3))
def test_no_shipped_configuration_has_a_limit_that_would_show_a_failure_late(name):
    late = [each for each in inspect(load(name)).warnings if "would show a failure late" in each]
    assert late == []


@pytest.mark.parametrize(
    ("name", "skew_us", "loose"), [("two_buses", 190.0, False), ("two_buses", 210.0, True)]
)
def test_syncs_farther_apart_than_two_fifths_of_the_period_are_loose(virtual, name, skew_us, loose):
    """Of 2 kHz the period is 500 us; a tenth is the default."""
    c = load(name)
    skewed = c.model_copy(update={"limits": c.limits.model_copy(update={"sync_skew_us": skew_us})})
    found = list(loose_limits(skewed, virtual[1], None))
    assert any("limits.sync_skew_us" in each for each in found) == loose


def with_law(virtual, **law):
    c, w, change = virtual
    return c.model_copy(update={"controller": c.controller.model_copy(update=law)}), w, change


@pytest.mark.parametrize("softest", range(6))
def test_a_following_error_is_needed_as_large_as_the_softest_leg_has_it(virtual, softest):
    """8 m/s^2 / (20 rad/s)^2 are 20 mm; the others have 40 rad/s, and 5 mm."""
    soft = with_law(virtual, wn_rad_s=[20.0 if leg == softest else 40.0 for leg in range(6)])
    assert warned(soft, following_error_m=0.0799) == []
    (line,) = warned(soft, following_error_m=0.0801)
    assert "4.0 times the 0.02 m that are needed" in line


@pytest.mark.parametrize("heaviest", range(6))
def test_the_leg_with_the_heaviest_rotor_decides_how_hard_legs_can_be_braked(virtual, heaviest):
    c, w, _ = virtual
    rotors = [300.0 if leg == heaviest else 5.0 for leg in range(6)]
    model = c.controller.model.model_copy(update={"reflected_mass_kg": rotors})
    turning = with_law(virtual, model=model)
    able = (25000.0 - np.abs(w.rest).max()) / (platform_mass_kg(c) + 300.0)
    assert warned(turning, deceleration_m_s2=3.9 * able) == []
    (line,) = warned(turning, deceleration_m_s2=4.1 * able)
    assert f"is 4.1 times the {able:.3g} m/s^2" in line


def named(warnings):
    return {each.split()[0] for each in warnings if "would show a failure late" in each}


WEIGHTLESS = {"gravity_m_s2": [0.0, 0.0, 0.0]}


@pytest.mark.parametrize(
    ("changes", "loose"),
    [
        ({"limits": {"acceleration_m_s2": 5.0}}, {"limits.force_N", "limits.speed_m_s"}),
        ({"platform": WEIGHTLESS}, {"limits.speed_m_s"}),
        ({"platform": WEIGHTLESS, "limits": {"acceleration_m_s2": 5.0}}, {"limits.speed_m_s"}),
    ],
)
def test_a_limit_of_what_a_pose_that_is_held_does_not_need_at_all_is_not_loose(virtual, changes, loose):
    """No acceleration at rest, and no force without weight: no ratio, and nothing to propose."""
    c, held = virtual[0], {"type": "hold", "duration_s": 1.0}
    text = with_changes(c.text, {"name": c.name, "reference": held} | changes)
    assert named(inspect(loads(text, "held.yaml", c.folder)).warnings) == loose


@pytest.mark.parametrize("rounding", [0.0, 1e-15])
def test_what_rounding_leaves_of_a_need_is_none(virtual, rounding):
    c, w, _ = virtual
    none = np.full_like(w.q, rounding)
    resting = w._replace(dq=none, ddq=none, tau=none, rest=none[:2])
    given = c.limits.model_copy(update={"acceleration_m_s2": 5.0})
    found = loose_limits(c.model_copy(update={"limits": given}), resting, None)
    assert named(found) == {"limits.speed_m_s"}, "which the approach needs"
