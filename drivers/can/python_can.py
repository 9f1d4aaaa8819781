"""python-can interfaces in general: all that have no module of their own in this package."""

import select
import struct
import time
from collections.abc import Set as AbstractSet
from contextlib import suppress
from typing import Any, Literal

import can
import numpy as np

from drivers.arrays import Rows
from drivers.can.link import Link
from drivers.can.messages import from_message, to_message
from drivers.clock import MONOTONIC
from drivers.config import BusSettings
from drivers.errors import BusError
from drivers.frame_array import FRAME, RECEIVED, frame_bytes, unpack_frames

_BATCH = 512
"""Most polls of one `receive`, which so ends even if frames keep arriving."""
_FAILURES = 8
"""Consecutive failed polls after which the interface counts as gone. A single failure is a lost frame."""
_UNREADABLE = (can.CanError, OSError, ValueError, IndexError, KeyError, TypeError, struct.error)
"""Exceptions of `recv` if the interface is gone, has lost frames or has read an invalid frame."""


class PythonCan(Link):
    """A bus opened by python-can; interface: its name in python-can.

    Mutable state: the bus, `off`, consecutive failures, received frames, frames lost, and the times at which
    the last frames were accepted.
    """

    clock = MONOTONIC
    off = False

    def __init__(self, bus: can.BusABC, interface: str = "") -> None:
        self._failures = 0
        self.virtual = interface == "udp_multicast"
        self._bus = bus
        self._held = bytearray()
        self._taken_ns = []
        try:
            self._selectable = bus.fileno() >= 0
        except (NotImplementedError, can.CanError, OSError):
            self._selectable = False

    def send(self, frames: Rows) -> int:
        """Send FRAME records until the interface refuses one; the result is how many were accepted."""
        self._taken_ns.clear()
        for frame in unpack_frames(frames.tobytes()):
            try:
                self._bus.send(to_message(frame), timeout=0)
            except ValueError as error:
                raise BusError(f"bus: frame 0x{frame[1]:X} cannot be sent: {error}") from error
            except (can.CanError, OSError):
                return len(self._taken_ns)
            self._taken_ns.append(time.monotonic_ns())
        self.off = False
        self._failures = 0
        return len(frames)

    def fileno(self) -> int:
        """Descriptor of the interface, readable when a frame has arrived; -1: no descriptor."""
        if not self._selectable:
            return -1
        try:
            return self._bus.fileno()
        except (can.CanError, OSError):
            self.off = True
            return -1

    def _take(self, timeout_s: float) -> Literal["frame", "nothing", "failure"]:
        """Receive one message into the inbox; an echo of an own frame counts as a frame but is not kept."""
        try:
            message = self._bus.recv(timeout_s)
        except _UNREADABLE as error:
            self.overflow += not self.off
            self._failures += 1
            self.off = self.off or self._failures >= _FAILURES
            line = getattr(self._bus, "_buffer", None)
            if isinstance(error.__cause__, UnicodeDecodeError) and isinstance(line, bytearray):
                line.clear()  # slcan keeps a line that it cannot decode, and adds to it
            return "failure"
        self._failures = 0
        if message is None:
            return "nothing"
        if not message.is_rx:
            return "frame"
        # not its own stamp: the clock of an adapter drifts, and lags by more than a drive takes to answer
        t_ns = time.monotonic_ns()
        identifier, data, flags = from_message(message)
        self._held += frame_bytes(t_ns, identifier, RECEIVED, len(data), flags, data)
        return "frame"

    def _readable(self, seconds: float) -> bool:
        file = self.fileno()
        if file < 0:
            return False
        try:
            return bool(select.select([file], [], [], seconds)[0])
        except (OSError, ValueError):
            self.off = True
            return False

    def receive(self) -> Rows:
        """Frames received, FRAME records, at most one batch.

        After an invalid line or datagram the interface returns no frame, although more may wait: the loop
        goes by the interface's descriptor.
        """
        for _ in range(_BATCH):
            found = self._take(0.0)
            if (found == "failure" and self.off) or (found == "nothing" and not self._readable(0.0)):
                break
        received, self._held = self._held, bytearray()
        return np.frombuffer(received, FRAME)

    def block(self, deadline_ns: int, _: AbstractSet[int]) -> None:
        """Sleep until a frame can be received, at most until `deadline_ns`."""
        seconds = max(0.0, (deadline_ns - time.monotonic_ns()) * 1e-9)
        if self.off:
            time.sleep(min(seconds, 1e-3))
        elif self._selectable:
            self._readable(seconds)
        else:
            self._take(seconds)

    def flush_tx(self) -> None:
        """Drop frames that wait to be sent, if the interface can. Raises BusError if it fails."""
        try:
            self._bus.flush_tx_buffer()
        except NotImplementedError:
            return
        except Exception as error:  # each interface raises its own
            raise BusError(f"bus: waiting frames cannot be dropped: {error}") from error

    def close(self) -> None:
        """Close the python-can bus; errors of an interface that no longer exists are ignored."""
        with suppress(Exception):
            self._bus.shutdown()


def unknown_interface(name: str) -> str:
    """Error text with the known interfaces if `name` is not a python-can interface; else empty."""
    if name in can.VALID_INTERFACES:
        return ""
    known = ", ".join(sorted(can.VALID_INTERFACES - {"virtual"}))
    return f"bus.interface: {name} is unknown, allowed: {known}; localcan needs no hardware"


def open_python_can(settings: BusSettings) -> PythonCan:
    """Open the python-can interface `bus.interface`. Raises BusError if it is unknown or does not open."""
    fd = settings.layout == "fd"
    options: dict[str, Any] = {"fd": True} if fd else {}
    if settings.interface != "udp_multicast":
        options["bitrate"] = settings.bitrate_bit_s
        if fd:
            options["data_bitrate"] = settings.data_bitrate_bit_s
    elif settings.options.get("hop_limit", 0) == 0:
        options["hop_limit"] = 0
    else:
        raise BusError(
            "bus.options.hop_limit: must be 0 (or left out); with more, every frame goes out to the "
            "local network, where others can read and send drive commands"
        )
    options |= settings.options
    if unknown := unknown_interface(settings.interface):
        raise BusError(unknown)
    try:
        bus = can.Bus(settings.channel, settings.interface, ignore_config=True, **options)
    except Exception as error:
        raise BusError(
            f"bus {settings.interface}:{settings.channel} does not open: {error}; "
            "check bus.channel and bus.options, or use bus.interface: localcan, which needs no hardware"
        ) from error
    return PythonCan(bus, settings.interface)
