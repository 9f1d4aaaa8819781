"""What a tick measures of motor drives, by what each of their frames says and when it comes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.motor_kernels import wire_state
from drivers.protocol import Frame, Received
from drivers.signals import NEVER, DriveMode, DriveState, Foreign
from tests.drivers.motor_families import Heard, last_tick
from tests.drivers.spoken_drives import RUNNING, SINCE_NS, Spoken, feedback

OFF, READY, RUN, FAULT, BOOT = (DriveState[name] for name in ("OFF", "READY", "RUN", "FAULT", "BOOT"))
KEPT = ("length", "rate", "drive_force", "drive_state", "drive_fault")
LATE = SINCE_NS - 1


def length(turns: float, leg: int) -> float:
    return float(Spoken().transmission.length(np.full(6, turns))[leg])


def test_tick_without_frames_keeps_the_measurement_and_counts_nothing():
    tick, dialogue = Spoken().told()
    for name in KEPT:
        assert tick[name].tolist() == last_tick()[name].tolist()
    assert tick["blind"].tolist() == [0] * 6
    assert [int(tick[name]) for name in ("rejected", "doubled", "foreign")] == [0, 0, 0]
    assert dialogue == Spoken().begun(owed=(1,) * 6)


def test_ages_grow_by_the_ticks_since_the_last_one_up_to_never_and_an_answer_makes_its_own_zero():
    tick, _ = Spoken().told(feedback(2), last=last_tick(10, [0, 2, 5, NEVER, NEVER - 2, 1]), number=13)
    assert tick["age"].tolist() == tick["counted_age"].tolist() == [3, 5, 0, NEVER, NEVER, 4]
    for before, grown in ((-1, 1), (0, 13)):
        tick, _ = Spoken().told(last=last_tick(before, [0, 1, 2, 3, 4, 5]))
        assert tick["age"].tolist() == [grown + k for k in range(6)], "of a first tick"


@pytest.mark.parametrize("leg", range(6))
def test_answer_measures_its_leg_through_its_transmission_and_no_other(leg):
    protocol = Spoken()
    tick, dialogue = protocol.told(feedback(leg, 0.5, 0.25, torque=1.5, power=int(FAULT), fault=7))
    t, six = protocol.transmission, np.ones(6)
    measured = {
        "length": t.length(0.5 * six)[leg],
        "rate": t.rate(0.25 * six)[leg],
        "drive_force": t.force(1.5 * six, t.rate(0.25 * six))[leg],
        "drive_fault": 7,
    }
    for name, value in measured.items():
        expected = last_tick()[name].copy()
        expected[leg] = value
        assert tick[name].tolist() == expected.tolist(), name
    assert dialogue.rate == tuple(tick["rate"].tolist())
    assert (
        tick["drive_state"].tolist() == list(dialogue.power) == [FAULT if k == leg else OFF for k in range(6)]
    )
    assert dialogue.said == tuple(13 if k == leg else 0 for k in range(6))


def test_answer_without_motion_is_blind_and_one_without_torque_leaves_the_force():
    tick, _ = Spoken().told(feedback(4, motion=None, torque=1.5), feedback(1), feedback(0, torque=0.0))
    assert tick["blind"].tolist() == [0, 0, 0, 0, 1, 0]
    assert tick["age"].tolist() == [0, 0, 1, 1, 1, 1]
    for name in ("length", "rate"):
        assert tick[name][4] == last_tick()[name][4]
    assert tick["drive_force"].tolist() == [0.0, *last_tick()["drive_force"][1:].tolist()]


def test_broken_and_foreign_frames_are_counted_and_say_nothing():
    broken = feedback(2, broken=True, power=int(FAULT), fault=7)
    foreign = Heard(2, foreign=True, power=int(RUN))
    for words, rejected, name in (((broken,) * 3, 3, 0), ((foreign, None), 0, Foreign.COMMAND)):
        tick, dialogue = Spoken().told(*words)
        assert (tick["rejected"], tick["foreign"]) == (rejected, name)
        assert tick["age"].tolist() == [1] * 6
        assert dialogue == Spoken().begun(owed=(1,) * 6)
    tick, _ = Spoken().told(None, feedback(5), broken, feedback(0))
    assert tick["age"].tolist() == [0, 1, 1, 1, 1, 0], "the next ones count"


# late answers


def test_answer_from_the_beginning_of_the_tick_is_its_own_and_one_from_before_is_not():
    for t_ns, age, rejected in ((SINCE_NS, 0, 0), (LATE, 1, 1)):
        tick, _ = Spoken().told((t_ns, feedback(3)))
        assert (tick["age"][3], tick["rejected"]) == (age, rejected)


@pytest.mark.parametrize("leg", range(6))
def test_late_answer_that_its_drive_owed_measures_at_its_age_and_another_does_not(leg):
    for owed in (0, 1, 2):
        ages = [owed if each == leg else 0 for each in range(6)]
        tick, _ = Spoken().told((LATE, feedback(leg, 0.5)), last=last_tick(10, ages), number=14)
        assert tick["length"][leg] == (length(0.5, leg) if owed else last_tick()["length"][leg])
        assert tick["age"].tolist() == [4] * 6, "of the tick before, which is four ago"
        assert tick["rejected"] == 1


def test_late_answer_is_not_taken_in_the_first_tick_nor_without_motion():
    for before, measured in ((-1, False), (0, True)):
        tick, _ = Spoken().told((LATE, feedback(1, 0.5)), last=last_tick(before, NEVER), number=1)
        assert (tick["length"][1] != last_tick()["length"][1]) == measured
        assert tick["age"][1] == (1 if measured else NEVER)
    tick, _ = Spoken().told((LATE, feedback(1, motion=None)), last=last_tick(10, 3), number=12)
    assert tick["age"].tolist() == [5] * 6
    assert tick["blind"].tolist() == [0, 1, 0, 0, 0, 0]


def test_of_a_late_answer_and_one_in_time_the_one_in_time_counts():
    late, there = (LATE, feedback(1, 0.5)), (SINCE_NS, feedback(1, 0.25))
    for words in ((late, there), (there, late)):
        tick, _ = Spoken().told(*words, last=last_tick(10, 3))
        assert (tick["length"][1], tick["age"][1]) == (length(0.25, 1), 0)


@pytest.mark.parametrize(
    ("done", "unasked_s", "counted"), [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 2), (3, 0.01, 0)]
)
def test_late_answers_are_counted_of_a_drive_that_is_set_up_and_sends_none_unasked(done, unasked_s, counted):
    protocol, late = Spoken(exchanges=2, unasked_s=unasked_s), (LATE, feedback(3))
    tick, _ = protocol.told(late, late, (LATE, feedback(2)), done=(0, 0, 0, done, 0, 0))
    assert tick["rejected"] == counted


# doubled and owed answers


@pytest.mark.parametrize("leg", [1, 4])
def test_second_answer_is_doubled_where_it_says_something_else_and_the_first_counts(leg):
    protocol = Spoken()
    for other in (feedback(leg, 0.25), feedback(leg, 0.5, 0.25)):
        tick, _ = protocol.told(feedback(leg, 0.5), other, feedback(5 - leg))
        assert (tick["doubled"], tick["length"][leg]) == (1 << leg, length(0.5, leg))
    tick, _ = protocol.told(feedback(leg, 0.5), feedback(leg, 0.5))
    assert tick["doubled"] == 0, "the same again"
    both = feedback(1), feedback(4), feedback(1, 0.25), feedback(4, speed=0.25)
    assert protocol.told(*both)[0]["doubled"] == 1 << 1 | 1 << 4


def test_second_answer_counts_where_the_drive_owed_one_or_sends_unasked():
    for protocol, owed in ((Spoken(), (0, 0, 1, 0, 0, 0)), (Spoken(unasked_s=0.01), (0,) * 6)):
        tick, _ = protocol.told(feedback(2, 0.5), feedback(2, 0.25), owed=owed)
        assert (tick["doubled"], tick["length"][2]) == (0, length(0.25, 2))


def test_drive_owes_what_it_was_asked_for_up_to_twenty_ticks():
    words = feedback(4, 0.5), feedback(4, 0.25), (LATE, feedback(3)), (LATE, feedback(5)), feedback(5)
    _, dialogue = Spoken().told(*words, done=(0, 1, 1, 1, 1, 1), owed=(5, 0, 19, 20, 3, 0))
    assert dialogue.owed == (0, 1, 20, 20, 2, 0)


def test_drive_not_heard_before_may_send_one_answer_more_than_polls():
    two = feedback(2, 0.5), feedback(2, 0.25)
    assert Spoken().told(*two, done=(0,) * 6)[0]["doubled"] == 0
    tick, dialogue = Spoken().told(*two, feedback(2, 0.75), done=(0,) * 6)
    assert (tick["doubled"], dialogue.owed) == (1 << 2, (0,) * 6)


# states


def test_frame_of_the_state_alone_measures_nothing_and_its_drive_stays_unanswered():
    tick, dialogue = Spoken().told(Heard(4, power=int(FAULT), fault=8), Heard(4, power=int(FAULT), fault=9))
    assert (tick["age"].tolist(), tick["doubled"]) == ([1] * 6, 0)
    assert (dialogue.power[4], dialogue.said[4], tick["drive_fault"][4]) == (FAULT, 13, 9)
    assert tick["drive_state"].tolist() == [OFF, OFF, OFF, OFF, FAULT, OFF]
    for name in ("length", "rate", "drive_force"):
        assert tick[name].tolist() == last_tick()[name].tolist()
    assert Spoken().told(Heard(4, power=int(OFF)))[1].said == (0, 0, 0, 0, 13, 0), "the same again"


def test_feedback_without_a_state_keeps_the_fault_and_one_without_a_fault_ends_it():
    tick, dialogue = Spoken().told(feedback(4, power=None, fault=9))
    assert (dialogue.power, dialogue.said) == ((int(OFF),) * 6, (0,) * 6)
    assert tick["drive_fault"].tolist() == last_tick()["drive_fault"].tolist()
    assert tick["age"][4] == 0
    for power in (OFF, RUN):
        assert Spoken().told(feedback(4, power=int(power)))[0]["drive_fault"].tolist() == [0, 1, 2, 3, 0, 5]


@pytest.mark.parametrize(("mode", "power"), [(m, RUN if m == DriveMode.RUN else OFF) for m in DriveMode])
def test_drive_that_never_reports_is_what_it_is_asked_for_or_faulted(mode, power):
    words = feedback(1, power=None), feedback(2, power=int(FAULT), fault=9)
    _, dialogue = Spoken(reports=False).told(*words, mode=int(mode), power=(0,) * 6)
    assert dialogue.power == (0, power, FAULT, 0, 0, 0)


def test_each_drive_is_in_boot_until_it_is_set_up_and_has_reported_its_state():
    power = tuple(map(int, (OFF, OFF, BOOT, RUN, FAULT, OFF)))
    tick, _ = Spoken(exchanges=2).told(feedback(0, power=None), done=(3, 2, 3, 1, 1, 0), power=power)
    assert tick["drive_state"].tolist() == [OFF, BOOT, BOOT, RUN, FAULT, BOOT]
    _, dialogue = Spoken(exchanges=2).told(*map(feedback, range(6)), done=(0, 1, 2, 3, 0, 0))
    assert dialogue.done == (1, 1, 2, 3, 1, 1), "heard for the first time, or farther on"


def test_each_drive_is_set_up_by_its_own_number_of_exchanges():
    protocol, once = Spoken(exchanges=(0, 1, 2, 0, 1, 0)), (1,) * 6
    tick, _ = protocol.told(*((LATE, feedback(leg)) for leg in range(6)), done=once)
    assert tick["rejected"] == 3, "of the drives without an exchange"
    tick, dialogue = protocol.told(*map(feedback, range(6)), done=once)
    assert tick["drive_state"].tolist() == [OFF, BOOT, BOOT, OFF, BOOT, OFF]
    assert protocol.legs_set_up(dialogue) == (True, False, False, True, False, True)
    _, dialogue = protocol.told(*(Heard(leg, answer=(10, 0.1 + 10 * leg)) for leg in range(6)), done=once)
    assert dialogue.done == (1, 2, 2, 1, 2, 1)


def test_drive_that_ran_and_is_off_while_run_is_asked_for_has_restarted():
    power = tuple(map(int, (RUN, OFF, RUN, OFF, FAULT, OFF)))
    ran = (False, False, True, True, False, False)
    for mode, expected in (
        (DriveMode.RUN, (True, False, True, True, False, False)),
        (DriveMode.READY, (False,) * 6),
    ):
        assert Spoken().told(feedback(5), mode=int(mode), power=power, ran=ran)[1].ran == expected
    tick, dialogue = Spoken().told(feedback(3), **RUNNING)
    assert tick["drive_state"].tolist() == [RUN, RUN, RUN, BOOT, RUN, RUN]
    assert dialogue.ran == (True,) * 6, "until RUN is asked for again"
    ran = (False, True, False, True, True, False)
    tick, _ = Spoken().told(feedback(0), mode=int(DriveMode.RUN), ran=ran)
    assert tick["drive_state"].tolist() == [BOOT if each else READY for each in ran]


@pytest.mark.parametrize("mode", DriveMode)
def test_state_follows_from_what_a_drive_says_and_is_asked_for(mode):
    for ran in (False, True):
        for set_up in (False, True):
            for power in (RUN, FAULT):
                assert wire_state(power, mode, set_up=set_up, ran=ran) == power
        assert wire_state(OFF, mode, set_up=False, ran=ran) == BOOT
        disabled = {
            DriveMode.OFF: OFF,
            DriveMode.RESET: OFF,
            DriveMode.READY: READY,
            DriveMode.RUN: (READY, BOOT)[ran],
        }
        assert wire_state(OFF, mode, set_up=True, ran=ran) == disabled[mode]


@pytest.mark.parametrize(("age", "done"), [(19, 3), (20, 0)])
def test_drive_silent_for_more_than_twenty_ticks_is_set_up_again_and_no_other(age, done):
    _, dialogue = Spoken(exchanges=2).told(last=last_tick(age=[0, 0, 0, age, 0, 0]), done=(0, 3, 3, 3, 3, 3))
    assert dialogue.done == (0, 3, 3, done, 3, 3)


def test_state_is_unknown_once_its_report_is_older_than_its_patience():
    _, dialogue = Spoken().told(power=(int(RUN),) * 6, said=(1, 2, 3, 4, 5, 6), patience_ticks=10)
    assert dialogue.power == (BOOT, BOOT, RUN, RUN, RUN, RUN)


def test_fresh_awaited_and_sender_follow_from_what_a_frame_says():
    protocol = Spoken()
    words: list[Any] = [feedback(0), Heard(3, power=int(OFF)), None, feedback(5), Heard(3, foreign=True)]
    frames = [protocol.word(each) for each in words]
    assert [protocol.awaited(each) for each in frames] == [0, -1, -1, 5, -1]
    assert [protocol.sender(each) for each in frames] == [0, 3, -1, 5, -1]
    assert [protocol.fresh(Received(SINCE_NS, each), 13, SINCE_NS) for each in frames[:3]] == [
        True,
        False,
        False,
    ]
    assert not protocol.fresh(Received(LATE, frames[0]), 13, SINCE_NS)
    assert [protocol.addressed(Frame(each, b"")) for each in (0x100, 0x105, 0x106)] == [(0,), (5,), ()]
