"""SocketCan over a socket that is made: what it does with each errno, ancillary datum and error frame."""

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
from drivers.protocol import BRS, ERROR, FD, Frame
from drivers.signals import BusState
from tests.drivers.frames_heard import got

SETTINGS = BusSettings(interface="socketcan", channel="can0", layout="classic")
CAN0 = CanInterface("can0", 5, True, 16, "can", True, 1_000_000, None, BusState.ACTIVE, 0, 0, None)
FRAME = Frame(0x80, b"\x01")
BUS_OFF, CONTROLLER_PROBLEM = 0x20000040, 0x20000004
TIMESTAMP, LOST = 35, 40
SECOND = 1_000_000_000


class MadeSocket:
    """What the kernel would answer, in order; `waiting` is what it still has of ours, bytes."""

    def __init__(self):
        self.answers: deque[object] = deque()
        self.sent = []
        self.waiting = 0
        self.refuses = None
        self.closed = False

    def send(self, raw):
        if self.refuses is not None:
            raise OSError(self.refuses, "made")
        self.sent.append(raw)

    def recvmsg(self, size, _ancillary):
        if not self.answers:
            raise BlockingIOError
        answer = self.answers.popleft()
        if isinstance(answer, OSError):
            raise answer
        raw, *rest = cast("tuple[Any, ...]", answer)
        return (raw[:size], *rest)  # as the kernel cuts it

    def getsockopt(self, _level, option, *_size):
        # SO_MEMINFO begins with what was received, its limit, and what waits to be sent; SO_ERROR is a number
        return struct.pack("=3I", 0, 0, self.waiting) if option == 55 else 0

    def close(self):
        self.closed = True

    def hears(self, word, data=bytes(8), t_ns=None, lost=None):
        ancillary = []
        t_ns = time.time_ns() if t_ns is None else t_ns
        ancillary.append((1, TIMESTAMP, struct.pack("=qq", t_ns // SECOND, t_ns % SECOND)))
        if lost is not None:
            ancillary.append((1, LOST, struct.pack("=I", lost)))
        classic = len(data) <= 8
        raw = (
            struct.pack("=IB3x8s", word, 8, data) if classic else struct.pack("=IBB2x64s", word, 64, 1, data)
        )
        self.answers.append((raw, ancillary, 0, None))


class Clock:
    """The module's time, set by hand."""

    def __init__(self):
        self.ns = 7 * SECOND

    def monotonic_ns(self):
        return self.ns

    def __getattr__(self, name):
        return getattr(time, name)


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(socketcan, "time", clock)
    return clock


@pytest.fixture
def made(monkeypatch, clock):
    sock = MadeSocket()
    monkeypatch.setattr(SocketCan, "_open", lambda _: (sock, CAN0))
    return SocketCan(SETTINGS), sock


@pytest.fixture
def kernel(monkeypatch):
    """Interfaces taken down and up, and how long the queue is."""
    calls, state = [], {"queued": 0, "interface": CAN0}

    def set_up(_index, *, up):
        if state.get("forbidden"):
            raise PermissionError(errno.EPERM, "made")
        calls.append(up)
        state.update({"queued": 0, "interface": CAN0})

    monkeypatch.setattr(netlink, "set_up", set_up)
    monkeypatch.setattr(netlink, "queued", lambda _: state["queued"])
    monkeypatch.setattr(netlink, "get_link", lambda _: b"")
    monkeypatch.setattr(socketcan, "parse", lambda *_: state["interface"])
    return calls, state


def test_a_frame_keeps_the_kernels_time_stamp(made, clock):
    can, sock = made
    sock.hears(0x123, b"12345678", t_ns=time.time_ns() - 3_000_000)
    (received,) = got(can.receive())
    assert received.frame == Frame(0x123, b"12345678")
    assert -4_000_000 < received.t_ns - clock.ns < -2_900_000


def test_a_frame_of_64_bytes_comes_whole(made):
    can, sock = made
    sock.hears(0x123, bytes(range(64)))
    (received,) = got(can.receive())
    assert (received.frame.id, received.frame.data) == (0x123, bytes(range(64)))
    assert received.frame.flags == FD | BRS


def test_a_stall_between_the_looks_at_two_clocks_moves_no_time_stamp(made, clock):
    can, sock = made
    sock.hears(0x123, t_ns=time.time_ns())
    looks = iter([0, 3_000_000, 0, 0])

    def monotonic_ns():
        clock.ns += next(looks, 0)
        return clock.ns

    clock.monotonic_ns = monotonic_ns
    (received,) = got(can.receive())
    assert abs(received.t_ns - clock.ns) < 1_000_000


def test_a_frame_is_out_when_the_kernel_has_taken_it(made, clock):
    can, sock = made
    taken = sock.send

    def send(raw):
        clock.ns += 1_000_000
        return taken(raw)

    sock.send, begun_ns = send, clock.ns
    assert can.send(sent_array([Frame(1, b""), Frame(2, b"")])) == 2
    assert can.sent_ns() == [begun_ns + 1_000_000, begun_ns + 2_000_000]
    can.send(sent_array([Frame(3, b"")]))
    assert can.sent_ns() == [begun_ns + 3_000_000]


@pytest.mark.parametrize("layout", ["classic", "fd"])
def test_the_kernel_is_asked_for_errors_of_all_classes_time_stamps_losses_and_fd_frames_where_the_layout_is(
    monkeypatch, kernel, layout
):
    set_to: dict[tuple[int, int], int] = {}
    bound = []

    class Socket(MadeSocket):
        def __init__(self, *kind):
            super().__init__()
            assert kind == (socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)

        def setblocking(self, blocks):
            assert not blocks

        def setsockopt(self, level, option, value):
            set_to[level, option] = value

        def bind(self, address):
            bound.append(address)

    monkeypatch.setattr(socket, "socket", Socket)
    # CAN_CTRLMODE_FD is 0x20 of linux/can/netlink.h
    kernel[1]["interface"] = CAN0._replace(mtu=72, data_bitrate_bit_s=5_000_000, modes=0x20)
    SocketCan(SETTINGS.model_copy(update={"layout": layout}))
    assert bound == [("can0",)]
    # linux/can.h and linux/can/raw.h: SOL_CAN_RAW, CAN_RAW_ERR_FILTER, CAN_ERR_MASK, CAN_RAW_FD_FRAMES
    assert set_to[101, 2] == 0x1FFFFFFF
    assert set_to.get((101, 5), 0) == (layout == "fd")
    assert set_to[socket.SOL_SOCKET, TIMESTAMP] == set_to[socket.SOL_SOCKET, LOST] == 1


@pytest.mark.parametrize(("kind", "virtual"), [("can", False), ("vcan", True), ("vxcan", True), ("", False)])
def test_an_interface_without_a_wire_is_told_from_others(monkeypatch, kind, virtual):
    monkeypatch.setattr(SocketCan, "_open", lambda _: (MadeSocket(), CAN0._replace(kind=kind)))
    assert SocketCan(SETTINGS).virtual == virtual


def test_losses_in_the_kernel_are_counted_once_and_over_the_wrap(made):
    can, sock = made
    for lost in (3, 3, 10, 0xFFFFFFFF, 1):
        sock.hears(0x80, lost=lost)
    got(can.receive())
    assert can.overflow == 0xFFFFFFFF + 2


def test_losses_are_told_once(made):
    can, sock = made
    bus = Bus([can])
    sock.hears(0x80, lost=3)
    got(bus.drain_now())
    assert bus.events().overflow == 3
    assert bus.events().overflow == 0
    sock.hears(0x80, lost=5)
    got(bus.drain_now())
    assert bus.events().overflow == 2


def test_a_controller_that_loses_frames_counts_with_the_kernel(made):
    can, sock = made
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x01, 0, 0, 0, 0, 0, 0]))
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x04, 0, 0, 0, 0, 0, 0]))
    got(can.receive())
    assert can.overflow == 1


def test_the_worst_state_lasts_until_it_was_asked_for(made):
    can, sock = made
    assert can.worst_state() is BusState.ACTIVE
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x20, 0, 0, 0, 0, 0, 0]))
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x40, 0, 0, 0, 0, 0, 0]))
    sock.hears(0x20000020)
    got(can.receive())
    assert can.worst_state() is BusState.PASSIVE
    assert can.worst_state() is BusState.ACTIVE


@pytest.mark.parametrize("back", [0x20000100, CONTROLLER_PROBLEM])
def test_bus_off_lasts_until_the_controller_says_that_it_is_back(made, back):
    can, sock = made
    sock.hears(BUS_OFF)
    # one that the controller had received before
    sock.hears(0x123, t_ns=time.time_ns() + SECOND)
    got(can.receive())
    assert can.off
    assert can.send(sent_array([FRAME])) == 0
    assert can.worst_state() is BusState.OFF
    sock.hears(back, bytes([0, 0x40, 0, 0, 0, 0, 0, 0]))
    got(can.receive())
    assert not can.off
    can.worst_state()
    assert can.worst_state() is BusState.ACTIVE


def test_a_virtual_interface_is_back_with_the_next_frame(made):
    can, sock = made
    can._interface = CAN0._replace(kind="vcan", has_controller=False)
    sock.hears(BUS_OFF)
    got(can.receive())
    assert can.off
    sock.hears(0x123)
    got(can.receive())
    assert not can.off
    assert can.worst_state() is BusState.OFF


def test_a_bus_that_was_off_between_two_looks_was_off(made):
    can, sock = made
    bus = Bus([can])
    sock.hears(BUS_OFF)
    sock.hears(0x20000100)
    got(bus.drain_now())
    assert bus.events() == (2, True, 0, BusState.OFF)
    assert bus.events() == (0, False, 0, BusState.ACTIVE)


def test_a_controller_that_was_restarted_unheard_is_used_again_at_the_next_try(made, kernel):
    can, sock = made
    sock.hears(BUS_OFF)
    got(can.receive())
    can.flush_tx()
    assert kernel[0] == []
    assert not can.off
    assert can.send(sent_array([FRAME])) == 1


def test_an_error_frame_without_a_state_leaves_bus_off_as_it_is(made):
    can, sock = made
    sock.hears(BUS_OFF)
    sock.hears(0x20000080)
    got(can.receive())
    assert can.off


def test_a_full_queue_is_a_busy_bus_until_it_has_not_been_empty_for_50_ms(made, clock):
    can, sock = made
    assert can.send(sent_array([FRAME] * 3)) == 3
    sock.waiting, sock.refuses = 900, errno.ENOBUFS
    for _ in range(6):
        assert can.send(sent_array([FRAME])) == 0
        clock.ns += 9_000_000
    assert not can.off
    sock.waiting, sock.refuses = 0, None
    assert can.send(sent_array([FRAME])) == 1
    sock.waiting = 900
    for _ in range(5):
        assert can.send(sent_array([FRAME])) == 1
        clock.ns += 10_000_000
    # it would take one more: that is what must not wait there
    assert can.send(sent_array([FRAME])) == 0
    assert can.off
    sock.waiting = 0
    assert can.send(sent_array([FRAME])) == 1
    assert not can.off


def test_a_machine_that_stood_still_has_not_seen_a_dead_bus(made, clock):
    can, sock = made
    sock.waiting = 900
    can.send(sent_array([FRAME]))
    clock.ns += SECOND
    assert not can.off
    assert can.send(sent_array([FRAME])) == 1
    assert not can.off


def test_a_frame_that_the_interface_cannot_carry_is_an_error(made):
    can, sock = made
    sock.refuses = errno.EMSGSIZE
    with pytest.raises(BusError, match="0x80"):
        can.send(sent_array([FRAME]))


def test_an_interface_that_was_down_is_used_again_once_it_is_up_as_configured(
    made, clock, kernel, monkeypatch
):
    can, sock = made
    _, state = kernel
    monkeypatch.setattr(SocketCan, "_open", lambda link: (sock, link._look()))
    sock.refuses = errno.ENETDOWN
    assert can.send(sent_array([FRAME])) == 0
    assert can.off
    sock.refuses = None
    for wrong in (CAN0._replace(up=False), CAN0._replace(bitrate_bit_s=1)):
        state["interface"] = wrong
        clock.ns += 100_000_000
        assert can.send(sent_array([FRAME])) == 0
    state["interface"] = CAN0
    # it is looked at ten times a second
    assert can.send(sent_array([FRAME])) == 0
    clock.ns += 100_000_000
    assert can.send(sent_array([FRAME])) == 1
    assert not can.off
    sock.answers.append(OSError(errno.ENETDOWN, "made"))
    assert got(can.receive()) == []
    assert can.off


def test_an_interface_that_was_deleted_is_looked_for_and_opened_again(made, clock, monkeypatch):
    can, sock = made
    sock.hears(0x123, lost=10)
    sock.answers.append(OSError(errno.ENODEV, "made"))
    got(can.receive())
    new = MadeSocket()

    def none(_):
        raise BusError("none")

    monkeypatch.setattr(SocketCan, "_open", none)
    assert can.send(sent_array([FRAME])) == 0
    assert can.off
    monkeypatch.setattr(SocketCan, "_open", lambda _: (new, CAN0))
    # ten times a second
    assert can.send(sent_array([FRAME])) == 0
    clock.ns += 100_000_000
    assert can.send(sent_array([FRAME])) == 1
    assert sock.closed
    assert new.sent == [pack(*FRAME)]
    assert not can.off
    new.hears(0x123, lost=2)
    got(can.receive())
    assert can.overflow == 12, "a new socket counts its losses from 0"


def starve(bus, sock, clock):
    sock.waiting = 900
    for _ in range(6):
        bus.send(sent_array([FRAME]))
        clock.ns += 10_000_000
    return bus.events().off


def test_what_waits_on_a_dead_bus_is_dropped_once_until_something_is_heard(made, clock, kernel):
    can, sock = made
    calls, _ = kernel
    bus = Bus([can])
    assert starve(bus, sock, clock)
    assert calls == [False, True]
    sock.waiting = 0
    bus.send(sent_array([FRAME]))
    assert not bus.events().off
    assert starve(bus, sock, clock)
    assert calls == [False, True]
    sock.waiting = 0
    sock.hears(0x181)
    got(bus.drain_now())
    bus.send(sent_array([FRAME]))
    assert not bus.events().off
    assert starve(bus, sock, clock)
    assert calls == [False, True] * 2


@pytest.mark.parametrize(("restart_ms", "dropped"), [(0, []), (100, [False, True])])
def test_a_controller_that_is_to_stay_bus_off_is_not_restarted_by_its_death(
    made, kernel, restart_ms, dropped
):
    can, sock = made
    can._interface = CAN0._replace(restart_ms=restart_ms)
    sock.hears(BUS_OFF)
    got(can.receive())
    assert can.off
    can.died()
    assert kernel[0] == dropped
    assert can.off == (not dropped), "one that was restarted is used"


def test_an_interface_that_was_taken_down_is_not_taken_up_by_its_death(made, kernel):
    can, sock = made
    sock.refuses = errno.ENETDOWN
    can.send(sent_array([FRAME]))
    can.died()
    assert kernel[0] == []


def test_frames_do_not_prove_that_an_interface_that_went_down_is_the_configured_one(made):
    can, sock = made
    sock.refuses = errno.ENETDOWN
    can.send(sent_array([FRAME]))
    sock.hears(0x123)
    assert [each.frame.id for each in got(can.receive())] == [0x123]
    assert can.off


@pytest.mark.parametrize("cause", ["queue", "bus-off"])
def test_a_new_try_drops_stale_frames_and_restarts_the_controller(made, kernel, cause):
    can, sock = made
    calls, state = kernel
    if cause == "queue":
        state["queued"] = 3
    else:
        sock.hears(BUS_OFF)
        got(can.receive())
        state["interface"] = CAN0._replace(state=BusState.OFF)
    can.flush_tx()
    assert calls == [False, True]
    assert not can.off


def test_an_empty_queue_is_left_alone(made, kernel):
    made[0].flush_tx()
    assert kernel[0] == []


def test_stale_frames_that_may_not_be_dropped_keep_the_bus_off(made, kernel):
    can, _ = made
    _, state = kernel
    state |= {"queued": 3, "forbidden": True}
    with pytest.raises(BusError, match=r"stale frames.*CAP_NET_ADMIN"):
        can.flush_tx()
    assert can.off
    state["queued"] = 0
    can.flush_tx()
    assert not can.off


def test_an_interface_with_another_bit_rate_by_now_keeps_the_bus_off(made, kernel):
    can, _ = made
    kernel[1]["interface"] = CAN0._replace(bitrate_bit_s=500_000)
    with pytest.raises(BusError, match="500000"):
        can.flush_tx()
    assert can.off


def test_error_frames_are_counted_with_the_worst_state_and_do_not_reach_the_loop(made):
    can, sock = made
    bus = Bus([can])
    sock.hears(CONTROLLER_PROBLEM, bytes([0, 0x10, 0, 0, 0, 0, 0, 0]))
    sock.hears(0x20000088)
    sock.hears(0x123)
    assert [r.frame.id for r in got(bus.drain_now())] == [0x123]
    assert bus.events() == (2, False, 0, BusState.PASSIVE)
    assert all(not r.frame.flags & ERROR for r in got(bus.drain_now()))
