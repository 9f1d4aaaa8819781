"""CAN interfaces, queues and an adapter for the tests, by netlink: without iproute2 and can-utils.

Layouts are those of linux/if_link.h, linux/can/vxcan.h, linux/can/netlink.h and linux/pkt_sched.h.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import pty
import socket
import struct
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

from drivers.can import netlink
from tests.vcan.guest import IFLA_IFNAME, IFLA_INFO_KIND, IFLA_LINKINFO, IFLA_TXQLEN, attribute

CREATE, REPLACE = 0x400, 0x100
RTM_DELLINK, RTM_NEWQDISC = 17, 36
INFO_DATA, VXCAN_PEER, CAN_BITTIMING = 2, 1, 1
TCA_KIND, TCA_OPTIONS, TCA_STATS2, TCA_STATS_QUEUE = 1, 2, 7, 3
PLUG, RELEASE = 0, 2
N_SLCAN, SIOCGIFNAME = 17, 0x8910
FRAME = struct.Struct("=IB3x8s")
SO_TIMESTAMPNS, SO_RCVBUFFORCE = 35, 33
PSCHED_TICK_S = 64e-9
"""Unit of time of queues, net/pkt_sched.h."""


def _link(flags: int, index: int, attributes: bytes, kind: int = netlink.RTM_NEWLINK) -> None:
    netlink.request(kind, flags, struct.pack("=BxHiII", 0, 0, index, 0, 0) + attributes)


def _info(kind: str, data: bytes = b"") -> bytes:
    nest = attribute(INFO_DATA, data) if data else b""
    return attribute(IFLA_LINKINFO, attribute(IFLA_INFO_KIND, kind.encode()) + nest)


def up(name: str, *, on: bool = True) -> None:
    netlink.set_up(socket.if_nametoindex(name), up=on)


def make_pair(near: str, far: str) -> None:
    """Make two CAN interfaces, the two ends of one wire, and bring them up."""
    peer = attribute(VXCAN_PEER, bytes(16) + attribute(IFLA_IFNAME, far.encode() + b"\0"))
    _link(CREATE, 0, attribute(IFLA_IFNAME, near.encode() + b"\0") + _info("vxcan", peer))
    for name in (near, far):
        up(name)
    # until then the kernel drops sent frames silently
    wait_until(lambda: all(_operates(name) for name in (near, far)))


def _operates(name: str) -> bool:
    return Path(f"/sys/class/net/{name}/operstate").read_text() == "up\n"


def delete(name: str) -> None:
    _link(0, socket.if_nametoindex(name), b"", RTM_DELLINK)


@contextlib.contextmanager
def pair(near: str, far: str) -> Iterator[None]:
    make_pair(near, far)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            delete(near)


def queue(name: str, kind: str, options: bytes, flags: int = CREATE | REPLACE) -> None:
    """Give an interface a queue of that kind, or change its queue (flags 0)."""
    head = struct.pack("=BxxxiIII", 0, socket.if_nametoindex(name), 0, netlink.TC_H_ROOT, 0)
    body = attribute(TCA_KIND, kind.encode() + b"\0") + attribute(TCA_OPTIONS, options)
    netlink.request(RTM_NEWQDISC, flags, head + body)


def plug(name: str, frames: int) -> None:
    """Block an interface, like a bus without acknowledgement, with room for `frames` classic frames."""
    queue(name, "plug", struct.pack("=iI", PLUG, 16 * frames))


def unplug(name: str) -> None:
    queue(name, "plug", struct.pack("=iI", RELEASE, 0), 0)


def lose(name: str, share: float, delay_s: float = 0.0, jitter_s: float = 0.0) -> None:
    """Make the kernel drop a share of the sent frames at random, and delay them by delay +- jitter, s."""
    delay, jitter = (round(each / PSCHED_TICK_S) for each in (delay_s, jitter_s))
    queue(name, "netem", struct.pack("=6I", delay, 1000, round(share * 0xFFFFFFFF), 0, 0, jitter))


def corrupt(name: str, share: float) -> None:
    """Make the kernel flip one bit, anywhere in struct can_frame, in a share of the sent frames."""
    options = struct.pack("=6I", 0, 1000, 0, 0, 0, 0)
    queue(name, "netem", options + attribute(4, struct.pack("=II", round(share * 0xFFFFFFFF), 0)))


def dropped(name: str) -> int:
    """Number of frames dropped by the queue of an interface."""
    index = socket.if_nametoindex(name)
    for answer in netlink.request(netlink.RTM_GETQDISC, netlink.NLM_F_DUMP, bytes(20)):
        (of,) = struct.unpack_from("=i", answer, 4)
        if of == index:
            statistics = netlink.attributes(netlink.attributes(answer[20:])[TCA_STATS2])[TCA_STATS_QUEUE]
            return int(struct.unpack_from("=3I", statistics)[2])
    return 0


def sent(name: str) -> int:
    """Number of frames that an interface has sent."""
    return int(Path(f"/sys/class/net/{name}/statistics/tx_packets").read_text())


def raw_socket(name: str, *, fd: bool = False) -> socket.socket:
    """A raw socket of the kernel, independent of our bus code."""
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    if fd:
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    sock.settimeout(0.2)
    sock.bind((name,))
    return sock


def heard(sock: socket.socket, patience_s: float = 0.1) -> list[bytes]:
    """Frames that a socket receives until it is quiet for a while."""
    sock.settimeout(patience_s)
    found = []
    with contextlib.suppress(TimeoutError):
        while True:
            found.append(sock.recv(72))
    return found


class Watched:
    """Two raw sockets that note, by the kernel's time stamps, when frames leave one end and reach the other.

    An interface without echo hands a frame to the sockets of its own end before its queue.
    """

    def __init__(self, near: str, far: str) -> None:
        self.ends = [raw_socket(name) for name in (near, far)]
        for sock in self.ends:
            sock.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 24)
            sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            sock.setblocking(False)

    def delays_us(self, count: int) -> list[float]:
        """Delays of the first frames, as long as they go one by one; lost frames are left out."""
        left, came = (self._stamps(sock) for sock in self.ends)
        found = []
        for (identifier, begun), (_, following) in itertools.pairwise(left[:count]):
            found += [t - begun for each, t in came if each == identifier and begun <= t < following][:1]
        return found

    def _stamps(self, sock: socket.socket) -> list[tuple[int, float]]:
        found = []
        sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)  # its interface was down meanwhile
        with contextlib.suppress(BlockingIOError), sock:
            while True:
                raw, ancillary, _, _ = sock.recvmsg(16, 64)
                seconds, nanoseconds = struct.unpack("=qq", ancillary[0][2])
                identifier = int.from_bytes(raw[:4], sys.byteorder)
                found.append((identifier, 1e6 * seconds + 1e-3 * nanoseconds))
        return found


class Adapter:
    """A serial CAN adapter played by the test, with the kernel's slcan as its driver.

    To the kernel it is a real CAN device, with bit rate, state and error counters.
    """

    def __init__(self, bitrate: int, txqueuelen: int = 10) -> None:
        self.master, self.slave = pty.openpty()
        for end in (self.master, self.slave):
            tty.setraw(end)
        fcntl.ioctl(self.slave, termios.TIOCSETD, struct.pack("i", N_SLCAN))
        self.name = fcntl.ioctl(self.slave, SIOCGIFNAME, bytes(16)).rstrip(b"\0").decode()
        timing = attribute(CAN_BITTIMING, struct.pack("=8I", bitrate, *[0] * 7))
        length = attribute(IFLA_TXQLEN, struct.pack("=I", txqueuelen))
        self.lines: list[bytes] = []
        """Lines that the kernel sent to the adapter."""
        self._stop = False
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        _link(0, socket.if_nametoindex(self.name), length + _info("can", timing))
        up(self.name)

    def _read(self) -> None:
        rest = b""
        while not self._stop:
            try:
                rest += os.read(self.master, 4096)
            except OSError:
                return
            *lines, rest = rest.split(b"\r")
            self.lines += lines
            for line in lines:
                self.sent(line)

    def sent(self, line: bytes) -> None:
        """Handle one line from the kernel, such as `t1232AABB`; overridden by a bridge."""

    def says(self, line: bytes) -> None:
        """Send a line to the kernel: a frame, `sb256256` for bus-off, `e1c` for a CRC error."""
        os.write(self.master, line + b"\r")

    def close(self) -> None:
        self._stop = True
        os.close(self.slave)
        os.close(self.master)


def wait_until(condition: Callable[[], bool], limit_s: float = 2.0) -> None:
    """Wait for a condition. Raises AssertionError at the time limit."""
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, "not within the time limit"
        time.sleep(0.002)
