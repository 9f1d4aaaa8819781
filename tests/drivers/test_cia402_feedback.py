"""What a tick measures of CiA 402 drives: each leg by its own frames, at its own age, with its own faults."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.cia402.states import STATUSWORDS, UNHEARD, State
from drivers.frame_array import received_array
from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, DriveSetup, Frame, Received
from drivers.signals import NEVER, DriveFault, DriveState, Foreign, Reaction
from drivers.tick_columns import Record, new_record
from hil.contracts.by_value import ByValue, Remembered
from tests.drivers.cia402_drives import Slope, difference, drives, made
from tests.drivers.spoken_drives import UNLIKE, UNLIKE_GEAR, last_tick

SETUP = DriveSetup(0.05, Reaction.DAMP, 250.0)
NODES = (1, 2, 3, 4, 5, 6)
P = ByValue(drives(NODES, lead_m=[0.01, 0.02, 0.03, 0.04, 0.05, 0.06]))
OFF, RUN, FAULT, BOOT = DriveState.OFF, DriveState.RUN, DriveState.FAULT, DriveState.BOOT
WOKE_NS, SYNCED_NS = 1_000, 1_500
"""When the loop woke up, and when the SYNC of this tick had ended on the bus of every leg but the last."""
KEPT = ("length", "rate", "drive_force", "drive_state")
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
    *frames: Frame | tuple[int, Frame],
    last: Record | None = None,
    protocol: ByValue = P,
    **fields: Any,
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


def test_a_tick_without_frames_keeps_the_measurement_and_counts_nothing():
    before = last_tick(10, [0, 2, 5, NEVER, NEVER - 2, 1])
    tick, _ = told(last=before)
    for name in KEPT:
        assert tick[name].tolist() == before[name].tolist()
    assert tick["drive_fault"].tolist() == FAULTS
    assert tick["age"].tolist() == tick["counted_age"].tolist() == [3, 5, 8, NEVER, NEVER, 4]
    assert tick["blind"].tolist() == [0] * 6
    assert [int(tick[name]) for name in ("rejected", "doubled", "foreign", "altered")] == [0] * 4
    assert told(last=last_tick(-1, 4))[0]["age"].tolist() == [5] * 6
    assert told(last=last_tick(0, 4))[0]["age"].tolist() == [17] * 6


@pytest.mark.parametrize("leg", range(6))
def test_two_tpdos_measure_their_leg_and_no_other(leg):
    tick, dialogue = told(speed(leg, -262144), place(leg, 131072, -100))
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


def test_a_state_without_its_speed_is_told_and_no_length_is():
    tick, dialogue = told(place(2, 131072, 100, State.DISABLED), states=(int(State.DISABLED),) * 6)
    assert tick["drive_state"].tolist() == [0, 1, OFF, 3, 4, 1]
    assert tick["drive_force"][2] != last_tick()["drive_force"][2]
    assert (tick["age"][2], tick["length"][2], tick["rate"][2]) == (1, 2.3, 0.03)
    assert dialogue.states[2] == State.DISABLED
    assert told(speed(2, 500))[0]["rate"].tolist() == last_tick()["rate"].tolist()


def test_what_came_before_the_sync_had_ended_on_the_bus_of_its_leg_is_a_tick_old():
    for t_ns, first, last in ((1_499, 1, 1), (1_500, 0, 1), (1_799, 0, 1), (1_800, 0, 0)):
        frames = [(t_ns, frame) for leg in (0, 5) for frame in (place(leg, 100), speed(leg))]
        tick, _ = told(*frames, last=last_tick(age=3))
        assert tick["age"].tolist() == [first, 4, 4, 4, 4, last]


def test_a_late_answer_counts_where_nothing_newer_is_held_and_the_older_of_two_tpdos_is_the_age():
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
def test_a_second_answer_doubles_its_node_where_the_drive_owes_none(leg):
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


def test_what_a_drive_owes_is_remembered_by_drive_and_kind_up_to_eight_and_when_it_was_missed():
    ages = [0, 1, 0, 2, 0, 0]
    _, dialogue = told(
        place(1), speed(4), last=last_tick(12, ages), missed=(5, 5, 4, 5, 5, 5), owed=tuple(range(12))
    )
    assert dialogue.missed == (5, 12, 4, 12, 5, 5)
    assert dialogue.owed == (1, 1, 1, 4, 5, 6, 7, 8, 1, 8, 8, 8)


def test_frames_that_cannot_be_trusted_are_counted_one_by_one():
    bad = [
        Frame(0x182, bytes(7)),
        Frame(0x182, b"\xff\xff" + bytes(6)),
        Frame(0x282, bytes(8)),
        Frame(0x082, bytes(7)),
        Frame(0x702, b"\6"),
        Frame(0x702, b"\5\5"),
        Frame(0x582, bytes(7)),
    ]
    tick, dialogue = told(*bad)
    assert (tick["rejected"], tick["foreign"]) == (7, 0)
    for name in KEPT:
        assert tick[name].tolist() == last_tick()[name].tolist()
    assert tick["drive_fault"].tolist() == FAULTS
    assert dialogue.at == begun().at


def test_frames_of_controllers_are_named_and_strangers_are_not():
    found = [Frame(0x80, b""), Frame(0x77F, b"\5"), Frame(0x601, bytes(8))]
    assert told(*found)[0]["foreign"] == Foreign.SYNC | Foreign.COMMAND | Foreign.CONFIG
    strange = [Frame(0x80, b"", flags) for flags in (EXTENDED, FD, REMOTE, ERROR, BUS)]
    tick, _ = told(
        *strange, Frame(0x187, bytes(8)), Frame(0x301, bytes(8)), place(0)._replace(flags=EXTENDED), place(3)
    )
    assert (tick["foreign"], tick["rejected"]) == (0, 0)
    assert tick["drive_state"].tolist() == [0, 1, 2, RUN, 4, 1]


def test_an_emcy_is_the_fault_of_its_drive_low_byte_first():
    tick, _ = told(Frame(0x084, bytes.fromhex("0573010000000000")))
    assert tick["drive_fault"].tolist() == [0, 1, 0, 0x7305, 4, 5]


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_that_boots_forgets_its_fault_its_answer_and_its_set_up(leg):
    before = last_tick()
    before["drive_fault"] = 0x7305
    tick, dialogue = told(
        place(leg), speed(leg), Frame(0x701 + leg, b"\0"), last=before, tries=(4,) * 6, asked=(3,) * 6
    )
    mine = [each == leg for each in range(6)]
    assert [s == BOOT for s in tick["drive_state"]] == [
        m or s == BOOT for m, s in zip(mine, before["drive_state"], strict=True)
    ]
    assert tick["age"].tolist() == [1] * 6
    assert tick["drive_fault"].tolist() == [0 if m else 0x7305 for m in mine]
    assert dialogue.states == tuple(UNHEARD if m else State.ENABLED for m in mine)
    assert dialogue.at == tuple(0 if m else n for m, n in zip(mine, begun().at, strict=True))
    assert (dialogue.tries[leg], dialogue.asked[leg]) == (0, -1)


@pytest.mark.parametrize(
    ("nmt", "done", "anew"), [(4, True, True), (127, True, True), (5, True, False), (127, False, False)]
)
def test_a_drive_that_leaves_operational_is_set_up_anew_and_keeps_its_fault(nmt, done, anew):
    at = begun().at if done else (2,) * 6
    tick, dialogue = told(Frame(0x705, bytes((nmt,))), at=at)
    assert dialogue.at == tuple(0 if anew and leg == 4 else n for leg, n in enumerate(at))
    assert tick["drive_fault"].tolist() == FAULTS
    assert (tick["drive_state"][4] == BOOT) == anew


@pytest.mark.parametrize("leg", range(6))
def test_a_drive_that_stopped_quickly_is_in_fault_by_that_until_it_is_not_stopped_any_more(leg):
    for state, before in ((State.QUICK_STOP, State.DISABLED), (State.DISABLED, State.ENABLED)):
        others = int(State.ENABLED if before is State.DISABLED else State.SWITCHED_ON)
        states = tuple(int(before) if each == leg else others for each in range(6))
        tick, dialogue = told(place(leg, state=state), states=states)
        assert dialogue.stopped == 1 << leg
        assert (tick["drive_state"][leg], tick["drive_fault"][leg]) == (FAULT, [2, 1, 2, 3, 4, 5][leg])
    states = tuple(int(State.SWITCHED_ON if each == leg else State.ENABLED) for each in range(6))
    tick, dialogue = told(place(leg, state=State.DISABLED), states=states)
    assert (dialogue.stopped, tick["drive_state"][leg]) == (0, OFF)
    halted, running = (
        told(states=(int(state),) * 6, stopped=1 << leg)[0]
        for state in (State.READY_TO_SWITCH_ON, State.ENABLED)
    )
    assert halted["drive_state"][leg] == FAULT
    assert running["drive_state"].tolist() == last_tick()["drive_state"].tolist()
    mine = last_tick()
    mine["drive_fault"] = DriveFault.ESTOP
    assert told(last=mine, stopped=1 << leg)[0]["drive_fault"].tolist() == [
        2 if each == leg else 0 for each in range(6)
    ]


@pytest.mark.parametrize("leg", range(6))
def test_the_first_answer_after_the_start_ends_the_set_up_of_its_drive(leg):
    last_step = tuple(n - 1 for n in begun().at)
    asked = tuple(0 if each == leg else -1 for each in range(6))
    frames = [frame for each in range(6) for frame in (place(each), speed(each))]
    _, dialogue = told(*frames, at=last_step, asked=asked)
    assert P.legs_set_up(dialogue) == tuple(each == leg for each in range(6))
    late = [(WOKE_NS, frame) for frame in frames]
    assert told(*late, at=last_step, asked=asked, last=last_tick(age=3))[1].at == last_step
    earlier = tuple(n - 2 for n in begun().at)
    assert told(*frames, at=earlier, asked=(9,) * 6)[1].at == earlier


def test_forces_are_read_with_the_losses_of_each_leg_at_its_rate():
    lossy = ByValue(made(NODES, UNLIKE_GEAR, force_limit_N=100.0))
    speeds = [30000, -30000, 0, 30000, -30000, 2000]
    frames = [
        frame for leg in range(6) for frame in (place(leg, 0, 100), speed(leg, 65536 * speeds[leg] // 100))
    ]
    tick, _ = told(*frames, protocol=lossy)
    lossless = 100 * 9e-3 * UNLIKE.N_per_Nm
    expected = lossless / UNLIKE._loss(lossless, tick["rate"])
    np.testing.assert_allclose(tick["drive_force"], expected, rtol=1e-9)
    assert len({round(share, 6) for share in expected / lossless}) > 2


def test_the_force_of_a_drive_without_losses_follows_from_its_torque_alone():
    last = last_tick()
    last["rate"] = np.nan
    tick, _ = told(*(place(leg, 0, 100) for leg in range(6)), last=last)
    np.testing.assert_allclose(tick["drive_force"], 100 * 9e-3 * P.transmission.N_per_Nm, rtol=1e-12)


# rates of lengths


def test_a_rate_of_lengths_is_the_slope_at_the_end_of_the_parabola_through_three():
    # d1 = 0.3 m / 2 s, d0 = 0.1 m/s over 1 s: d1 + (d1 - d0) 2 / 3
    rate, after = difference(1.3, 3_000_000_000, Slope(0.1, 1.0, 1_000_000_000, 1.0), 9.0, 2.0)
    assert rate == pytest.approx(0.15 + 0.05 * 2 / 3, rel=1e-12)
    assert tuple(after) == pytest.approx((0.15, 2.0, 3_000_000_000, 1.3), rel=1e-12)
    rate, after = difference(1.3, 3_000_000_000, Slope(0.0, 0.0, 1_000_000_000, 1.0), 9.0, 2.0)
    assert rate == pytest.approx(0.15, rel=1e-12), "of two lengths the mean rate"
    assert difference(1.3, 7, Slope(), 9.0, 2.0) == (0.0, Slope(0.0, 0.0, 7, 1.3))


@pytest.mark.parametrize(("periods", "kind"), [(0.49, "kept"), (0.5, "new"), (50.0, "new"), (50.01, "begun")])
def test_a_step_of_half_a_period_to_fifty_makes_a_rate(periods, kind):
    before = Slope(0.5, 1.0, 0, 1.0)
    rate, after = difference(2.0, round(periods * 1e9), before, 9.0, 1.0)
    if kind == "kept":
        assert (rate, after) == (9.0, before)
    elif kind == "begun":
        assert (rate, after) == (0.0, Slope(0.0, 0.0, round(periods * 1e9), 2.0))
    else:
        assert after.rate == pytest.approx(1.0 / periods)


@pytest.mark.parametrize("late", [0, 1])
def test_a_length_is_latched_when_the_sync_of_its_tick_had_ended_on_the_bus_of_its_leg(late):
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


def test_a_step_is_long_enough_by_the_period_of_the_loop_and_else_leaves_each_leg_its_own_rate():
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
