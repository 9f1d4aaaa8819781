"""Measurement of motor drives in a tick, by the content of each frame and its time."""

from __future__ import annotations

import struct
from math import nan
from typing import Any

import numpy as np
import pytest

from drivers.frame_array import received_array
from drivers.moteus import pad
from drivers.protocol import BRS, EXTENDED, FD, Frame, Received
from drivers.signals import NEVER, DriveMode, DriveState, Foreign
from hil.contracts.loopback import at_tick
from tests.drivers.motor_families import (
    LATE,
    MOTEUS_NODES,
    ODRIVE_NODES,
    SINCE_NS,
    UNLIKE,
    begun,
    last_tick,
    measured,
    mit,
    moteus,
    odrive,
)

OFF, READY, RUN, FAULT, BOOT = (DriveState[name] for name in ("OFF", "READY", "RUN", "FAULT", "BOOT"))
KEPT = ("length", "rate", "drive_force", "drive_state", "drive_fault")
P, DAMIAO, ODRIVE = moteus(UNLIKE, 2.0), mit("damiao", UNLIKE), odrive(UNLIKE)


def reply(
    leg: int, turns: float = 0.5, speed: float = 0.0, torque: float = nan, mode: int = 0, fault: int = 0
) -> Frame:
    """Answer of a moteus, disabled by default; mode 10 runs, mode 1 is a fault."""
    data = b"\x21\0" + bytes((mode,)) + b"\x2f\x01" + struct.pack("<3f", turns, speed, torque)
    identifier = MOTEUS_NODES[leg] << 8
    return Frame(
        identifier, pad(data + bytes((0x21, 0x0F, fault))), FD | BRS | EXTENDED * (identifier > 0x7FF)
    )


def beat(leg: int, error: int = 0, state: int = 1) -> Frame:
    """Heartbeat of an ODrive: only state and error."""
    return Frame(ODRIVE_NODES[leg] << 5 | 1, struct.pack("<IBBBB", error, state, 0, 0, 0))


def estimate(leg: int, turns: float = 0.5) -> Frame:
    """Answer of an ODrive: only its motion."""
    return Frame(ODRIVE_NODES[leg] << 5 | 9, struct.pack("<ff", turns, 0.0))


def status(leg: int, code: int = 0) -> Frame:
    node = (1, 2, 3, 4, 5, 15)[leg]
    return Frame(16 + node, bytes((code << 4 | node, 0x80, 0, 0x80, 8, 0, 30, 30)))


COMMAND = Frame(3, bytes(8), FD)
"""Command to leg 2 of moteus."""
NOBODYS = Frame(0x600, bytes(8))


def length(turns: float, leg: int) -> float:
    return float(UNLIKE.length(np.full(6, turns))[leg])


def test_period_without_frames_keeps_the_last_measurement_and_counts_no_error():
    tick, dialogue = measured(P)
    for name in KEPT:
        assert tick[name].tolist() == last_tick()[name].tolist()
    assert tick["blind"].tolist() == [0] * 6
    assert [int(tick[name]) for name in ("rejected", "doubled", "foreign")] == [0, 0, 0]
    assert dialogue == begun(P, owed=(1,) * 6)


def test_measurement_ages_grow_by_the_elapsed_periods_up_to_the_value_for_never():
    tick, _ = measured(P, reply(2), last=last_tick(10, [0, 2, 5, NEVER, NEVER - 2, 1]), number=13)
    assert tick["age"].tolist() == tick["counted_age"].tolist() == [3, 5, 0, NEVER, NEVER, 4]
    for before, grown in ((-1, 1), (0, 13)):
        tick, _ = measured(P, last=last_tick(before, [0, 1, 2, 3, 4, 5]))
        assert tick["age"].tolist() == [grown + k for k in range(6)], "in a first tick"


@pytest.mark.parametrize("leg", range(6))
def test_answer_updates_only_its_leg_with_length_and_force_through_the_transmission(leg):
    tick, dialogue = measured(P, reply(leg, 0.5, 0.25, 1.5, mode=1, fault=39))
    t, six = UNLIKE, np.ones(6)
    figures = {
        "length": t.length(0.5 * six)[leg],
        "rate": t.rate(0.25 * six)[leg],
        "drive_force": t.force(1.5 * six, t.rate(0.25 * six))[leg],
        "drive_fault": 0x100 + 39,
    }
    for name, value in figures.items():
        expected = last_tick()[name].copy()
        expected[leg] = value
        assert tick[name].tolist() == expected.tolist(), name
    assert dialogue.rate == tuple(tick["rate"].tolist())
    assert (
        tick["drive_state"].tolist() == list(dialogue.power) == [FAULT if k == leg else OFF for k in range(6)]
    )
    assert dialogue.said == tuple(13 if k == leg else 0 for k in range(6))


def test_answer_without_position_marks_its_leg_unmeasured_and_without_torque_keeps_the_force():
    tick, _ = measured(P, reply(4, nan, torque=1.5), reply(1), reply(0, torque=0.0))
    assert tick["blind"].tolist() == [0, 0, 0, 0, 1, 0]
    assert tick["age"].tolist() == [0, 0, 1, 1, 1, 1]
    for name in ("length", "rate"):
        assert tick[name][4] == last_tick()[name][4]
    assert tick["drive_force"].tolist() == [0.0, *last_tick()["drive_force"][1:].tolist()]


def test_invalid_and_foreign_frames_are_counted_and_do_not_change_the_measurement():
    broken = reply(2)._replace(data=b"\x21")
    for frames, rejected, name in (((broken,) * 3, 3, 0), ((COMMAND, NOBODYS), 0, Foreign.COMMAND)):
        tick, dialogue = measured(P, *frames)
        assert (tick["rejected"], tick["foreign"]) == (rejected, name)
        assert tick["age"].tolist() == [1] * 6
        assert dialogue == begun(P, owed=(1,) * 6)
    tick, _ = measured(P, NOBODYS, reply(5), broken, reply(0))
    assert tick["age"].tolist() == [0, 1, 1, 1, 1, 0], "the next ones count"


# late answers


@pytest.mark.parametrize("leg", range(6))
def test_late_answer_updates_the_measurement_only_if_the_previous_answer_is_missing(leg):
    for owed in (0, 1, 2):
        ages = [owed if each == leg else 0 for each in range(6)]
        tick, _ = measured(P, (LATE, reply(leg)), last=last_tick(10, ages), number=14)
        assert tick["length"][leg] == (length(0.5, leg) if owed else last_tick()["length"][leg])
        assert tick["age"].tolist() == [4] * 6, "from the tick before, four ticks ago"
        assert tick["rejected"] == 1


def test_late_answer_is_not_used_in_the_first_period_or_without_a_position():
    for before, taken in ((-1, False), (0, True)):
        tick, _ = measured(P, (LATE, reply(1)), last=last_tick(before, NEVER), number=1)
        assert (tick["length"][1] != last_tick()["length"][1]) == taken
        assert tick["age"][1] == (1 if taken else NEVER)
    tick, _ = measured(P, (LATE, reply(1, nan)), last=last_tick(10, 3), number=12)
    assert tick["age"].tolist() == [5] * 6
    assert tick["blind"].tolist() == [0, 1, 0, 0, 0, 0]


def test_answer_in_time_has_precedence_over_a_late_answer():
    late, there = (LATE, reply(1)), (SINCE_NS, reply(1, 0.25))
    for frames in ((late, there), (there, late)):
        tick, _ = measured(P, *frames, last=last_tick(10, 3))
        assert (tick["length"][1], tick["age"][1]) == (length(0.25, 1), 0)


@pytest.mark.parametrize(("done", "counted"), [(0, 0), (1, 0), (5, 0), (6, 2)])
def test_late_answers_count_as_errors_only_after_the_set_up_of_their_drive(done, counted):
    late = (LATE, status(3)), (LATE, status(3)), (LATE, status(2))
    assert measured(DAMIAO, *late, done=(0, 0, 0, done, 0, 0))[0]["rejected"] == counted


# doubled and owed answers


@pytest.mark.parametrize("leg", [1, 4])
def test_second_answer_with_different_content_marks_a_duplicate_node_and_the_first_is_used(leg):
    for other in (reply(leg, 0.25), reply(leg, speed=0.25), reply(leg, torque=1.0), reply(leg, mode=10)):
        tick, _ = measured(P, reply(leg), other, reply(5 - leg))
        assert (tick["doubled"], tick["length"][leg]) == (1 << leg, length(0.5, leg))
    assert measured(P, reply(leg), reply(leg))[0]["doubled"] == 0, "the same again"
    both = reply(1), reply(4), reply(1, 0.25), reply(4, speed=0.25)
    assert measured(P, *both)[0]["doubled"] == 1 << 1 | 1 << 4


def test_second_answer_in_a_period_is_used_if_an_earlier_answer_is_missing():
    tick, _ = measured(P, reply(2), reply(2, 0.25), owed=(0, 0, 1, 0, 0, 0))
    assert (tick["doubled"], tick["length"][2]) == (0, length(0.25, 2))


def test_polls_without_answer_are_counted_per_drive_for_up_to_twenty_periods():
    frames = reply(4), reply(4, 0.25), (LATE, reply(3)), (LATE, reply(5)), reply(5)
    _, dialogue = measured(P, *frames, done=(0, 1, 1, 1, 1, 1), owed=(5, 0, 19, 20, 3, 0))
    assert dialogue.owed == (0, 1, 20, 20, 2, 0)


def test_drive_not_yet_set_up_may_send_one_answer_more_than_it_was_polled():
    two = reply(2), reply(2, 0.25)
    assert measured(P, *two, done=(0,) * 6)[0]["doubled"] == 0
    tick, dialogue = measured(P, *two, reply(2, 0.75), done=(0,) * 6)
    assert (tick["doubled"], dialogue.owed) == (1 << 2, (0,) * 6)


@pytest.mark.parametrize(
    ("counts", "doubled"),
    [
        ((0, 1, 2), ()),
        ((0, 1, 1, 1, 1, 1, 2), ()),
        ((0, 0, 0, 4, 1), ()),
        ((0, 0, 0, 5), (3,)),
        ((2,), (0,)),
        ((0, 0, 0, 2, 2, 2, 2, 2), (6, 7)),
    ],
)
def test_node_counts_as_duplicate_once_it_sends_more_answers_than_it_was_polled(counts, doubled):
    dialogue, last, said, found = begun(P), last_tick(12), 0, []
    for number, count in enumerate(counts):
        answers = [reply(2, said + k) for k in range(count)]
        heard = received_array([Received(1, frame) for frame in answers])
        said, tick = said + count, at_tick(13 + number)
        dialogue = P.decode(dialogue, heard, last, tick, 0)
        found += [number] if tick["doubled"] else []
        if count:
            newest = length(said - 1, 2)
            assert (tick["length"][2] == newest) == (number not in doubled), (
                "the newest of the missing answers is used"
            )
        last = tick
    assert found == list(doubled)


# states


def test_frame_that_contains_only_a_drive_state_does_not_change_the_measurement():
    tick, dialogue = measured(ODRIVE, beat(4, 8), beat(4, 16))
    assert (tick["age"].tolist(), tick["doubled"]) == ([1] * 6, 0)
    assert (dialogue.power[4], dialogue.said[4], tick["drive_fault"][4]) == (FAULT, 13, 0x110)
    assert tick["drive_state"].tolist() == [OFF, OFF, OFF, OFF, FAULT, OFF]
    for name in ("length", "rate", "drive_force"):
        assert tick[name].tolist() == last_tick()[name].tolist()
    assert measured(ODRIVE, beat(4))[1].said == (0, 0, 0, 0, 13, 0), "the same again"


def test_feedback_without_a_drive_state_keeps_the_fault_of_the_drive():
    tick, dialogue = measured(ODRIVE, estimate(4))
    assert (dialogue.power, dialogue.said) == ((int(OFF),) * 6, (0,) * 6)
    assert tick["drive_fault"].tolist() == last_tick()["drive_fault"].tolist()
    assert tick["age"][4] == 0
    for mode in (0, 10):
        assert measured(P, reply(4, mode=mode))[0]["drive_fault"].tolist() == [0, 1, 2, 3, 0, 5]


@pytest.mark.parametrize(("mode", "power"), [(m, RUN if m == DriveMode.RUN else OFF) for m in DriveMode])
def test_state_of_a_drive_that_never_reports_one_is_the_commanded_state_or_a_fault(mode, power):
    replies = (Frame(0, bytes((leg + 1, 0x80, 0, 0x80, 8, 0, 30, code))) for leg, code in ((1, 0), (2, 1)))
    _, dialogue = measured(mit("cubemars", UNLIKE), *replies, mode=int(mode), power=(0,) * 6)
    assert dialogue.power == (0, power, FAULT, 0, 0, 0)


def test_state_of_a_drive_is_boot_until_its_set_up_is_complete_and_it_has_reported_a_state():
    power = tuple(map(int, (OFF, OFF, BOOT, RUN, FAULT, OFF)))
    tick, _ = measured(DAMIAO, status(0), done=(6, 5, 6, 1, 1, 0), power=power)
    assert tick["drive_state"].tolist() == [OFF, BOOT, BOOT, RUN, FAULT, BOOT]
    _, dialogue = measured(DAMIAO, *map(status, range(6)), done=(0, 1, 2, 6, 0, 0))
    assert dialogue.done == (1, 1, 2, 6, 1, 1), "first answer, or further progress"


def test_drive_that_ran_and_is_off_while_run_is_commanded_counts_as_restarted():
    power = tuple(map(int, (RUN, OFF, RUN, OFF, FAULT, OFF)))
    ran = (False, False, True, True, False, False)
    for mode, expected in (
        (DriveMode.RUN, (True, False, True, True, False, False)),
        (DriveMode.READY, (False,) * 6),
    ):
        assert measured(P, reply(5), mode=int(mode), power=power, ran=ran)[1].ran == expected
    ran = (False, True, False, True, True, False)
    tick, dialogue = measured(P, reply(0), mode=int(DriveMode.RUN), ran=ran)
    assert tick["drive_state"].tolist() == [BOOT if each else READY for each in ran]
    assert dialogue.ran == ran, "drives count as restarted until RUN is requested again"


@pytest.mark.parametrize(("age", "done"), [(19, 6), (20, 0)])
def test_only_drives_silent_for_over_twenty_periods_are_set_up_again(age, done):
    _, dialogue = measured(DAMIAO, last=last_tick(age=[0, 0, 0, age, 0, 0]), done=(0, 6, 6, 6, 6, 6))
    assert dialogue.done == (0, 6, 6, done, 6, 6)


def test_state_of_a_drive_is_unknown_once_its_last_report_is_older_than_the_timeout():
    _, dialogue = measured(P, power=(int(RUN),) * 6, said=(1, 2, 3, 4, 5, 6), patience_ticks=10)
    assert dialogue.power == (BOOT, BOOT, RUN, RUN, RUN, RUN)


def test_sender_of_a_frame_and_whether_it_is_awaited_and_fresh_follow_from_its_content():
    frames: list[Any] = [estimate(0), beat(3), NOBODYS, estimate(5), Frame(2 << 5 | 0xE, bytes(8))]
    assert [ODRIVE.awaited(each) for each in frames] == [9, -1, -1, 62 << 5 | 9, -1]
    assert [ODRIVE.sender(each) for each in frames] == [0, 3, -1, 5, -1]
    fresh = [ODRIVE.fresh(Received(SINCE_NS, each), 13, SINCE_NS) for each in frames]
    assert [bool(each) for each in fresh] == [True, False, False, True, False]
    assert not ODRIVE.fresh(Received(LATE, frames[0]), 13, SINCE_NS)
