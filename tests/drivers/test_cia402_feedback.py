"""What a tick measures of CiA 402 drives: each leg by its own frames, at its own age, with its own faults."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.cia402.states import STATUSWORDS, State
from drivers.frame_array import received_array
from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, Frame, Received
from drivers.signals import DriveFault, DriveState, Foreign
from drivers.tick_columns import Record, new_record
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.ends import SETUP
from tests.drivers.cia402_drives import NODES, STEP_m, drives, made
from tests.drivers.motor_families import UNLIKE_GEAR, last_tick

P = ByValue(drives(NODES, lead_m=[0.01, 0.02, 0.03, 0.04, 0.05, 0.06]))
OFF, RUN, FAULT, BOOT = DriveState.OFF, DriveState.RUN, DriveState.FAULT, DriveState.BOOT
WOKE_NS = 1_000
"""When the loop woke up; the SYNC of this tick ended 500 ns later, on the bus of the last leg 800 ns later."""
FAULTS = [0, 1, 0, 3, 4, 5]
"""Of the tick before: a stop, 2, is over where the drive is not stopped any more."""


def place(leg: int, counts: int = 0, torque: int = 0, state: State = State.ENABLED) -> Frame:
    return Frame(0x181 + leg, struct.pack("<Hih", STATUSWORDS[state], counts, torque))


def speed(leg: int, counts_per_s: int = 0) -> Frame:
    return Frame(0x281 + leg, struct.pack("<i", counts_per_s))


def begun(protocol: ByValue = P, **fields: Any) -> Remembered:
    start = protocol.start(SETUP)
    done = {"at": start.steps, "states": (int(State.ENABLED),) * 6}
    return start._replace(**done | fields)


def told(
    *frames: Frame | tuple[int, Frame], last: Record | None = None, protocol: ByValue = P, **fields: Any
) -> tuple[Any, Remembered]:
    """Return a tick and the dialogue after these frames; one with a time came then, the others in time."""
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


def test_tpdo_without_its_speed_gives_the_state_and_no_length():
    tick, dialogue = told(place(2, 131072, 100, State.DISABLED), states=(int(State.DISABLED),) * 6)
    assert tick["drive_state"].tolist() == [0, 1, OFF, 3, 4, 1]
    assert tick["drive_force"][2] != last_tick()["drive_force"][2]
    assert (tick["age"][2], tick["length"][2], tick["rate"][2]) == (1, 2.3, 0.03)
    assert dialogue.states[2] == State.DISABLED
    assert told(speed(2, 500))[0]["rate"].tolist() == last_tick()["rate"].tolist()


def test_answer_from_before_the_end_of_the_sync_on_its_bus_is_a_tick_old():
    for t_ns, first, last in ((1_499, 1, 1), (1_500, 0, 1), (1_799, 0, 1), (1_800, 0, 0)):
        frames = [(t_ns, frame) for leg in (0, 5) for frame in (place(leg, 100), speed(leg))]
        tick, _ = told(*frames, last=last_tick(age=3))
        assert tick["age"].tolist() == [first, 4, 4, 4, 4, last]


def test_late_answer_counts_unless_a_newer_is_held():
    late, here = (WOKE_NS, place(2, 131072)), (WOKE_NS, speed(2))
    for age, there in ((0, False), (1, True)):
        ages = [1 - age] * 6
        ages[2] = age
        tick, _ = told(late, here, last=last_tick(age=ages))
        assert (tick["length"][2] != 2.3) == there
        assert tick["age"][2] == 1
    assert told(late, speed(2), last=last_tick(age=3))[0]["age"][2] == 1
    assert told(late, place(2, 131072), speed(2), last=last_tick(age=3))[0]["age"][2] == 0, "the same in time"
    assert told(place(2), here, last=last_tick(age=3))[0]["age"][2] == 4, "its speed is of another SYNC"


@pytest.mark.parametrize("leg", range(6))
def test_second_answer_doubles_its_node_where_the_drive_owes_none(leg):
    frames = [place(leg, 100), speed(leg, 1)]
    tick, _ = told(*frames, place(leg, 101), owed=(0,) * 12)
    assert tick["doubled"] == 1 << leg
    assert told(*frames, speed(leg, 2), owed=(0,) * 12)[0]["doubled"] == 1 << leg
    assert told(*frames, *frames, owed=(0,) * 12)[0]["doubled"] == 0
    lately = tuple(5 if each == leg else -100 for each in range(6))
    owes = tuple(int(each % 6 == leg) for each in range(12))
    tick, dialogue = told(*frames, place(leg, 101), speed(leg, 2), missed=lately, owed=owes)
    assert tick["doubled"] == 0
    assert tick["length"][leg] == P.transmission.length(np.full(6, 101 / 131072))[leg]
    assert dialogue.owed == tuple(0 if each % 6 == leg else 1 for each in range(12))
    assert told(*frames, place(leg, 101), missed=(4,) * 6, owed=owes)[0]["doubled"] == 1 << leg


def doubled(*ticks: int) -> int:
    """Return what is doubled in the last of some ticks, after calm ones, with so many answers of leg 4 each."""
    dialogue, m = P.start(SETUP), new_record()
    answers = [[place(4, 100), speed(4)], [place(4, 101), speed(4, 1)]]
    for number, count in enumerate([1] * 20 + list(ticks)):
        last, m = m, new_record()
        m["tick"] = number
        heard = received_array([Received(1, frame) for answer in answers[:count] for frame in answer])
        dialogue = P.decode(dialogue, heard, last, m, 0)
    return int(m["doubled"])


def test_drive_that_missed_a_tick_may_catch_up_once_and_soon():
    assert doubled(2) == 1 << 4
    assert doubled(0, 2) == doubled(0, 1, 1, 2) == 0
    assert doubled(0, 1, 2, 2) == 1 << 4, "it owed one alone"
    assert doubled(0, *[1] * 8, 2) == 1 << 4, "an answer that was lost does not come"


def test_frames_of_another_controller_are_foreign_and_unknown_ones_are_not():
    for frame, name in (
        (Frame(0x080, b""), Foreign.SYNC),
        (Frame(0x000, b"\1\5"), Foreign.CONFIG),
        (Frame(0x605, bytes(8)), Foreign.CONFIG),
        (Frame(0x205, bytes(4)), Foreign.COMMAND),
        (Frame(0x77F, b"\5"), Foreign.COMMAND),
    ):
        assert told(frame)[0]["foreign"] == name
    strange = [Frame(0x80, b"", flags) for flags in (EXTENDED, FD, REMOTE, ERROR, BUS)]
    tick, _ = told(
        *strange, Frame(0x187, bytes(8)), Frame(0x301, bytes(8)), place(0)._replace(flags=EXTENDED), place(3)
    )
    assert (tick["foreign"], tick["rejected"]) == (0, 0)
    assert tick["drive_state"].tolist() == [0, 1, 2, RUN, 4, 1]


@pytest.mark.parametrize(
    ("nmt", "done", "anew"), [(4, True, True), (127, True, True), (5, True, False), (127, False, False)]
)
def test_drive_that_leaves_operational_is_set_up_again_and_keeps_its_fault(nmt, done, anew):
    at = begun().at if done else (2,) * 6
    tick, dialogue = told(Frame(0x705, bytes((nmt,))), at=at)
    assert dialogue.at == tuple(0 if anew and leg == 4 else n for leg, n in enumerate(at))
    assert tick["drive_fault"].tolist() == FAULTS
    assert (tick["drive_state"][4] == BOOT) == anew


@pytest.mark.parametrize("leg", range(6))
def test_drive_that_stopped_quickly_is_in_fault_until_it_is_switched_on(leg):
    def of_leg(own: State, others: State) -> tuple[int, ...]:
        return tuple(int(own if each == leg else others) for each in range(6))

    for state, before, others in (
        (State.QUICK_STOP, State.DISABLED, State.ENABLED),
        (State.DISABLED, State.ENABLED, State.SWITCHED_ON),
    ):
        tick, dialogue = told(place(leg, state=state), states=of_leg(before, others))
        assert dialogue.stopped == 1 << leg
        assert (tick["drive_state"][leg], tick["drive_fault"][leg]) == (FAULT, [2, 1, 2, 3, 4, 5][leg])
    tick, dialogue = told(place(leg, state=State.DISABLED), states=of_leg(State.SWITCHED_ON, State.ENABLED))
    assert (dialogue.stopped, tick["drive_state"][leg]) == (0, OFF)
    mine = last_tick()
    mine["drive_fault"] = DriveFault.ESTOP
    for state in (State.READY_TO_SWITCH_ON, State.ENABLED):
        tick, _ = told(last=mine, states=(int(state),) * 6, stopped=1 << leg)
        halted = state is State.READY_TO_SWITCH_ON
        assert tick["drive_state"][leg] == (FAULT if halted else mine["drive_state"][leg])
    tick, _ = told(last=mine, stopped=1 << leg)
    assert tick["drive_fault"].tolist() == [2 if each == leg else 0 for each in range(6)]


@pytest.mark.parametrize("changes", [{}, {"efficiency": 1.0}, {"back_driving_efficiency": 1.0}])
def test_forces_are_read_with_the_losses_of_each_leg_at_its_rate(changes):
    lossy = ByValue(made(NODES, UNLIKE_GEAR.model_copy(update=changes), force_limit_N=100.0))
    counts = [30000, -30000, 0, 30000, -30000, 2000]
    frames = [f for leg in range(6) for f in (place(leg, 0, 100), speed(leg, 65536 * counts[leg] // 100))]
    tick, _ = told(*frames, protocol=lossy)
    expected = lossy.transmission.force(np.full(6, 100 * 9e-3), tick["rate"])
    np.testing.assert_allclose(tick["drive_force"], expected, rtol=1e-9)


# rates of lengths


@pytest.mark.parametrize("late", [0, 1])
def test_rate_of_lengths_is_the_slope_of_a_parabola_at_its_last_sync(late):
    """10 k + k^2 counts k tenths of a millisecond after the first SYNC, answered in the tick or in the next."""
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
def test_length_is_latched_at_the_end_of_the_sync_on_the_bus_of_its_leg(late):
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


def test_step_of_half_a_period_to_fifty_makes_a_rate():
    protocol = ByValue(drives(NODES, velocity=False))
    run = received_array([Received(2_000, place(leg, 131072)) for leg in range(6)])
    before = {"mean": 0.5, "T": 0.004, "latched_ns": 0, "length": 0.0, "has_length": 1}
    for t_ns, kind in ((1_999_999, "kept"), (2_000_001, "new"), (199_999_999, "new"), (200_000_001, "begun")):
        tick = new_record()
        tick["tick"], tick["t_ns"] = 13, t_ns
        dialogue = protocol.decode(begun(protocol, **before), run, last_tick(), tick, 1_000)
        assert (tick["rate"].tolist() == last_tick()["rate"].tolist()) == (kind == "kept")
        assert (tick["rate"].tolist() == [0.0] * 6) == (kind == "begun")
        assert [each > 0.0 for each in dialogue.T] == [kind != "begun"] * 6
