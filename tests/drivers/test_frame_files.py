"""Files of frames line by line, as their own tools write them, and read back by python-can."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from drivers.can.frame_files import WRITERS, BlfWriter
from drivers.protocol import BRS, BUS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame

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


@pytest.fixture
def east(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A local time two hours ahead of UTC."""
    monkeypatch.setenv("TZ", "EET-2")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def written(kind: str, path: Path, channels: tuple[str, ...], frames: Any = FRAMES) -> None:
    writer = WRITERS[kind](path, channels)
    for k, frame in enumerate(frames):
        writer.write(T_ns + 1_500_000_000 * k, frame, sent=k % 2 == 1)
    writer.close()


def test_candump_has_time_channel_identifier_and_data(tmp_path):
    written("candump", tmp_path / "a.log", ("can 0/x", ""))
    assert (tmp_path / "a.log").read_text("ascii").splitlines() == [
        "(1700000000.123457) can_0_x 080#A7C3",
        "(1700000001.623457) can_0_x 1ABCDEF0#",
        "(1700000003.123457) can_0_x 012#R",
        "(1700000004.623457) can_0_x 7FF##0000102030405060708090A0B",
        "(1700000006.123457) can0 181##10A",
        "(1700000007.623457) can_0_x 182##201",
        "(1700000009.123457) can_0_x_2 20000040#0000000000000000",
    ]


@pytest.mark.usefixtures("east")
def test_asc_begins_at_the_second_of_its_first_frame_in_local_time(tmp_path):
    written("asc", tmp_path / "a.asc", ("a",))
    lines = (tmp_path / "a.asc").read_text("ascii").splitlines()
    assert lines[0].startswith("date ")
    assert lines[1:3] == ["base hex  timestamps absolute", "internal events logged"]
    assert lines[3].startswith("Begin Triggerblock Wed Nov 15 00:13:20.0")
    assert lines[4:6] == [" 0.000000 Start of measurement", " 0.000000 First frame"]
    zeros = "       0    0 {:>8}" + "        0" * 5
    expected = [
        "  0.123457 1  80              Rx   d 2 A7 C3",
        "  1.623457 1  1ABCDEF0x       Tx   d 0",
        "  3.123457 1  12              Rx   r 0",
        "  4.623457 CANFD   1 Tx        7FF  "
        + " " * 32
        + " 0 0 9 12 00 01 02 03 04 05 06 07 08 09 0A 0B "
        + zeros.format("1000"),
        "  6.123457 CANFD   2 Rx        181  " + " " * 32 + " 1 0 1  1 0A " + zeros.format("3000"),
        "  7.623457 CANFD   1 Tx        182  " + " " * 32 + " 0 1 1  1 01 " + zeros.format("5000"),
        "  9.123457 3  ErrorFrame",
        "End TriggerBlock",
    ]
    assert [line.split() for line in lines[6:]] == [line.split() for line in expected]


def test_an_asc_without_frames_has_no_time(tmp_path):
    written("asc", tmp_path / "a.asc", ("a",), ())
    assert "Begin" not in (tmp_path / "a.asc").read_text("ascii")


@pytest.mark.parametrize("kind", ["asc", "blf"])
def test_what_is_written_is_read_by_python_can(tmp_path, kind):
    written(kind, tmp_path / f"a.{kind}", ("a",))
    reader: Any = {"asc": can.ASCReader, "blf": can.BLFReader}[kind](tmp_path / f"a.{kind}")
    found = list(reader)
    assert len(found) == len(FRAMES)
    for k, (message, (identifier, data, flags)) in enumerate(zip(found, FRAMES, strict=True)):
        error = bool(flags & ERROR)
        assert message.is_error_frame == error
        assert message.channel == flags // BUS
        if error:
            continue
        assert (message.arbitration_id, bytes(message.data)) == (identifier, data)
        kinds = message.is_extended_id, message.is_remote_frame, message.is_fd
        assert kinds == (bool(flags & EXTENDED), bool(flags & REMOTE), bool(flags & FD))
        assert (message.bitrate_switch, message.error_state_indicator) == (
            bool(flags & BRS),
            bool(flags & ESI),
        )
        assert message.is_rx == (k % 2 == 0)
        if kind == "blf":
            assert message.timestamp == pytest.approx(1e-9 * T_ns + 1.5 * k, abs=2e-6)


def test_a_blf_whose_last_container_finds_no_room_is_closed_all_the_same(tmp_path, monkeypatch):
    def full() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    writer = BlfWriter(tmp_path / "a.blf", ("a",))
    file = writer._file
    monkeypatch.setattr(writer._writer, "stop", full)
    with pytest.raises(OSError, match="No space left"):
        writer.close()
    assert file.closed
