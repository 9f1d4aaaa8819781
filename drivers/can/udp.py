"""Poses of motion capture by UDP, as frames of a bus of their own: one datagram, one frame.

The kernel receives datagrams and stamps their arrival. The loop takes those that are there, at most BATCH a
look, and never waits for one. A datagram of another length, or from another address than the configured one,
becomes a frame without data: the codec refuses and counts it, and it is in the log.
"""

import ipaddress
import select
import socket
import time
from collections.abc import Set as AbstractSet

import numpy as np

from drivers.arrays import Rows
from drivers.can.hardware_stamps import SO_TIMESTAMPNS, stamps_of
from drivers.can.link import Link
from drivers.clock import MONOTONIC
from drivers.config import DATAGRAM_BYTES, POSE_ID, UDP, BusSettings
from drivers.errors import BusError
from drivers.frame_array import FRAME, RECEIVED, frame_bytes, unpack_frames
from drivers.protocol import FD

BATCH = 8
"""Most datagrams of one look; further ones stay in the kernel, whose buffer drops what does not fit."""


class Udp(Link):
    """A socket for datagrams: bound to the configured address for the controller, a sender for the plant.

    `clock`: that of the other buses. Mutable state: the socket.
    """

    knows_ends = True  # of the frames it sends: none

    def __init__(self, settings: BusSettings, role: str) -> None:
        """Raises BusError for an invalid address, or one that this machine does not have."""
        self.clock = MONOTONIC
        self._taken_ns = []
        self._address, self._source = addresses(settings)
        here = self._address if role == "controller" else (self._source, 0)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
            self._socket.bind(here)
        except OSError as error:
            self._socket.close()
            raise BusError(
                f"bus {UDP}:{here[0]}:{here[1]} does not open: {error.strerror}; an address of this machine "
                "('ip address' lists them) and a port that no program uses are needed"
            ) from error

    def send(self, frames: Rows) -> int:
        """Send the data of each frame as a datagram; one that the kernel refuses is lost, as on a network."""
        for _, _, _, size, _, data in unpack_frames(frames.tobytes()):
            try:
                self._socket.sendto(data[:size], self._address)
            except OSError:
                self.overflow += 1
        self._taken_ns = [self.clock.now()] * len(frames)
        return len(frames)

    def fileno(self) -> int:
        """Descriptor of the socket, readable when a datagram has arrived."""
        return self._socket.fileno()

    def receive(self) -> Rows:
        """Datagrams that have arrived since the last call, as FRAME records, at most BATCH."""
        received = bytearray()
        for _ in range(BATCH):
            try:
                data, ancillary, _, (host, _) = self._socket.recvmsg(DATAGRAM_BYTES + 1, 64)
            except OSError:
                break
            now_ns = time.time_ns()
            waited_ns = max(0, now_ns - (stamps_of(ancillary)[0] or now_ns))
            fits = len(data) == DATAGRAM_BYTES and host == self._source
            data = data if fits else b""
            t_ns = self.clock.now() - waited_ns
            received += frame_bytes(t_ns, POSE_ID, RECEIVED, len(data), FD, data)
        return np.frombuffer(received, FRAME)

    def block(self, deadline_ns: int, _: AbstractSet[int]) -> None:
        """Sleep until a datagram can be received, at most until `deadline_ns`."""
        seconds = max(0.0, (deadline_ns - self.clock.now()) * 1e-9)
        select.select([self._socket], [], [], seconds)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def addresses(settings: BusSettings) -> tuple[tuple[str, int], str]:
    """(host, port) to bind, and the address that may send. Raises BusError for anything else."""
    host, _, port = settings.channel.rpartition(":")
    source = settings.options.get("source", "")
    try:
        here, there = ipaddress.IPv4Address(host), ipaddress.IPv4Address(str(source))
        fits = not (here.is_unspecified or there.is_unspecified) and 0 < int(port) < 1 << 16
    except ValueError:
        fits = False
    if not fits or set(settings.options) != {"source"}:
        raise BusError(
            f"bus {UDP}: allowed: channel ADDRESS:PORT of this machine and options {{source: ADDRESS}} of "
            f"the sender, IPv4; given: channel {settings.channel}, options {settings.options}"
        )
    return (str(here), int(port)), str(there)
