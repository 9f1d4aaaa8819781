"""The start-up dialogue of CiA 402 step by step: its frames, its turns, its patience, and its answers."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.cia402 import end as ends
from drivers.cia402 import objects as o
from drivers.cia402.end import Step, max_torque, plan, watchdog_ms
from drivers.errors import ProtocolError
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import DriveSetup, Frame, Received
from drivers.signals import DriveState, Reaction
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
    steps = plan(5, SETUP, drives())

    def read(index: int, sub: int) -> bytes:
        return bytes((0x40, index & 0xFF, index >> 8, sub, 0, 0, 0, 0))

    expected = [read(0x1000, 0), b"\x80\5", read(0x6502, 0), read(0x6076, 0)]
    expected += [bytes.fromhex(each) for each in WRITES.split()]
    expected += [read(int(each[:4], 16), int(each[4])) for each in READ_BACK.split()]
    expected.append(b"\1\5")
    assert [step.request(5) for step in steps] == expected


def test_what_is_read_is_compared_with_what_was_written_in_the_bits_that_count():
    found = {step.key: step for step in plan(5, SETUP, drives(), 4096) if step.kind == "read"}
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
        for s in plan(5, SETUP._replace(reaction=reaction), drives())
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


NODES = (10, 11, 12, 13, 14, 15)
P = drives(NODES)
DONE = 3


def begun(plans: Any = (A,) * 6, setup: DriveSetup = SETUP, **fields: Any) -> ends.Cia402End:
    """Return the controller's end of six drives with these plans, at these steps."""
    end = ends.Cia402End(P, setup, plans)
    for name, value in fields.items():
        end.state[name] = value
    return end


def tick(number: int = 100, **columns: Any) -> Record:
    record = new_record()
    record["tick"], record["drive_state"], record["age"] = number, OFF, 0
    for name, value in columns.items():
        record[name] = value
    return record


def sent(end: ends.Cia402End, *given: Any, **columns: Any) -> tuple[Frame, ...]:
    """Return the requests of a tick."""
    return sent_frames(end.set_up(tick(*given, **columns)))


def asked(frames: tuple[Frame, ...]) -> list[int]:
    """Return the legs of requests to nodes 10 to 15."""
    return [frame.id - 0x60A if frame.id else frame.data[1] - 10 for frame in frames]


def of(end: ends.Cia402End, name: str) -> list[int]:
    found: list[int] = end.state[name].tolist()
    return found


@pytest.mark.parametrize(("number", "legs"), [(0, [0, 1, 2]), (1, [3, 4, 5]), (2, [0, 1, 2]), (3, [3, 4, 5])])
def test_the_turn_goes_round_by_the_number_of_the_tick_and_no_more_are_asked_than_fit(number, legs):
    end = begun()
    assert asked(sent(end, number)) == legs
    assert of(end, "asked") == [number if leg in legs else -1 for leg in range(6)]
    assert of(end, "tries") == [int(leg in legs) for leg in range(6)]


def test_drives_that_are_done_that_wait_or_that_are_powered_are_passed_over():
    waits: dict[str, Any] = {"at": (DONE, 0, 0, 0, 0, DONE), "asked": (-1, 95, 88, 87, -1, -1)}
    states = [OFF, OFF, OFF, OFF, READY, OFF]
    assert asked(sent(begun(**waits), drive_state=states)) == [2, 3]
    for age, there in ((11, False), (12, True)):
        frames = sent(begun(**waits), drive_state=states, age=[0, 0, 0, 0, age, 0])
        assert (4 in asked(frames)) == there, "silent for its patience"


@pytest.mark.parametrize(
    ("rate_Hz", "ticks"), [(250.0, 12), (100.0, 6), (120.0, 6), (150.0, 8), (1000.0, 50)]
)
def test_patience_is_50_ms_and_six_ticks_at_least(rate_Hz, ticks):
    setup = SETUP._replace(rate_Hz=rate_Hz)
    for since, again in ((ticks - 1, False), (ticks, True)):
        assert bool(sent(begun(setup=setup, asked=100 - since))) == again


@pytest.mark.parametrize(("tries", "at", "first"), [(19, 1, False), (20, 1, True), (20, 0, False)])
def test_a_drive_that_did_not_answer_twenty_times_is_asked_from_the_beginning(tries, at, first):
    mine = (A[0]._replace(key=o.REVISION), *A[1:])
    end = begun((A, A, mine, A, A, A), at=(3, 3, at, 3, 3, 3), tries=(0, 0, tries, 0, 0, 0))
    assert sent(end) == (Frame(0x60C, mine[0 if first or at == 0 else 1].request(12)),)
    assert of(end, "at") == [3, 3, 0 if first else at, 3, 3, 3]
    assert of(end, "tries") == [0, 0, 1 if first else tries + 1, 0, 0, 0]
    assert of(end, "asked") == [-1, -1, 100, -1, -1, -1]


def test_an_nmt_command_is_not_answered_but_for_the_start_and_the_next_step_follows():
    prepare = (Step("nmt", o.DEVICE_TYPE, o.PRE_OPERATIONAL), A[1])
    end = begun((A, A, prepare, A, A, A), at=(3, 3, 0, 3, 3, 3))
    assert sent(end) == (Frame(0, b"\x80\x0c"),)
    assert [of(end, name)[2] for name in ("at", "asked", "tries")] == [1, -1, 0]
    end = begun(at=(3, 3, 2, 3, 3, 3))
    assert sent(end) == (Frame(0, b"\1\x0c"),)
    assert [of(end, name)[2] for name in ("at", "asked", "tries")] == [2, 100, 1]


def test_a_drive_in_fault_of_which_no_code_is_known_is_asked_for_it_when_it_is_set_up():
    states, codes = [FAULT, OFF, FAULT, FAULT, RUN, FAULT], [1, 0, 0, 0x7300, 0, 0]
    end = begun(at=DONE)
    frames = sent(end, drive_state=states, drive_fault=codes)
    assert sorted(frames) == [Frame(0x600 + node, bytes.fromhex("403f600000000000")) for node in (12, 15)]
    assert of(end, "tries") == [0] * 6
    assert of(end, "asked") == [-1, -1, 100, -1, -1, 100]
    assert sent(begun(at=DONE)) == ()
    assert len(sent(begun(at=DONE), drive_state=FAULT)) == 3
    early = begun(at=(3, 3, 1, 3, 3, 3))
    frames = sent(early, drive_state=states, drive_fault=[1, 0, 0, 1, 0, 1])
    assert frames == (Frame(0x60C, A[1].request(12)),), "the set-up comes first"


# answers


def read(value: int, index: int = 0x1000) -> bytes:
    return bytes((0x43, index & 0xFF, index >> 8, 0)) + value.to_bytes(4, "little")


WROTE = bytes.fromhex("6060600000000000")


def at(leg_at: int, plans: Any = (A,) * 6, **fields: Any) -> ends.Cia402End:
    """Return leg 2 at a step, asked in tick 90."""
    asked = {"asked": (9, 9, 90, 9, 9, 9), "tries": (1, 1, 5, 1, 1, 1)}
    return begun(plans, at=(0, 0, leg_at, 0, 0, 0), **asked | fields)


def answered(end: ends.Cia402End, data: bytes, number: int = 100, **columns: Any) -> Record:
    """Let leg 2 answer; return the tick."""
    here = tick(number)
    end.take(received_array([Received(1, Frame(0x58C, data))]), tick(number - 1, **columns), here, 0)
    return here


def same(end: ends.Cia402End, other: ends.Cia402End) -> bool:
    return all(of(end, name) == of(other, name) for name in ("at", "asked", "tries", "refused"))


def test_an_answer_leads_its_drive_alone_to_the_next_step():
    for leg_at, data in ((0, read(7)), (0, read(0xAB07)), (1, WROTE)):
        end = at(leg_at)
        assert answered(end, data)["rejected"] == 0
        assert of(end, "at") == [0, 0, leg_at + 1, 0, 0, 0]
        assert of(end, "asked") == [9, 9, -1, 9, 9, 9]
        assert of(end, "tries") == [1, 1, 0, 1, 1, 1]


def test_an_answer_to_nothing_that_was_asked_changes_nothing_and_what_is_no_answer_is_rejected():
    for leg_at, data in (
        (0, WROTE),
        (1, read(7)),
        (1, read(10, 0x6060)),
        (0, read(7, 0x1001)),
        (2, read(1)),
        (2, read(1, 0x000C)),
        (3, read(7)),
    ):
        end = at(leg_at)
        assert answered(end, data)["rejected"] == 0
        assert same(end, at(leg_at))
    end = begun()
    answered(end, read(7))
    assert same(end, begun())
    for data in (b"", read(7)[:7], b"\x20" + bytes(7), b"\x41" + bytes(7)):
        assert answered(at(0), data)["rejected"] == 1


@pytest.mark.parametrize(
    ("head", "value"),
    [(0x43, 0x12345678), (0x47, 0x345678), (0x4B, 0x5678), (0x4F, 0x78), (0x4E, 0x12345678)],
)
def test_a_drive_in_fault_says_why_in_the_bytes_of_the_size(head, value):
    data = bytes((head, 0x3F, 0x60, 0)) + bytes.fromhex("78563412")
    found = answered(begun(at=DONE), data, drive_state=FAULT)
    assert found["drive_fault"].tolist() == [0, 0, value, 0, 0, 0]
    known = answered(begun(at=DONE), data, drive_state=FAULT, drive_fault=9)
    assert known["drive_fault"].tolist() == [9] * 6
    assert not answered(begun(at=DONE), data)["drive_fault"].any()
    abort = bytes.fromhex("803f600000000206")
    assert not answered(begun(at=DONE), abort, drive_state=FAULT)["drive_fault"].any()


def test_a_refusal_is_kept_until_the_drive_is_set_up_and_waits_its_patience():
    end = at(1)
    answered(end, bytes.fromhex("8060600030000906"))
    why = "0x6060:0 mode of operation: write refused with abort 0x06090030 (invalid value for the parameter)"
    assert (of(end, "at"), of(end, "asked"), of(end, "tries")[2]) == ([0] * 6, [9, 9, 100, 9, 9, 9], 0)
    assert end.lacks() == tuple(
        "no answer to 1 requests for 0x1000:0 device type" if leg != 2 else why for leg in range(6)
    )
    answered(end, read(7), 110)
    assert end.lacks()[2] == why
    last = at(1, (A, A, A[:2], A, A, A), refused=2, abort=o.BAD_VALUE)
    answered(last, WROTE)
    assert last.lacks() == tuple("" if leg == 2 else why for leg in range(6))


def test_an_abort_without_a_code_is_that_of_an_unknown_command():
    end = at(1)
    answered(end, bytes.fromhex("8060600000000000"))
    assert "abort 0x05040001" in end.lacks()[2]


def test_a_value_that_reads_otherwise_is_named_in_the_bits_that_count():
    end = at(0)
    answered(end, read(0xAB08))
    assert end.lacks()[2] == "0x1000:0 device type is 8, expected 7"
    assert (of(end, "at")[2], of(end, "asked")[2]) == (0, 100)


@pytest.mark.parametrize(("code", "passes"), [(0x06020000, True), (0x06090011, True), (0x06090030, False)])
@pytest.mark.parametrize("optional", [False, True])
def test_an_object_that_is_not_there_is_passed_over_where_a_drive_may_lack_it(code, passes, optional):
    end = at(0, ((A[0]._replace(optional=optional), A[1]),) * 6)
    answered(end, bytes.fromhex("80001000") + code.to_bytes(4, "little"))
    found = of(end, "at")[2], "refused" in end.lacks()[2]
    assert found == ((1, False) if passes and optional else (0, True))


def test_a_drive_that_was_started_lacks_its_tpdo():
    assert at(2).lacks()[2] == "it sends no TPDO, although it was started by NMT"
    assert at(1).lacks()[2] == "no answer to 5 requests for 0x6060:0 mode of operation"
