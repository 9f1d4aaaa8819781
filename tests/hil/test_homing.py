"""Turns that drives forget at power-off: restored from the parked lengths, or refused."""

import numpy as np
import pytest

from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import of_python
from drivers.signals import NEVER
from drivers.tick_columns import new_record, tick_at
from hil.loop import homing_kernels
from hil.loop.homing import SILENT_TICKS, Homing, LastPose, Stroke, unwrapped_turns

STEP = np.array([0.0025, 0.0025, 0.005, 0.01, 0.1, 0.0025])
SIGN = np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0])
PARKED = np.array([0.301, 0.312, 0.323, 0.334, 0.345, 0.356])
LIMIT = 2e-4
TURNS = np.array([7, -3, 12, 0, -1, 100])
"""Whole turns that each drive has forgotten."""
PERIOD_S = 0.0025


class Leg:
    """Six drives that report given lengths, tick by tick."""

    def __init__(self, stroke=None, **changes):
        pose = LastPose(
            PARKED, np.full(6, LIMIT), STEP, SIGN * STEP, "parked 2026-01-02", "hil homing a.yaml"
        )._replace(**changes)
        self.pose = pose
        self.homing = Homing(pose, stroke or Stroke(0.2, 0.5, None), PERIOD_S)
        self.last = new_record()
        self.last["age"] = NEVER
        self.number = -1
        self.seen = np.zeros(6)
        """(6,) m, lengths of the last tick in the decoder."""
        self.homing.record["decode"], self._reading = of_python(self._read, *[INTEGER] * 6)

    def _read(self, _codec, _frames, _count, _since_ns, last, tick):
        """Decode: a silent leg keeps its last reported length."""
        self.seen = tick_at(last)["length"].copy()
        quiet = list(self.silent)
        tick_at(tick)["length"][quiet] = self.seen[quiet]
        return 0

    def hear(self, reported, *, braked=True, silent=(), rate=0.0, skipped=0, late=(), by=1):
        self.number += 1 + skipped
        tick = new_record()
        tick["tick"] = self.number
        tick["rate"] = rate
        tick["length"] = reported
        for leg in range(6):
            tick["age"][leg] = self.last["age"][leg] + 1 if leg in silent else by * (leg in late)
        self.silent, self.homing.record["braked"] = silent, braked
        homing_kernels.decode(self.homing.record, 0, 0, 0, self.last, tick)
        self.last = tick
        return tick["length"]


def forgotten(length):
    return length - TURNS * STEP


def only(leg):
    """1.0 for one leg, 0.0 for the others."""
    return 1.0 * (np.arange(6) == leg)


def test_whole_turns_are_added_to_the_reported_length():
    legs = Leg()
    here = PARKED + 0.9 * LIMIT * np.array([1, -1, 1, -1, 1, -1])
    np.testing.assert_allclose(legs.hear(forgotten(here)), here, atol=1e-12)
    assert legs.homing.known
    assert not legs.homing.refusal
    assert unwrapped_turns(legs.homing, legs.pose) == (TURNS * SIGN).tolist()
    for _ in range(100):
        here = here + 5e-4
        found = legs.hear(forgotten(here), braked=False, rate=5e-4 / PERIOD_S)
    np.testing.assert_allclose(found, here, atol=1e-12)
    found = legs.hear(forgotten(here), silent=(3,))
    np.testing.assert_array_equal(legs.seen, forgotten(here), "the decoder sees what the drives reported")
    np.testing.assert_allclose(found, here, atol=1e-12)


def test_turns_of_a_geared_motor_are_reported_as_fractions():
    legs = Leg(m_per_turn=3.0 * STEP)
    legs.hear(forgotten(PARKED))
    assert unwrapped_turns(legs.homing, legs.pose) == [2.333333, -1.0, 4.0, 0.0, -0.333333, 33.333333]


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_leg_moved_beyond_its_limit_since_parking_is_refused_until_it_is_back(leg, side):
    legs = Leg()
    here = PARKED + 1.1 * side * LIMIT * only(leg)
    legs.hear(forgotten(here))
    assert not legs.homing.known
    assert legs.homing.refusal.startswith(f"leg {leg} is {here[leg]:.6f} m long, and was {PARKED[leg]:.6f} m")
    turns = -1.1 * side * LIMIT / STEP[leg] * SIGN[leg]
    for words in (
        f"{side * 1.1e3 * LIMIT:+.3f} mm, allowed: 0.2 mm",
        f"{turns:+.3f} turns",
        "`hil homing a.yaml",
    ):
        assert words in legs.homing.refusal
    legs.hear(forgotten(PARKED))
    assert legs.homing.known


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_each_leg_has_its_own_limit_of_motion_since_parking(leg, side):
    limits, there = 2.0**-12 * np.array([3, 1, 6, 2, 5, 4]), np.full(6, 0.25)
    for beyond, known in ((0.0, True), (2.0**-40, False)):
        legs = Leg(length=there, limit_m=limits, step_m=np.full(6, 2.0**-8))
        legs.hear(there + side * (limits[leg] + beyond) * only(leg))
        assert legs.homing.known is known


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize(
    ("low", "high", "known"), [(0.25, 0.5, True), (0.2501, 0.5, False), (0.25, 0.4999, False)]
)
def test_drive_with_a_position_range_inside_the_stroke_is_refused(leg, low, high, known):
    ends = np.where(only(leg), low, 0.0), np.where(only(leg), high, 1.0)
    legs = Leg(Stroke(0.25, 0.5, ends))
    legs.hear(PARKED)
    assert legs.homing.known is known
    assert (
        f"leg {leg}: its drive was switched on where its position field" in legs.homing.refusal
    ) is not known


@pytest.mark.parametrize(("old", "known"), [(1, True), (2, False)])
def test_first_reading_at_most_one_tick_old_restores_the_motor_turns(old, known):
    legs = Leg()
    legs.hear(forgotten(PARKED), late=(3,), by=old)
    assert legs.homing.known is known
    legs.hear(forgotten(PARKED))
    assert legs.homing.known


@pytest.mark.parametrize(("share", "known"), [(0.49, True), (-0.49, True), (0.5, False), (-0.51, False)])
def test_jump_of_half_a_turn_in_a_tick_means_a_drive_restart(share, known):
    legs = Leg(length=np.full(6, 0.25), step_m=np.full(6, 2.0**-8))
    for part in (0.0, share):
        legs.hear(0.25 + part * 2.0**-8 * only(2), braked=False)
    assert legs.homing.known is known
    assert ("leg 2: its drive was switched off" in legs.homing.refusal) is not known


@pytest.mark.parametrize("legs_that", [range(6), (2,), (5,)])
@pytest.mark.parametrize(
    "ticks",
    [
        [{}, {}],
        [{"silent": True}, {}],
        [{"silent": True}, {"silent": True}, {"late": True}, {}],
        [{"skipped": 1}],
        [{"skipped": 4}],
    ],
    ids=["heard", "silent", "silent and late", "one skipped", "four skipped"],
)
def test_motor_turns_of_a_moving_leg_are_restored_from_its_last_rate(legs_that, ticks):
    """0.7 of a turn in each tick, for every leg."""
    legs, speed, moved = Leg(), 0.7 * STEP / PERIOD_S, PARKED.copy()
    these = np.isin(np.arange(6), legs_that)
    legs.hear(forgotten(moved), braked=False, rate=speed)
    for tick in ticks:
        skipped = tick.get("skipped", 0)
        moved = moved + speed * PERIOD_S * (1 + skipped)
        reads = moved - speed * PERIOD_S * (these & ("late" in tick))
        which = {kind: tuple(legs_that) for kind in ("silent", "late") if kind in tick}
        legs.hear(forgotten(reads), braked=False, rate=speed, skipped=skipped, **which)
    np.testing.assert_allclose(legs.last["length"], moved, atol=1e-12)
    assert legs.homing.known
    assert not legs.homing.refusal


@pytest.mark.parametrize("silent_ticks", [0, SILENT_TICKS + 1])
def test_motor_turns_of_a_drive_restarted_with_closed_brake_are_restored(silent_ticks):
    """Restored to its last length, not to its parked length."""
    legs, moved = Leg(), PARKED.copy()
    legs.hear(forgotten(moved), braked=False)
    for _ in range(3):
        moved = moved + 0.2 * STEP[0]
        legs.hear(forgotten(moved), braked=False)
    for _ in range(silent_ticks):
        legs.hear(forgotten(moved), silent=(4,))
    np.testing.assert_allclose(legs.hear(forgotten(moved) + 3 * STEP * only(4)), moved, atol=1e-12)
    assert legs.homing.known


@pytest.mark.parametrize("silent_ticks", [1, SILENT_TICKS + 2])
def test_motor_turns_of_a_drive_restarted_with_open_brake_stay_unknown(silent_ticks):
    legs = Leg()
    legs.hear(forgotten(PARKED))
    for _ in range(silent_ticks):
        legs.hear(forgotten(PARKED), silent=(4,), braked=False)
    legs.hear(forgotten(PARKED) + 3 * STEP * only(4), braked=False)
    before = legs.homing.added.copy()
    for _ in range(3):
        legs.hear(forgotten(PARKED))
        assert not legs.homing.known
    assert legs.homing.refusal.startswith("leg 4: its drive was switched off")
    np.testing.assert_array_equal(legs.homing.added, before)


@pytest.mark.parametrize(("ticks", "known"), [(SILENT_TICKS, True), (SILENT_TICKS + 1, False)])
def test_motor_turns_of_a_drive_silent_too_long_with_open_brake_become_unknown(ticks, known):
    legs = Leg()
    legs.hear(forgotten(PARKED))
    for _ in range(ticks):
        legs.hear(forgotten(PARKED), silent=(1,), braked=False)
    np.testing.assert_allclose(legs.hear(forgotten(PARKED), braked=False), PARKED, atol=1e-12)
    assert legs.homing.known is known
    assert ("leg 1: its drive was switched off, or silent for 20 ticks" in legs.homing.refusal) is not known


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("ticks", [1, 3 * SILENT_TICKS])
def test_drive_that_answers_later_is_restored_to_its_parked_length(leg, ticks):
    legs = Leg()
    for _ in range(ticks):
        legs.hear(forgotten(PARKED), silent=(leg,))
        assert not legs.homing.known
        assert not legs.homing.refusal
    np.testing.assert_allclose(legs.hear(forgotten(PARKED)), PARKED, atol=1e-12)
    assert legs.homing.known


@pytest.mark.parametrize("leg", [0, 3])
@pytest.mark.parametrize("silent", range(6))
def test_drive_restarted_before_all_have_answered_is_restored(leg, silent):
    legs, others = Leg(), {silent} - {leg}
    legs.hear(forgotten(PARKED), silent=others)
    reads = forgotten(PARKED) + 4 * STEP * only(leg)
    for _ in range(2):
        found = legs.hear(reads, silent=others)
        np.testing.assert_allclose(np.delete(found, [*others]), np.delete(PARKED, [*others]), atol=1e-12)
    np.testing.assert_allclose(legs.hear(reads), PARKED, atol=1e-12)
    assert legs.homing.known


def test_brakes_once_open_count_as_open_until_a_reset():
    legs = Leg()
    legs.hear(forgotten(PARKED))
    assert not legs.homing.opened
    for braked in (False, False, True, True, False, True):
        legs.hear(forgotten(PARKED), braked=braked)
        assert legs.homing.opened
    legs.homing.reset()
    legs.hear(forgotten(PARKED))
    assert not legs.homing.opened


def test_reset_clears_the_refusal_of_a_drive_with_unknown_motor_turns():
    legs = Leg()
    legs.hear(forgotten(PARKED), braked=False)
    for _ in range(SILENT_TICKS + 2):
        legs.hear(forgotten(PARKED), silent=(4,), braked=False)
    assert "leg 4: its drive was switched off" in legs.homing.refusal
    legs.homing.reset()
    assert not legs.homing.refusal
    legs.number, legs.last = -1, new_record()
    np.testing.assert_allclose(legs.hear(forgotten(PARKED)), PARKED, atol=1e-12)
    assert legs.homing.known
