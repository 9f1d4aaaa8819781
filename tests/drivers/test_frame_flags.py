"""Round trip of each kind of frame through the kernel's bytes and through a python-can message."""

from __future__ import annotations

import sys

import can
import pytest

from drivers.can.messages import from_message, to_message
from drivers.can.socketcan import pack, unpack
from drivers.errors import BusError
from drivers.frame_array import received_array, unpack_frames
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame, Received

little_endian = pytest.mark.skipif(sys.byteorder != "little", reason="byte vectors are little endian")
WORDS = {
    EXTENDED: "is_extended_id",
    REMOTE: "is_remote_frame",
    ERROR: "is_error_frame",
    FD: "is_fd",
    BRS: "bitrate_switch",
    ESI: "error_state_indicator",
}
KINDS = [0, EXTENDED, REMOTE, EXTENDED | REMOTE, FD, FD | BRS, FD | ESI, FD | BRS | ESI, EXTENDED | FD, ERROR]


# struct can_frame and canfd_frame of linux/can.h, little endian, written out by hand
@little_endian
@pytest.mark.parametrize(
    ("frame", "raw"),
    [
        (Frame(0x123, b"\x01\x02"), "23010000 02000000 0102000000000000"),
        (Frame(0x7FF, bytes(8)), "ff070000 08000000 0000000000000000"),
        (Frame(0x1ABCDEF0, b"", EXTENDED), "f0debc9a 00000000 0000000000000000"),
        (Frame(0x1FFFFFFF, b"", EXTENDED | REMOTE), "ffffffdf 00000000 0000000000000000"),
        (Frame(0x12, b"", REMOTE), "12000040 00000000 0000000000000000"),
        (Frame(0x181, b"\xff" * 12, FD), "81010000 0c000000" + "ff" * 12 + "00" * 52),
        (Frame(0x181, b"\xff" * 12, FD | BRS), "81010000 0c010000" + "ff" * 12 + "00" * 52),
        (Frame(0x181, b"\xff" * 64, FD | ESI), "81010000 40020000" + "ff" * 64),
        (Frame(0x123, b"\xff" * 64, FD | BRS | ESI | EXTENDED), "23010080 40030000" + "ff" * 64),
    ],
)
def test_socketcan_frames_have_the_byte_layout_of_the_linux_kernel(frame, raw):
    assert pack(*frame) == bytes.fromhex(raw)
    assert unpack(bytes.fromhex(raw)) == frame


@little_endian
def test_error_frame_read_from_socketcan_keeps_its_error_classes():
    # CAN_ERR_FLAG | CAN_ERR_BUSOFF, and all 29 bits of classes
    assert unpack(bytes.fromhex("40000020 08000000 0000000000000000")) == Frame(0x40, bytes(8), ERROR)
    assert unpack(bytes.fromhex("ffffff3f 08000000 0000000000000000")) == Frame(0x1FFFFFFF, bytes(8), ERROR)


@pytest.mark.parametrize(("size", "flags"), [(9, 0), (65, FD)])
def test_data_too_long_for_a_socketcan_frame_is_refused(size, flags):
    with pytest.raises(BusError, match=f"{size} bytes"):
        pack(*Frame(0x7FF, bytes(size), flags))


@pytest.mark.parametrize("flags", KINDS)
def test_python_can_message_keeps_the_kind_of_frame_classic_fd_remote_or_error(flags):
    frame = Frame(0x123, b"" if flags & REMOTE else b"\x11\x22", flags)
    (unpacked,) = unpack_frames(received_array([Received(2_000_000_000, frame)]).tobytes())
    message = to_message(unpacked, 500_000_000, "c")
    for flag, word in WORDS.items():
        assert getattr(message, word) == bool(flags & flag), word
    assert (message.timestamp, message.channel, message.is_rx) == (2.5, "c", True)
    assert from_message(message) == frame
    words = {name: bool(flags & flag) for flag, name in WORDS.items()}
    assert from_message(can.Message(arbitration_id=0x123, data=b"\x11", **words)).flags == flags
