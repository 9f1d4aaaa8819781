"""What a tick measures of motor drives, by what each of their frames says and when it comes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.protocol import Frame, Received
from drivers.signals import NEVER, DriveMode, DriveState, Foreign
from tests.drivers.motor_families import Heard
from tests.drivers.spoken_drives import RUNNING, SINCE_NS, Spoken, feedback, last_tick

OFF, RUN, FAULT, BOOT = DriveState.OFF, DriveState.RUN, DriveState.FAULT, DriveState.BOOT
KEPT = ("length", "rate", "drive_force", "drive_state", "drive_fault")
LATE = SINCE_NS - 1


def test_a_tick_without_frames_keeps_the_measurement_and_counts_nothing():
    tick, dialogue = Spoken().told()
    for name in KEPT:
        assert tick[name].tolist() == last_tick()[name].tolist()
    assert tick["blind"].tolist() == [0] * 6
    assert [int(tick[name]) for name in ("rejected", "doubled", "foreign")] == [0, 0, 0]
    assert dialogue == Spoken().begun(owed=(1,) * 6)


def test_ages_grow_by_the_ticks_since_the_last_one_up_to_never_and_an_answer_makes_its_own_zero():
    ages = [0, 2, 5, NEVER, NEVER - 2, 1]
    tick, _ = Spoken().told(feedback(2), last=last_tick(10, ages), number=13)
    assert tick["age"].tolist() == [3, 5, 0, NEVER, NEVER, 4]
    assert tick["counted_age"].tolist() == tick["age"].tolist()


@pytest.mark.parametrize(("before", "grown"), [(-1, 1), (0, 13)])
def test_ages_of_a_first_tick_grow_by_one(before, grown):
    tick, _ = Spoken().told(last=last_tick(before, [0, 1, 2, 3, 4, 5]))
    assert tick["age"].tolist() == [grown + k for k in range(6)]


def test_an_answer_measures_its_leg_through_the_transmission_of_that_leg_and_no_other():
    protocol = Spoken()
    for leg in range(6):
        tick, dialogue = protocol.told(feedback(leg, 0.5, 0.25, torque=1.5, power=int(FAULT), fault=7))
        t, before = protocol.transmission, last_tick()
        six = np.ones(6)
        force = t.force(1.5 * six, t.rate(0.25 * six))
        measured = {
            "length": t.length(0.5 * six)[leg],
            "rate": t.rate(0.25 * six)[leg],
            "drive_force": force[leg],
            "drive_fault": 7,
        }
        for name, value in measured.items():
            expected = before[name].copy()
            expected[leg] = value
            assert tick[name].tolist() == expected.tolist(), name
        assert dialogue.rate == tuple(tick["rate"].tolist())
        assert dialogue.power == tuple(int(FAULT if k == leg else OFF) for k in range(6))
        assert tick["drive_state"].tolist() == list(dialogue.power)
        assert dialogue.said == tuple(13 if k == leg else 0 for k in range(6))


def test_an_answer_without_motion_leaves_its_leg_as_it_was_and_calls_it_blind():
    tick, _ = Spoken().told(feedback(4, motion=None, torque=1.5), feedback(1))
    assert tick["blind"].tolist() == [0, 0, 0, 0, 1, 0]
    assert tick["age"].tolist() == [1, 0, 1, 1, 1, 1]
    for name in ("length", "rate", "drive_force"):
        assert tick[name][4] == last_tick()[name][4]


def test_an_answer_without_a_torque_leaves_the_force_that_was_told_before():
    tick, _ = Spoken().told(feedback(3), feedback(4, torque=0.0))
    assert tick["drive_force"].tolist() == [11.0, 12.0, 13.0, 14.0, 0.0, 16.0]


def test_a_frame_that_cannot_be_trusted_is_counted_and_says_nothing():
    broken = feedback(2, broken=True, power=int(FAULT), fault=7)
    tick, dialogue = Spoken().told(broken, broken, broken)
    assert (tick["rejected"], tick["foreign"]) == (3, 0)
    assert tick["age"].tolist() == [1] * 6
    assert dialogue == Spoken().begun(owed=(1,) * 6)


def test_a_command_of_another_controller_is_named_and_says_nothing_of_the_drive():
    tick, dialogue = Spoken().told(Heard(2, foreign=True, power=int(RUN)), None)
    assert (tick["rejected"], tick["foreign"]) == (0, Foreign.COMMAND)
    assert dialogue == Spoken().begun(owed=(1,) * 6)


def test_after_a_frame_of_nobody_the_next_ones_count():
    tick, _ = Spoken().told(None, feedback(5), None, feedback(0))
    assert tick["age"].tolist() == [0, 1, 1, 1, 1, 0]


def test_an_answer_from_the_very_beginning_of_the_tick_is_its_own_and_one_from_before_is_not():
    for t_ns, age, rejected in ((SINCE_NS, 0, 0), (LATE, 1, 1)):
        tick, _ = Spoken().told((t_ns, feedback(3)))
        assert (tick["age"][3], tick["rejected"]) == (age, rejected)


@pytest.mark.parametrize("leg", range(6))
def test_a_late_answer_that_its_drive_owed_measures_at_its_age_and_one_that_it_did_not_owe_does_not(leg):
    for owed in (0, 1, 2):
        ages = [0] * 6
        ages[leg] = owed
        tick, _ = Spoken().told((LATE, feedback(leg, 0.5)), last=last_tick(10, ages), number=14)
        there = Spoken().transmission.length(np.full(6, 0.5))[leg]
        assert tick["length"][leg] == (there if owed else last_tick()["length"][leg])
        assert tick["age"].tolist() == [4] * 6, "of the tick before, which is four ago"
        assert tick["rejected"] == 1


def test_a_late_answer_of_a_drive_that_was_never_heard_measures_not_before_there_is_a_tick_before():
    for before, measured in ((-1, False), (0, True)):
        tick, _ = Spoken().told((LATE, feedback(1, 0.5)), last=last_tick(before, NEVER), number=1)
        assert (tick["length"][1] != last_tick()["length"][1]) == measured
        assert tick["age"][1] == (1 if measured else NEVER)


def test_a_blind_late_answer_makes_no_leg_fresh():
    tick, _ = Spoken().told((LATE, feedback(1, motion=None)), last=last_tick(10, 3), number=12)
    assert tick["age"].tolist() == [5] * 6
    assert tick["blind"].tolist() == [0, 1, 0, 0, 0, 0]


def test_of_a_late_answer_and_one_in_time_the_one_in_time_counts():
    late, there = (LATE, feedback(1, 0.5)), (SINCE_NS, feedback(1, 0.25))
    for words in ((late, there), (there, late)):
        tick, _ = Spoken().told(*words, last=last_tick(10, 3))
        assert tick["length"][1] == Spoken().transmission.length(np.full(6, 0.25))[1]
        assert tick["age"][1] == 0


@pytest.mark.parametrize(("done", "counted"), [(0, 0), (1, 0), (2, 0), (3, 2)])
def test_late_answers_are_counted_of_a_drive_that_is_set_up_alone(done, counted):
    protocol = Spoken(exchanges=2)
    told = (0, 0, 0, done, 0, 0)
    tick, _ = protocol.told((LATE, feedback(3)), (LATE, feedback(3)), (LATE, feedback(2)), done=told)
    assert tick["rejected"] == counted


def test_each_drive_is_set_up_by_its_own_number_of_exchanges():
    protocol, once = Spoken(exchanges=(0, 1, 2, 0, 1, 0)), (1,) * 6
    tick, _ = protocol.told(*((LATE, feedback(leg)) for leg in range(6)), done=once)
    assert tick["rejected"] == 3, "of the drives without an exchange"
    tick, dialogue = protocol.told(*map(feedback, range(6)), done=once)
    assert tick["drive_state"].tolist() == [OFF, BOOT, BOOT, OFF, BOOT, OFF]
    assert protocol.legs_set_up(dialogue) == (True, False, False, True, False, True)
    _, dialogue = protocol.told(*(Heard(leg, answer=(10, 0.1 + 10 * leg)) for leg in range(6)), done=once)
    assert dialogue.done == (1, 2, 2, 1, 2, 1)


def test_late_answers_of_drives_that_send_unasked_are_not_counted():
    tick, _ = Spoken(unasked_s=0.01).told((LATE, feedback(3)))
    assert tick["rejected"] == 0


def test_a_second_answer_is_doubled_where_it_says_something_else_and_the_first_one_counts():
    for leg in range(6):
        twice = [feedback(each, 0.5) for each in range(6)] * 2
        tick, _ = Spoken().told(*twice, feedback(leg, 0.25), feedback(leg, 0.5))
        assert tick["doubled"] == 1 << leg
        assert tick["length"][leg] == Spoken().transmission.length(np.full(6, 0.5))[leg]
    tick, _ = Spoken().told(*twice, feedback(1, 0.25), feedback(4, speed=0.25))
    assert tick["doubled"] == 1 << 1 | 1 << 4


def test_of_two_answers_the_second_counts_where_the_drive_owed_one_or_sends_unasked():
    for protocol, owed in ((Spoken(), (0, 0, 1, 0, 0, 0)), (Spoken(unasked_s=0.01), (0,) * 6)):
        tick, _ = protocol.told(feedback(2, 0.5), feedback(2, 0.25), owed=owed)
        assert tick["doubled"] == 0
        assert tick["length"][2] == protocol.transmission.length(np.full(6, 0.25))[2]


def test_a_drive_that_is_heard_owes_what_it_was_asked_for_up_to_twenty_ticks_and_another_nothing():
    words = feedback(4, 0.5), feedback(4, 0.25), (LATE, feedback(3)), (LATE, feedback(5)), feedback(5)
    _, dialogue = Spoken().told(*words, done=(0, 1, 1, 1, 1, 1), owed=(5, 0, 19, 20, 3, 0))
    assert dialogue.owed == (0, 1, 20, 20, 2, 0)


def test_of_drives_not_heard_before_one_more_answer_than_polls_is_no_second_node():
    two = feedback(2, 0.5), feedback(2, 0.25)
    assert Spoken().told(*two, done=(0,) * 6)[0]["doubled"] == 0
    tick, dialogue = Spoken().told(*two, feedback(2, 0.75), done=(0,) * 6)
    assert (tick["doubled"], dialogue.owed) == (1 << 2, (0,) * 6)


def test_a_frame_that_tells_the_state_alone_measures_nothing_and_its_drive_stays_unanswered():
    tick, dialogue = Spoken().told(Heard(4, power=int(FAULT), fault=8), Heard(4, power=int(FAULT), fault=9))
    assert tick["age"].tolist() == [1] * 6
    assert tick["doubled"] == 0
    assert (dialogue.power[4], dialogue.said[4], tick["drive_fault"][4]) == (FAULT, 13, 9)
    assert tick["drive_state"].tolist() == [OFF, OFF, OFF, OFF, FAULT, OFF]
    for name in ("length", "rate", "drive_force"):
        assert tick[name].tolist() == last_tick()[name].tolist()


def test_that_a_drive_said_again_the_same_is_remembered_with_the_tick():
    _, dialogue = Spoken().told(Heard(4, power=int(OFF)))
    assert dialogue.said == (0, 0, 0, 0, 13, 0)


def test_feedback_that_tells_no_state_leaves_state_and_fault_as_they_were():
    tick, dialogue = Spoken().told(feedback(4, power=None, fault=9))
    assert (dialogue.power, dialogue.said) == ((int(OFF),) * 6, (0,) * 6)
    assert tick["drive_fault"].tolist() == last_tick()["drive_fault"].tolist()
    assert tick["age"][4] == 0


def test_a_drive_that_says_its_state_and_no_fault_has_none_any_more():
    for power in (OFF, RUN):
        tick, _ = Spoken().told(feedback(4, power=int(power)))
        assert tick["drive_fault"].tolist() == [0, 1, 2, 3, 0, 5]


@pytest.mark.parametrize(("mode", "power"), [(m, RUN if m == DriveMode.RUN else OFF) for m in DriveMode])
def test_a_drive_that_never_tells_is_what_it_is_asked_for_where_it_answers_and_faulted_where_it_says_so(
    mode, power
):
    words = feedback(1, power=None), feedback(2, power=int(FAULT), fault=9)
    _, dialogue = Spoken(reports=False).told(*words, mode=int(mode), power=(0,) * 6)
    assert dialogue.power == (0, power, FAULT, 0, 0, 0)


def test_a_drive_that_is_heard_for_the_first_time_is_noted_and_one_farther_on_stays_there():
    _, dialogue = Spoken(exchanges=2).told(*map(feedback, range(6)), done=(0, 1, 2, 3, 0, 0))
    assert dialogue.done == (1, 1, 2, 3, 1, 1)


def test_each_drive_is_in_boot_until_it_is_set_up_and_has_said_whether_it_is_enabled():
    power = tuple(map(int, (OFF, OFF, BOOT, RUN, FAULT, OFF)))
    tick, _ = Spoken(exchanges=2).told(feedback(0, power=None), done=(3, 2, 3, 1, 1, 0), power=power)
    assert tick["drive_state"].tolist() == [OFF, BOOT, BOOT, RUN, FAULT, BOOT]


def test_which_drives_ran_is_remembered_while_run_is_asked_for():
    power = tuple(map(int, (RUN, OFF, RUN, OFF, FAULT, OFF)))
    ran = (False, False, True, True, False, False)
    for mode, expected in (
        (DriveMode.RUN, (True, False, True, True, False, False)),
        (DriveMode.READY, (False,) * 6),
    ):
        _, dialogue = Spoken().told(feedback(5), mode=int(mode), power=power, ran=ran)
        assert dialogue.ran == expected


def test_a_drive_that_ran_and_says_while_run_is_asked_for_that_it_is_off_has_restarted():
    tick, dialogue = Spoken().told(feedback(3), **RUNNING)
    assert tick["drive_state"].tolist() == [RUN, RUN, RUN, BOOT, RUN, RUN]
    assert dialogue.ran == (True,) * 6, "until RUN is asked for anew"


def test_of_drives_that_are_off_while_run_is_asked_for_those_that_ran_have_restarted():
    ran = (False, True, False, True, True, False)
    tick, _ = Spoken().told(feedback(0), mode=int(DriveMode.RUN), ran=ran)
    assert tick["drive_state"].tolist() == [BOOT if each else DriveState.READY for each in ran]


@pytest.mark.parametrize(("age", "done"), [(19, 3), (20, 0)])
def test_a_drive_that_was_silent_for_more_than_twenty_ticks_is_set_up_anew_and_no_other(age, done):
    _, dialogue = Spoken(exchanges=2).told(last=last_tick(age=[0, 0, 0, age, 0, 0]), done=(0, 3, 3, 3, 3, 3))
    assert dialogue.done == (0, 3, 3, done, 3, 3)


def test_what_a_drive_said_counts_for_its_patience_and_then_nobody_knows_what_it_does():
    said = (1, 2, 3, 4, 5, 6)
    _, dialogue = Spoken().told(power=(int(RUN),) * 6, said=said, patience_ticks=10)
    assert dialogue.power == (BOOT, BOOT, RUN, RUN, RUN, RUN)


def test_fresh_is_an_answer_from_the_beginning_of_the_tick_on_and_no_other_frame():
    protocol = Spoken()
    answer, other = protocol.word(feedback(0)), protocol.word(Heard(3, power=int(OFF)))
    nobody = protocol.word(None)
    assert [protocol.awaited(each) for each in (answer, other, nobody)] == [0, -1, -1]
    assert protocol.awaited(protocol.word(feedback(5))) == 5
    for t_ns, frame, fresh in (
        (SINCE_NS, answer, True),
        (LATE, answer, False),
        (SINCE_NS, other, False),
        (SINCE_NS, nobody, False),
    ):
        assert protocol.fresh(Received(t_ns, frame), 13, SINCE_NS) is fresh


def test_frames_concern_the_leg_that_they_name_and_a_command_comes_from_no_drive():
    protocol = Spoken()
    words: list[Any] = [feedback(0), feedback(5), Heard(3, foreign=True), None]
    assert [protocol.sender(protocol.word(each)) for each in words] == [0, 5, -1, -1]
    assert [protocol.addressed(Frame(each, b"")) for each in (0x100, 0x105, 0x106)] == [(0,), (5,), ()]
