"""Verdicts of the matrix on artificial runs: both sides of every bound."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.signals import Fault, Mode
from hil.study.faults.diagnoses import EXPECTED
from hil.study.faults.verdict import Bounds, Trace, judge, see
from plant_fmu.faults import FAULTS

BOUNDS = Bounds(stopping_m=50e-3, controlled_m=80e-3, harmless_m=10e-3, harmless_s=10e-3)
N, BEGUN = 1700, 100
NAMED = {
    "brake_slow": "BRAKE",
    "brake_stuck_closed": "FOLLOWING",
    "encoder_drift": "BRAKE",
    "frames_old": "SECOND_CONTROLLER",
    "frames_forged_command": "SECOND_CONTROLLER",
    "frames_forged_feedback": "DUPLICATE_NODE",
    "drive_gain": "FOLLOWING",
}
"""Fault reported for a kind unless a test says otherwise; ENCODER for all other kinds."""


def run(
    before: Mode = Mode.TRACKING,
    reacts: int | None = None,
    drift: float = 0.0,
    after: float = 0.0,
    *,
    leg: int | None = 2,
    ending: Mode = Mode.FAULT,
    causes: dict[str, set[int]] | None = None,
) -> Trace:
    """Leg 2 drifts from the reference by `drift` m per tick from fault to reaction, then moves by `after` m.

    causes : faults reported at the reaction, each with its legs; default: ENCODER of leg 2.
    """
    named = {} if reacts is None else {"ENCODER": {2}} if causes is None else causes
    length, desired = np.full((N, 6), 1.5), np.full((N, 6), 1.5)
    mode, faults = np.full(N, int(before)), np.zeros(N, int)
    stop = N if reacts is None else BEGUN + reacts
    ticks = np.clip(np.arange(N) - BEGUN + 1, 0, min(stop, 300) - BEGUN + 1)
    length[:, 2] += drift * ticks
    if reacts is not None:
        mode[stop:] = int(ending)
        faults[stop:] = sum(int(Fault[cause.partition("/")[0]]) for cause in named)
        length[stop + 1 :, 2] += after
    else:
        mode[300:] = int(Mode.PARKED)
    return Trace(
        length, desired, mode, faults, 1000.0, BEGUN, leg, success=reacts is None, failed="",
        causes={cause: frozenset(legs) for cause, legs in named.items()},
    )  # fmt: skip


def shaped(kind: str, **shape: Any) -> Trace:
    """A run whose reaction reports the expected fault of its kind."""
    return run(**({"causes": {NAMED.get(kind, "ENCODER"): {2}}} | shape))


def verdict(kind: str, t: Trace) -> tuple[bool, str]:
    return judge(kind, t, see(kind, t), BOUNDS)


def test_error_of_a_fault_case_counts_until_the_reaction_and_travel_after_it():
    s = see("encoder_jump", run(reacts=10, drift=1e-4, after=7e-3))
    assert s.declared == 10
    assert s.error_m == pytest.approx(11e-4)
    assert s.travel_m == pytest.approx(7e-3)
    assert s.last_m == 0


def test_motion_along_the_reference_is_not_an_error_of_a_fault_case():
    t = run(reacts=50, drift=1e-3)
    moving = t._replace(desired=t.length)
    assert see("encoder_jump", moving).error_m == 0
    assert see("encoder_jump", moving).found_m == pytest.approx(51e-3)


def test_error_on_closed_brakes_counts_from_the_resting_leg_lengths():
    t = run(Mode.UNLOADING, reacts=20, drift=1e-4)
    off = t._replace(desired=t.desired + 0.3)
    assert see("encoder_jump", off).error_m == pytest.approx(21e-4)


def test_motion_of_a_healthy_leg_counts_as_error_not_as_faulty_motion():
    s = see("encoder_jump", run(reacts=20, drift=1e-4, leg=3))
    assert s.error_m == pytest.approx(21e-4)
    assert (s.found_m, s.found_ticks) == (0, 0)


@pytest.mark.parametrize(("speed_m_s", "good"), [(0.019, False), (0.021, True)])
def test_fault_case_of_a_brake_in_motion_may_travel_the_stopping_distance(speed_m_s, good):
    t = shaped("brake_stuck_closed", reacts=5, after=40e-3)
    length = t.length.copy()
    length[: BEGUN + 5] -= 1e-3 * speed_m_s
    assert verdict("brake_stuck_closed", t._replace(length=length))[0] is good
    assert not verdict("brake_stuck_closed", shaped("brake_stuck_closed", reacts=101, drift=1.01e-4))[0]


@pytest.mark.parametrize(
    ("ending", "after_mm", "good"),
    [(Mode.PARKING, 51, False), (Mode.STOPPING, 51, True), (Mode.STOPPING, 81, False)],
)
def test_fault_case_with_a_controlled_stop_may_travel_its_own_stopping_distance(ending, after_mm, good):
    t = shaped("drive_gain", reacts=5, after=1e-3 * after_mm, ending=ending)
    length = t.length.copy()
    length[: BEGUN + 5] -= 1e-3
    assert verdict("drive_gain", t._replace(length=length))[0] is good


@pytest.mark.parametrize(("speed_m_s", "good"), [(1.01, True), (0.95, False)])
def test_allowed_error_of_an_undetected_fault_grows_with_the_speed_of_the_reference(speed_m_s, good):
    t = run(drift=0.098e-3)
    way = np.zeros((N, 6))
    way[:, 4] = 1e-3 * speed_m_s * np.minimum(np.arange(N), 299)
    assert verdict("drive_gain", t._replace(desired=t.desired + way, length=t.length + way))[0] is good


@pytest.mark.parametrize(("ending", "ticks"), [(Mode.HELD, 1000), (Mode.FAULT, 100), (Mode.PARKED, 100)])
@pytest.mark.parametrize(("creep_m", "good"), [(4.9e-5, True), (5.1e-5, False)])
def test_fault_case_fails_if_the_platform_creeps_at_the_end(ending, ticks, creep_m, good):
    t = shaped("drive_gain", reacts=10, ending=ending)
    length = t.length.copy()
    length[-1 - ticks :, 4] += np.linspace(0, creep_m, 1 + ticks)
    found, words = verdict("drive_gain", t._replace(length=length))
    assert (found, "the platform moves at the end" in words) == (good, not good)


def test_fault_case_does_not_fail_for_motion_before_its_last_second():
    t = shaped("drive_gain", reacts=10, ending=Mode.HELD)
    length = t.length.copy()
    length[:-1001, 4] -= 1e-3
    assert verdict("drive_gain", t._replace(length=length))[0]


CASES: list[tuple[str, dict[str, Any], bool, str]] = [
    # brakes: 10 mm, before and after
    ("brake_slow", {"reacts": 99, "drift": 0.99e-4}, True, "within"),
    ("brake_slow", {"reacts": 99, "drift": 1.01e-4}, False, "error 10"),
    ("brake_slow", {"reacts": 5, "after": 9.9e-3, "ending": Mode.HELD}, True, "within"),
    ("brake_slow", {"reacts": 5, "after": 10.1e-3, "ending": Mode.HELD}, False, "moved 10"),
    ("brake_slow", {"reacts": 5, "after": 10.1e-3, "ending": Mode.PARKED}, False, "moved 10"),
    ("brake_slow", {"drift": 0.049e-3}, True, "harmless"),
    ("brake_slow", {"drift": 0.051e-3}, False, "no reaction"),
    ("brake_slow", {"before": Mode.UNLOADING, "reacts": 99, "drift": 0.9e-4, "after": 9.9e-3}, True, "within 10 mm"),
    ("brake_slow", {"before": Mode.UNLOADING, "reacts": 99, "drift": 0.9e-4, "after": 10.1e-3}, False, "moved 10 mm"),
    ("brake_slow", {"before": Mode.PARKING, "reacts": 99, "drift": 0.9e-4, "after": 40e-3}, True, "within 50 mm"),
    # jump and freeze: 2 mm or 20 ms from the first 0.1 mm on
    ("encoder_jump", {"reacts": 199, "drift": 0.99e-5}, True, "detected after"),
    ("encoder_jump", {"reacts": 250, "drift": 1.01e-5}, False, "allowed: 2.00 mm or 20 ms"),
    ("encoder_freeze", {"reacts": 20, "drift": 1e-3}, True, "20 ms"),
    ("encoder_freeze", {"reacts": 21, "drift": 1e-3}, False, "21 ms"),
    ("encoder_freeze", {}, True, "not observable with these sensors: the leg did not move"),
    ("encoder_freeze", {"drift": 0.99e-5}, True, "harmless"),
    ("encoder_freeze", {"drift": 1.01e-5}, False, "not detected"),
    ("encoder_jump", {}, False, "not detected: error 0.00 mm"),
    ("encoder_jump", {"drift": 0.5e-5}, False, "not detected: error 1.00 mm"),
    ("encoder_jump", {"reacts": 0, "after": 51e-3}, False, "travelled 51 mm"),
    # forged and old: declared within 2 ticks and 2 mm
    ("frames_old", {"reacts": 2}, True, "within"),
    ("frames_old", {"reacts": 3}, False, "reported after 3 ticks"),
    ("frames_forged_command", {"reacts": 1, "drift": 0.99e-3}, True, "within"),
    ("frames_forged_command", {"reacts": 1, "drift": 1.01e-3}, False, "error until reported 2.02 mm"),
    ("bus_second_controller", {}, False, "not reported"),
    ("frames_forged_feedback", {"reacts": 1, "after": 51e-3}, False, "travelled"),
    # the others: the printed stopping distance, or harmless
    ("drive_gain", {"reacts": 99, "drift": 0.49e-3}, True, "within 50 mm"),
    ("drive_gain", {"reacts": 99, "drift": 0.51e-3}, False, "moved 51 mm"),
    ("drive_gain", {"reacts": 9, "after": 51e-3}, False, "travelled 51 mm"),
    ("frames_loss", {"drift": 0.049e-3}, True, "harmless"),
    ("frames_loss", {"drift": 0.051e-3}, False, "no reaction: error 10 mm"),
    # what six encoders cannot see
    ("encoder_drift", {"drift": 1e-4}, True, "not observable with these sensors: remaining error 20 mm"),
    ("encoder_late", {}, True, "not observable"),
    ("encoder_late", {"reacts": 99, "drift": 0.49e-3}, True, "within 50 mm"),
    ("encoder_late", {"reacts": 99, "drift": 0.51e-3}, False, "moved 51 mm"),
    ("encoder_drift", {"reacts": 99, "drift": 0.51e-3}, True, "not observable with these sensors in motion: remaining error 51 mm"),
    ("encoder_drift", {"reacts": 9, "after": 51e-3}, False, "travelled 51 mm"),
    ("encoder_scale", {"before": Mode.UNLOADING, "reacts": 9, "after": 10.1e-3}, False, "travelled 10 mm"),
    # on closed brakes: 10 mm for everything
    ("drive_gain", {"before": Mode.LOADING, "reacts": 99, "drift": 0.99e-4}, True, "within 10 mm"),
    ("drive_gain", {"before": Mode.LOADING, "reacts": 99, "drift": 1.01e-4}, False, "moved 10 mm"),
    ("drive_gain", {"before": Mode.UNLOADING, "reacts": 9, "after": 9.9e-3}, True, "within 10 mm"),
    ("drive_gain", {"before": Mode.UNLOADING, "reacts": 9, "after": 10.1e-3}, False, "travelled 10 mm"),
    ("drive_gain", {"before": Mode.PARKING, "reacts": 9, "after": 10.1e-3}, True, "within 50 mm"),
    ("encoder_jump", {"before": Mode.LOADING, "reacts": 0, "after": 10.1e-3}, False, "travelled 10 mm"),
    ("frames_loss", {"before": Mode.UNLOADING, "drift": 0.049e-3}, True, "harmless"),
    ("frames_loss", {"before": Mode.UNLOADING, "drift": 0.051e-3}, False, "no reaction: error 10 mm"),
    ("encoder_noise", {"drift": 0.051e-3}, False, "no reaction"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "shape", "good", "text"), CASES)
def test_fault_case_of_each_kind_passes_below_its_bound_and_fails_above_it(kind, shape, good, text):
    found, words = verdict(kind, shaped(kind, **shape))
    assert (found, text in words) == (good, True), words


# cause and leg


NAMING: list[tuple[str, dict[str, set[int]], bool, str]] = [
    ("encoder_jump", {"ENCODER/JUMP": {2}}, True, "detected after"),
    ("encoder_jump", {"STROKE": {2}}, False, "the cause is missing: reported STROKE, expected ENCODER"),
    ("encoder_jump", {"ENCODER/JUMP": {2}, "STROKE": {2}}, True, "detected after"),
    ("encoder_jump", {"ENCODER/JUMP": {1}}, False, "the leg is missing: ENCODER/JUMP reports leg 1, expected leg 2"),
    ("encoder_jump", {"ENCODER/JUMP": {1}, "STROKE": {2}}, False, "the leg is missing"),
    ("encoder_jump", {"ENCODER/JUMP": {1, 2}}, True, "detected after"),
    ("encoder_jump", {"ENCODER/JUMP": set()}, False, "ENCODER/JUMP reports no leg, expected leg 2"),
    ("drive_gain", {"ENCODER/LEAP": {2}}, True, "within"),
    ("drive_gain", {"ENCODER/JUMP": {2}}, False, "the cause is missing: reported ENCODER/JUMP"),
    ("drive_gain", {"ENCODER/JUMP": {2}, "FOLLOWING": {0, 2}}, True, "within"),
    ("drive_gain", {"CERTIFICATE": set()}, True, "within"),
    ("drive_gain", {"CERTIFICATE": set(), "FOLLOWING": {1}}, False, "FOLLOWING reports leg 1, expected leg 2"),
    ("drive_silence", {"STALE": set()}, False, "STALE reports no leg"),
    ("frames_duplicate", {"STALE": {0}}, False, "the cause is missing: reported STALE, expected none"),
    ("brake_stuck_open", {"FOLLOWING": {2}}, False, "the cause is missing: reported FOLLOWING, expected BRAKE"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "causes", "good", "text"), NAMING)
def test_fault_case_passes_only_if_the_reaction_reports_an_expected_cause_and_leg(kind, causes, good, text):
    found, words = verdict(kind, run(reacts=1, causes=causes, ending=Mode.HELD))
    assert (found, text in words) == (good, True), words


def test_fault_case_that_affects_no_single_leg_needs_no_leg_in_the_report():
    assert verdict("frames_loss", run(reacts=1, causes={"STALE": set()}, leg=None))[0]


def test_fault_case_reports_both_an_exceeded_bound_and_a_missing_cause():
    _, words = verdict("drive_gain", run(reacts=9, after=51e-3, causes={"STALE": set()}))
    assert words.startswith("travelled 51 mm, allowed: 50 mm; the cause is missing: reported STALE")


@pytest.mark.parametrize(
    ("rate_Hz", "ticks", "allowed_ms"),
    [(4000.0, 80, 20), (1000.0, 20, 20), (500.0, 14, 28), (250.0, 11, 44), (100.0, 7, 70), (50.0, 7, 140)],
)
def test_a_slow_loop_has_more_time_to_detect_a_frozen_encoder(rate_Hz, ticks, allowed_ms):
    kind = "encoder_freeze"
    assert verdict(kind, shaped(kind, reacts=ticks, drift=1e-3, after=1e-3)._replace(rate_Hz=rate_Hz))[0]
    late = shaped(kind, reacts=ticks + 1, drift=1e-3, after=1e-3)._replace(rate_Hz=rate_Hz)
    assert not verdict(kind, late)[0]
    assert f"allowed: 2.00 mm or {allowed_ms} ms" in verdict(kind, late)[1]


def test_detection_time_of_an_encoder_jump_ends_when_that_encoder_is_reported():
    t = run(reacts=10, drift=1e-4, causes={"STROKE": {2}, "ENCODER": {2}})
    late = t.faults.copy()
    late[: BEGUN + 45] &= int(Fault.STROKE)
    good, words = verdict("encoder_jump", t._replace(faults=late))
    assert good
    assert "and 44 ms" in words
    far = t.length.copy()
    far[BEGUN + 11 :, 2] += 2e-3
    assert not verdict("encoder_jump", t._replace(faults=late, length=far))[0]


@pytest.mark.parametrize(("leg", "good"), [(2, True), (1, False)])
def test_fault_case_may_continue_without_the_failed_encoder(leg, good):
    t = run()._replace(lost=frozenset({leg}))
    assert verdict("encoder_jump", t)[0] is good
    assert not verdict("encoder_jump", run(drift=1.01e-5)._replace(lost=frozenset({2})))[0]


def test_fault_case_fails_if_another_fault_precedes_the_injected_one():
    t = run(reacts=10)
    early = t.faults.copy()
    early[BEGUN - 1 :] = int(Fault.ENCODER)
    assert verdict("encoder_jump", t._replace(faults=early)) == (
        False,
        "there was a fault before this one began",
    )


def test_every_fault_kind_of_the_matrix_has_expected_causes():
    assert set(EXPECTED) == {name for name in FAULTS if not name.startswith("process")}


def test_fault_case_with_neither_reaction_nor_parking_fails():
    found = verdict("frames_loss", run()._replace(success=False))
    assert found == (False, "ended without a reaction, but not parked")


@pytest.mark.parametrize("kind", EXPECTED)
def test_fault_case_with_a_plant_failure_passes_only_for_fault_kinds_that_cause_it(kind):
    good, words = verdict(kind, run()._replace(failed="the plant crashed"))
    assert (good, "the plant failed" in words) == (kind in {"plant_crash", "plant_nan", "plant_hang"}, True)


def test_fault_guide_lists_the_expected_causes_of_every_fault_kind():
    guide = (Path(__file__).parents[3] / "docs/guides/faults.md").read_text()
    rows = guide.partition("| kinds | a right cause is any of |")[2].partition("\n\n")[0].splitlines()[2:]
    named: dict[str, set[str]] = {}
    for kinds, causes, _ in (row.strip("|").split("|") for row in rows):
        listed = {
            re.sub(r"`(\w+)` \((\w+)\)|`(\w+)`", r"\1\3/\2", cause.strip()).rstrip("/")
            for cause in causes.split(",")
        }
        named |= {kind: listed - {"none"} for kind in re.findall(r"`(\w+)`", kinds)}
    assert named == EXPECTED
