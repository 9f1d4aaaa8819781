"""SocketCAN as a raw socket: frames with the kernel's time stamps, error frames, losses.

Layouts and constants are those of linux/can.h, linux/can/raw.h and linux/can/error.h.
"""

import errno
import select
import socket
import struct
import time
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from pathlib import Path

from drivers.clock import MONOTONIC
from drivers.errors import BusError
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame, Received

_CLASSIC = struct.Struct("=IB3x8s")
_FD = struct.Struct("=IBB2x64s")
_TIMESPEC = struct.Struct("=qq")
_EFF, _RTR, _ERR = 0x80000000, 0x40000000, 0x20000000
_SO_TIMESTAMPNS, _SO_RXQ_OVFL = 35, 40
_ERR_CRTL, _ERR_BUSOFF, _ERR_RESTARTED = 0x004, 0x040, 0x100
_CRTL_RX_OVERFLOW = 0x01
_IFF_UP = 1
_SOL_CAN_RAW, _RAW_ERR_FILTER, _RAW_FD_FRAMES, _ERR_MASK = 101, 2, 5, 0x1FFFFFFF
_FD_MTU = 72
_BATCH = 512
_RECEIVE_BUFFER = 1 << 20
_FLUSH_S = 0.05


class SocketCan:
    """A raw CAN socket.

    Mutable state: the socket, whether the bus is off and since when, and `overflow`, frames lost so far in
    the kernel or the controller.
    Raises BusError when the kernel has no CAN, or the channel does not exist, is down or cannot carry CAN FD.
    """

    clock = MONOTONIC

    def __init__(self, channel: str, *, fd: bool) -> None:
        self.overflow = 0
        self._down = False
        self._bus_off = False
        self._since_ns = 0
        self._kernel_lost = 0
        self.channel = channel
        try:
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except (OSError, AttributeError) as error:
            raise BusError(
                f"bus socketcan:{channel}: this kernel has no CAN sockets ({error}); load them with "
                "'modprobe can can_raw' where the kernel has them, or use bus.interface: localcan"
            ) from error
        try:
            self._set_up(fd)
        except BaseException:
            self._socket.close()
            raise

    def _set_up(self, fd: bool) -> None:
        sock, channel = self._socket, self.channel
        sock.setblocking(False)
        device = Path("/sys/class/net") / channel
        if not channel or "/" in channel or not device.exists():
            raise BusError(
                f"bus socketcan:{channel}: no such network interface; 'ip link' lists them, and "
                f"'ip link add {channel} type vcan' makes a virtual one (or use bus.interface: localcan)"
            )
        if not int((device / "flags").read_text(), 16) & _IFF_UP:
            raise BusError(f"bus socketcan:{channel} is down: 'ip link set {channel} up' (bit rates first)")
        if fd and int((device / "mtu").read_text()) < _FD_MTU:
            raise BusError(
                f"bus socketcan:{channel} carries classic CAN only: 'ip link set {channel} mtu 72' (vcan) or "
                f"'ip link set {channel} type can ... fd on', or use bus.layout: classic"
            )
        try:
            if fd:
                sock.setsockopt(_SOL_CAN_RAW, _RAW_FD_FRAMES, 1)
            sock.setsockopt(_SOL_CAN_RAW, _RAW_ERR_FILTER, _ERR_MASK)
            sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            # the kernel grants what net.core.rmem_max allows
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            sock.bind((channel,))
        except OSError as error:
            raise BusError(
                f"bus socketcan:{channel} does not open: {error.strerror}; is it a CAN interface?"
            ) from error

    @property
    def off(self) -> bool:
        """Whether the interface is down or the controller bus-off, until the contrary is seen."""
        return self._down or self._bus_off

    def send(self, frames: Sequence[Frame]) -> int:
        """Return how many frames the kernel took, from the first on."""
        for i, frame in enumerate(frames):
            try:
                self._socket.send(pack(frame))
            except OSError as error:
                if error.errno in {errno.EMSGSIZE, errno.EINVAL}:
                    raise BusError(
                        f"bus socketcan:{self.channel} cannot carry frame 0x{frame.id:X} "
                        f"({len(frame.data)} bytes): {error.strerror}; see bus.layout"
                    ) from error
                # no buffer: the bus is busy, or nobody acknowledges
                if error.errno in {errno.ENETDOWN, errno.ENXIO, errno.ENODEV}:
                    self._set_down()
                return i
            self._down = False
        return len(frames)

    def first_sent_ns(self) -> None:
        """Return None: nobody asks the kernel when a frame was on the wire."""
        return

    def fileno(self) -> int:
        """Return the socket's descriptor, readable when something has come."""
        return self._socket.fileno()

    def foresee(self) -> None:
        """Return None: what is under way is not known."""
        return

    def arm(self, *, idle: bool = True) -> bool:
        """Return True: the socket tells by itself."""
        del idle
        return True

    def _set_down(self) -> None:
        self._down = True
        self._since_ns = time.time_ns()

    def receive(self) -> list[Received]:
        """Return the frames that are there, error frames included."""
        received: list[Received] = []
        real_to_monotonic = time.monotonic_ns() - time.time_ns()
        for _ in range(_BATCH):
            try:
                raw, ancillary, _, _ = self._socket.recvmsg(_FD_MTU, 64)
            except BlockingIOError:
                break
            except OSError:
                self._set_down()
                break
            t_ns = time.time_ns()
            for _, kind, value in ancillary:
                if kind == _SO_TIMESTAMPNS:
                    seconds, nanoseconds = _TIMESPEC.unpack(value[:16])
                    t_ns = seconds * 1_000_000_000 + nanoseconds
                elif kind == _SO_RXQ_OVFL:
                    lost = int.from_bytes(value[:4], "little")
                    self.overflow += (lost - self._kernel_lost) & 0xFFFFFFFF
                    self._kernel_lost = lost
            frame = unpack(raw)
            if frame.flags & ERROR:
                self._note(frame, t_ns)
            elif self.off and t_ns > self._since_ns:
                # what arrives afterwards proves that the bus is back
                self._down = self._bus_off = False
            received.append(Received(t_ns + real_to_monotonic, frame))
        return received

    def _note(self, frame: Frame, t_ns: int) -> None:
        if frame.id & _ERR_BUSOFF:
            self._bus_off = True
            self._since_ns = t_ns
        elif frame.id & _ERR_RESTARTED:
            self._bus_off = False
        if frame.id & _ERR_CRTL and frame.data[1] & _CRTL_RX_OVERFLOW:
            self.overflow += 1

    def block(self, deadline_ns: int, _: AbstractSet[int]) -> None:
        """Sleep until something can be received, or the deadline."""
        seconds = max(0.0, (deadline_ns - time.monotonic_ns()) * 1e-9)
        select.select([self._socket], [], [], min(seconds, 1e-3) if self.off else seconds)

    def flush_tx(self) -> None:
        """Wait until the kernel takes frames again. What lies in its queue cannot be dropped from here.

        Raises BusError when it does not: the queue holds stale frames that would reach the drives later.
        """
        if not select.select([], [self._socket], [], _FLUSH_S)[1]:
            raise BusError(
                f"bus socketcan:{self.channel} has stale frames in its transmit queue and sends none; "
                f"clear it with 'ip link set {self.channel} down' and '... up'"
            )

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def pack(frame: Frame) -> bytes:
    """Return a Frame as struct can_frame or canfd_frame."""
    id_, data, flags = frame
    if len(data) > (64 if flags & FD else 8):
        raise BusError(f"bus: frame 0x{id_:X} has {len(data)} bytes; classic CAN carries 8, CAN FD 64")
    word = id_ | (_EFF if flags & EXTENDED else 0) | (_RTR if flags & REMOTE else 0)
    if flags & FD:
        return _FD.pack(word, len(data), (flags & BRS) >> 2 | (flags & ESI) >> 2, data)
    return _CLASSIC.pack(word, len(data), data)


def unpack(raw: bytes) -> Frame:
    """Return a struct can_frame or canfd_frame as a Frame; an error frame's identifier is its class bits."""
    if len(raw) == _FD.size:
        word, length, bits, data = _FD.unpack(raw)
        flags = FD | (bits & 3) << 2
    else:
        word, length, data = _CLASSIC.unpack(raw)
        flags = 0
    if word & _ERR:
        return Frame(word & 0x1FFFFFFF, data[:length], flags | ERROR)
    flags |= (EXTENDED if word & _EFF else 0) | (REMOTE if word & _RTR else 0)
    return Frame(word & (0x1FFFFFFF if word & _EFF else 0x7FF), data[:length], flags)
