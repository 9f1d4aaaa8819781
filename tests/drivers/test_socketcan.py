"""SocketCan over a fake kernel: its reaction to each errno, ancillary datum and error frame."""

from __future__ import annotations

import errno
import socket
import struct
import time
from collections import deque
from typing import Any, cast

import pytest

from drivers.can import netlink, socketcan
from drivers.can.bus import Bus
from drivers.can.can_interface import CanInterface
from drivers.can.socketcan import SocketCan, pack
from drivers.config import BusSettings
from drivers.errors import BusError
from drivers.frame_array import sent_array
from drivers.protocol import BRS, FD, Frame
from drivers.signals import BusState
from tests.drivers.received_frames import got

SETTINGS = BusSettings(interface="socketcan", channel="can0", layout="classic")
CAN0 = CanInterface("can0", 5, True, 16, "can", True, 1_000_000, None, BusState.ACTIVE, 0, 0, None)
FRAME = Frame(0x80, b"\x01")
BUS_OFF, RESTARTED, CONTROLLER_PROBLEM = 0x20000040, 0x20000100, 0x20000004
TIMESTAMP, LOST, MEMINFO = 35, 40, 55
SECOND = 1_000_000_000


class FakeSocket:
    """A fake socket: answers of the kernel, in order; `waiting`: bytes of our frames in its queue."""

    def __init__(self, kernel: Kernel) -> None:
        self.kernel, self.answers = kernel, deque[object]()
        self.sent, self.options, self.waiting = list[bytes](), dict[tuple[int, int], int](), 0
        self.refuses: int | None = None
        self.kept = 0
        """Error left by taking the interface down, until it is read or raised."""
        self.closed = False

    def setblocking(self, blocks: bool) -> None:
        assert not blocks

    def setsockopt(self, level: int, option: int, value: int) -> None:
        self.options[level, option] = value

    def bind(self, address: tuple[str]) -> None:
        assert address == ("can0",)
        if self.kernel.unbindable:
            raise OSError(errno.ENODEV, "made")

    def send(self, raw: bytes) -> None:
        if self.refuses is not None:
            raise OSError(self.refuses, "made")
        self.sent.append(raw)

    def recvmsg(self, size: int, _ancillary: int) -> Any:
        error, self.kept = self.kept, 0
        if error:
            raise OSError(error, "made")
        if not self.answers:
            raise BlockingIOError
        answer = self.answers.popleft()
        if isinstance(answer, OSError):
            raise answer
        raw, *rest = cast("tuple[Any, ...]", answer)
        return (raw[:size], *rest)  # the kernel truncates it

    def getsockopt(self, _level: int, option: int, *_size: int) -> Any:
        # SO_MEMINFO: bytes received, their limit, bytes waiting to be sent, ...; SO_ERROR is a number
        if option == MEMINFO:
            return struct.pack("=3I", 0, 0, self.waiting)
        error, self.kept = self.kept, 0
        return error

    def close(self) -> None:
        self.closed = True

    def hears(
        self, word: int, data: bytes = bytes(8), t_ns: int | None = None, lost: int | None = None
    ) -> None:
        t_ns = time.time_ns() if t_ns is None else t_ns
        ancillary = [(1, TIMESTAMP, struct.pack("=qq", t_ns // SECOND, t_ns % SECOND))]
        if lost is not None:
            ancillary.append((1, LOST, struct.pack("=I", lost)))
        layout, head = ("=IB3x8s", (8,)) if len(data) <= 8 else ("=IBB2x64s", (64, 1))
        self.answers.append((struct.pack(layout, word, *head, data), ancillary, 0, None))


class Kernel:
    """An interface, its queue and its sockets. State: calls received, and the state of the interface."""

    def __init__(self) -> None:
        self.interface, self.queued = CAN0, 0
        self.there, self.forbidden, self.unbindable = True, False, False
        self.calls, self.sockets = list[bool](), list[FakeSocket]()

    def open(self, *kind: int) -> FakeSocket:
        assert kind == (socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        self.sockets.append(FakeSocket(self))
        return self.sockets[-1]

    def get_link(self, _name: str) -> bytes:
        if not self.there:
            raise OSError(errno.ENODEV, "made")
        return b""

    def set_up(self, _index: int, *, up: bool) -> None:
        if self.forbidden:
            raise PermissionError(errno.EPERM, "made")
        self.calls.append(up)
        self.queued, self.interface = 0, CAN0
        if not up:
            self.sockets[-1].kept = errno.ENETDOWN


class Clock:
    """Time of the module, set by the test."""

    def __init__(self) -> None:
        self.ns = 7 * SECOND

    def monotonic_ns(self) -> int:
        return self.ns

    def __getattr__(self, name: str) -> Any:
        return getattr(time, name)


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(socketcan, "time", clock)
    return clock


@pytest.fixture
def kernel(monkeypatch, clock):
    kernel = Kernel()
    monkeypatch.setattr(socket, "socket", kernel.open)
    monkeypatch.setattr(netlink, "get_link", kernel.get_link)
    monkeypatch.setattr(netlink, "set_up", kernel.set_up)
    monkeypatch.setattr(netlink, "queued", lambda _: kernel.queued)
    monkeypatch.setattr(socketcan, "parse", lambda *_: kernel.interface)
    return kernel


@pytest.fixture
def made(kernel):
    can = SocketCan(SETTINGS)
    return can, kernel.sockets[-1]


def sends(can: SocketCan, *frames: Frame) -> int:
    return can.send(sent_array(frames or (FRAME,)))


@pytest.mark.parametrize("layout", ["classic", "fd"])
def test_socket_options_request_error_frames_time_stamps_loss_counts_and_fd_frames(kernel, layout):
    # CAN_CTRLMODE_FD is 0x20 of linux/can/netlink.h
    kernel.interface = CAN0._replace(mtu=72, data_bitrate_bit_s=5_000_000, modes=0x20)
    with Bus([SocketCan(SETTINGS.model_copy(update={"layout": layout}))]):
        (sock,) = kernel.sockets
        # linux/can.h and linux/can/raw.h: SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK, CAN_RAW_FD_FRAMES
        assert sock.options[101, 2] == 0x1FFFFFFF
        assert sock.options.get((101, 5), 0) == (layout == "fd")
        assert sock.options[socket.SOL_SOCKET, TIMESTAMP] == sock.options[socket.SOL_SOCKET, LOST] == 1
        assert not sock.closed
    assert sock.closed


@pytest.mark.parametrize(("there", "words"), [(False, "no such network interface"), (True, "does not open")])
def test_can_interface_that_is_missing_or_cannot_be_bound_is_refused(kernel, there, words):
    kernel.there, kernel.unbindable = there, True
    with pytest.raises(BusError, match=words):
        SocketCan(SETTINGS)
    assert kernel.sockets[0].closed


# what is received


@pytest.mark.parametrize(("data", "flags"), [(b"12345678", 0), (bytes(range(64)), FD | BRS)])
def test_frame_is_received_intact_with_the_kernels_time_stamp(made, clock, data, flags):
    can, sock = made
    sock.hears(0x123, data, t_ns=time.time_ns() - 3_000_000)
    (received,) = got(can.receive())
    assert received.frame == Frame(0x123, data, flags)
    assert -4_000_000 < received.t_ns - clock.ns < -2_900_000


def test_frames_lost_by_the_kernel_are_counted_once_and_across_the_counter_wrap(made):
    can, sock = made
    for lost in (3, 3, 10, 0xFFFFFFFF, 1):
        sock.hears(0x80, lost=lost)
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x01, 0, 0, 0, 0, 0, 0]))  # the controller's own overflow
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x04, 0, 0, 0, 0, 0, 0]))
    got(can.receive())
    assert can.overflow == 0xFFFFFFFF + 2 + 1


def test_worst_state_of_the_can_controller_is_kept_until_it_is_read(made):
    can, sock = made
    assert (can.worst_state(), can.virtual) == (BusState.ACTIVE, False)
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x20, 0, 0, 0, 0, 0, 0]))
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x40, 0, 0, 0, 0, 0, 0]))
    sock.hears(0x20000020)
    got(can.receive())
    assert [can.worst_state() for _ in range(2)] == [BusState.PASSIVE, BusState.ACTIVE]


@pytest.mark.parametrize("back", [RESTARTED, CONTROLLER_PROBLEM])
def test_bus_off_lasts_until_an_error_frame_reports_the_return_of_the_can_controller(made, back):
    can, sock = made
    sock.hears(BUS_OFF)
    sock.hears(0x20000080)  # an error without a state
    sock.hears(0x123, t_ns=time.time_ns() + SECOND)  # the controller had received this one before
    got(can.receive())
    assert (can.off, sends(can), can.worst_state()) == (True, 0, BusState.OFF)
    sock.hears(back, bytes([0, 0x40, 0, 0, 0, 0, 0, 0]))
    got(can.receive())
    assert not can.off
    assert [can.worst_state() for _ in range(2)][1] is BusState.ACTIVE


def test_virtual_can_interface_counts_as_restored_with_its_next_frame(kernel):
    kernel.interface = CAN0._replace(kind="vcan", has_controller=False)
    can = SocketCan(SETTINGS)
    kernel.sockets[-1].hears(BUS_OFF)
    got(can.receive())
    assert (can.off, can.virtual) == (True, True)
    kernel.sockets[-1].hears(0x123)
    got(can.receive())
    assert (can.off, can.worst_state()) == (False, BusState.OFF)


def test_bus_off_that_begins_and_ends_between_two_readings_is_reported(made):
    can, sock = made
    bus = Bus([can])
    sock.hears(BUS_OFF)
    sock.hears(RESTARTED)
    got(bus.drain_now())
    assert bus.events() == (2, True, 0, BusState.OFF)
    assert bus.events() == (0, False, 0, BusState.ACTIVE)


# a bus that takes nothing


def test_full_send_queue_means_a_busy_bus_and_after_50_ms_a_dead_bus(made, clock):
    can, sock = made
    assert sends(can, *[FRAME] * 3) == 3
    sock.waiting, sock.refuses = 900, errno.ENOBUFS
    for _ in range(6):
        assert sends(can) == 0
        clock.ns += 9_000_000
    assert not can.off
    sock.waiting, sock.refuses = 0, None
    assert sends(can) == 1
    sock.waiting = 900
    for _ in range(5):
        assert sends(can) == 1
        clock.ns += 10_000_000
    # the kernel would accept one more, but it must not wait there
    assert (sends(can), can.off) == (0, True)
    sock.waiting = 0
    assert (sends(can), can.off) == (1, False)


def test_stall_of_the_machine_is_not_taken_for_a_dead_bus(made, clock):
    can, sock = made
    sock.waiting = 900
    sends(can)
    clock.ns += SECOND
    assert (can.off, sends(can), can.off) == (False, 1, False)


def test_sending_a_frame_that_the_can_interface_cannot_carry_raises_an_error(made):
    can, sock = made
    sock.refuses = errno.EMSGSIZE
    with pytest.raises(BusError, match="0x80"):
        sends(can)


def test_can_interface_that_went_down_is_used_again_once_it_is_up_as_configured(made, clock, kernel):
    can, sock = made
    sock.refuses = errno.ENETDOWN
    assert (sends(can), can.off) == (0, True)
    can.died()
    assert kernel.calls == [], "the program does not bring the interface up"
    sock.hears(0x123)
    assert [each.frame.id for each in got(can.receive())] == [0x123]
    assert can.off, "a received frame does not prove that the interface is the configured one"
    for wrong in (CAN0._replace(up=False), CAN0._replace(bitrate_bit_s=1)):
        kernel.interface = wrong
        clock.ns += 100_000_000
        assert sends(can) == 0
    kernel.interface = CAN0
    assert sends(can) == 0, "the interface is checked ten times a second"
    clock.ns += 100_000_000
    assert (sends(can), can.off) == (1, False)
    kernel.sockets[-1].answers.append(OSError(errno.ENETDOWN, "made"))
    assert (got(can.receive()), can.off) == ([], True)


def test_can_interface_that_was_deleted_and_created_again_is_opened_again(made, clock, kernel):
    can, sock = made
    sock.hears(0x123, lost=10)
    sock.answers.append(OSError(errno.ENODEV, "made"))
    got(can.receive())
    kernel.there = False
    assert (sends(can), can.off) == (0, True)
    kernel.there = True
    clock.ns += 100_000_000
    assert (sends(can), can.off) == (1, False)
    new = kernel.sockets[-1]
    assert (sock.closed, new.sent) == (True, [pack(*FRAME)])
    new.hears(0x123, lost=2)
    got(can.receive())
    assert can.overflow == 12, "a new socket counts its losses from 0"


# stale frames


def starve(bus: Bus, sock: FakeSocket, clock: Clock) -> int:
    sock.waiting = 900
    for _ in range(6):
        bus.send(sent_array([FRAME]))
        clock.ns += 10_000_000
    return bus.events().off


def test_queued_frames_of_a_dead_bus_are_dropped_only_once_until_a_frame_is_received(made, clock, kernel):
    can, sock = made
    bus = Bus([can])
    for hears, drops in ((False, 1), (False, 1), (True, 2)):
        sock.waiting = 0
        if hears:
            sock.hears(0x181)
            got(bus.drain_now())
        bus.send(sent_array([FRAME]))
        assert not bus.events().off
        assert starve(bus, sock, clock)
        assert kernel.calls == [False, True] * drops


@pytest.mark.parametrize(("restart_ms", "dropped"), [(0, []), (100, [False, True])])
def test_can_controller_with_restart_ms_0_stays_bus_off(kernel, restart_ms, dropped):
    kernel.interface = CAN0._replace(restart_ms=restart_ms)
    can = SocketCan(SETTINGS)
    kernel.sockets[-1].hears(BUS_OFF)
    got(can.receive())
    can.died()
    assert (kernel.calls, can.off) == (dropped, not dropped)


@pytest.mark.parametrize("cause", ["nothing", "queue", "bus-off", "restarted unnoticed"])
def test_flush_drops_queued_frames_and_restarts_the_can_controller_after_bus_off(made, kernel, cause):
    can, sock = made
    if cause == "queue":
        kernel.queued = 3
    elif cause != "nothing":
        sock.hears(BUS_OFF)
        got(can.receive())
        if cause == "bus-off":
            kernel.interface = CAN0._replace(state=BusState.OFF)
    can.flush_tx()
    assert kernel.calls == ([False, True] if cause in {"queue", "bus-off"} else [])
    sock.hears(0x123)
    assert [each.frame.id for each in got(can.receive())] == [0x123], (
        "the program itself took the interface down and up"
    )
    assert (can.off, sends(can)) == (False, 1)


def test_flush_without_cap_net_admin_or_at_a_wrong_bit_rate_is_refused_and_the_bus_stays_off(made, kernel):
    can, _ = made
    for queued, interface, words in (
        (3, CAN0, "CAP_NET_ADMIN"),
        (0, CAN0._replace(bitrate_bit_s=9), "is 1000"),
    ):
        kernel.queued, kernel.forbidden, kernel.interface = queued, True, interface
        with pytest.raises(BusError, match=words):
            can.flush_tx()
        assert can.off
    kernel.interface = CAN0
    can.flush_tx()
    assert not can.off
