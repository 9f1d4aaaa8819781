"""The last figure of a section that its rule takes, and the first that it refuses."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from drivers.signals import Fault
from hil.app.configuration.configuration import load
from hil.config.delay import DelayCompensation
from hil.config.design import ErrorWeight, UncertaintyRanges
from hil.config.estimation import FusionSettings
from hil.config.limits import LimitSettings
from hil.config.linear_controller import LinearController
from hil.config.model import ModelSettings
from hil.config.number import plain_number
from hil.config.platform import CylinderShape, JointCircle, PayloadSettings, PlatformSettings
from hil.config.reactions import ReactionSettings
from hil.config.running import EngageSettings
from hil.config.values import Pose

LIMITS = {
    "force_N": 1.0, "force_step_N": 1.0, "force_window_N": 1.0, "speed_m_s": 1.0, "deceleration_m_s2": 1.0,
    "following_error_m": 1.0,
}  # fmt: skip
POINT = {"mass_kg": 2.0, "com_m": (0.1, 0.2, 0.3), "shape": {"type": "point"}}
ROOM = ((0.0, 0.2), (0.1, 0.3), (0.2, 0.4))
PLACE = (0.0, 0.0, 0.0)
ERROR = {"low_m": 1e-4, "bandwidth_rad_s": 10.0}
RANGES: dict[str, Any] = {"inertia": 0.2, "transport_ms": (0.5, 1.0), "drive_bandwidth_Hz": (100.0, 200.0)}


def taken(kind: Any, /, **figures: Any) -> bool:
    """Return whether a section takes figures."""
    try:
        kind(**figures)
    except ValidationError:
        return False
    return True


@pytest.mark.parametrize(("warn", "fault", "fine"), [(2, 5, True), (5, 5, True), (6, 5, False)])
def test_a_stale_leg_is_warned_of_before_it_faults_or_in_the_same_tick(warn, fault, fine):
    assert taken(LimitSettings, **LIMITS, stale_warn_ticks=warn, stale_fault_ticks=fault) is fine


@pytest.mark.parametrize("key", ["bus_ms", "drive_lag_ms", "hold_ms"])
def test_one_delay_of_the_three_is_enough_to_compensate_and_none_is_not(key):
    assert taken(DelayCompensation, **{key: 0.5})
    assert not taken(DelayCompensation, **{key: 0.0})


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("degrees", "fine"), [(180.0, True), (-180.0, True), (180.1, False), (-180.1, False)]
)
def test_a_pose_may_be_turned_by_half_a_turn_about_any_axis_and_not_beyond(axis, degrees, fine):
    vector = [0.0, 0.0, 0.0]
    vector[axis] = degrees
    assert taken(Pose, position_m=PLACE, rotation_vector_deg=tuple(vector)) is fine


@pytest.mark.parametrize(("closes", "expected"), [(None, 0.1), (0.0, 0.0), (0.05, 0.05), (0.3, 0.3)])
def test_brakes_have_the_time_to_close_that_is_given_and_that_to_open_where_none_is(closes, expected):
    assert EngageSettings(brake_release_s=0.1, brake_close_s=closes).closing_s == expected


@pytest.mark.parametrize(("spacing_m", "fine"), [(1.9999, True), (2.0, False), (2.1, False)])
def test_the_joints_of_a_pair_stand_less_than_the_diameter_of_their_circle_apart(spacing_m, fine):
    circle = {"radius_m": 1.0, "pair_centres_deg": (0.0, 120.0, 240.0)}
    assert taken(JointCircle, **circle, pair_spacing_m=spacing_m) is fine


@pytest.mark.parametrize(("inner_m", "fine"), [(0.0, True), (0.0999, True), (0.1, False), (0.2, False)])
def test_a_tube_has_a_wall(inner_m, fine):
    assert taken(CylinderShape, type="cylinder", radius_m=0.1, length_m=1.0, inner_radius_m=inner_m) is fine


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("at", "fine"), [(0, True), (1, True), (-1e-3, False), (1 + 1e-3, False)])
def test_the_centre_of_mass_of_the_model_lies_within_its_range_on_each_axis(axis, at, fine):
    low, high = ROOM[axis]
    place = list(POINT["com_m"])  # type: ignore[call-overload]
    place[axis] = low + at * (high - low)
    assert taken(PayloadSettings, **POINT | {"com_m": tuple(place)}, com_range_m=ROOM) is fine


@pytest.mark.parametrize(("mass_kg", "fine"), [(1.0, True), (4.0, True), (0.999, False), (4.001, False)])
def test_the_mass_of_the_model_lies_within_its_range(mass_kg, fine):
    assert taken(PayloadSettings, **POINT | {"mass_kg": mass_kg}, mass_range_kg=(1.0, 4.0)) is fine


@pytest.mark.parametrize(("ends", "fine"), [((2.0, 2.0), True), ((1.0, 3.0), True), ((3.0, 1.0), False)])
def test_a_range_goes_from_less_to_more_or_is_a_single_figure(ends, fine):
    assert taken(PayloadSettings, **POINT, mass_range_kg=ends) is fine


@pytest.mark.parametrize(("peak_m", "fine"), [(1.1e-4, True), (1e-4, False), (1e-5, False)])
def test_the_error_at_rest_is_below_that_at_the_worst_frequency(peak_m, fine):
    assert taken(ErrorWeight, **ERROR, peak_m=peak_m) is fine


@pytest.mark.parametrize("key", ["transport_ms", "drive_bandwidth_Hz"])
@pytest.mark.parametrize(("ends", "fine"), [((1.0, 2.0), True), ((1.0, 1.0), False), ((2.0, 1.0), False)])
def test_each_range_of_an_uncertainty_has_a_width(key, ends, fine):
    assert taken(UncertaintyRanges, **RANGES | {key: ends}) is fine


def test_the_fastest_drives_have_the_least_lag_and_the_slowest_the_most():
    assert UncertaintyRanges(**RANGES).lag_ms == pytest.approx((0.795775, 1.591549), rel=1e-6)


@pytest.mark.parametrize(
    ("legs", "fine"), [([], True), ([0, 5], True), ([3, 3], False), ([6], False), ([-1], False)]
)
def test_the_legs_that_may_be_lost_are_named_once_each(legs, fine):
    assert taken(FusionSettings, may_lose_legs=legs) is fine


@pytest.mark.parametrize("variant", ["full", "no_H", "printed", "constant", "constant_MG", "massless_legs"])
def test_a_model_is_frozen_at_a_pose_where_it_is_constant_and_nowhere_else(variant):
    constant = variant.startswith("constant")
    assert taken(ModelSettings, variant=variant) is not constant
    assert taken(ModelSettings, variant=variant, frozen_at={"position_m": PLACE}) is constant


LAW: dict[str, Any] = {
    "kind": "linear-controller", "method": "hinf", "axes": "joint", "rate_Hz": 1000.0, "inputs": ["error", "rate_error"],
    "A": [[0.0] * 3] * 3, "B": [[0.0] * 2] * 3, "C": [[0.0] * 3], "D": [[0.0] * 2], "anti_windup": [0.0] * 3,
    "design": {},
}  # fmt: skip


@pytest.mark.parametrize("matrix", ["A", "B", "C", "D"])
def test_each_matrix_of_a_law_has_as_many_columns_in_each_row_as_there_is_to_multiply(matrix):
    assert taken(LinearController, **LAW)
    rows = [list(row) for row in LAW[matrix]]
    for change in (rows[-1][:-1], [*rows[-1], 0.0]):
        assert not taken(LinearController, **LAW | {matrix: [*rows[:-1], change]})


@pytest.mark.parametrize("count", [0, 2, 4])
def test_a_law_has_a_number_of_anti_windup_for_each_state(count):
    assert not taken(LinearController, **LAW | {"anti_windup": [0.0] * count})


@pytest.mark.parametrize("reaction", ["ss1", "sbc", "sto"])
def test_all_faults_of_one_reaction_lead_to_it_and_those_of_another_do_not(reaction):
    settings = ReactionSettings(stroke="ss1", speed="ss1", drive="sto", stale="sto", law="sto")
    expected = {
        "ss1": {"STROKE", "SPEED", "CERTIFICATE", "REFUSED_FRAMES", "SET_UP"},
        "sto": {"DRIVE", "STALE", "LAW"},
        "sbc": {
            "FOLLOWING", "KINEMATICS", "ASSEMBLY", "CONDITION", "NOT_FINITE", "ENCODER", "UNCERTAIN",
            "DUPLICATE_NODE",
        },
    }  # fmt: skip
    found = settings.led_to(reaction)
    assert {fault.name for fault in Fault if fault and fault in found} == expected[reaction]


@pytest.mark.parametrize(
    ("word", "number"), [("1", 1.0), ("-.5", -0.5), ("+2.", 2.0), (" 3e-2 ", 0.03), ("1E3", 1000.0)]
)
def test_a_word_in_plain_figures_is_a_number(word, number):
    assert plain_number(word) == number


@pytest.mark.parametrize("word", ["", ".", "1_0", "nan", "inf", "0x10", "٣", "1 2", "1e", "e5", "--1", "1,5"])
def test_a_word_of_other_signs_is_no_number(word):
    assert plain_number(word) != plain_number(word)


@pytest.mark.parametrize("half", ["cylinder", "rod"])
@pytest.mark.parametrize(("inertia_kg_m2", "fine"), [(0.0, True), (0.1, True), (None, False)])
def test_legs_that_spin_have_an_inertia_about_themselves_be_it_none_at_all(half, inertia_kg_m2, fine):
    figures = load("virtual").platform.model_dump()
    for each in ("cylinder", "rod"):
        figures[each]["inertia_axial_kg_m2"] = 0.1
    figures[half]["inertia_axial_kg_m2"] = inertia_kg_m2
    spinning = {"leg_spin": "universal", "universal_joint_base_axes": [(1.0, 0.0, 0.0)] * 6}
    assert taken(PlatformSettings, **figures | spinning) is fine
    assert taken(PlatformSettings, **figures | {"leg_spin": "none"})
