"""python-can interfaces: opening, reception, losses, and when one counts as off."""

from __future__ import annotations

import os
import struct
import time
import tty
from collections.abc import Iterator
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import can
import pytest
from can.interfaces.slcan import slcanBus

from drivers.can.bus import Bus
from drivers.can.python_can import PythonCan, open_python_can
from drivers.config import BusSettings
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import Frame
from tests.drivers.received_frames import got

PAIR = (Frame(1, b"a"), Frame(2, b"b"))
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
    """A fake python-can bus: `recv` gives or raises the elements of `coming`, then `last`.

    Mutable state: what is to come, the number of polls, frames sent, and whether it was shut down.
    """

    def __init__(self, *coming: Look, last: Look = None, raises: Exception | None = None) -> None:
        self.coming, self.last, self.raises = list(coming), last, raises
        self.refuses: Exception | None = None
        self.looks, self.sent, self.shut = 0, list[tuple[int, bytes]](), False

    def fileno(self) -> int:
        raise NotImplementedError

    def recv(self, _timeout_s: float) -> can.Message | None:
        self.looks += 1
        found = self.coming.pop(0) if self.coming else self.last
        if isinstance(found, Exception):
            raise found
        return found

    def send(self, sent: can.Message, timeout: float) -> None:
        assert timeout == 0
        if self.refuses is not None:
            raise self.refuses
        self.sent.append((sent.arbitration_id, bytes(sent.data)))

    def flush_tx_buffer(self) -> None:
        if self.raises is not None:
            raise self.raises

    def shutdown(self) -> None:
        self.shut = True
        if self.raises is not None:
            raise self.raises


def on(adapter: Any, interface: str = "") -> PythonCan:
    return PythonCan(adapter, interface)


def heard(bus: PythonCan) -> list[int]:
    return [each.frame.id for each in got(bus.receive())]


# opening


OWN = {"bitrate": 250_000, "data_bitrate": 4_000_000, "fd": False, "single_handle": True}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"layout": "fd"}, {"bitrate": 500_000, "fd": True, "data_bitrate": 2_000_000}),
        ({"layout": "classic"}, {"bitrate": 500_000}),
        ({"layout": "fd", "options": OWN}, OWN),
        ({"interface": "udp_multicast", "layout": "classic"}, {"hop_limit": 0}),
    ],
)
def test_python_can_bus_is_opened_with_the_bit_rates_of_its_layout_or_options(monkeypatch, changes, expected):
    """Files and environment of python-can are ignored: they may set a bit rate for other work."""
    opened: list[Any] = []

    def bus(*place: str, **options: Any) -> Adapter:
        opened.append((place, options))
        return Adapter()

    monkeypatch.setattr(can, "Bus", bus)
    settings = {"interface": "kvaser", "bitrate_bit_s": 500_000, "data_bitrate_bit_s": 2_000_000} | changes
    open_python_can(BusSettings.model_validate({"channel": "3", **settings}))
    ((place, options),) = opened
    assert place == ("3", settings["interface"])
    assert options == {"ignore_config": True, **expected}


@pytest.mark.parametrize("interface", ["kvaser", "slcan", "udp_multicast"])
@pytest.mark.parametrize("age_s", [0.0, 0.9, -3e-4, 1e6])
def test_frame_received_through_python_can_has_the_time_at_which_it_was_read(monkeypatch, interface, age_s):
    """Its own time stamp is ignored: it may come from the adapter's clock."""
    coming: Any = Adapter(can.Message(timestamp=time.time() - age_s, arbitration_id=1))
    monkeypatch.setattr(can, "Bus", lambda *_, **__: coming)
    bus = open_python_can(BusSettings(interface=interface, channel="0", layout="classic"))
    before_ns = time.monotonic_ns()
    (received,) = got(bus.receive())
    assert before_ns <= received.t_ns <= time.monotonic_ns()
    assert bus.virtual == (interface == "udp_multicast")


# what is heard and sent


def test_frames_are_sent_through_python_can_without_waiting_until_one_is_refused():
    adapter = Adapter()
    bus = on(adapter)
    before_ns = time.monotonic_ns()
    assert bus.send(sent_array(PAIR)) == 2
    assert adapter.sent == [(1, b"a"), (2, b"b")]
    assert before_ns <= bus.sent_ns()[0] <= bus.sent_ns()[1] <= time.monotonic_ns()
    adapter.refuses = can.CanOperationError("full")
    assert (bus.send(sent_array(PAIR)), bus.sent_ns()) == (0, [])
    adapter.refuses = ValueError("too long")
    with pytest.raises(BusError, match="0x1"):
        bus.send(sent_array(PAIR))


def test_python_can_bus_that_failed_counts_as_off_until_it_accepts_frames_again():
    adapter = Adapter()
    bus = on(adapter)
    for _ in range(2):
        adapter.last = adapter.refuses = can.CanOperationError("gone")
        assert (heard(bus), bus.off) == ([], True)
        assert (bus.send(sent_array(PAIR)), bus.off) == (0, True)
        adapter.last = adapter.refuses = None
        assert heard(bus) == []
        assert (bus.send(sent_array(PAIR)), bus.off) == (2, False)


def test_python_can_echo_of_a_sent_frame_is_ignored():
    echo = message(0x80, is_rx=False)
    assert heard(on(Adapter(echo, message(1), echo, echo, message(2)))) == [1, 2]
    bus = on(Adapter(echo))
    bus.block(0, frozenset())
    assert heard(bus) == []


@pytest.mark.parametrize("error", GARBLED, ids=repr)
def test_unreadable_python_can_message_counts_as_one_lost_frame(error):
    bus = on(Adapter(error, message(1), None, *[error, message(2)] * 20))
    assert (heard(bus), bus.overflow, bus.off) == ([1], 1, False)
    assert (heard(bus), bus.overflow, bus.off) == ([2] * 20, 21, False)


def test_reading_from_python_can_ends_although_frames_arrive_without_end():
    adapter = Adapter(last=message(7))
    bus = on(adapter)
    for _ in range(2):
        adapter.looks = 0
        assert len(heard(bus)) == adapter.looks < 2_000


@pytest.mark.parametrize(("failures", "off"), [(7, False), (8, True)])
def test_python_can_interface_counts_as_lost_after_eight_consecutive_failures(failures, off):
    adapter = Adapter(None)
    bus = on(adapter)
    heard(bus)
    adapter.coming = [*[OSError("lost")] * failures, None]
    heard(bus)
    assert bus.off is off


@pytest.mark.parametrize("error", [*GARBLED, OSError("gone")], ids=repr)
def test_python_can_interface_that_only_fails_counts_as_off_at_the_first_reading(error):
    adapter = Adapter(last=error)
    bus = on(adapter)
    assert (heard(bus), bus.off) == ([], True)
    looks, lost = adapter.looks, bus.overflow
    assert heard(bus) == []
    assert (adapter.looks, bus.overflow) == (looks + 1, lost), "the adapter is polled once"


# the end


@pytest.mark.parametrize("error", [can.CanOperationError("port"), OSError("usb"), AttributeError("handle")])
def test_error_while_a_python_can_bus_closes_is_ignored_and_releases_the_role(error):
    given: list[str] = []
    role: Any = SimpleNamespace(close=lambda: given.append("back"))
    adapter = Adapter(raises=error)
    with Bus([on(adapter)], role) as bus, pytest.raises(BusError, match="cannot be dropped"):
        bus.flush_tx()
    assert (adapter.shut, given) == (True, ["back"])
    Bus([on(Adapter(raises=NotImplementedError()))]).flush_tx()


# slcan as python-can has it, on a terminal in place of the adapter


@pytest.fixture
def line() -> Iterator[tuple[PythonCan, int]]:
    """A bus and the descriptor at which its adapter would write."""
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
    """Write as the adapter, and wait until all of it has arrived."""
    bus, adapter = line
    os.write(adapter, data)
    port: Any = bus._bus.serialPortOrig  # type: ignore[attr-defined]
    assert any(port.in_waiting == len(data) for _ in range(1_000_000))


def test_one_reading_of_a_slcan_adapter_gives_all_frames_after_confirmation_lines(line):
    bus, _ = line
    write(line, b"\r" * 12 + b"t1232AABB\r" + b"z\r" * 6 + b"t1241CC\r" + b"\r")
    assert [each.frame for each in got(bus.receive())] == [Frame(0x123, b"\xaa\xbb"), Frame(0x124, b"\xcc")]
    assert (heard(bus), bus.overflow, bus.off) == ([], 0, False)


@pytest.mark.parametrize("garbled", [b"t12", b"t12G2AABB", b"t1232AAB", b"t123XAABB", b"t1232\xff\xfe"])
def test_damaged_line_of_a_slcan_adapter_counts_as_one_lost_frame(line, garbled):
    bus, _ = line
    write(line, garbled + b"\r" + b"t1241CC\r" * 6)
    assert heard(bus) == [0x124] * 6
    assert (bus.overflow, bus.off) == (1, False)


def test_bus_of_an_unplugged_adapter_counts_as_off_and_closes_without_error(line):
    bus, adapter = line
    os.close(adapter)
    assert (heard(bus), bus.off) == ([], True)
    bus.block(0, frozenset())
    Bus([bus]).close()
