"""Measurement of CiA 402 drives in a tick: each leg by its own frames, with its own age and faults."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.cia402.states import STATUSWORDS, UNHEARD, State
from drivers.frame_array import received_array
from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, Frame, Received
from drivers.signals import NEVER, DriveFault, DriveState, Foreign
from drivers.tick_columns import Record, new_record
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.loopback import SETUP
from tests.drivers.cia402_drives import NODES, STEP_m, drives, made
from tests.drivers.motor_families import UNLIKE_GEAR, last_tick

P = ByValue(drives(NODES, lead_m=[0.01, 0.02, 0.03, 0.04, 0.05, 0.06]))
OFF, RUN, FAULT, BOOT = DriveState.OFF, DriveState.RUN, DriveState.FAULT, DriveState.BOOT
WOKE_NS = 1_000
"""Wake-up time of the loop; this tick's SYNC ended 500 ns later, on the bus of the last leg 800 ns later."""
KEPT = ("length", "rate", "drive_force", "drive_state")
FAULTS = [0, 1, 0, 3, 4, 5]
"""Faults of the tick before; the stop, 2, has ended, as that drive is no longer stopped."""


def place(leg: int, counts: int = 0, torque: int = 0, state: State = State.ENABLED) -> Frame:
    return Frame(0x181 + leg, struct.pack("<Hih", STATUSWORDS[state], counts, torque))


def speed(leg: int, counts_per_s: int = 0) -> Frame:
    return Frame(0x281 + leg, struct.pack("<i", counts_per_s))


def begun(protocol: ByValue = P, **fields: Any) -> Remembered:
    start = protocol.start(SETUP)
    done = {"at": start.steps, "states": (int(State.ENABLED),) * 6}
    return start._replace(**done | fields)


def decoded(
    *frames: Frame | tuple[int, Frame],
    last: Record | None = None,
    protocol: ByValue = P,
    **fields: Any,
) -> tuple[Any, Remembered]:
    """Tick and dialogue after these frames; a pair has the time of a late frame, the others are in time."""
    timed = [
        Received(*each) if isinstance(each[0], int) and len(each) == 2 else Received(2_000, each)
        for each in frames
    ]
    tick = new_record()
    tick["tick"], tick["latch_ns"] = 13, [500] * 5 + [800]
    for name in ("blind", "rejected", "doubled", "foreign", "altered"):
        tick[name] = 9
    before = last_tick() if last is None else last
    return tick, protocol.decode(begun(protocol, **fields), received_array(timed), before, tick, WOKE_NS)


def test_period_without_frames_keeps_the_last_measurement_increases_ages_and_counts_no_error():
    before = last_tick(10, [0, 2, 5, NEVER, NEVER - 2, 1])
    tick, _ = decoded(last=before)
    for name in KEPT:
        assert tick[name].tolist() == before[name].tolist()
    assert tick["drive_fault"].tolist() == FAULTS
    assert tick["age"].tolist() == tick["counted_age"].tolist() == [3, 5, 8, NEVER, NEVER, 4]
    assert tick["blind"].tolist() == [0] * 6
    assert [int(tick[name]) for name in ("rejected", "doubled", "foreign", "altered")] == [0] * 4
    assert decoded(last=last_tick(-1, 4))[0]["age"].tolist() == [5] * 6
    assert decoded(last=last_tick(0, 4))[0]["age"].tolist() == [17] * 6


@pytest.mark.parametrize("leg", range(6))
def test_two_tpdos_of_a_drive_update_the_measurement_of_its_leg_only(leg):
    tick, dialogue = decoded(speed(leg, -262144), place(leg, 131072, -100))
    t, before = P.transmission, last_tick()
    six = np.ones(6)
    measured = {
        "length": t.length(six)[leg],
        "rate": t.rate(-2.0 * six)[leg],
        "drive_force": -100 * 9e-3 * t.N_per_Nm[leg],
        "drive_state": RUN,
        "age": 0,
    }
    before["age"] = 1
    for name, value in measured.items():
        expected = before[name].copy()
        expected[leg] = value
        np.testing.assert_allclose(tick[name], expected, rtol=1e-12, err_msg=name)
    assert dialogue.rate == tuple(tick["rate"].tolist())


def test_tpdo1_without_tpdo2_gives_the_drive_state_but_no_length():
    tick, dialogue = decoded(place(2, 131072, 100, State.DISABLED), states=(int(State.DISABLED),) * 6)
    assert tick["drive_state"].tolist() == [0, 1, OFF, 3, 4, 1]
    assert tick["drive_force"][2] != last_tick()["drive_force"][2]
    assert (tick["age"][2], tick["length"][2], tick["rate"][2]) == (1, 2.3, 0.03)
    assert dialogue.states[2] == State.DISABLED
    assert decoded(speed(2, 500))[0]["rate"].tolist() == last_tick()["rate"].tolist()


def test_answer_received_before_the_end_of_sync_on_its_bus_is_one_period_old():
    for t_ns, first, last in ((1_499, 1, 1), (1_500, 0, 1), (1_799, 0, 1), (1_800, 0, 0)):
        frames = [(t_ns, frame) for leg in (0, 5) for frame in (place(leg, 100), speed(leg))]
        tick, _ = decoded(*frames, last=last_tick(age=3))
        assert tick["age"].tolist() == [first, 4, 4, 4, 4, last]


def test_late_answer_is_used_unless_a_newer_one_was_already_received():
    late, here = (WOKE_NS, place(2, 131072)), (WOKE_NS, speed(2))
    for age, there in ((0, False), (1, True)):
        ages = [1 - age] * 6
        ages[2] = age
        tick, _ = decoded(late, here, last=last_tick(age=ages))
        assert (tick["length"][2] != 2.3) == there
        assert tick["age"][2] == 1
    assert decoded(late, speed(2), last=last_tick(age=3))[0]["age"][2] == 1
    assert decoded(late, place(2, 131072), speed(2), last=last_tick(age=3))[0]["age"][2] == 0, (
        "the same in time"
    )
    assert decoded(place(2), here, last=last_tick(age=3))[0]["age"][2] == 4, (
        "its velocity belongs to another SYNC"
    )


@pytest.mark.parametrize("leg", range(6))
def test_second_different_answer_marks_a_duplicate_node_unless_an_earlier_one_is_missing(leg):
    frames = [place(leg, 100), speed(leg, 1)]
    tick, _ = decoded(*frames, place(leg, 101), owed=(0,) * 12)
    assert tick["doubled"] == 1 << leg
    assert decoded(*frames, speed(leg, 2), owed=(0,) * 12)[0]["doubled"] == 1 << leg
    assert decoded(*frames, *frames, owed=(0,) * 12)[0]["doubled"] == 0
    owes = tuple(int(each % 6 == leg) for each in range(12))
    tick, dialogue = decoded(*frames, place(leg, 101), speed(leg, 2), owed=owes)
    assert tick["doubled"] == 0
    assert tick["length"][leg] == P.transmission.length(np.full(6, 101 / 131072))[leg]
    assert dialogue.owed == tuple(0 if each % 6 == leg else 1 for each in range(12))


def test_missing_answers_are_counted_per_drive_and_kind_of_tpdo_after_its_set_up():
    owed, at = tuple(range(10, 22)), (*begun().steps[:5], 0)
    _, dialogue = decoded(place(1), speed(4), owed=owed, at=at)
    assert dialogue.owed == (11, 11, 13, 14, 15, 0, 17, 18, 19, 20, 20, 0)


def doubled(*counts: int, before: int = 20, ends: Remembered | None = None) -> list[int]:
    """Ticks with a doubled leg 4, after `before` ticks with one answer and then these numbers of answers."""
    dialogue, m, found, said = begun() if ends is None else ends, new_record(), [], 0
    for number, count in enumerate([1] * before + list(counts)):
        last, m = m, new_record()
        m["tick"] = number
        sent = [frame for k in range(count) for frame in (place(4, said + k), speed(4, said + k))]
        said += count
        dialogue = P.decode(dialogue, received_array([Received(1, f) for f in sent]), last, m, 0)
        found += [number - before] if m["doubled"] else []
    return found


def test_drive_may_send_as_many_late_answers_as_are_missing_without_counting_as_duplicate():
    assert doubled(0, 2) == doubled(0, 1, 1, 2) == []
    assert doubled(0, 1, 2, 2) == [3], "only one answer was missing"
    for late in (1, 2, 5, 16):
        for lasts in (0, 40, 120):
            assert doubled(*[0] * late, *[1] * lasts, late + 1, 1, 1) == [], "a lasting delay of the answers"


def test_duplicate_node_is_detected_within_21_periods_however_many_answers_were_lost_before():
    assert doubled(*[2] * 5) == [0, 1, 2, 3, 4]
    for lost in (1, 8, 20, 33, 300):
        assert doubled(*[0] * lost, *[2] * 30)[0] == lost + min(lost, 20), "answers were lost"
    assert doubled(0, 1, 1, *[2] * 3) == [4, 5], "a drive that is always late"
    started = begun(at=(0,) * 6)
    assert doubled(*[2] * 3, before=0, ends=started) == [], "not set up"
    assert doubled(3, before=0, ends=started) == [0]


def test_duplicate_node_that_answers_just_before_the_next_sync_is_detected():
    answers = [[place(4, k), speed(4, k)] for k in (100, 101, 102)]
    _, dialogue = decoded(*answers[0])
    for late, found in ((answers[0], 0), (answers[1], 1 << 4)):
        heard = [Received(WOKE_NS, frame) for frame in late] + [Received(2_000, f) for f in answers[2]]
        tick = new_record()
        tick["tick"], tick["latch_ns"] = 13, 500
        P.decode(dialogue, received_array(heard), last_tick(), tick, WOKE_NS)
        assert tick["doubled"] == found


def test_invalid_frames_are_counted_and_do_not_change_the_measurement():
    bad = {
        0x182: (bytes(7), b"\xff\xff" + bytes(6)), 0x282: (bytes(8),), 0x082: (bytes(7),),
        0x702: (b"\6", b"\5\5"), 0x582: (bytes(7),),
    }  # fmt: skip
    tick, dialogue = decoded(*(Frame(identifier, data) for identifier, each in bad.items() for data in each))
    assert (tick["rejected"], tick["foreign"]) == (7, 0)
    for name in KEPT:
        assert tick[name].tolist() == last_tick()[name].tolist()
    assert tick["drive_fault"].tolist() == FAULTS
    assert dialogue.at == begun().at


def test_controller_frames_from_elsewhere_count_as_foreign_and_unknown_frames_do_not():
    for frame, name in (
        (Frame(0x080, b""), Foreign.SYNC),
        (Frame(0x000, b"\1\5"), Foreign.CONFIG),
        (Frame(0x605, bytes(8)), Foreign.CONFIG),
        (Frame(0x205, bytes(4)), Foreign.COMMAND),
        (Frame(0x77F, b"\5"), Foreign.COMMAND),
    ):
        assert decoded(frame)[0]["foreign"] == name
    strange = [Frame(0x80, b"", flags) for flags in (EXTENDED, FD, REMOTE, ERROR, BUS)]
    tick, _ = decoded(
        *strange, Frame(0x187, bytes(8)), Frame(0x301, bytes(8)), place(0)._replace(flags=EXTENDED), place(3)
    )
    assert (tick["foreign"], tick["rejected"]) == (0, 0)
    assert tick["drive_state"].tolist() == [0, 1, 2, RUN, 4, 1]


@pytest.mark.parametrize("leg", range(6))
def test_emcy_sets_or_clears_the_fault_of_its_drive(leg):
    for data, code in (("0573010000000000", 0x7305), ("0000000000000000", 0)):
        tick, _ = decoded(Frame(0x081 + leg, bytes.fromhex(data)))
        assert tick["drive_fault"].tolist() == [code if each == leg else n for each, n in enumerate(FAULTS)]


@pytest.mark.parametrize("leg", range(6))
def test_boot_up_message_clears_the_fault_the_answer_and_the_set_up_of_its_drive(leg):
    before, mine = last_tick(), [each == leg for each in range(6)]
    before["drive_fault"] = 0x7305
    booted = place(leg), speed(leg), Frame(0x701 + leg, b"\0")
    tick, dialogue = decoded(*booted, last=before, tries=(4,) * 6, asked=(3,) * 6)
    states = [BOOT if m else state for m, state in zip(mine, before["drive_state"].tolist(), strict=True)]
    assert tick["drive_state"].tolist() == states
    assert tick["age"].tolist() == [1] * 6
    assert tick["drive_fault"].tolist() == [0 if m else 0x7305 for m in mine]
    assert dialogue.states == tuple(UNHEARD if m else State.ENABLED for m in mine)
    assert dialogue.at == tuple(0 if m else n for m, n in zip(mine, begun().at, strict=True))
    assert (dialogue.tries[leg], dialogue.asked[leg]) == (0, -1)


@pytest.mark.parametrize(
    ("nmt", "done", "again"), [(4, True, True), (127, True, True), (5, True, False), (127, False, False)]
)
def test_drive_that_leaves_nmt_operational_is_set_up_again_and_keeps_its_fault(nmt, done, again):
    at = begun().at if done else (2,) * 6
    tick, dialogue = decoded(Frame(0x705, bytes((nmt,))), at=at)
    assert dialogue.at == tuple(0 if again and leg == 4 else n for leg, n in enumerate(at))
    assert tick["drive_fault"].tolist() == FAULTS
    assert (tick["drive_state"][4] == BOOT) == again


@pytest.mark.parametrize("leg", range(6))
def test_drive_after_a_quick_stop_counts_as_in_fault_until_it_is_switched_on(leg):
    def of_leg(own: State, others: State) -> tuple[int, ...]:
        return tuple(int(own if each == leg else others) for each in range(6))

    for state, before, others in (
        (State.QUICK_STOP, State.DISABLED, State.ENABLED),
        (State.DISABLED, State.ENABLED, State.SWITCHED_ON),
    ):
        tick, dialogue = decoded(place(leg, state=state), states=of_leg(before, others))
        assert dialogue.stopped == 1 << leg
        assert (tick["drive_state"][leg], tick["drive_fault"][leg]) == (FAULT, [2, 1, 2, 3, 4, 5][leg])
    tick, dialogue = decoded(
        place(leg, state=State.DISABLED), states=of_leg(State.SWITCHED_ON, State.ENABLED)
    )
    assert (dialogue.stopped, tick["drive_state"][leg]) == (0, OFF)
    mine = last_tick()
    mine["drive_fault"] = DriveFault.ESTOP
    for state in (State.READY_TO_SWITCH_ON, State.ENABLED):
        tick, _ = decoded(last=mine, states=(int(state),) * 6, stopped=1 << leg)
        halted = state is State.READY_TO_SWITCH_ON
        assert tick["drive_state"][leg] == (FAULT if halted else mine["drive_state"][leg])
    tick, _ = decoded(last=mine, stopped=1 << leg)
    assert tick["drive_fault"].tolist() == [2 if each == leg else 0 for each in range(6)]


@pytest.mark.parametrize("leg", range(6))
def test_first_answer_after_nmt_start_completes_the_set_up_of_its_drive(leg):
    last_step = tuple(n - 1 for n in begun().at)
    asked = tuple(0 if each == leg else -1 for each in range(6))
    frames = [frame for each in range(6) for frame in (place(each), speed(each))]
    _, dialogue = decoded(*frames, at=last_step, asked=asked)
    assert P.legs_set_up(dialogue) == tuple(each == leg for each in range(6))
    late = [(WOKE_NS, frame) for frame in frames]
    assert decoded(*late, at=last_step, asked=asked, last=last_tick(age=3))[1].at == last_step
    earlier = tuple(n - 2 for n in begun().at)
    assert decoded(*frames, at=earlier, asked=(9,) * 6)[1].at == earlier


@pytest.mark.parametrize("changes", [{}, {"efficiency": 1.0}, {"back_driving_efficiency": 1.0}])
def test_measured_force_of_each_leg_includes_its_transmission_losses_at_its_rate(changes):
    lossy = ByValue(made(NODES, UNLIKE_GEAR.model_copy(update=changes), force_limit_N=100.0))
    counts = [30000, -30000, 0, 30000, -30000, 2000]
    frames = [f for leg in range(6) for f in (place(leg, 0, 100), speed(leg, 65536 * counts[leg] // 100))]
    tick, _ = decoded(*frames, protocol=lossy)
    expected = lossy.transmission.force(np.full(6, 100 * 9e-3), tick["rate"])
    np.testing.assert_allclose(tick["drive_force"], expected, rtol=1e-9)


def test_measured_force_of_a_leg_without_losses_follows_from_the_motor_torque_alone():
    last = last_tick()
    last["rate"] = np.nan
    tick, _ = decoded(*(place(leg, 0, 100) for leg in range(6)), last=last)
    np.testing.assert_allclose(tick["drive_force"], 100 * 9e-3 * P.transmission.N_per_Nm, rtol=1e-12)


# rates of lengths


@pytest.mark.parametrize("late", [0, 1])
def test_rate_from_three_lengths_is_the_slope_at_the_end_of_their_parabola(late):
    """10 k + k^2 counts at k tenths of a millisecond after the first SYNC, answered in this tick or the next."""
    protocol, last = ByValue(drives(NODES, velocity=False)), new_record()
    dialogue = protocol.start(SETUP)
    k = np.cumsum([0, 43, 37, 46, 34, 41, 38, 44, 36])
    for n in range(late, len(k)):
        tick = new_record()
        tick["tick"], tick["t_ns"] = n, 100_000 * k[n]
        at = k[n - late].item()
        heard = Received(int(tick["t_ns"]) + 1, place(4, 10 * at + at * at))
        dialogue = protocol.decode(
            dialogue, received_array([heard]), last, tick, int(tick["t_ns"]) + 2 * late
        )
        last = tick
    assert last["age"][4] == late
    assert last["rate"][4] == pytest.approx((10 + 2 * k[-1 - late]) * STEP_m / 1e-4, rel=1e-9)


@pytest.mark.parametrize("late", [0, 1])
def test_length_is_sampled_at_the_end_of_sync_on_the_bus_of_its_leg(late):
    last = last_tick(age=3)
    last["t_ns"], last["lateness_ns"], last["latch_ns"] = 100, 20, [1, 2, 3, 4, 5, 6]
    tick = new_record()
    tick["tick"], tick["t_ns"], tick["lateness_ns"], tick["latch_ns"] = 13, 900, 100, [10, 20, 30, 40, 50, 60]
    protocol = ByValue(drives(NODES, velocity=False))
    run = received_array([Received(1_000 if late else 2_000, place(leg, 131072)) for leg in range(6)])
    dialogue = protocol.decode(begun(protocol), run, last, tick, 1_000)
    ended = [121, 122, 123, 124, 125, 126] if late else [1_010, 1_020, 1_030, 1_040, 1_050, 1_060]
    lengths = protocol.transmission.length(np.ones(6))
    assert list(dialogue.latched_ns) == ended
    assert list(dialogue.length) == pytest.approx(lengths.tolist(), rel=1e-12)
    assert tick["age"].tolist() == [late] * 6


def test_rate_is_computed_from_lengths_half_to_fifty_periods_apart():
    protocol = ByValue(drives(NODES, velocity=False))
    run = received_array([Received(2_000, place(leg, 131072)) for leg in range(6)])
    before = {"mean": 0.5, "T": 0.004, "latched_ns": 0, "length": 0.0, "has_length": 1}
    for t_ns, kind in (
        (1_999_999, "kept"),
        (2_000_001, "new"),
        (199_999_999, "new"),
        (200_000_001, "begun"),
    ):
        tick = new_record()
        tick["tick"], tick["t_ns"] = 13, t_ns
        dialogue = protocol.decode(begun(protocol, **before), run, last_tick(), tick, 1_000)
        assert (tick["rate"].tolist() == last_tick()["rate"].tolist()) == (kind == "kept")
        assert (tick["rate"].tolist() == [0.0] * 6) == (kind == "begun")
        assert [each > 0.0 for each in dialogue.T] == [kind != "begun"] * 6
