"""Turns that drives forget at power-off are found from where the legs were parked, or the leg is refused."""

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
"""How many whole turns each drive has forgotten."""
PERIOD_S = 0.0025


class Leg:
    """Six drives that report `reported`, tick by tick."""

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
        """(6,) m, what the decoder saw of the last tick."""
        record, integers = self.homing.record, [INTEGER] * 6
        record["decode"], self._reading = of_python(self._read, *integers)
        record["correct"], self._correcting = of_python(self._correct, INTEGER)

    def _read(self, _codec, _frames, _count, _since_ns, last, tick):
        """Decode: a silent leg keeps the length that it reported last."""
        self.seen = tick_at(last)["length"].copy()
        quiet = list(self.silent)
        tick_at(tick)["length"][quiet] = self.seen[quiet]
        return 0

    def _correct(self, tick):
        self.homing.correct(tick_at(tick), self.last, braked=bool(self.homing.record["braked"]))
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


def test_whole_turns_are_added_to_the_length_that_is_read():
    legs = Leg()
    here = PARKED + 0.9 * LIMIT * np.array([1, -1, 1, -1, 1, -1])
    found = legs.hear(forgotten(here))
    np.testing.assert_allclose(found, here, atol=1e-12)
    assert legs.homing.known
    assert not legs.homing.refusal
    assert unwrapped_turns(legs.homing, legs.pose) == (TURNS * SIGN).tolist()


def test_a_motor_to_which_no_turn_is_added_says_0_whatever_its_sign():
    legs = Leg()
    legs.hear(PARKED)
    assert [f"{turns:g}" for turns in unwrapped_turns(legs.homing, legs.pose)] == ["0"] * 6


def test_a_third_of_a_turn_is_said_to_six_digits():
    legs = Leg(m_per_turn=3.0 * STEP)
    legs.hear(forgotten(PARKED))
    assert unwrapped_turns(legs.homing, legs.pose) == [2.333333, -1.0, 4.0, 0.0, -0.333333, 33.333333]


def test_the_turn_stays_while_the_leg_moves_on_past_many_turns():
    legs = Leg()
    legs.hear(forgotten(PARKED))
    moved = PARKED.copy()
    for _ in range(100):
        moved = moved + 5e-4
        found = legs.hear(forgotten(moved), braked=False, rate=5e-4 / PERIOD_S)
    np.testing.assert_allclose(found, moved, atol=1e-12)
    assert legs.homing.known


def test_the_decoder_sees_the_lengths_that_the_drives_reported():
    legs = Leg()
    legs.hear(forgotten(PARKED))
    found = legs.hear(forgotten(PARKED), silent=(3,))
    np.testing.assert_array_equal(legs.seen, forgotten(PARKED))
    np.testing.assert_allclose(found, PARKED, atol=1e-12)


@pytest.mark.parametrize("leg", range(6))
def test_a_leg_that_is_elsewhere_is_refused_by_its_name_with_both_lengths_and_the_turns(leg):
    legs = Leg()
    here = PARKED.copy()
    here[leg] += 0.3 * STEP[leg]
    legs.hear(forgotten(here))
    said = legs.homing.refusal
    assert not legs.homing.known
    assert said.startswith(
        f"leg {leg} is {here[leg]:.6f} m long, and was {PARKED[leg]:.6f} m (parked 2026-01-02)"
    )
    assert f"{-0.3 * SIGN[leg]:+.3f} turns of its motor" in said
    assert "`hil homing a.yaml --leg LEG LENGTH`" in said


def test_a_leg_that_comes_back_to_where_it_was_is_taken():
    legs = Leg()
    here = PARKED.copy()
    here[2] += 0.3 * STEP[2]
    legs.hear(forgotten(here))
    legs.hear(forgotten(PARKED))
    assert legs.homing.known


def test_turns_are_not_known_before_all_six_legs_are_heard():
    legs = Leg()
    legs.hear(forgotten(PARKED), silent=(5,))
    assert not legs.homing.known
    assert not legs.homing.refusal


@pytest.mark.parametrize("silent_ticks", [0, SILENT_TICKS + 1])
def test_a_drive_that_was_switched_off_behind_its_brake_is_found_again(silent_ticks):
    legs = Leg()
    legs.hear(forgotten(PARKED))
    for _ in range(silent_ticks):
        legs.hear(forgotten(PARKED), silent=(4,))
    reads = forgotten(PARKED)
    reads[4] += 3 * STEP[4]
    found = legs.hear(reads)
    np.testing.assert_allclose(found, PARKED, atol=1e-12)
    assert legs.homing.known


@pytest.mark.parametrize("silent_ticks", [0, SILENT_TICKS + 1])
def test_a_drive_that_was_switched_off_with_its_brake_open_is_lost(silent_ticks):
    legs = Leg()
    legs.hear(forgotten(PARKED))
    for _ in range(silent_ticks + 1):
        legs.hear(forgotten(PARKED), silent=(4,), braked=False)
    reads = forgotten(PARKED)
    reads[4] += 3 * STEP[4]
    legs.hear(reads, braked=False)
    legs.hear(reads)
    assert not legs.homing.known
    assert "leg 4: its drive was switched off" in legs.homing.refusal


@pytest.mark.parametrize(("ticks", "known"), [(20, True), (21, False)])
def test_a_drive_that_was_silent_for_20_ticks_keeps_its_turn_and_for_one_more_may_have_been_off(ticks, known):
    legs = Leg()
    legs.hear(forgotten(PARKED))
    for _ in range(ticks):
        legs.hear(forgotten(PARKED), silent=(1,), braked=False)
    np.testing.assert_allclose(legs.hear(forgotten(PARKED), braked=False), PARKED, atol=1e-12)
    assert legs.homing.known is known
    assert ("leg 1: its drive was switched off, or silent for 20 ticks" in legs.homing.refusal) is not known


def test_a_drive_whose_position_ends_inside_the_stroke_is_refused():
    ends = np.full(6, 0.0), np.full(6, 0.6)
    legs = Leg(Stroke(0.2, 0.5, ends))
    legs.hear(forgotten(PARKED))
    assert (
        "leg 5: its drive was switched on where its position ends at leg lengths of 0.2500 and 0.8500 m"
        in (legs.homing.refusal)
    )


def test_both_ends_of_the_stroke_count():
    legs = Leg(Stroke(0.3, 0.595, (np.full(6, 0.0), np.full(6, 0.6))))
    legs.hear(PARKED + 3 * STEP * (np.arange(6) == 1))
    assert (
        "leg 1: its drive was switched on where its position ends at leg lengths of -0.0075 and 0.5925 m"
        in (legs.homing.refusal)
    )


@pytest.mark.parametrize(
    ("low", "high", "known"),
    [(0.25, 0.5, True), (0.25 + 2**-20, 0.5, False), (0.25, 0.5 - 2**-20, False)],
)
def test_a_position_that_ends_where_the_stroke_does_is_long_enough_to_the_last_bit(low, high, known):
    for leg in range(6):
        only = np.arange(6) == leg
        legs = Leg(Stroke(0.25, 0.5, (np.where(only, low, 0.0), np.where(only, high, 1.0))))
        legs.hear(PARKED)
        assert legs.homing.known is known


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_leg_beyond_the_limit_is_refused_whether_it_has_got_longer_or_shorter(leg, side):
    legs = Leg()
    legs.hear(forgotten(PARKED + side * 1.1 * LIMIT * (np.arange(6) == leg)))
    assert f"leg {leg} is" in legs.homing.refusal
    assert f"{side * 1.1e3 * LIMIT:+.3f} mm, allowed" in legs.homing.refusal
    assert not legs.homing.known


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_leg_may_be_as_far_from_where_it_was_as_its_limit_to_the_last_bit(leg, side):
    limits, there = 2.0**-12 * np.array([3, 1, 6, 2, 5, 4]), np.full(6, 0.25)
    for beyond, known in ((0.0, True), (2.0**-40, False)):
        legs = Leg(length=there, limit_m=limits, step_m=np.full(6, 2.0**-8))
        legs.hear(there + side * (limits[leg] + beyond) * (np.arange(6) == leg))
        assert legs.homing.known is known


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_half_a_turn_to_the_last_bit_is_a_leap_and_a_bit_less_is_none(side):
    there = np.full(6, 0.25)
    for short, known in ((0.0, False), (2.0**-40, True)):
        legs = Leg(length=there, step_m=np.full(6, 2.0**-8))
        legs.hear(there, braked=False)
        legs.hear(there + side * (2.0**-9 - short) * (np.arange(6) == 4), braked=False)
        assert legs.homing.known is known


def test_a_leg_that_moves_by_most_of_a_turn_a_tick_is_followed_by_its_rate():
    legs = Leg()
    moved = PARKED.copy()
    for speed in (0.0, 0.4, 0.8, 0.8, 0.8, 0.4, 0.0):
        moved = moved + speed * PERIOD_S
        found = legs.hear(forgotten(moved), braked=False, rate=speed)
    np.testing.assert_allclose(found, moved, atol=1e-12)
    assert legs.homing.known


def test_after_a_silent_tick_the_rate_leads_over_the_time_of_both():
    """0.75 of a turn a tick: after two the reading is a turn and a half from the last one."""
    legs = Leg()
    legs.hear(forgotten(PARKED), braked=False, rate=0.75)
    legs.hear(forgotten(PARKED), braked=False, rate=0.75, silent=range(6))
    moved = PARKED + 0.75 * 2 * PERIOD_S
    found = legs.hear(forgotten(moved), braked=False, rate=0.75)
    np.testing.assert_allclose(found, moved, atol=1e-12)
    assert legs.homing.known
    assert not legs.homing.refusal


@pytest.mark.parametrize("leg", range(6))
def test_each_leg_is_led_by_its_own_rate_over_its_own_silence(leg):
    """0.7 of a turn a tick, each leg as fast as its step is long; the others are heard in every tick."""
    legs, speed, moved = Leg(), 0.7 * STEP / PERIOD_S, PARKED.copy()
    legs.hear(forgotten(moved), braked=False, rate=speed)
    for changes in ({"silent": (leg,)}, {}, {"silent": (leg,)}, {"silent": (leg,)}, {"late": (leg,)}, {}):
        moved = moved + speed * PERIOD_S
        reads = moved - speed * PERIOD_S * (np.arange(6) == leg) * ("late" in changes)
        legs.hear(forgotten(reads), braked=False, rate=speed, **changes)
    np.testing.assert_allclose(legs.last["length"], moved, atol=1e-12)
    assert legs.homing.known
    assert not legs.homing.refusal


@pytest.mark.parametrize(("old", "known"), [(1, True), (2, False)])
def test_a_first_reading_tells_the_turn_if_it_is_a_tick_old_and_not_if_it_is_older(old, known):
    legs = Leg()
    legs.hear(forgotten(PARKED), late=(3,), by=old)
    assert legs.homing.known is known
    legs.hear(forgotten(PARKED))
    assert legs.homing.known


@pytest.mark.parametrize("skipped", [1, 2, 4])
def test_after_skipped_ticks_the_rate_leads_over_all_of_their_time(skipped):
    """The loop was held up; 0.75 of a turn a tick."""
    legs = Leg()
    legs.hear(forgotten(PARKED), braked=False, rate=0.75)
    moved = PARKED + 0.75 * (1 + skipped) * PERIOD_S
    found = legs.hear(forgotten(moved), braked=False, rate=0.75, skipped=skipped)
    np.testing.assert_allclose(found, moved, atol=1e-12)
    assert legs.homing.known


def test_a_reading_that_is_a_tick_old_is_where_the_rate_leads_until_then():
    legs = Leg()
    legs.hear(forgotten(PARKED), braked=False, rate=0.75)
    for _ in range(2):
        legs.hear(forgotten(PARKED), braked=False, rate=0.75, silent=range(6))
    moved = PARKED + 0.75 * 2 * PERIOD_S
    found = legs.hear(forgotten(moved), braked=False, rate=0.75, late=range(6))
    np.testing.assert_allclose(found, moved, atol=1e-12)
    assert legs.homing.known


@pytest.mark.parametrize(("share", "known"), [(0.49, True), (-0.49, True), (0.51, False), (-0.51, False)])
def test_half_a_turn_from_where_the_rate_leads_is_a_leap(share, known):
    legs = Leg()
    legs.hear(forgotten(PARKED), braked=False)
    legs.hear(forgotten(PARKED + share * STEP * (np.arange(6) == 2)), braked=False)
    assert legs.homing.known is known
    assert ("leg 2: its drive was switched off" in legs.homing.refusal) is not known


def test_a_drive_switched_off_behind_its_brake_is_found_where_it_was_last_and_not_where_it_was_parked():
    legs = Leg()
    moved = PARKED.copy()
    legs.hear(forgotten(moved), braked=False)
    for _ in range(3):
        moved = moved + 0.2 * STEP[0]
        legs.hear(forgotten(moved), braked=False)
    reads = forgotten(moved)
    reads[5] -= 8 * STEP[5]
    np.testing.assert_allclose(legs.hear(reads), moved, atol=1e-12)
    assert legs.homing.known


def test_a_leg_that_is_lost_stays_lost_and_the_others_keep_their_turns():
    legs = Leg()
    legs.hear(forgotten(PARKED))
    reads = forgotten(PARKED)
    reads[3] += 2 * STEP[3]
    legs.hear(reads, braked=False)
    before = legs.homing.added.copy()
    for _ in range(3):
        legs.hear(forgotten(PARKED))
    assert legs.homing.refusal.startswith("leg 3: its drive was switched off")
    assert not legs.homing.known
    np.testing.assert_array_equal(legs.homing.added, before)


def test_a_reset_forgets_what_was_found_what_disagreed_and_whose_turn_was_lost():
    legs = Leg()
    legs.hear(forgotten(PARKED), braked=False)
    assert legs.homing.opened
    for _ in range(SILENT_TICKS + 2):
        legs.hear(forgotten(PARKED), silent=(4,), braked=False)
    assert "leg 4: its drive was switched off" in legs.homing.refusal
    legs.homing.reset()
    assert not legs.homing.refusal
    assert vars(legs.homing).keys() == vars(Leg().homing).keys()
    for name, value in vars(Leg().homing).items():
        if name not in {"_pose", "_stroke", "_period_s", "record"}:
            np.testing.assert_array_equal(getattr(legs.homing, name), value, err_msg=name)
    assert not legs.homing.opened
    assert not legs.homing.record["wrong"].any()
    legs.number, legs.last = -1, new_record()
    np.testing.assert_allclose(legs.hear(forgotten(PARKED)), PARKED, atol=1e-12)
    assert legs.homing.known


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("ticks", [1, 3 * SILENT_TICKS])
def test_a_drive_that_is_heard_later_than_the_others_is_found_where_its_leg_was_parked(leg, ticks):
    legs = Leg()
    for _ in range(ticks):
        legs.hear(forgotten(PARKED), silent=(leg,))
    np.testing.assert_allclose(legs.hear(forgotten(PARKED)), PARKED, atol=1e-12)
    assert legs.homing.known


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("silent", range(6))
def test_a_drive_that_is_switched_off_before_another_one_was_ever_heard_is_found_again(leg, silent):
    legs, others = Leg(), {silent} - {leg}
    legs.hear(forgotten(PARKED), silent=others)
    reads = forgotten(PARKED) + 4 * STEP * (np.arange(6) == leg)
    for _ in range(2):
        found = legs.hear(reads, silent=others)
        np.testing.assert_allclose(np.delete(found, [*others]), np.delete(PARKED, [*others]), atol=1e-12)
    np.testing.assert_allclose(legs.hear(reads), PARKED, atol=1e-12)
    assert legs.homing.known


def test_drives_that_forget_nothing_are_left_alone():
    homing = Homing(None, Stroke(0.2, 0.5, None), PERIOD_S)
    tick = new_record()
    tick["length"] = 0.123
    homing.correct(tick, new_record(), braked=False)
    assert homing.known
    assert (tick["length"] == 0.123).all()


def test_brakes_that_have_been_open_once_have_been_open_until_a_reset():
    legs = Leg()
    legs.hear(forgotten(PARKED))
    assert not legs.homing.opened
    for braked in (False, False, True, True, False, True):
        legs.hear(forgotten(PARKED), braked=braked)
        assert legs.homing.opened
    legs.homing.reset()
    legs.hear(forgotten(PARKED))
    assert not legs.homing.opened


def test_of_each_leg_that_is_elsewhere_the_refusal_says_by_how_many_millimetres_and_what_is_allowed():
    legs = Leg()
    legs.hear(forgotten(PARKED) + 5e-4 * (np.arange(6) == 1) - 6e-4 * (np.arange(6) == 4))
    for what in ("leg 1 is", "+0.500 mm, allowed: 0.2 mm", "leg 4 is", "-0.600 mm, allowed: 0.2 mm"):
        assert what in legs.homing.refusal
