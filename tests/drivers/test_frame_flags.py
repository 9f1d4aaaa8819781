"""What a frame is has a bit, or a word, of its own in the kernel's bytes, in python-can's Message and back."""

from __future__ import annotations

import struct

import can
import pytest

from drivers.can.messages import from_message, to_message
from drivers.can.socketcan import pack, unpack
from drivers.frame_array import received_array, unpack_frames
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame, Received

KERNEL = [
    (0, 0x0000_0123, 0),
    (EXTENDED, 0x8000_0123, 0),
    (REMOTE, 0x4000_0123, 0),
    (EXTENDED | REMOTE, 0xC000_0123, 0),
    (FD, 0x0000_0123, 0x0),
    (FD | BRS, 0x0000_0123, 0x1),
    (FD | ESI, 0x0000_0123, 0x2),
    (FD | BRS | ESI, 0x0000_0123, 0x3),
    (FD | BRS | EXTENDED, 0x8000_0123, 0x1),
]
"""Flags, the identifier's word and the byte of flags, after linux/can.h."""
WORDS = {
    EXTENDED: "is_extended_id",
    REMOTE: "is_remote_frame",
    ERROR: "is_error_frame",
    FD: "is_fd",
    BRS: "bitrate_switch",
    ESI: "error_state_indicator",
}
KINDS = [*(flags for flags, _, _ in KERNEL), ERROR]


@pytest.mark.parametrize(("flags", "word", "bits"), KERNEL)
def test_the_kernel_is_given_and_gives_each_kind_of_frame_with_the_bits_of_its_header(flags, word, bits):
    data = b"" if flags & REMOTE else b"\x11\x22\x33"
    head = struct.pack("=IBB2x", word, len(data), bits)
    raw = head + data.ljust(64 if flags & FD else 8, b"\0")
    frame = Frame(0x123, data, flags)
    assert pack(*frame) == raw
    assert unpack(raw) == frame


@pytest.mark.parametrize("flags", KINDS)
def test_a_message_of_python_can_says_of_each_kind_of_frame_what_it_is_and_nothing_else(flags):
    frame = Frame(0x123, b"" if flags & REMOTE else b"\x11\x22", flags)
    (unpacked,) = unpack_frames(received_array([Received(2_000_000_000, frame)]).tobytes())
    message = to_message(unpacked, 500_000_000, "c")
    assert {name for name in WORDS.values() if getattr(message, name)} == {
        name for flag, name in WORDS.items() if flags & flag
    }
    assert (message.timestamp, message.channel, message.is_rx) == (2.5, "c", True)
    assert from_message(message) == frame


@pytest.mark.parametrize("flags", KINDS)
def test_a_message_that_another_program_made_becomes_the_same_kind_of_frame(flags):
    words = {name: bool(flags & flag) for flag, name in WORDS.items()}
    assert from_message(can.Message(arbitration_id=0x123, data=b"\x11", **words)).flags == flags
