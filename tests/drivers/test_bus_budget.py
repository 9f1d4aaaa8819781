"""The arithmetic of a tick on the bus, to the letter: shapes, sums, loads, and what is said where it does not fit."""

from __future__ import annotations

from collections import Counter
from math import inf

import pytest

from drivers.can.bus_time import BitTiming, frame_bits, frame_time_ns
from drivers.errors import BusError, ConfigurationError
from drivers.protocol import BRS, ERROR, EXTENDED, FD, REMOTE, Frame
from hil.app.configuration.bus_budget import BusBudget, budget, check

RATES = BitTiming(1_000_000, 5_000_000)
FRAMES = [Frame(1, bytes(8))] * 2 + [Frame(2, bytes(12), FD | BRS)] * 3 + [Frame(3, bytes(4))]


@pytest.mark.parametrize(
    ("length", "flags", "bits"),
    [
        (8, 0, (135, 0)),
        (8, EXTENDED, (160, 0)),
        (8, REMOTE, (55, 0)),
        (8, REMOTE | EXTENDED, (80, 0)),
        (0, ERROR, (23, 0)),
        (99, ERROR | FD, (23, 0)),
        (12, FD | BRS, (34, 153)),
        (12, FD, (187, 0)),
        (16, FD | BRS, (34, 193)),
        (17, FD | BRS, (34, 238)),
        (20, FD | BRS, (34, 238)),
        (64, FD | BRS, (34, 678)),
        (12, FD | BRS | EXTENDED, (57, 154)),
    ],
)
def test_a_frame_has_its_bits_at_each_rate_at_worst(length, flags, bits):
    assert frame_bits(length, flags) == bits


def test_a_time_is_rounded_up_to_a_nanosecond():
    # 135 bits at 300 kbit/s are 450000 ns, 55 are 183333.3; 34 at 300 k and 153 at 700 k are 331904.8
    odd = BitTiming(300_000, 700_000)
    assert frame_time_ns(8, 0, odd) == 450_000
    assert frame_time_ns(0, 0, odd) == 183_334
    assert frame_time_ns(12, FD | BRS, odd) == 331_905


def test_the_frames_of_a_tick_are_counted_by_shape_and_written_out():
    found = budget(FRAMES, RATES, 500.0, 60.0)
    assert found.frames == {(8, 0): 2, (12, FD | BRS): 3, (4, 0): 1}
    # 135 + 135 us, three times 34 + 153 / 5 = 64.6 us, 95 us
    assert found.total_ns == 558_800
    assert found.load_percent == pytest.approx(27.94)
    assert found.highest_rate_Hz == pytest.approx(1e9 / 558_800)
    assert found.allowed_rate_Hz == pytest.approx(0.6e9 / 558_800)
    assert found.table() == (
        "    2 x classic  8 byte: 135 bit = 135.0 us each, 270.0 us\n"
        "    3 x CAN FD  12 byte: 34 bit + 153 fast bit = 64.6 us each, 193.8 us\n"
        "    1 x classic  4 byte: 95 bit = 95.0 us each, 95.0 us\n"
        "  total 558.8 us of a 2000.0 us period = 27.9 % at 500 Hz (allowed 60 %)"
    )


def test_a_bus_without_frames_is_never_full():
    found = budget([], RATES, 500.0)
    assert (found.total_ns, found.load_percent, found.highest_rate_Hz, found.fits) == (0, 0.0, inf, True)


@pytest.mark.parametrize(("total_ns", "fits"), [(700_000, True), (700_001, False)])
def test_a_load_fits_up_to_what_is_allowed(total_ns, fits):
    assert BusBudget(Counter(), RATES, 1000.0, 70.0, total_ns).fits is fits


def test_what_does_not_fit_is_refused_with_its_arithmetic_and_its_ways_out():
    many = [Frame(1, bytes(8))] * 12
    with pytest.raises(ConfigurationError) as caught:
        check(many, BitTiming(500_000, 2_000_000), 250.0, where="bus.channels[1]", either_layout=True)
    assert str(caught.value) == (
        "bus.channels[1]: the frames of one tick do not fit at 0.5 Mbit/s, worst-case stuffing:\n"
        "   12 x classic  8 byte: 135 bit = 270.0 us each, 3240.0 us\n"
        "  total 3240.0 us of a 4000.0 us period = 81.0 % at 250 Hz (allowed 70 %)\n"
        "  these frames fit up to 216 Hz (309 Hz fill the bus): lower loop.rate_Hz, raise the bit rates, or "
        "spread the legs over several buses (bus.channels), or use bus.layout: fd"
    )
    with pytest.raises(ConfigurationError, match=r"^bus: the frames .* 0\.5 Mbit/s, worst-case"):
        check(many, BitTiming(500_000, 2_000_000), 250.0)
    with pytest.raises(
        ConfigurationError, match=r"at 0\.5 Mbit/s \(data phase 2 Mbit/s\), worst-case .*\n"
    ) as caught:
        check([*many, Frame(1, b"", FD)], BitTiming(500_000, 2_000_000), 250.0, either_layout=True)
    assert str(caught.value).endswith("(bus.channels)")
    assert check(iter(many), BitTiming(500_000, 2_000_000), 250.0, 81.0).fits


def test_a_frame_that_cannot_be_on_the_bus_is_refused_with_what_may_help():
    assert frame_bits(64, FD)
    for length, flags, text in (
        (9, 0, "a classic CAN frame carries 0 to 8 bytes, not 9: use bus.layout: fd"),
        (-1, 0, "a classic CAN frame carries 0 to 8 bytes, not -1: use bus.layout: fd"),
        (65, FD, "a CAN FD frame carries 0 to 64 bytes, not 65: split it"),
        (-1, FD, "a CAN FD frame carries 0 to 64 bytes, not -1: split it"),
    ):
        with pytest.raises(BusError, match=f"^{text}$"):
            frame_bits(length, flags)
