"""Bus time against closed forms, bit streams built by hand, and bitwise arbitration."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.can.arbitration import priority
from drivers.can.bus_time import FD_LENGTHS, BitTiming, frame_bits, frame_time_ns
from drivers.errors import BusError, ConfigurationError
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import BRS, ERROR, EXTENDED, FD, REMOTE, Frame
from hil.app.configuration.bus_budget import budget
from tests.drivers.arbitration_queue import arbitrate

CLASSIC_1M = BitTiming(1_000_000, 1_000_000)
FD_1M_5M = BitTiming(1_000_000, 5_000_000)


@pytest.mark.parametrize(
    ("length", "flags", "bits"),
    [
        (8, REMOTE | EXTENDED, (80, 0)),
        (99, ERROR | FD, (23, 0)),
        (12, FD, (187, 0)),
        (12, FD | BRS, (34, 153)),
        (20, FD | BRS, (34, 238)),
        (64, FD | BRS, (34, 678)),
        (12, FD | BRS | EXTENDED, (57, 154)),
    ],
)
def test_worst_case_bits_of_a_frame_equal_hand_calculations_at_each_bit_rate(length, flags, bits):
    assert frame_bits(length, flags) == bits


@pytest.mark.parametrize(("length", "bits"), [(8, 135), (4, 95), (0, 55), (1, 65)])
def test_worst_case_time_of_a_classic_frame_equals_davis_2007(length, bits):
    # R. Davis et al., Real-Time Systems 35 (2007), eq. 1: 55 + 10 s bits for 11-bit identifiers
    assert 55 + 10 * length == bits
    assert frame_bits(length, 0) == (bits, 0)
    # and 80 + 10 s for 29-bit identifiers
    assert frame_bits(length, EXTENDED) == (80 + 10 * length, 0)


def test_bus_time_of_three_frame_layouts_of_a_period_equals_hand_calculations():
    eight, four = Frame(1, bytes(8)), Frame(1, bytes(4))
    assert budget([eight] * 12, CLASSIC_1M, 500).total_ns == 1_620_000
    assert budget([eight] * 2 + [four] * 6, CLASSIC_1M, 500).total_ns == 840_000
    fd = budget([Frame(1, bytes(32), FD | BRS)] + [Frame(2, bytes(12), FD | BRS)] * 6, FD_1M_5M, 1000)
    assert fd.total_ns == 493_200
    assert fd.load_percent == pytest.approx(49.32)
    assert round(fd.highest_rate_Hz) == 2028


def test_crc_byte_in_the_sync_frame_costs_ten_bits_per_period():
    """44 + 16 + 3 + floor(49 / 4) = 75 bits; with one byte 65."""
    frames = [Frame(1, bytes(32), FD | BRS)] + [Frame(2, bytes(12), FD | BRS)] * 6
    without, with_crc = (budget([Frame(0x80, bytes(n)), *frames], FD_1M_5M, 1000) for n in (1, 2))
    assert (without.total_ns, with_crc.total_ns) == (558_200, 568_200)
    assert (int(without.highest_rate_Hz), int(with_crc.highest_rate_Hz)) == (1791, 1759)
    ours = LegsProtocol("fd", (1, 2, 3, 4, 5, 6)).traits.cyclic_frames
    assert budget(ours, FD_1M_5M, 1000).total_ns == with_crc.total_ns


def crc(bits: list[int], width: int, poly: int) -> list[int]:
    register = 0
    for bit in bits:
        top = register >> (width - 1) & 1
        register = (register << 1) & ((1 << width) - 1)
        if top ^ bit:
            register ^= poly
    return [register >> (width - 1 - i) & 1 for i in range(width)]


def number(value: int, width: int) -> list[int]:
    return [value >> (width - 1 - i) & 1 for i in range(width)]


def stuff_bits(bits: list[int]) -> int:
    stuffed = 0
    run, last = 0, -1
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed += 1
            run, last = 1, 1 - bit
    return stuffed


def classic_length(id_: int, extended: bool, data: bytes) -> int:
    head = (
        [0, *number(id_ >> 18, 11), 1, 1, *number(id_ & 0x3FFFF, 18), 0, 0, 0]
        if extended
        else [0, *number(id_, 11), 0, 0, 0]
    )
    bits = head + number(len(data), 4) + [b for byte in data for b in number(byte, 8)]
    bits += crc(bits, 15, 0x4599)
    return len(bits) + stuff_bits(bits) + 1 + 2 + 7 + 3


def fd_length(id_: int, extended: bool, data: bytes) -> tuple[int, int]:
    head = (
        [0, *number(id_ >> 18, 11), 1, 1, *number(id_ & 0x3FFFF, 18)] if extended else [0, *number(id_, 11)]
    )
    head += [0, 1, 0, 1] if extended else [0, 0, 1, 0, 1]
    tail = [0, *number(FD_LENGTHS.index(len(data)), 4)] + [b for byte in data for b in number(byte, 8)]
    slow_stuff = stuff_bits(head)
    fast_stuff = stuff_bits(head + tail) - slow_stuff
    protected = 4 + (17 if len(data) <= 16 else 21)
    fixed = len([i for i in range(protected) if i % 4 == 0])
    return len(head) + slow_stuff + 1 + 2 + 7 + 3, len(tail) + fast_stuff + protected + fixed


PATTERNS = st.one_of(
    st.binary(max_size=64),
    st.sampled_from([b"\x00" * 64, b"\xff" * 64, b"\x78" * 64, b"\x0f" * 64, b"\x87" * 64, b"\xc3" * 64]),
)


@given(st.integers(0, 0x7FF), st.booleans(), PATTERNS, st.integers(0, 8))
def test_no_classic_can_bit_stream_is_longer_than_the_computed_worst_case(id_, extended, data, n):
    actual = classic_length(id_, extended, data[:n])
    bound = frame_bits(len(data[:n]), EXTENDED if extended else 0)[0]
    assert actual <= bound
    stuffed = (54 if extended else 34) + 8 * len(data[:n])
    assert actual >= bound - (stuffed - 1) // 4
    # ISO 11898-1: 44 bits next to the data, 64 with a long identifier, and the interframe space
    least = (64 if extended else 44) + 8 * len(data[:n]) + 3
    assert frame_time_ns(len(data[:n]), EXTENDED if extended else 0, CLASSIC_1M, least=True) == 1000 * least
    assert least <= actual


@given(st.integers(0, 0x7FF), st.booleans(), PATTERNS, st.sampled_from(FD_LENGTHS))
def test_no_can_fd_bit_stream_takes_longer_than_the_computed_worst_case(id_, extended, data, n):
    payload = data.ljust(64, data[-1:] or b"\x00")[:n]
    slow, fast = fd_length(id_, extended, payload)
    slow_bound, fast_bound = frame_bits(n, FD | BRS | (EXTENDED if extended else 0))
    assert slow <= slow_bound
    assert slow + fast <= slow_bound + fast_bound
    assert slow * 5 + fast <= slow_bound * 5 + fast_bound
    # the bits between the rates count at the slow one: 1 us instead of 0.2 us
    assert (
        frame_time_ns(n, FD | BRS | (EXTENDED if extended else 0), FD_1M_5M, least=True)
        <= 1000 * slow + 200 * fast - 800
    )
    assert frame_time_ns(n, FD | (EXTENDED if extended else 0), FD_1M_5M, least=True) <= 1000 * (slow + fast)


@pytest.mark.parametrize(("flags", "us"), [(0, 111), (EXTENDED, 131), (FD, 158), (FD | BRS, 54.8)])
def test_shortest_frame_has_only_the_fixed_stuff_bits(flags, us):
    length = 12 if flags & FD else 8
    assert frame_time_ns(length, flags, FD_1M_5M, least=True) == 1000 * us


def test_frame_length_is_padded_to_the_next_valid_length_or_refused():
    assert FD_LENGTHS == (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
    padded = {n: min(each for each in FD_LENGTHS if each >= n) for n in range(65)}
    assert all(frame_bits(n, FD | BRS) == frame_bits(padded[n], FD | BRS) for n in range(65))
    for length, flags in ((9, 0), (65, FD), (-1, 0)):
        with pytest.raises(BusError, match=str(length)):
            frame_bits(length, flags)


def test_shortest_time_of_a_frame_is_rounded_down_and_the_longest_up():
    slow = BitTiming(162_093, 162_093)
    assert frame_time_ns(0, 0, slow, least=True) == 289_956, "47 bits take 289 956.99999 ns"
    assert frame_time_ns(0, 0, slow) == 339_312, "55 bits take 339 311.38 ns"


def test_longest_real_bit_stream_is_within_4_bits_of_the_computed_worst_case():
    # identifier 0x078 and 0x78 bytes repeat 0000 1111: a stuff bit every fourth bit
    streams = [classic_length(0x078, False, bytes([byte] * 8)) for byte in (0x3C, 0x78, 0x0F, 0xC3)]
    assert max(streams) >= 135 - 4


def test_bus_overload_is_refused_with_bits_times_load_and_highest_rate():
    many = [Frame(1, bytes(8))] * 12
    with pytest.raises(ConfigurationError) as caught:
        budget(many, CLASSIC_1M, 1000, 70).require(either_layout=True)
    for part in ("12 x classic", "135.0 us each", "1620.0 us", "162.0 %", "617 Hz", "432 Hz", "layout: fd"):
        assert part in str(caught.value)
    budget(many, CLASSIC_1M, 432, 70).require()
    with pytest.raises(ConfigurationError) as caught:
        budget([*many, Frame(1, b"", FD)], CLASSIC_1M, 1000).require(either_layout=True)
    assert "layout: fd" not in str(caught.value), "the layout is fd already"


@st.composite
def headers(draw):
    extended = draw(st.booleans())
    id_ = draw(st.integers(0, 0x1FFFFFFF if extended else 0x7FF))
    if extended and draw(st.booleans()):
        id_ = (id_ & 0x3FFFF) | draw(st.sampled_from([0x100, 0x101])) << 18
    elif draw(st.booleans()):
        id_ = draw(st.sampled_from([0x100, 0x101])) << (18 if extended else 0)
    return id_, (EXTENDED if extended else 0) | (REMOTE if draw(st.booleans()) else 0)


def field(id_: int, flags: int) -> list[int]:
    remote = 1 if flags & REMOTE else 0
    if flags & EXTENDED:
        return [*number(id_ >> 18, 11), 1, 1, *number(id_ & 0x3FFFF, 18), remote]
    return [*number(id_, 11), remote, 0]


@given(headers(), headers())
def test_computed_frame_priority_agrees_with_bitwise_arbitration(a, b):
    first, second = field(*a), field(*b)
    for x, y in zip(first, second, strict=False):
        if x != y:
            assert (priority(*a) < priority(*b)) == (x == 0)
            return
    assert a == b or priority(*a) != priority(*b)


def test_priorities_of_standard_extended_and_remote_frames_agree_with_the_standard():
    assert priority(0, ERROR) < priority(0, 0)
    assert priority(0x100, 0) < priority(0x100, REMOTE) < priority(0x100 << 18, EXTENDED)
    assert priority(0x100 << 18 | 5, EXTENDED) < priority(0x101, 0)


def test_lowest_identifier_among_frames_queued_before_the_bus_is_free_wins_arbitration():
    # 0x300 has the idle bus; 0x200 and 0x100 wait for its end; 0x050 comes too late for that and is next
    queued = [(0, 0x300, 0, 100), (10, 0x200, 1, 100), (20, 0x100, 2, 100), (101, 0x050, 3, 100)]
    sent, free = arbitrate(queued, 0, 10_000)
    assert sent == [(0, 100), (2, 200), (3, 300), (1, 400)]
    assert free == 400


def test_arbitration_decides_only_frames_that_begin_up_to_the_present_time():
    queued = [(0, 5, 0, 100), (0, 4, 1, 100), (0, 3, 2, 100)]
    assert arbitrate(queued, 0, 0) == ([(2, 100)], 100)
    assert arbitrate(queued, 0, 99) == ([(2, 100)], 100)
    assert arbitrate(queued, 0, 100) == ([(2, 100), (1, 200)], 200)
    assert arbitrate([(50, 1, 0, 100)], 0, 49) == ([], 0)
    assert arbitrate([(50, 1, 0, 100)], 0, 50) == ([(0, 150)], 150)


@given(st.lists(st.tuples(st.integers(0, 1000), st.integers(0, 5), st.integers(1, 200)), max_size=20))
def test_bus_never_idles_and_sends_the_highest_priority_first(frames):
    queued = [(t, key, i, duration) for i, (t, key, duration) in enumerate(frames)]
    random.Random(0).shuffle(queued)
    by_number = {q[2]: q for q in queued}
    sent, _ = arbitrate(queued, 100, 1 << 40)
    assert sorted(i for i, _ in sent) == sorted(by_number)
    free = 100
    left = dict(by_number)
    for i, end in sent:
        t, key, _, duration = left.pop(i)
        start = end - duration
        assert start == max(free, min([t, *(q[0] for q in left.values())]))
        assert all((key, i) < (q[1], q[2]) for q in left.values() if q[0] <= start)
        free = end


@given(
    st.lists(st.tuples(st.integers(0, 1000), st.integers(0, 5), st.integers(1, 200)), max_size=20),
    st.lists(st.integers(0, 2000), max_size=5),
)
def test_intermediate_polls_do_not_change_the_result_of_arbitration(frames, looks):
    queued = [(t, key, i, duration) for i, (t, key, duration) in enumerate(frames)]
    at_once, _ = arbitrate(queued, 100, 1 << 40)
    assert len(at_once) == len(queued)
    pieces: list[tuple[int, int]] = []
    free = 100
    for until in [*sorted(looks), 1 << 40]:
        sent, free = arbitrate(queued, free, until)
        queued = [each for each in queued if each[2] not in dict(sent)]
        pieces += sent
    assert pieces == at_once
