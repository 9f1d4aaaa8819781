"""Interfaces of python-can that echo, lose bytes, fail or go away: what is heard, what is lost, when one is off, how it ends."""

from __future__ import annotations

import os
import struct
import tty
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from types import SimpleNamespace
from typing import Any

import can
import pytest
from can.interfaces.slcan import slcanBus

from drivers.can.bus import Bus
from drivers.can.link import Link
from drivers.can.python_can import PythonCan
from drivers.errors import BusError
from drivers.protocol import Frame
from tests.drivers.frames_heard import got

Look = can.Message | Exception | None
GARBLED = [
    ValueError("int()"),
    IndexError("line"),
    KeyError("X"),
    can.CanOperationError("overrun"),
    TypeError("ord()"),
    struct.error("unpack"),
]


def message(identifier: int, **changes: Any) -> can.Message:
    return can.Message(arbitration_id=identifier, is_extended_id=False, **changes)


class Adapter:
    """A stand-in for a bus of python-can: what `recv` gives or raises, look by look; then `last`.

    Mutable state: what is to come, how often it was looked, and whether it was shut down.
    """

    def __init__(self, *coming: Look, last: Look = None, raises: Exception | None = None) -> None:
        self.coming, self.last, self.raises = list(coming), last, raises
        self.looks = 0
        self.shut = False

    def fileno(self) -> int:
        raise NotImplementedError

    def recv(self, _timeout_s: float) -> can.Message | None:
        self.looks += 1
        found = self.coming.pop(0) if self.coming else self.last
        if isinstance(found, Exception):
            raise found
        return found

    def send(self, _message: can.Message, timeout: float) -> None:
        del timeout

    def flush_tx_buffer(self) -> None:
        if self.raises is not None:
            raise self.raises

    def shutdown(self) -> None:
        self.shut = True
        if self.raises is not None:
            raise self.raises


def on(adapter: Any) -> PythonCan:
    return PythonCan(adapter)


def heard(bus: PythonCan) -> list[int]:
    return [each.frame.id for each in got(bus.receive())]


def test_an_echo_of_a_frame_of_our_own_is_no_frame_that_has_come_and_hides_none_behind_it():
    echo = message(0x80, is_rx=False)
    adapter = Adapter(echo, message(1), echo, echo, message(2))
    assert heard(on(adapter)) == [1, 2]


def test_an_echo_that_ends_a_wait_is_none_either():
    bus = on(Adapter(message(0x80, is_rx=False)))
    bus.block(0, frozenset())
    assert heard(bus) == []


@pytest.mark.parametrize("error", GARBLED, ids=repr)
def test_what_cannot_be_read_is_one_lost_frame_and_what_is_behind_it_is_heard_each_time(error):
    bus = on(Adapter(error, message(1), None, *[error, message(2)] * 20))
    assert (heard(bus), bus.overflow, bus.off) == ([1], 1, False)
    assert (heard(bus), bus.overflow, bus.off) == ([2] * 20, 21, False)


@pytest.mark.parametrize("error", [*GARBLED, OSError("gone")], ids=repr)
def test_an_interface_that_gives_nothing_but_failures_is_off_at_the_first_look(error):
    adapter = Adapter(last=error)
    bus = on(adapter)
    assert heard(bus) == []
    assert bus.off
    looks, lost = adapter.looks, bus.overflow
    assert heard(bus) == []
    assert adapter.looks == looks + 1, "one that is off is not asked again and again"
    assert bus.overflow == lost, "nothing is there to be lost"


def test_where_frames_come_all_the_time_a_look_ends_and_the_next_goes_on():
    adapter = Adapter(last=message(7))
    bus = on(adapter)
    for _ in range(2):
        adapter.looks = 0
        assert len(heard(bus)) == adapter.looks < 2_000


RAISED = [can.CanOperationError("port"), OSError("usb"), RuntimeError("maker"), AttributeError("handle")]


@pytest.mark.parametrize("error", RAISED, ids=repr)
def test_what_an_interface_raises_as_it_is_shut_down_ends_no_run_and_keeps_no_role(error):
    given: list[str] = []
    role: Any = SimpleNamespace(close=lambda: given.append("back"))
    adapter = Adapter(raises=error)
    with Bus([on(adapter)], role):
        pass
    assert adapter.shut
    assert given == ["back"]


@pytest.mark.parametrize("error", RAISED, ids=repr)
def test_frames_that_cannot_be_dropped_are_an_error_of_the_bus(error):
    with pytest.raises(BusError, match="cannot be dropped"):
        Bus([on(Adapter(raises=error))]).flush_tx()


def test_an_interface_that_drops_no_frames_is_asked_in_vain_and_refuses_nothing():
    Bus([on(Adapter(raises=NotImplementedError()))]).flush_tx()


@pytest.mark.parametrize("bad", range(3))
def test_where_one_bus_does_not_close_the_others_are_closed_and_the_role_is_given_back(bad):
    closed: list[object] = []

    def close(k: int) -> None:
        closed.append(k)
        if k == bad:
            raise OSError

    links: Any = [Link() for _ in range(3)]
    for k, link in enumerate(links):
        link.clock, link.close = None, lambda k=k: close(k)
    role = ExitStack()
    role.callback(closed.append, "role")
    with pytest.raises(OSError):
        Bus(links, role).close()
    assert closed == [0, 1, 2, "role"]


# slcan as python-can has it, on a terminal in place of the adapter


@pytest.fixture
def line() -> Iterator[tuple[PythonCan, int]]:
    """Return a bus and the descriptor at which its adapter would write."""
    ours, theirs = os.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    bus = slcanBus(os.ttyname(theirs), bitrate=1_000_000, sleep_after_open=0, timeout=0)
    yield PythonCan(bus), ours
    with suppress(can.CanError, OSError):
        bus.shutdown()
    os.close(theirs)
    with suppress(OSError):
        os.close(ours)


def write(line: tuple[PythonCan, int], data: bytes) -> None:
    """Let the adapter write, and wait until all of it is there."""
    bus, adapter = line
    os.write(adapter, data)
    port: Any = bus._bus.serialPortOrig  # type: ignore[attr-defined]
    assert any(port.in_waiting == len(data) for _ in range(1_000_000))


def test_all_frames_behind_the_lines_that_confirm_what_was_sent_are_there_at_one_look(line):
    bus, _ = line
    write(line, b"\r" * 12 + b"t1232AABB\r" + b"z\r" * 6 + b"t1241CC\r" + b"\r")
    frames = [each.frame for each in got(bus.receive())]
    assert frames == [Frame(0x123, b"\xaa\xbb"), Frame(0x124, b"\xcc")]
    assert heard(bus) == []
    assert (bus.overflow, bus.off) == (0, False)


@pytest.mark.parametrize("garbled", [b"t12", b"t12G2AABB", b"t1232AAB", b"t123XAABB"])
def test_a_line_that_has_lost_a_byte_is_one_lost_frame(line, garbled):
    bus, _ = line
    write(line, garbled + b"\r" + b"t1241CC\r")
    assert heard(bus) == [0x124]
    assert (bus.overflow, bus.off) == (1, False)


def test_a_line_that_is_no_text_spoils_none_that_comes_later(line):
    bus, _ = line
    write(line, b"t1232\xff\xfe\r")
    assert heard(bus) == []
    assert (bus.overflow, bus.off) == (1, False)
    write(line, b"t1241CC\r")
    assert heard(bus) == [0x124]


def test_frames_that_wait_behind_a_line_that_is_no_text_are_read(line):
    bus, _ = line
    write(line, b"t1232\xff\xfe\r" + b"t1241CC\r" * 6)
    assert heard(bus) == [0x124] * 6
    assert (bus.overflow, bus.off) == (1, False)


def test_an_adapter_that_is_pulled_out_is_off_and_is_closed_without_a_word(line):
    bus, adapter = line
    os.close(adapter)
    assert heard(bus) == []
    assert bus.off
    bus.block(0, frozenset())
    Bus([bus]).close()
