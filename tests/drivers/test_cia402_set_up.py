"""The start-up dialogue of CiA 402 step by step: its frames, turns, patience and answers."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.cia402 import controller_end as ends
from drivers.cia402 import objects as o
from drivers.cia402.controller_end import Step, max_torque, plan, watchdog_ms
from drivers.errors import ProtocolError
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import DriveSetup, Frame, Received
from drivers.signals import LEGS, DriveState, Reaction
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
"""For 9 N m, 10 kN, heartbeat of 24 ms, watchdog of 50 ms, 250 Hz: 40 x 10^-4 s."""
READ_BACK = """
14001 14002 16000 16001 16002 18001 18002 1A000 1A001 1A002 1A003 18011 18012 1A010 1A011 18021 18031 10161
10170 10291 60070 605A0 605E0 60610 60720 60C21 60C22
"""


def test_set_up_identifies_a_drive_maps_its_pdos_writes_settings_reads_them_back_and_starts_it():
    steps = plan(5, SETUP, drives())

    def read(index: int, sub: int) -> bytes:
        return bytes((0x40, index & 0xFF, index >> 8, sub, 0, 0, 0, 0))

    expected = [read(0x1000, 0), b"\x80\5", read(0x6502, 0), read(0x6076, 0)]
    expected += [bytes.fromhex(each) for each in WRITES.split()]
    expected += [read(int(each[:4], 16), int(each[4])) for each in READ_BACK.split()]
    expected.append(b"\1\5")
    assert [step.request(5) for step in steps] == expected


def test_values_read_back_in_set_up_are_compared_in_the_bits_of_their_mask():
    found = {step.key: step for step in plan(5, SETUP, drives(), 4096) if step.kind == "read"}
    whole, cob, off = 0xFFFFFFFF, 0xBFFFFFFF, 0x80000000
    expected = {
        0x10000: (0x0192, 0xFFFF, False), 0x65020: (0x200, 0x200, True), 0x60760: (9000, whole, False),
        0x608F1: (4096, whole, True), 0x608F2: (1, whole, True), 0x14001: (0x205, cob, False),
        0x18001: (0x185, cob, False), 0x18011: (0x285, cob, False), 0x18021: (0x80000385, off, True),
        0x18031: (0x80000485, off, True), 0x14002: (255, whole, False), 0x18002: (1, whole, False),
        0x16000: (2, whole, False), 0x16001: (0x60400010, whole, False), 0x1A000: (3, whole, False),
        0x1A001: (0x60410010, whole, False), 0x10161: (127 << 16 | 50, whole, False),
        0x10291: (1, whole, True), 0x60610: (10, whole, False), 0x60C21: (40, whole, True),
        0x60C22: (0xFC, whole, True),
    }  # fmt: skip
    for number, (value, mask, optional) in expected.items():
        step = found[number >> 4, number & 15]
        assert (step.value, step.mask, step.optional) == (value, mask, optional), hex(number)


def values(protocol: Any, kind: str, key: tuple[int, int], setup: DriveSetup = SETUP) -> list[list[int]]:
    """Values of an object that are written to or expected of each drive, in order."""
    return [[s.value for s in each if (s.kind, s.key) == (kind, key)] for each in protocol.plans(setup)]


def test_steps_of_the_set_up_depend_on_rate_velocity_source_counts_and_reaction():
    # 391 Hz: 2.558 ms, more than 255 steps of 10 us
    for rate_Hz, *period in ((2000.0, 50, -5), (391.0, 26, -4), (1000.0 / 255, 255, -3), (0.1, 100, -1)):
        setup = DriveSetup(max(10.0, 4.0 / rate_Hz), Reaction.BRAKE, rate_Hz)
        for sub, value in enumerate(period, 1):
            for kind in ("write", "read"):
                assert values(drives(), kind, (0x60C2, sub), setup) == [[value % 256]] * LEGS
    for velocity in (True, False):
        for n, base in enumerate((0x180, 0x280, 0x380, 0x480)):
            off = 0 if n == 0 or (n == 1 and velocity) else 1 << 31
            for kind in ("write", "read"):
                last = [each[-1] for each in values(drives(velocity=velocity), kind, (0x1800 + n, 1))]
                assert last == [base + node | off for node in range(1, LEGS + 1)], (n, kind)
    counts = [4096 + leg for leg in range(LEGS)]
    asked = values(drives(counts_per_turn=counts), "read", o.ENCODER_INCREMENTS)
    assert asked == [[each] for each in counts]
    for reaction, code in ((Reaction.BRAKE, 0), (Reaction.DAMP, 2)):
        assert (
            values(drives(), "write", o.FAULT_REACTION, SETUP._replace(reaction=reaction)) == [[code]] * LEGS
        )
    for reaction in (Reaction.HOLD, Reaction.ZERO):
        with pytest.raises(ProtocolError, match=r"reactions\.silence.*brake or damp"):
            drives().controller_end(SETUP._replace(reaction=reaction))


@pytest.mark.parametrize(
    ("watchdog_s", "rate_Hz", "found"),
    [
        (0.0005, 1e5, 0), (0.0006, 1e5, 1), (0.05, 1e5, 50), (65.5344, 1e5, 65534), (0.016, 250.0, 16),
        (4.0 * (1 - 1e-9), 1.0, 4000), (0.00049, 1e5, "0x1016"), (65.535, 1e5, "0x1016"),
        (float("nan"), 1e5, "0x1016"), (0.0159, 250.0, "4 periods"), (4.0 * (1 - 1.5e-9), 1.0, "4 periods"),
    ],
)  # fmt: skip
def test_watchdog_shorter_than_four_periods_or_beyond_16_bits_of_ms_is_refused(watchdog_s, rate_Hz, found):
    setup = DriveSetup(watchdog_s, Reaction.DAMP, rate_Hz)
    if isinstance(found, str):
        with pytest.raises(ProtocolError, match=found):
            watchdog_ms(setup)
        return
    assert watchdog_ms(setup) == found


def test_written_max_torque_gives_the_weakest_leg_the_force_limit_and_saturates_at_16_bits():
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
P = drives((10, 11, 12, 13, 14, 15))
DONE = 3


def begun(plans: Any = (A,) * 6, setup: DriveSetup = SETUP, **fields: Any) -> ends.Cia402End:
    """The controller's end of six drives with these plans, at these steps."""
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
    return sent_frames(end.set_up(tick(*given, **columns)))


def asked(frames: tuple[Frame, ...]) -> list[int]:
    """Legs of requests to nodes 10 to 15."""
    return [frame.id - 0x60A if frame.id else frame.data[1] - 10 for frame in frames]


def of(end: ends.Cia402End, name: str) -> list[int]:
    found: list[int] = end.state[name].tolist()
    return found


def test_set_up_request_is_not_sent_to_drives_that_are_complete_awaiting_an_answer_or_powered():
    waits: dict[str, Any] = {"at": (DONE, 0, 0, 0, 0, DONE), "asked": (-1, 95, 88, 87, -1, -1)}
    states = [OFF, OFF, OFF, OFF, READY, OFF]
    assert asked(sent(begun(**waits), drive_state=states)) == [2, 3]
    for age, there in ((11, False), (12, True)):
        frames = sent(begun(**waits), drive_state=states, age=[0, 0, 0, 0, age, 0])
        assert (4 in asked(frames)) == there, "silent for its patience"


@pytest.mark.parametrize(("rate_Hz", "ticks"), [(250.0, 12), (100.0, 6), (150.0, 8), (1000.0, 50)])
def test_unanswered_set_up_request_is_repeated_after_50_ms_but_at_least_six_periods(rate_Hz, ticks):
    for since, again in ((ticks - 1, False), (ticks, True)):
        assert bool(sent(begun(setup=SETUP._replace(rate_Hz=rate_Hz), asked=100 - since))) == again


@pytest.mark.parametrize(("tries", "at", "first"), [(19, 1, False), (20, 1, True), (20, 0, False)])
def test_set_up_of_a_drive_starts_again_after_twenty_unanswered_requests(tries, at, first):
    mine = (A[0]._replace(key=o.REVISION), *A[1:])
    end = begun((A, A, mine, A, A, A), at=(3, 3, at, 3, 3, 3), tries=(0, 0, tries, 0, 0, 0))
    assert sent(end) == (Frame(0x60C, mine[0 if first or at == 0 else 1].request(12)),)
    assert of(end, "at") == [3, 3, 0 if first else at, 3, 3, 3]
    assert of(end, "tries") == [0, 0, 1 if first else tries + 1, 0, 0, 0]
    assert of(end, "asked") == [-1, -1, 100, -1, -1, -1]


def test_nmt_command_in_set_up_needs_no_answer_but_nmt_start_waits_for_a_tpdo():
    prepare = (Step("nmt", o.DEVICE_TYPE, o.PRE_OPERATIONAL), A[1])
    end = begun((A, A, prepare, A, A, A), at=(3, 3, 0, 3, 3, 3))
    assert sent(end) == (Frame(0, b"\x80\x0c"),)
    assert [of(end, name)[2] for name in ("at", "asked", "tries")] == [1, -1, 0]
    end = begun(at=(3, 3, 2, 3, 3, 3))
    assert sent(end) == (Frame(0, b"\1\x0c"),)
    assert [of(end, name)[2] for name in ("at", "asked", "tries")] == [2, 100, 1]


def test_drive_in_fault_with_unknown_error_code_gets_a_request_for_the_code():
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


@pytest.mark.parametrize(
    ("head", "value"),
    [
        (0x43, 0x12345678), (0x47, 0x345678), (0x4B, 0x5678), (0x4F, 0x78), (0x42, 0x12345678),
        # without bit 0 the two size bits have no meaning
        (0x46, 0x12345678), (0x4A, 0x12345678), (0x4E, 0x12345678),
        # segmented transfer; abort; confirmation
        (0x40, None), (0x41, None), (0x44, None), (0x49, None), (0x4D, None), (0x80, None), (0x60, None),
    ],
)  # fmt: skip
def test_sdo_answer_has_as_many_bytes_as_its_size_field_or_four(head, value):
    data = bytes.fromhex(f"{head:02x}64601278563412")
    assert o.read_value(data) == (None if value is None else ((0x6064, 0x12), value))
    assert o.read_value(data[:7]) is None


def read(value: int, index: int = 0x1000) -> bytes:
    return bytes((0x43, index & 0xFF, index >> 8, 0)) + value.to_bytes(4, "little")


WROTE = bytes.fromhex("6060600000000000")


def at(leg_at: int, plans: Any = (A,) * 6, **fields: Any) -> ends.Cia402End:
    """Controller's end with leg 2 at a step, requested in tick 90."""
    asked = {"asked": (9, 9, 90, 9, 9, 9), "tries": (1, 1, 5, 1, 1, 1)}
    return begun(plans, at=(0, 0, leg_at, 0, 0, 0), **asked | fields)


def answered(end: ends.Cia402End, data: bytes, number: int = 100, **columns: Any) -> Record:
    """Decode an answer of leg 2; the result is the tick."""
    here = tick(number)
    end.take(received_array([Received(1, Frame(0x58C, data))]), tick(number - 1, **columns), here, 0)
    return here


def same(end: ends.Cia402End, other: ends.Cia402End) -> bool:
    return all(of(end, name) == of(other, name) for name in ("at", "asked", "tries", "refused"))


def test_sdo_answer_to_another_request_does_not_advance_the_set_up():
    others = (0, WROTE), (1, read(7)), (1, read(10, 0x6060)), (0, read(7, 0x1001)), (2, read(1)), (3, read(7))
    for leg_at, data in (*others, (2, read(1, 0x000C))):
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
def test_error_code_read_from_a_drive_in_fault_becomes_its_fault_if_none_is_known(head, value):
    data = bytes((head, 0x3F, 0x60, 0)) + bytes.fromhex("78563412")
    assert answered(begun(at=DONE), data)["rejected"] == 0
    found = answered(begun(at=DONE), data, drive_state=FAULT)
    assert found["drive_fault"].tolist() == [0, 0, value, 0, 0, 0]
    known = answered(begun(at=DONE), data, drive_state=FAULT, drive_fault=9)
    assert known["drive_fault"].tolist() == [9] * 6
    assert not answered(begun(at=DONE), data)["drive_fault"].any()
    for other in ("803f600000000206", "4b41600005730000", "423f6000"):
        assert not answered(begun(at=DONE), bytes.fromhex(other), drive_state=FAULT)["drive_fault"].any()


def test_refused_set_up_request_is_reported_until_success_and_repeated_after_the_timeout():
    end = at(1)
    answered(end, bytes.fromhex("8060600030000906"))
    assert (of(end, "at"), of(end, "asked"), of(end, "tries")[2]) == ([0] * 6, [9, 9, 100, 9, 9, 9], 0)
    why = end.lacks()[2]
    assert why.startswith("0x6060:0 mode of operation: write refused with abort 0x06090030")
    assert all(lack.startswith("no answer to 1 requests for 0x1000:0") for lack in end.lacks() if lack != why)
    answered(end, read(7), 110)
    assert end.lacks()[2] == why
    last = at(1, (A, A, A[:2], A, A, A), refused=2, abort=o.BAD_VALUE)
    answered(last, WROTE)
    assert last.lacks() == tuple("" if leg == 2 else why for leg in range(6))
    end = at(1)
    answered(end, bytes.fromhex("8060600000000000"))
    assert "abort 0x05040001" in end.lacks()[2], "without a code: an unknown command"


@pytest.mark.parametrize(("code", "passes"), [(0x06020000, True), (0x06090011, True), (0x06090030, False)])
@pytest.mark.parametrize("optional", [False, True])
def test_missing_optional_object_is_skipped_in_the_set_up(code, passes, optional):
    end = at(0, ((A[0]._replace(optional=optional), A[1]),) * 6)
    answered(end, bytes.fromhex("80001000") + code.to_bytes(4, "little"))
    found = of(end, "at")[2], "refused" in end.lacks()[2]
    assert found == ((1, False) if passes and optional else (0, True))
