"""SocketCAN through a raw socket: kernel time stamps, error frames, lost frames, removal of stale frames.

Layouts and constants follow linux/can.h, linux/can/raw.h and asm-generic/socket.h.
"""

import errno
import select
import socket
import struct
import sys
import time
from collections.abc import Set as AbstractSet
from contextlib import suppress

import numpy as np

from drivers.arrays import Rows
from drivers.can import hardware_stamps, netlink
from drivers.can.can_interface import FD_MTU, CanInterface, parse, read_error, refusal
from drivers.can.link import Link
from drivers.clock import MONOTONIC
from drivers.config import BusSettings
from drivers.errors import BusError
from drivers.frame_array import FRAME, RECEIVED, frame_bytes, unpack_frames
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE
from drivers.signals import BusState

_CLASSIC = struct.Struct("=IB3x8s")
_FD = struct.Struct("=IBB2x64s")
_EFF, _RTR, _ERR = 0x80000000, 0x40000000, 0x20000000
_SO_RXQ_OVFL, _SO_MEMINFO = 40, 55
_WMEM = struct.Struct("=8xI")
"""Start of SO_MEMINFO, up to SK_MEMINFO_WMEM_ALLOC."""
_SOL_CAN_RAW, _RAW_ERR_FILTER, _RAW_FD_FRAMES, _ERR_MASK = 101, 2, 5, 0x1FFFFFFF
_DOWN = frozenset({errno.ENETDOWN, errno.ENXIO, errno.ENODEV})
"""Errors of an interface that is down or gone."""
_BATCH, _ANCILLARY = 512, 128
"""Frames of one look; bytes of the ancillary data of one."""
_RECEIVE_BUFFER = 1 << 20
_FLUSH_S = 0.05
STUCK_NS = 50_000_000
"""A bus is dead if it has not emptied our transmit queue for this long, ..."""
STUCK_LOOKS = 5
"""... over at least this many checks: after a stall of the machine there are fewer."""
_NO_WIRE = ("vcan", "vxcan")
"""Kinds of interfaces without a wire."""
_CLOCK_LOOKS, _CLOSE_NS = 5, 10_000
"""Most readings of both clocks, and the time between them that is close enough."""
_LOOK_NS = 100_000_000
"""Interval of the checks whether an interface is back."""


class SocketCan(Link):
    """A raw CAN socket.

    Mutable state: the socket; `overflow` (frames lost so far in the kernel or the controller); whether the
    interface is down or missing, could not be cleared, or differs from the configuration; whether the
    controller is bus-off, and its worst state since the last query; since when own frames wait; the times at
    which the kernel accepted the last frames; the controller's clock. Raises BusError if the kernel has no
    CAN, or the channel is missing, down, or differs from the section `bus`.
    """

    clock = MONOTONIC

    def __init__(self, settings: BusSettings) -> None:
        self.channel = settings.channel
        self._settings = settings
        self._down = self._refused = self._bus_off = self._stuck = self._dropped = False
        self._kernel_lost = self._looked_ns = self._waited = self._waiting_since = 0
        self._taken_ns = []
        self._clock = hardware_stamps.ControllerClock()
        self._stamped_by = hardware_stamps.stamped_by(settings)
        self._socket, self._interface = self._open()
        self._state = self._worst = self._interface.state
        self.virtual = self._interface.kind in _NO_WIRE

    @property
    def facts(self) -> str:
        """Bit rates, options and state of the interface, one line of text."""
        stale = "; without CAP_NET_ADMIN frames that wait on a dead bus stay in its queue"
        return (
            f"bus socketcan:{self._interface.facts}; time stamps of {self._stamped_by}"
            f"{'' if netlink.administers() else stale}"
        )

    def _open(self) -> tuple[socket.socket, CanInterface]:
        channel = self.channel
        try:
            sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except (AttributeError, OSError) as error:
            raise BusError(
                f"bus socketcan:{channel}: this kernel has no CAN sockets ({error}); load them with "
                "'modprobe can can_raw' where the kernel has them, or use bus.interface: localcan"
            ) from error
        try:
            sock.setblocking(False)
            interface = self._look()
            if self._settings.layout == "fd":
                sock.setsockopt(_SOL_CAN_RAW, _RAW_FD_FRAMES, 1)
            sock.setsockopt(_SOL_CAN_RAW, _RAW_ERR_FILTER, _ERR_MASK)
            # the kernel grants what net.core.rmem_max allows
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            stamps = (
                (hardware_stamps.SO_TIMESTAMPING, hardware_stamps.WANTED)
                if self._stamped_by == hardware_stamps.HARDWARE
                else (hardware_stamps.SO_TIMESTAMPNS, 1)
            )
            for option, value in (stamps, (_SO_RXQ_OVFL, 1)):
                sock.setsockopt(socket.SOL_SOCKET, option, value)
            sock.bind((channel,))
            self._clock.forget()
        except BaseException as error:
            sock.close()
            if not isinstance(error, OSError):
                raise
            raise BusError(
                f"bus socketcan:{channel} does not open: {error.strerror}; is it a CAN interface?"
            ) from error
        return sock, interface

    def _look(self) -> CanInterface:
        channel = self.channel
        try:
            interface = parse(channel, netlink.get_link(channel))
        except (OSError, ValueError) as error:
            raise BusError(
                f"bus socketcan:{channel}: no such network interface; 'ip link' lists them, and "
                f"'ip link add {channel} type vcan' makes a virtual one (or use bus.interface: localcan)"
            ) from error
        why = refusal(interface, self._settings)
        if why:
            raise BusError(f"bus socketcan:{channel} {why}")
        return interface

    @property
    def off(self) -> bool:
        """True while the interface is down, bus-off or not as configured, or own frames wait too long.

        Each condition lasts until its end is observed.
        """
        return self._down or self._refused or self._bus_off or self._stuck

    def worst_state(self) -> BusState:
        """Worst state of the CAN controller since the last call, from error frames."""
        worst, self._worst = self._worst, self._state
        return worst

    def _look_at_queue(self) -> None:
        (waiting,) = _WMEM.unpack(self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _WMEM.size))
        if not waiting:
            self._waited = 0
            self._stuck = False
            return
        now = time.monotonic_ns()
        if not self._waited:
            self._waiting_since = now
        self._waited += 1
        self._stuck = self._waited >= STUCK_LOOKS and now - self._waiting_since >= STUCK_NS

    def send(self, frames: Rows) -> int:
        """Send FRAME records; the result is how many the kernel accepted, from the first on.

        It is 0 while the bus is off or older frames have waited for STUCK_NS: a dead bus would send them
        later, when it is back.
        """
        self._taken_ns.clear()
        self._look_at_queue()
        if self._refused or self._bus_off or self._stuck or (self._down and not self._is_back()):
            return 0
        for _, identifier, _, size, flags, data in unpack_frames(frames.tobytes()):
            try:
                self._socket.send(pack(identifier, data[:size], flags))
            except OSError as error:
                if error.errno in {errno.EMSGSIZE, errno.EINVAL}:
                    raise BusError(
                        f"bus socketcan:{self.channel} cannot carry frame 0x{identifier:X} "
                        f"({size} bytes): {error.strerror}; see bus.layout"
                    ) from error
                # no buffer: the bus is busy, or nobody acknowledges
                self._down = error.errno in _DOWN
                break
            self._taken_ns.append(time.monotonic_ns())
        return len(self._taken_ns)

    def fileno(self) -> int:
        """Descriptor of the raw socket, readable when a frame has arrived."""
        return self._socket.fileno()

    def _is_back(self) -> bool:
        now = time.monotonic_ns()
        if now - self._looked_ns >= _LOOK_NS:
            self._looked_ns = now
            with suppress(BusError):
                self._come_back()
        return not self._down

    def _come_back(self) -> None:
        if self._down:
            sock, self._interface = self._open()
            self._socket.close()
            self._socket = sock
            self._waited = self._kernel_lost = 0
        else:
            self._interface = self._look()
        self._down = self._bus_off = False
        self._state = self._interface.state

    def receive(self) -> Rows:
        """Frames received since the last call, FRAME records, error frames included."""
        received = bytearray()
        real_to_monotonic = _real_to_monotonic()
        for _ in range(_BATCH):
            try:
                raw, ancillary, _, _ = self._socket.recvmsg(FD_MTU, _ANCILLARY)
            except BlockingIOError:
                break
            except OSError:
                self._down = True
                break
            arrived_ns, stamp_ns = hardware_stamps.stamps_of(ancillary)
            t_ns = self._clock.taken_ns((arrived_ns or time.time_ns()) + real_to_monotonic, stamp_ns)
            for _, kind, value in ancillary:
                if kind == _SO_RXQ_OVFL:
                    lost = int.from_bytes(value[:4], sys.byteorder)
                    self.overflow += (lost - self._kernel_lost) & 0xFFFFFFFF
                    self._kernel_lost = lost
            identifier, data, flags = unpack(raw)
            if flags & ERROR:
                self._note(identifier, data)
            else:
                self._dropped = False
                if self._bus_off and not self._interface.has_controller:
                    # a virtual interface never says that it was restarted
                    self._bus_off, self._state = False, BusState.UNKNOWN
            received += frame_bytes(t_ns, identifier, RECEIVED, len(data), flags, data)
        return np.frombuffer(received, FRAME)

    def _note(self, identifier: int, data: bytes) -> None:
        state, lost = read_error(identifier, data)
        self.overflow += lost
        if state is not BusState.UNKNOWN:
            self._clock.forget()
            self._state, self._worst = state, max(self._worst, state)
            self._bus_off = state is BusState.OFF

    def block(self, deadline_ns: int, _: AbstractSet[int]) -> None:
        """Sleep until a frame can be received, at most until `deadline_ns`."""
        seconds = max(0.0, (deadline_ns - time.monotonic_ns()) * 1e-9)
        select.select([self._socket], [], [], min(seconds, 1e-3) if self.off else seconds)

    def died(self) -> None:
        """Drop frames that wait to be sent, if permitted; not again until a frame has been received.

        A controller that is to stay bus-off is left alone: its driver drops the frames at the restart.
        """
        stays_off = self._bus_off and self._interface.has_controller and not self._interface.restart_ms
        if self._dropped or self._down or stays_off:
            return
        self._dropped = True
        with suppress(OSError):
            self._drop()

    def _drop(self) -> None:
        """Take the interface down and up, which drops the frames in its queue and in the controller."""
        netlink.set_up(self._interface.number, up=False)
        netlink.set_up(self._interface.number, up=True)
        self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        self._bus_off = False
        self._clock.forget()
        self._look_at_queue()

    def flush_tx(self) -> None:
        """Drop stale frames, restart a bus-off controller, and compare the interface with the section `bus`.

        Stale frames have waited longer than 50 ms, whoever sent them. The interface is taken down and up.
        Raises BusError if that needs CAP_NET_ADMIN and this process lacks it, or if the interface is gone or
        differs: the bus then counts as off.
        """
        self._refused = True
        try:
            if not self._down and self._to_drop():
                self._drop()
        except OSError as error:
            raise BusError(
                f"bus socketcan:{self.channel} is gone, bus-off, or has stale frames in its transmit queue: "
                f"{error.strerror}; clear it with 'ip link set {self.channel} down' and '... up', or give "
                "this program CAP_NET_ADMIN"
            ) from error
        self._come_back()
        self._refused = False

    def _to_drop(self) -> bool:
        self._interface = parse(self.channel, netlink.get_link(self.channel))
        if self._interface.state is BusState.OFF:
            return True
        end = time.monotonic() + _FLUSH_S
        while netlink.queued(self._interface.number):
            if time.monotonic() >= end:
                return True
            time.sleep(_FLUSH_S / 10)
        return False

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _real_to_monotonic() -> int:
    """CLOCK_MONOTONIC minus CLOCK_REALTIME (the kernel's time stamps), ns, from two close readings.

    A stall between the readings would shift all time stamps.
    """
    for _ in range(_CLOCK_LOOKS):
        before, real, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if after - before < _CLOSE_NS:
            break
    return (before + after) // 2 - real


def pack(identifier: int, data: bytes, flags: int) -> bytes:
    """Frame as struct can_frame or canfd_frame. Raises BusError for too many bytes."""
    size = len(data)
    if size > (64 if flags & FD else 8):
        raise BusError(f"bus: frame 0x{identifier:X} has {size} bytes; classic CAN carries 8, CAN FD 64")
    word = identifier | (_EFF if flags & EXTENDED else 0) | (_RTR if flags & REMOTE else 0)
    if flags & FD:
        return _FD.pack(word, size, (flags & BRS) >> 2 | (flags & ESI) >> 2, data)
    return _CLASSIC.pack(word, size, data)


def unpack(raw: bytes) -> tuple[int, bytes, int]:
    """Identifier (of an error frame its classes), data and flags of struct can_frame or canfd_frame."""
    if len(raw) == _FD.size:
        word, length, bits, data = _FD.unpack(raw)
        flags = FD | (bits & 3) << 2
    else:
        word, length, data = _CLASSIC.unpack(raw)
        flags = 0
    if word & _ERR:
        return word & 0x1FFFFFFF, data[:length], flags | ERROR
    flags |= (EXTENDED if word & _EFF else 0) | (REMOTE if word & _RTR else 0)
    return word & (0x1FFFFFFF if word & _EFF else 0x7FF), data[:length], flags
