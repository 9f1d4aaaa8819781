"""One interface of python-can look by look: what it takes, when it is off, how it dates, and kernel frames' ends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import can
import pytest

from drivers.can import python_can
from drivers.can.arbitration import priority
from drivers.can.python_can import PythonCan
from drivers.can.socketcan import pack, unpack
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame
from tests.drivers.arbitrated import arbitrate
from tests.drivers.frames_heard import got

PAIR = (Frame(1, b"a"), Frame(2, b"b"))
LOST = can.CanOperationError("lost")
NO_FILE = NotImplementedError()


class Adapter:
    """An interface that does what it is told. State: what it was given, and what it has."""

    def __init__(self, *looks: Any, file: Any = NO_FILE) -> None:
        self.looks, self.file, self.sent = list(looks), file, list[Any]()
        self.refuses: Exception | None = None

    def fileno(self) -> int:
        if isinstance(self.file, Exception):
            raise self.file
        return int(self.file)

    def send(self, message: can.Message, timeout: float) -> None:
        if self.refuses is not None and self.sent:
            raise self.refuses
        self.sent.append((message.arbitration_id, bytes(message.data), timeout))

    def recv(self, _timeout: float) -> can.Message | None:
        found = self.looks.pop(0) if self.looks else None
        if isinstance(found, Exception):
            raise found
        return found


def opened(*looks: Any, interface: str = "", **more: Any) -> tuple[PythonCan, Adapter]:
    adapter: Any = Adapter(*looks, **more)
    return PythonCan(adapter, interface), adapter


def test_frames_are_sent_without_waiting_and_each_that_is_taken_has_its_time(monkeypatch):
    times = iter(range(100, 200))
    monkeypatch.setattr(python_can, "time", SimpleNamespace(monotonic_ns=lambda: next(times)))
    bus, adapter = opened()
    assert bus.send(sent_array(PAIR)) == 2
    assert adapter.sent == [(1, b"a", 0), (2, b"b", 0)]
    assert bus.sent_ns() == [100, 101]
    adapter.refuses, adapter.sent = LOST, []
    assert (bus.send(sent_array(PAIR)), bus.sent_ns()) == (1, [102])
    assert (bus.send(sent_array(PAIR)), bus.sent_ns()) == (0, [])
    adapter.refuses = ValueError("too long")
    with pytest.raises(BusError, match="bus: frame 0x1 cannot be sent: too long"):
        bus.send(sent_array(PAIR))


@pytest.mark.parametrize(("failures", "off"), [(7, False), (8, True)])
@pytest.mark.parametrize("before", ["nothing", "silence", "a look", "a sending"])
def test_eight_looks_in_a_row_that_fail_are_an_interface_that_is_gone(failures, off, before):
    bus, adapter = opened(*[LOST] * 7 * (before != "nothing"))
    got(bus.receive())
    if before == "a sending":
        bus.send(sent_array(PAIR))
    elif before == "a look":
        adapter.looks = [can.Message(arbitration_id=5)]
        assert [each.frame.id for each in got(bus.receive())] == [5]
    adapter.looks = [LOST] * failures
    got(bus.receive())
    assert (bus.off, bus.overflow) == (off, failures + 7 * (before != "nothing"))
    bus.send(sent_array(PAIR))
    assert not bus.off


def test_an_interface_without_a_descriptor_has_none_and_one_whose_descriptor_is_gone_is_off():
    for file, known in ((NO_FILE, -1), (-1, -1), (0, 0), (7, 7)):
        bus, adapter = opened(file=file)
        assert (bus.fileno(), bus.off) == (known, False)
    adapter.file = LOST
    assert (bus.fileno(), bus.off) == (-1, True)
    bus, adapter = opened(file=7)
    adapter.file = LOST
    bus.block(0, frozenset())
    assert bus.off
    assert bus.arm()
    link: Any = bus
    assert link.foresee() is None


# frames of the kernel, and their order on the wire


@pytest.mark.parametrize(
    ("size", "flags", "fits"), [(8, 0, True), (9, 0, False), (64, FD, True), (65, FD, False)]
)
def test_a_frame_of_the_kernel_has_8_bytes_or_64(size, flags, fits):
    if fits:
        assert unpack(pack(*Frame(0x7FF, bytes(size), flags))) == Frame(0x7FF, bytes(size), flags)
        return
    with pytest.raises(BusError, match=f"frame 0x7FF has {size} bytes; classic CAN carries 8, CAN FD 64"):
        pack(*Frame(0x7FF, bytes(size), flags))


@pytest.mark.parametrize("identifier", [0, 1, 0x400, 0x7FF])
@pytest.mark.parametrize("flags", [0, REMOTE, FD, FD | BRS, FD | ESI])
def test_a_plain_frame_of_the_kernel_is_the_same_there_and_back(identifier, flags):
    assert unpack(pack(*Frame(identifier, b"ab", flags))) == Frame(identifier, b"ab", flags)
    assert unpack(pack(*Frame(identifier, b"", flags)))[0] == identifier


@pytest.mark.parametrize("identifier", [0, 1, 0x7FF, 0x800, 0x10000000, 0x1FFFFFFF])
def test_an_extended_identifier_and_the_classes_of_an_error_are_29_bits(identifier):
    for flags in (EXTENDED, EXTENDED | FD, EXTENDED | REMOTE):
        assert unpack(pack(*Frame(identifier, b"", flags))) == Frame(identifier, b"", flags)
    raw = (identifier | 0x20000000).to_bytes(4, "little") + b"\x08\0\0\0" + bytes(8)
    assert unpack(raw) == Frame(identifier, bytes(8), ERROR)
    eleven = (identifier & 0x1FFFFFFF).to_bytes(4, "little") + bytes(12)
    assert unpack(eleven)[0] == identifier & 0x7FF


@pytest.mark.parametrize(
    ("identifier", "flags", "bits"),
    [
        (0x555, 0, "10101010101 0 0 000000000000000000 0"),
        (0x555, REMOTE, "10101010101 1 0 000000000000000000 0"),
        (0x15555555, EXTENDED, "10101010101 1 1 010101010101010101 0"),
        (0x15555555, EXTENDED | REMOTE, "10101010101 1 1 010101010101010101 1"),
        (0x2AAAAAA, EXTENDED, "00010101010 1 1 101010101010101010 0"),
    ],
)
def test_the_rank_of_a_frame_is_its_arbitration_field_and_one_more(identifier, flags, bits):
    assert priority(identifier, flags) == 1 + int(bits.replace(" ", ""), 2)
    assert priority(identifier, flags | ERROR) == 0


def test_a_frame_has_the_bus_by_its_rank_then_by_its_number_once_it_is_there():
    # at ns, rank, number, duration: the idle bus goes to who comes first, then to the best that waits
    queued = [(50, 9, 7, 10), (52, 5, 4, 10), (52, 5, 3, 10), (75, 1, 2, 10), (60, 9, 1, 10), (200, 1, 9, 10)]
    assert arbitrate(queued, 0, 1_000) == ([(7, 60), (3, 70), (4, 80), (2, 90), (1, 100), (9, 210)], 210)
