"""The start-up dialogue of CiA 402 step by step: its frames, its turns, its patience, and its answers."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.cia402 import objects as o
from drivers.cia402.plan import Step, max_torque, plan, watchdog_ms
from drivers.cia402.set_up import Cia402Dialogue, Slope, answered, lack, next_frames, patience
from drivers.errors import ProtocolError
from drivers.protocol import DriveSetup, Frame
from drivers.signals import DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, new_record
from tests.drivers.cia402_drives import drives

SETUP = DriveSetup(0.05, Reaction.DAMP, 250.0)
OFF, READY, RUN, FAULT = DriveState.OFF, DriveState.READY, DriveState.RUN, DriveState.FAULT
WRITES = """
2300140105020080 2F001402FF000000 2F00160000000000 2300160110004060 2300160210007160 2F00160002000000
2300140105020000 2300180185010080 2F00180201000000 2F001A0000000000 23001A0110004160 23001A0220006460
23001A0310007760 2F001A0003000000 2300180185010000 2301180185020080 2F01180201000000 2F011A0000000000
23011A0120006C60 2F011A0001000000 2301180185020000 2302180185030080 2303180185040080 2316100132007F00
2B17100018000000 2F29100101000000 2B07600001000000 2B5A600002000000 2B5E600002000000 2F6060000A000000
2B726000D10D0000 2FC2600128000000 2FC26002FC000000
"""
"""9 N m, 10 kN, heartbeat of 24 ms, watchdog of 50 ms, 250 Hz: 40 x 10^-4 s."""
READ_BACK = """
14001 14002 16000 16001 16002 18001 18002 1A000 1A001 1A002 1A003 18011 18012 1A010 1A011 18021 18031 10161
10170 10291 60070 605A0 605E0 60610 60720 60C21 60C22
"""


def test_a_drive_is_asked_what_it_is_mapped_set_read_back_and_started_in_this_order():
    steps = plan(5, SETUP, drives()._settings)

    def read(index: int, sub: int) -> Frame:
        return Frame(0x605, bytes((0x40, index & 0xFF, index >> 8, sub, 0, 0, 0, 0)))

    expected = [read(0x1000, 0), Frame(0, b"\x80\5"), read(0x6502, 0), read(0x6076, 0)]
    expected += [Frame(0x605, bytes.fromhex(each)) for each in WRITES.split()]
    expected += [read(int(each[:4], 16), int(each[4])) for each in READ_BACK.split()]
    expected.append(Frame(0, b"\1\5"))
    assert [step.frame(5) for step in steps] == expected


def test_what_is_read_is_compared_with_what_was_written_in_the_bits_that_count():
    found = {step.key: step for step in plan(5, SETUP, drives()._settings, 4096) if step.kind == "read"}
    expected = {
        0x10000: (0x0192, 0xFFFF, False),
        0x65020: (0x200, 0x200, True),
        0x60760: (9000, 0xFFFFFFFF, False),
        0x608F1: (4096, 0xFFFFFFFF, True),
        0x608F2: (1, 0xFFFFFFFF, True),
        0x14001: (0x205, 0xBFFFFFFF, False),
        0x18001: (0x185, 0xBFFFFFFF, False),
        0x18011: (0x285, 0xBFFFFFFF, False),
        0x18021: (0x80000385, 0x80000000, True),
        0x18031: (0x80000485, 0x80000000, True),
        0x14002: (255, 0xFFFFFFFF, False),
        0x18002: (1, 0xFFFFFFFF, False),
        0x16000: (2, 0xFFFFFFFF, False),
        0x16001: (0x60400010, 0xFFFFFFFF, False),
        0x1A000: (3, 0xFFFFFFFF, False),
        0x1A001: (0x60410010, 0xFFFFFFFF, False),
        0x10161: (127 << 16 | 50, 0xFFFFFFFF, False),
        0x10291: (1, 0xFFFFFFFF, True),
        0x60610: (10, 0xFFFFFFFF, False),
        0x60C21: (40, 0xFFFFFFFF, True),
        0x60C22: (0xFC, 0xFFFFFFFF, True),
    }
    for number, (value, mask, optional) in expected.items():
        step = found[number >> 4, number & 15]
        assert (step.value, step.mask, step.optional) == (value, mask, optional), hex(number)


@pytest.mark.parametrize(
    ("watchdog_s", "ms"),
    [
        (0.0005, 0),
        (0.0006, 1),
        (0.05, 50),
        (65.5344, 65534),
        (0.00049, None),
        (65.535, None),
        (float("nan"), None),
    ],
)
def test_a_watchdog_is_a_consumer_heartbeat_time_of_16_bits(watchdog_s, ms):
    setup = DriveSetup(watchdog_s, Reaction.DAMP, 1e5)
    if ms is not None:
        assert watchdog_ms(setup) == ms
        return
    with pytest.raises(ProtocolError, match=r"does not fit into 0x1016: 0.001 to 65.535 s are allowed"):
        watchdog_ms(setup)


@pytest.mark.parametrize(("reaction", "code"), [(Reaction.BRAKE, 0), (Reaction.DAMP, 2)])
def test_a_reaction_is_the_fault_reaction_option_code_of_the_drive(reaction, code):
    (step,) = [
        s
        for s in plan(5, SETUP._replace(reaction=reaction), drives()._settings)
        if s.key == o.FAULT_REACTION and s.kind == "write"
    ]
    assert (step.value, step.size) == (code, 2)


def test_a_watchdog_of_four_periods_may_be_rounded_by_a_billionth_of_it():
    assert watchdog_ms(DriveSetup(4.0 * (1 - 1e-9), Reaction.DAMP, 1.0)) == 4000
    with pytest.raises(ProtocolError, match=r"too short at 1 Hz"):
        watchdog_ms(DriveSetup(4.0 * (1 - 1.5e-9), Reaction.DAMP, 1.0))


@pytest.mark.parametrize(("watchdog_s", "fits"), [(0.016, True), (0.0159, False)])
def test_a_watchdog_is_of_four_periods_or_more(watchdog_s, fits):
    setup = DriveSetup(watchdog_s, Reaction.DAMP, 250.0)
    if fits:
        assert watchdog_ms(setup) == 16
        return
    with pytest.raises(ProtocolError, match=r"too short at 250 Hz: at least 4 periods are allowed, 0.016 s"):
        watchdog_ms(setup)


def test_the_most_torque_is_that_of_the_leg_with_the_least_force_a_permille_and_never_over_16_bits():
    assert max_torque(1000.0, [2.0, -1.0, 4.0]) == 1000
    assert max_torque(1000.5, [2.0, 1.0]) == 1001
    assert max_torque(1000.0 * (1 + 0.5e-12), [1.0]) == 1000
    assert max_torque(1000.0 * (1 + 1.5e-12), [1.0]) == 1001
    assert max_torque(65534.5, [1.0]) == max_torque(1e6, [1.0]) == 65535


# whose turn it is


A = (
    Step("read", o.DEVICE_TYPE, 7, mask=0xFF),
    Step("write", o.MODE, 10, 1),
    Step("nmt", o.DEVICE_TYPE, o.START),
)


def begun(**fields: Any) -> Cia402Dialogue:
    return Cia402Dialogue(SETUP, (A,) * 6, 3)._replace(**fields)


def tick(number: int = 100, **columns: Any) -> Record:
    record = new_record()
    record["tick"], record["drive_state"], record["age"] = number, OFF, 0
    for name, value in columns.items():
        record[name] = value
    return record


def asked(frames: tuple[Frame, ...]) -> list[int]:
    """Return the legs of requests to nodes 10 to 15."""
    return [frame.id - 0x60A if frame.id else frame.data[1] - 10 for frame in frames]


NODES = (10, 11, 12, 13, 14, 15)


def test_a_dialogue_begins_with_drives_of_which_nothing_is_known():
    assert begun()._asdict() == {
        "setup": SETUP,
        "plans": (A,) * 6,
        "beat": 3,
        "at": (0,) * 6,
        "asked": (-1,) * 6,
        "tries": (0,) * 6,
        "refusal": ("",) * 6,
        "states": (-1,) * 6,
        "mode": DriveMode.OFF,
        "stopped": 0,
        "resets": 0,
        "rate": (0.0,) * 6,
        "slopes": (Slope(),) * 6,
        "owed": (1,) * 12,
        "missed": (0,) * 6,
    }
    assert tuple(Slope()) == (0.0, 0.0, 0, None)


@pytest.mark.parametrize(("number", "legs"), [(0, [0, 1]), (1, [2, 3]), (2, [4, 5]), (3, [0, 1])])
def test_the_turn_goes_round_by_the_number_of_the_tick_and_no_more_are_asked_than_fit(number, legs):
    dialogue, frames = next_frames(begun(), tick(number), NODES, 2)
    assert asked(frames) == legs
    assert dialogue.asked == tuple(number if leg in legs else -1 for leg in range(6))
    assert dialogue.tries == tuple(int(leg in legs) for leg in range(6))


def test_drives_that_are_done_that_wait_or_that_are_powered_are_passed_over():
    waits = {"at": (3, 0, 0, 0, 0, 3), "asked": (-1, 95, 88, 87, -1, -1)}
    states = [OFF, OFF, OFF, OFF, READY, OFF]
    _, frames = next_frames(begun(**waits), tick(drive_state=states), NODES, 6)
    assert asked(frames) == [2, 3]
    for age, there in ((11, False), (12, True)):
        ages = [0, 0, 0, 0, age, 0]
        _, frames = next_frames(begun(**waits), tick(drive_state=states, age=ages), NODES, 6)
        assert (4 in asked(frames)) == there, "silent for its patience"


@pytest.mark.parametrize(
    ("rate_Hz", "ticks"), [(250.0, 12), (100.0, 6), (120.0, 6), (150.0, 8), (1000.0, 50)]
)
def test_patience_is_50_ms_and_six_ticks_at_least(rate_Hz, ticks):
    assert patience(begun(setup=SETUP._replace(rate_Hz=rate_Hz))) == ticks
    for since, again in ((ticks - 1, False), (ticks, True)):
        dialogue = begun(setup=SETUP._replace(rate_Hz=rate_Hz), asked=(100 - since,) * 6)
        assert bool(next_frames(dialogue, tick(100), NODES, 6)[1]) == again


@pytest.mark.parametrize(("tries", "at", "first"), [(19, 1, False), (20, 1, True), (20, 0, False)])
def test_a_drive_that_did_not_answer_twenty_times_is_asked_from_the_beginning(tries, at, first):
    mine = (A[0]._replace(key=o.REVISION), *A[1:])
    before = begun(at=(3, 3, at, 3, 3, 3), tries=(0, 0, tries, 0, 0, 0), plans=(A, A, mine, A, A, A))
    dialogue, (frame,) = next_frames(before, tick(100), NODES, 3)
    assert frame == mine[0 if first or at == 0 else 1].frame(12)
    assert dialogue.at == (3, 3, 0 if first else at, 3, 3, 3)
    assert dialogue.tries == (0, 0, 1 if first else tries + 1, 0, 0, 0)
    assert dialogue.asked == (-1, -1, 100, -1, -1, -1)


def test_an_nmt_command_is_not_answered_but_for_the_start_and_the_next_step_follows():
    prepare = (Step("nmt", o.DEVICE_TYPE, o.PRE_OPERATIONAL), A[1])
    dialogue, (frame,) = next_frames(
        begun(plans=(A, A, prepare, A, A, A), at=(3, 3, 0, 3, 3, 3)), tick(), NODES, 3
    )
    assert frame == Frame(0, b"\x80\x0c")
    assert (dialogue.at[2], dialogue.asked[2], dialogue.tries[2]) == (1, -1, 0)
    dialogue, (frame,) = next_frames(begun(at=(3, 3, 2, 3, 3, 3)), tick(), NODES, 3)
    assert frame == Frame(0, b"\1\x0c")
    assert (dialogue.at[2], dialogue.asked[2], dialogue.tries[2]) == (2, 100, 1)


def test_a_drive_in_fault_of_which_no_code_is_known_is_asked_for_it_when_it_is_set_up():
    done = begun(at=(3,) * 6)
    states, codes = [FAULT, OFF, FAULT, FAULT, RUN, FAULT], [1, 0, 0, 0x7300, 0, 0]
    dialogue, frames = next_frames(done, tick(drive_state=states, drive_fault=codes), NODES, 6)
    assert sorted(frames) == [Frame(0x600 + node, bytes.fromhex("403f600000000000")) for node in (12, 15)]
    assert dialogue.tries == (0,) * 6
    assert dialogue.asked == (-1, -1, 100, -1, -1, 100)
    assert next_frames(done, tick(), NODES, 6) == (done, ())
    assert len(next_frames(done, tick(drive_state=FAULT), NODES, 6)[1]) == 6
    early = begun(at=(3, 3, 1, 3, 3, 3))
    _, (frame,) = next_frames(early, tick(drive_state=states, drive_fault=[1, 0, 0, 1, 0, 1]), NODES, 6)
    assert frame == A[1].frame(12), "the set-up comes first"


# answers


def read(value: int, index: int = 0x1000) -> bytes:
    return bytes((0x43, index & 0xFF, index >> 8, 0)) + value.to_bytes(4, "little")


WROTE = bytes.fromhex("6060600000000000")


def at(leg_at: int, **fields: Any) -> Cia402Dialogue:
    """Return leg 2 at a step, asked in tick 90."""
    return begun(at=(0, 0, leg_at, 0, 0, 0), asked=(9, 9, 90, 9, 9, 9), tries=(1, 1, 5, 1, 1, 1), **fields)


def test_an_answer_leads_its_drive_alone_to_the_next_step():
    for leg_at, data in ((0, read(7)), (0, read(0xAB07)), (1, WROTE)):
        after = answered(at(leg_at), 2, data, 100)
        assert after is not None
        assert after.at == (0, 0, leg_at + 1, 0, 0, 0)
        assert after.asked == (9, 9, -1, 9, 9, 9)
        assert after.tries == (1, 1, 0, 1, 1, 1)


def test_an_answer_to_nothing_that_was_asked_changes_nothing_and_what_is_no_answer_is_none():
    for leg_at, data in (
        (0, WROTE),
        (1, read(7)),
        (1, read(10, 0x6060)),
        (0, read(7, 0x1001)),
        (2, read(1)),
        (3, read(7)),
    ):
        assert answered(at(leg_at), 2, data, 100) == at(leg_at)
    unasked = begun(at=(0, 0, 0, 0, 0, 0))
    assert answered(unasked, 2, read(7), 100) == unasked
    for data in (b"", read(7)[:7], b"\x20" + bytes(7), b"\x41" + bytes(7)):
        assert answered(at(0), 2, data, 100) is None


def test_a_refusal_is_kept_until_the_drive_is_set_up_and_waits_its_patience():
    abort = bytes.fromhex("8060600030000906")
    after = answered(at(1), 2, abort, 100)
    assert after is not None
    why = "0x6060:0 mode of operation: write refused with abort 0x06090030 (invalid value for the parameter)"
    assert after.refusal == ("", "", why, "", "", "")
    assert (after.at, after.asked, after.tries[2]) == ((0,) * 6, (9, 9, 100, 9, 9, 9), 0)
    assert [lack(after, leg) for leg in range(6)] == [
        "no answer to 1 requests for 0x1000:0 device type" if leg != 2 else why for leg in range(6)
    ]
    again = answered(after, 2, read(7), 110)
    assert again is not None
    assert again.refusal[2] == why
    last = answered(at(1, plans=(A, A, A[:2], A, A, A), refusal=("x",) * 6), 2, WROTE, 100)
    assert last is not None
    assert last.refusal == ("x", "x", "", "x", "x", "x")
    assert lack(last, 2) == ""


def test_a_value_that_reads_otherwise_is_named_in_the_bits_that_count():
    after = answered(at(0), 2, read(0xAB08), 100)
    assert after is not None
    assert after.refusal[2] == "0x1000:0 device type is 8, expected 7"
    assert (after.at[2], after.asked[2]) == (0, 100)


@pytest.mark.parametrize(("code", "passes"), [(0x06020000, True), (0x06090011, True), (0x06090030, False)])
@pytest.mark.parametrize("optional", [False, True])
def test_an_object_that_is_not_there_is_passed_over_where_a_drive_may_lack_it(code, passes, optional):
    plans = ((A[0]._replace(optional=optional), A[1]),) * 6
    after = answered(at(0, plans=plans), 2, bytes.fromhex("80001000") + code.to_bytes(4, "little"), 100)
    assert after is not None
    assert (after.at[2], bool(after.refusal[2])) == ((1, False) if passes and optional else (0, True))


def test_a_drive_that_was_started_lacks_its_tpdo():
    assert lack(at(2), 2) == "it sends no TPDO, although it was started by NMT"
    assert lack(at(1), 2) == "no answer to 5 requests for 0x6060:0 mode of operation"
