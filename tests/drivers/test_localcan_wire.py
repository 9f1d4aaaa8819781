"""The shared memory of a channel by itself: its timing in one word, its slots, its outboxes, and its border."""

from __future__ import annotations

import mmap
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.can.bus_time import BitTiming
from drivers.can.link import collect
from drivers.can.localcan import layout
from drivers.can.localcan.participant import Participant
from drivers.can.localcan.wire import Mode, Wire
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import ERROR, EXTENDED, FD, Frame
from tests.drivers.frames_heard import got


@pytest.fixture
def wire(tmp_path: Path) -> Iterator[Wire]:
    made = Wire(tmp_path / "t.wire3")
    yield made
    made.close()


def enter(wire: Wire) -> int:
    """Take a slot, and show it to the others."""
    serial = wire.enter()
    wire.words[layout.slot_at(serial) + layout.SLOT_SERIAL] = serial
    return serial


@pytest.mark.parametrize("fd", [False, True])
@pytest.mark.parametrize(
    "rates", [(1, 2), (1_000_000, 5_000_000), ((1 << 31) - 1, (1 << 31) - 1), (500_000, 1)]
)
def test_both_rates_and_whether_there_is_can_fd_are_one_word(wire, rates, fd):
    assert wire.present() == {}
    for mode in (Mode(BitTiming(*rates), fd), Mode(BitTiming(7, 9), not fd)):
        wire.fix(mode)
        assert wire.mode == mode


def test_a_newcomer_has_the_first_empty_slot_and_a_number_that_none_had_before(wire):
    pid = os.getpid()
    wires: list[Wire] = [wire]

    def come() -> int:
        wires[-1].unlock()
        wires.append(Wire(wire.path))
        return enter(wires[-1])

    assert wire.present() == {}
    assert [come() for _ in range(3)] == [1 * 64 + 0, 2 * 64 + 1, 3 * 64 + 2]
    assert wire.present() == {64: pid, 129: pid, 194: pid}
    wire.words[layout.slot_at(129) + layout.SLOT_SERIAL] = 0
    assert come() == 4 * 64 + 1
    assert wire.present() == {64: pid, 257: pid, 194: pid}
    for each in wires[1:]:
        each.close()


def test_who_takes_a_slot_has_never_been_rung_and_holds_no_time(wire):
    at = layout.slot_at(64)
    wire.words[at + layout.SLOT_RUNG] = wire.words[at + layout.SLOT_DUE] = 9
    wire.words[at + layout.SLOT_COUNT] = wire.words[at + layout.SLOT_FIRST] = 5
    assert enter(wire) == 64
    assert wire.words[at : at + 6].tolist() == [64, os.getpid(), 0, 5, 0, 5]


def test_the_sixty_fifth_participant_finds_no_room(wire):
    for index in range(64):
        wire.words[layout.slot_at(index) + layout.SLOT_SERIAL] = 64 + index
    wire.words[layout.USED_AT] = 64
    with pytest.raises(BusError, match=r"^localcan: t\.wire3 has 64 participants, no more fit; close one$"):
        wire.enter()
    wire.words[layout.slot_at(63) + layout.SLOT_SERIAL] = 0
    assert wire.enter() % 64 == 63


def test_a_bus_of_which_nobody_is_left_is_begun_anew_and_one_with_somebody_goes_on(runtime):
    first, second = Participant("t", BitTiming(7, 9)), Participant("t")
    words, path = first._wire.words, first._wire.path
    assert second.mode == Mode(BitTiming(7, 9), fd=True)
    words[layout.LOG_AT + layout.LOG - 1] = 7
    for killed in (first, second):
        killed._wire.close()
    third = Participant("t")
    assert (third._wire.path, list(third._wire.present()), third._wire.mode) == (path, [64], None)
    assert not words[layout.LOG_AT : layout.OUTBOX_AT].any()
    third.close()


def test_header_slots_log_and_outboxes_lie_one_behind_the_other_in_a_file_of_their_size(wire):
    assert layout.SLOTS_AT + 64 * 16 <= layout.LOG_AT
    assert layout.OUTBOX_AT == layout.LOG_AT + 32_768
    assert wire.path.stat().st_size == 8 * layout.record_at(63, 0) + 8 * 15 * 8192 == layout.SIZE
    assert layout.record_at(129, 8192 + 5) == layout.OUTBOX_AT + 15 * (8192 + 5)
    assert (layout.slot_at(64), layout.slot_at(129)) == (64, 80)
    assert isinstance(wire.memory, mmap.mmap)


# what a participant takes and refuses


@pytest.fixture
def node(runtime: Any) -> Iterator[Participant]:
    del runtime
    made = Participant("t", BitTiming(1_000_000, 5_000_000), fd=False)
    yield made
    made.close()


@pytest.mark.parametrize(
    ("identifier", "flags", "fits"),
    [
        (0, 0, True),
        (0x7FF, 0, True),
        (0x800, 0, False),
        (0x1FFFFFFF, EXTENDED, True),
        (0x20000000, EXTENDED, False),
        (0x7FF, ERROR, True),
    ],
)
def test_an_identifier_fits_its_kind_of_frame(node, identifier, flags, fits):
    if fits:
        assert node.send(sent_array([Frame(identifier, b"", flags)])) == 1
        return
    with pytest.raises(BusError, match="does not fit a CAN frame; extended ones need the flag"):
        node.send(sent_array([Frame(identifier, b"", flags)]))


def test_a_classic_bus_takes_no_frame_of_can_fd_and_says_how_it_runs(node):
    with pytest.raises(BusError, match=r"localcan t is a classic CAN bus: frame 0x12 needs CAN FD"):
        node.send(sent_array([Frame(0x12, b"", FD)]))
    assert node.mode == Mode(BitTiming(1_000_000, 5_000_000), fd=False)
    text = r"localcan t runs as classic CAN 1000000 bit/s, asked for was {}: use the timing of the others "
    for rates, fd, asked in (
        (None, True, r"CAN FD 1000000/5000000 bit/s"),
        (BitTiming(500_000, 5_000_000), None, r"classic CAN 500000 bit/s"),
    ):
        with pytest.raises(BusError, match=text.format(asked) + r"\(processes \d+\) or another channel"):
            Participant("t", rates, fd=fd)
    Participant("t", BitTiming(1_000_000, 7), fd=False).close()


@pytest.mark.parametrize(("limit", "taken"), [(3, 3), (0, 0), (64, 5)])
def test_no_more_frames_wait_than_the_limit(runtime, limit, taken):
    del runtime
    node = Participant("t", BitTiming(10_000, 10_000), tx_limit=limit)
    try:
        assert node.send(sent_array([Frame(k, bytes(8)) for k in range(5)])) == taken
    finally:
        node.close()


@pytest.mark.parametrize(("length", "carried"), [(8, 8), (9, 12), (12, 12), (33, 48), (63, 64), (64, 64)])
def test_a_frame_of_can_fd_arrives_filled_with_zeros_to_a_length_that_there_is(runtime, length, carried):
    del runtime
    sender, hearer = (Participant("t", BitTiming(1_000_000, 5_000_000), fd=True) for _ in range(2))
    data = bytes(range(1, length + 1))
    try:
        assert sender.send(sent_array([Frame(0x12, data, FD)])) == 1
        (heard,) = got(collect(hearer, time.monotonic_ns() + 10**9, {0x12}))
        with pytest.raises(BusError, match="a CAN FD frame carries 0 to 64 bytes, not 65: split it"):
            sender.send(sent_array([Frame(0x12, bytes(65), FD)]))
    finally:
        sender.close()
        hearer.close()
    assert heard.frame == Frame(0x12, data + bytes(carried - length), FD)
