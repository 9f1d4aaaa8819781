"""Frame files as other tools write them, read back by python-can."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import can
import pytest

from drivers.can.frame_files import WRITERS
from drivers.can.messages import from_message
from drivers.protocol import BRS, BUS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame, off_bus

T_ns = 1_700_000_000_123_456_500
"""2023-11-14 22:13:20 UTC, and half a microsecond that is rounded up."""
FRAMES = (
    Frame(0x80, b"\xa7\xc3"),
    Frame(0x1ABCDEF0, b"", EXTENDED),
    Frame(0x12, b"", REMOTE),
    Frame(0x7FF, bytes(range(12)), FD),
    Frame(0x181, b"\x0a", FD | BRS | BUS),
    Frame(0x182, b"\x01", FD | ESI),
    Frame(0x40, bytes(8), ERROR | 2 * BUS),
)


def written(kind: str, path: Path, *channels: str) -> None:
    writer = WRITERS[kind](path, channels)
    for k, frame in enumerate(FRAMES):
        writer.write(T_ns + 1_500_000_000 * k, frame, sent=k % 2 == 1)
    writer.close()


def test_candump_export_has_time_channel_identifier_and_data(tmp_path):
    written("candump", tmp_path / "a.log", "can 0/x", "")
    assert (tmp_path / "a.log").read_text("ascii").splitlines() == [
        "(1700000000.123457) can_0_x 080#A7C3",
        "(1700000001.623457) can_0_x 1ABCDEF0#",
        "(1700000003.123457) can_0_x 012#R",
        "(1700000004.623457) can_0_x 7FF##0000102030405060708090A0B",
        "(1700000006.123457) can0 181##10A",
        "(1700000007.623457) can_0_x 182##201",
        "(1700000009.123457) can_0_x_2 20000040#0000000000000000",
    ]


@pytest.mark.parametrize("kind", ["asc", "blf"])
def test_python_can_reads_the_frames_of_asc_and_blf_exports(tmp_path, kind):
    written(kind, tmp_path / f"a.{kind}", "a")
    reader: Any = {"asc": can.ASCReader, "blf": can.BLFReader}[kind](tmp_path / f"a.{kind}")
    for k, (message, frame) in enumerate(zip(reader, FRAMES, strict=True)):
        assert (message.is_error_frame, message.channel) == (bool(frame.flags & ERROR), frame.bus)
        if not message.is_error_frame:
            assert from_message(message) == off_bus(frame)
            assert message.is_rx == (k % 2 == 0)
            if kind == "blf":
                assert message.timestamp == pytest.approx(1e-9 * T_ns + 1.5 * k, abs=2e-6)
