"""Measurement of a tick with the protocol `legs`: each leg by its own frames, at their age."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from drivers.frame_array import received_array
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import ALWAYS, BUS, ERROR, EXTENDED, REMOTE, DriveSetup, Frame, Received
from drivers.signals import INVALID, NEVER, Command, DriveFault, DriveMode, DriveState, Foreign, Reaction
from drivers.tick_columns import new_record
from hil.contracts.drives_end import answers, reports
from hil.contracts.messages import Configure, Status, Sync
from tests.drivers.legs_frames import command_frames, opening, resealed
from tests.drivers.motor_families import last_tick

NODES = (127, 20, 30, 40, 50, 1)
P = {layout: LegsProtocol(layout, NODES, 32_000.0) for layout in ("classic", "fd", "ideal")}
SETUP = DriveSetup(0.0125, Reaction.HOLD, 250.0)
NUMBER, SINCE_NS = 13, 1_000
LENGTH = np.array([1.5, 1.6, 1.7, 1.8, 1.9, 2.0])
RATE = np.array([0.25, -0.25, 0.5, -0.5, 0.75, -0.75])
FORCE = np.array([1000.0, -2000.0, 3000.0, 4.0, -60.0, 2.0])
RUN = np.full(6, 3)
COUNTS = ("rejected", "doubled", "foreign", "altered")
KEPT = ("length", "rate", "drive_force", "drive_state", "drive_fault")
layouts = pytest.mark.parametrize("layout", P)
legs = pytest.mark.parametrize("leg", range(6))


def sent(layout: str, counter: int = NUMBER, **changes: Any) -> list[Frame]:
    """Feedbacks of all legs to the SYNC of a tick, each with different numbers."""
    values: dict[str, Any] = {"length": LENGTH, "rate": RATE, "force": FORCE, "state": RUN} | changes
    return [frame for _, frame in answers(P[layout], Sync(counter & 0xF), *values.values())]


def taken(
    layout: str, *frames: Frame, last: Any = None, t_ns: int = SINCE_NS, since_ns: int = SINCE_NS
) -> Any:
    tick = new_record()
    tick["tick"] = NUMBER
    for name in ("blind", *COUNTS):
        tick[name] = 9
    before = last_tick() if last is None else last
    end = P[layout].controller_end(SETUP)
    end.take(received_array([Received(t_ns, f) for f in frames]), before, tick, since_ns)
    return tick


@layouts
def test_period_without_frames_keeps_the_last_measurement_and_counts_no_error(layout):
    before = last_tick(10, [0, 2, 5, NEVER, NEVER - 2, 1])
    tick = taken(layout, last=before)
    for name in KEPT:
        assert tick[name].tolist() == before[name].tolist()
    assert tick["age"].tolist() == tick["counted_age"].tolist() == [3, 5, 8, NEVER, NEVER, 4]
    assert tick["blind"].tolist() == [0] * 6
    assert [int(tick[name]) for name in COUNTS] == [0] * 4
    assert taken(layout, last=last_tick(-1, 4))["age"].tolist() == [5] * 6
    assert taken(layout, last=last_tick(0, 4))["age"].tolist() == [17] * 6


@layouts
@legs
def test_feedback_frame_updates_the_measurement_of_its_leg_only(layout, leg):
    tick, before = taken(layout, sent(layout)[leg]), last_tick(age=1)
    measured = {"length": LENGTH, "rate": RATE, "drive_state": RUN, "age": 0 * RUN}
    measured |= {"drive_force": FORCE} if layout != "classic" else {}
    for name in ("length", "rate", "drive_force", "drive_state", "age"):
        expected = before[name].copy()
        expected[leg] = measured[name][leg] if name in measured else expected[leg]
        np.testing.assert_allclose(tick[name], expected, rtol=0, atol=1e-9, err_msg=name)
    assert tick["counted_age"].tolist() == tick["age"].tolist()
    assert tick["drive_fault"].tolist() == before["drive_fault"].tolist()


@layouts
@pytest.mark.parametrize(
    ("behind", "age", "rejected"), [(0, 0, 0), (1, 1, 0), (8, 8, 0), (9, 21, 1), (15, 21, 1)]
)
def test_late_feedback_has_the_age_of_its_sync_and_future_feedback_is_refused(layout, behind, age, rejected):
    tick = taken(layout, sent(layout, NUMBER - behind)[4], last=last_tick(12, 20))
    assert (int(tick["age"][4]), int(tick["rejected"])) == (age, rejected)
    assert tick["age"].tolist()[:4] == [21] * 4


@layouts
def test_feedback_received_before_the_control_period_does_not_count_as_answer_to_its_sync(layout):
    for t_ns, counter, age, rejected in (
        (SINCE_NS - 1, 13, 4, 1),
        (SINCE_NS, 13, 0, 0),
        (SINCE_NS - 1, 12, 1, 0),
    ):
        tick = taken(layout, sent(layout, counter)[4], last=last_tick(12, 3), t_ns=t_ns)
        assert (int(tick["age"][4]), int(tick["rejected"])) == (age, rejected)
    assert taken(layout, sent(layout)[4], t_ns=-5, since_ns=ALWAYS)["age"][4] == 0
    fresh = [P[layout].fresh(Received(SINCE_NS + k, sent(layout)[4]), NUMBER, SINCE_NS) for k in (-1, 0, 1)]
    assert fresh == [False, True, True]


@layouts
def test_late_feedback_is_used_if_it_is_newer_than_the_last_received(layout):
    for held, there in ((2, False), (3, True)):
        tick = taken(layout, sent(layout, NUMBER - 3)[4], last=last_tick(12, held))
        assert tick["length"][4] == pytest.approx(LENGTH[4] if there else 2.5)
        assert tick["age"][4] == 3
        assert (int(tick["rejected"]), int(tick["doubled"])) == (0, 0 if there else 1 << 4)


@layouts
@legs
def test_feedback_with_invalid_length_marks_its_leg_as_unmeasured_and_increases_its_age(layout, leg):
    states = RUN.copy()
    states[leg] = DriveState.FAULT | INVALID
    tick = taken(layout, *sent(layout, state=states), last=last_tick(12, 5))
    mine = [each == leg for each in range(6)]
    assert tick["blind"].tolist() == mine
    assert tick["age"].tolist() == [6 if each else 0 for each in mine]
    assert tick["drive_state"].tolist() == [4 if each else 3 for each in mine]
    assert [tick[name][leg] for name in KEPT[:2]] == [last_tick()[name][leg] for name in KEPT[:2]]
    assert tick["drive_force"][leg] == pytest.approx(11.0 + leg if layout == "classic" else FORCE[leg])
    late = taken(layout, sent(layout, NUMBER - 1, state=states)[leg], last=last_tick(12, 5))
    assert (late["blind"][leg], late["drive_state"][leg]) == (0, last_tick()["drive_state"][leg])


@layouts
@legs
def test_second_answer_with_different_content_marks_a_duplicate_node(layout, leg):
    good = sent(layout)
    others = [
        sent(layout, length=LENGTH + 0.01),
        sent(layout, rate=RATE + 0.01),
        sent(layout, state=RUN + 1),
        sent(layout, state=RUN | INVALID),
    ]
    others += [sent(layout, force=FORCE + 10)] if layout != "classic" else []
    for other in others:
        tick = taken(layout, *good, other[leg])
        assert tick["doubled"] == 1 << leg
        assert tick["length"][leg] == pytest.approx(LENGTH[leg])
        assert tick["age"].tolist() == [0] * 6
    assert taken(layout, *good, *good)["doubled"] == 0
    assert taken(layout, *good, others[0][1], others[0][4])["doubled"] == 1 << 1 | 1 << 4
    blind = sent(layout, state=RUN | INVALID)
    assert taken(layout, *blind, *blind)["doubled"] == 0
    assert taken(layout, *blind, good[leg])["doubled"] == 1 << leg
    other = sent(layout, state=DriveState.FAULT | INVALID + 0 * RUN)[leg]
    for second, doubled in ((blind[leg], 0), (good[leg], 1 << leg), (other, 1 << leg)):
        assert taken(layout, blind[leg], second)["doubled"] == doubled


@layouts
@legs
def test_late_answer_after_one_with_invalid_length_does_not_mark_a_duplicate_node(layout, leg):
    blind, late = sent(layout, state=RUN | INVALID)[leg], sent(layout, NUMBER - 1)[leg]
    tick = taken(layout, blind, late, last=last_tick(12, 5))
    assert (int(tick["doubled"]), int(tick["age"][leg])) == (0, 1)
    assert tick["length"][leg] == pytest.approx(LENGTH[leg])
    assert tick["blind"].tolist() == [each == leg for each in range(6)]


def follow(
    layout: str, answered: Sequence[list[int] | None], confirmed: int = 63, early: int = -1
) -> tuple[list[int], list[int], list[bool]]:
    """Ticks with a doubled node; ages of leg 4; whether its length was that of the SYNC of this age.

    answered: for each tick from 0 on the SYNCs whose answers of leg 4 arrive, None: the tick is skipped. Each
    length is 1.5 m plus 1 mm a SYNC, and 100 mm for a second drive, whose answers to SYNC n are written as
    -n. early: the first answer of this tick arrives before the loop wakes up.
    """
    end, last, found, ages, right = P[layout].controller_end(SETUP), new_record(), [], [], []
    end.state["confirmed"] = confirmed
    for number, syncs in enumerate(answered):
        if syncs is None:
            continue
        tick = new_record()
        tick["tick"] = number
        lengths = [1.5 + 1e-3 * abs(n) + 0.1 * (n < 0) for n in syncs]
        frames = [sent(layout, abs(n), length=np.full(6, x))[4] for n, x in zip(syncs, lengths, strict=True)]
        times = [SINCE_NS - (number == early and k == 0) for k in range(len(frames))]
        heard = received_array([Received(t, f) for t, f in zip(times, frames, strict=True)])
        end.take(heard, last, tick, SINCE_NS)
        found += [number] if tick["doubled"] else []
        ages.append(int(tick["age"][4]))
        right.append(abs(tick["length"][4] - 1.5 - 1e-3 * (number - ages[-1])) < 1e-9)
        last = tick
    return found, ages, right


BEFORE: list[list[int] | None] = [[n] for n in range(20)]


@layouts
@pytest.mark.parametrize("late", [1, 2, 5, 12, 16, 17, 20, 32, 45])
def test_late_answers_do_not_mark_a_duplicate_node_and_have_the_age_of_their_sync(layout, late):
    back = 20 + late
    silent, burst = [*BEFORE, *[list[int]()] * late], list(range(20, back + 1))
    after = [[n] for n in range(back + 1, back + 20)]
    found, ages, right = follow(layout, [*silent, burst, *after])
    assert (found, ages[back:], all(right)) == ([], [0] * 20, True)
    if late <= 20:
        drained = [burst[k : k + 2] for k in range(0, late + 1, 2)]
        found, ages, right = follow(
            layout, [*silent, *drained, *([n] for n in range(back + len(drained), 80))]
        )
        assert (found, all(right)) == ([], True), "two a tick: newer ones take the place of older ones"
    if late < 16:
        lasting = [[n] for n in range(20, 60)]
        found, ages, right = follow(layout, [*silent, *lasting, list(range(60, 61 + late))])
        assert (found, all(right), ages[-1]) == ([], True, 0)
        assert ages[back:-1] == [late if late <= 8 else 1 + late + k for k in range(40)]


@layouts
@pytest.mark.parametrize("pause", [8, 16, 20])
def test_late_answers_of_a_drive_that_pauses_again_do_not_count_as_fresh(layout, pause):
    silent = [*BEFORE, *[list[int]()] * 20]
    paused = [[20], [21], [22], *[list[int]()] * pause, *([n] for n in range(23, 40))]
    found, ages, right = follow(layout, [*silent, *paused])
    first = 43 + pause
    assert (found, all(right[: first + 5])) == ([], True)
    assert min(ages[40 : first + 5]) > 20


@layouts
def test_answer_queued_during_a_controller_stall_of_16_periods_does_not_count_as_fresh(layout):
    for early in (-1, 35):
        stalled = [*BEFORE[:19], [], *[None] * 15, [19, 35], [36]]
        found, ages, right = follow(layout, stalled, early=early)
        assert (found, ages[-2:], all(right)) == ([], [0, 0], True)
    found, ages, _ = follow(layout, [*BEFORE, *[None] * 16, [36], [37]])
    assert (found, ages[-2:]) == ([], [0, 0]), "nothing was missing"


@layouts
def test_duplicate_node_is_detected_within_two_periods_however_many_answers_were_lost_before(layout):
    for lost in (0, 1, 8, 16, 20, 33, 100, 300):
        back = 20 + lost
        twice = [[n, -n] for n in range(back, back + 20)]
        first = back + min(lost // 16, 2)
        assert follow(layout, [*BEFORE, *[list[int]()] * lost, *twice])[0] == list(range(first, back + 20))
    late = [[n - 1, 1 - n] for n in range(21, 40)]
    assert follow(layout, [*BEFORE, [], *late])[0] == list(range(21, 40)), (
        "two nodes whose answers are always one period late"
    )
    start = [[], *([n, -n] for n in range(1, 9))]
    assert follow(layout, start, confirmed=0)[0] == list(range(1, 9)), "at start"


@layouts
def test_feedback_of_a_drive_that_was_silent_for_16_periods_counts_8_periods_after_its_return(layout):
    for lost in (16, 20, 33, 100):
        back = 20 + lost
        found, ages, right = follow(
            layout, [*BEFORE, *[list[int]()] * lost, *([n] for n in range(back, back + 30))]
        )
        assert (found, all(right)) == ([], True)
        assert ages[back:] == [1 + lost + k for k in range(8)] + [0] * 22
    assert follow(layout, [[], *([n] for n in range(1, 9))], confirmed=0)[1][1:] == [0] * 8


def test_received_controller_frames_count_as_foreign_by_kind_in_any_bus_layout():
    zeros = Command(DriveMode.OFF, np.zeros(6))
    commands = [f for p in P.values() for f in command_frames(p, zeros, 0)]
    assert len(commands) == 4
    kinds = {
        Foreign.SYNC: opening(P["fd"], 0),
        Foreign.ESTOP: P["fd"].traits.emergency_stop,
        Foreign.CONFIG: P["fd"].configure(0.01, Reaction.BRAKE),
        Foreign.COMMAND: commands,
    }
    for kind, frames in kinds.items():
        for frame in frames:
            assert taken("fd", frame)["foreign"] == kind
    every = [frame for frames in kinds.values() for frame in frames]
    assert taken("fd", *every)["foreign"] == sum(kinds)
    assert taken("fd", Frame(0x7FE, b""), Frame(0x081, b""))["foreign"] == 0


@layouts
@legs
def test_status_frame_reports_the_fault_of_its_drive_and_a_changed_set_up(layout, leg):
    def status(fault: DriveFault, state: int, **other: Any) -> Frame:
        holds = Configure(leg, 0.0125, Reaction.HOLD)._replace(**other)
        return reports(P[layout], Status(leg, state, fault, holds))[0]

    tick = taken(layout, status(DriveFault.STROKE, 4))
    assert tick["drive_fault"].tolist() == [5 if each == leg else k for each, k in enumerate(range(6))]
    assert (int(tick["altered"]), int(tick["rejected"])) == (0, 0)
    for state, altered in ((1, 1 << leg), (0, 0)):  # no set-up in BOOT
        tick = taken(layout, status(DriveFault.NONE, state, watchdog_s=0.1))
        assert (int(tick["altered"]), int(tick["rejected"])) == (altered, 0)
    good = status(DriveFault.STROKE, 4)
    for at, value in ((0, 5), (1, 6)):
        tick, end = new_record(), P[layout].controller_end(SETUP)
        end.state["confirmed"] = 0b111111
        bad = Received(SINCE_NS, resealed(good, at, bytes([value])))
        end.take(received_array([bad, bad]), last_tick(), tick, SINCE_NS)
        assert (int(end.state["confirmed"]), int(tick["rejected"])) == (0b111111, 2)
        assert tick["drive_fault"].tolist() == last_tick()["drive_fault"].tolist()


@layouts
@legs
def test_repeated_answer_marks_a_duplicate_node_only_if_it_differs_from_the_last_received(layout, leg):
    held = taken(layout, *sent(layout))
    held["tick"], held["age"] = NUMBER - 1, 2
    again = [sent(layout, NUMBER - 3, state=state)[leg] for state in (RUN, RUN + 1)]
    blind = sent(layout, state=RUN | INVALID)[leg]

    def doubled(*frames: Frame, blind_before: int = -1) -> int:
        held["blind"] = [each == blind_before for each in range(6)]
        return int(taken(layout, *frames, last=held)["doubled"])

    assert [doubled(frame) for frame in again] == [0, 1 << leg]
    assert [doubled(frame, blind_before=leg) for frame in again] == [0, 0]
    assert [doubled(frame, blind_before=(leg + 1) % 6) for frame in again] == [0, 1 << leg]
    assert [doubled(blind, frame) for frame in again] == [0, 0]


@layouts
@pytest.mark.parametrize("flag", [EXTENDED, REMOTE, ERROR, BUS, 128 * BUS], ids=str)
def test_frames_of_unknown_kinds_or_other_buses_do_not_change_the_measurement(layout, flag):
    frames = [*sent(layout), *opening(P[layout], 0), *P[layout].traits.emergency_stop]
    tick = taken(layout, *(frame._replace(flags=frame.flags | flag) for frame in frames))
    assert tick["age"].tolist() == [1] * 6
    assert [int(tick[name]) for name in COUNTS] == [0] * 4
