"""Time stamps of a CAN controller's own clock, related to the kernel's.

Drivers start that clock with CLOCK_REALTIME, CLOCK_MONOTONIC or 0, and it runs freely: none has a PTP clock.
The frames that reach the kernel fastest show how the clocks differ, and so how long each other took.
Layouts and constants follow linux/ethtool.h, linux/sockios.h and linux/net_tstamp.h.
"""

import array
import socket
import struct
from contextlib import suppress

from drivers.config import BusSettings
from drivers.errors import BusError

HARDWARE_STAMPS, HARDWARE = "hardware_stamps", "hardware"
"""Option that uses them, and what then stamps received frames."""
SO_TIMESTAMPNS, SO_TIMESTAMPING, WANTED = 35, 37, 1 << 2 | 1 << 3 | 1 << 4 | 1 << 6
"""Socket options; SOF_TIMESTAMPING_RX_HARDWARE, RX_SOFTWARE, SOFTWARE and RAW_HARDWARE."""
_GIVEN = 1 << 2 | 1 << 6
_SIOCETHTOOL, _GET_TS_INFO, _INFO_WORDS = 0x8946, 0x41, 11
_REQUEST = struct.Struct("=16sQ16x")
_TIMES = struct.Struct("=qq")
"""struct timespec: seconds, nanoseconds. struct scm_timestamping has three: software, unused, hardware."""
_DRIFT = 1e-4
"""Largest difference of the rates of the two clocks."""
_LATEST_NS = 5_000_000
"""A frame that took longer than the fastest one by more than this starts the comparison again."""


def _wants(settings: BusSettings) -> bool:
    """True if the interface is to use hardware stamps. Raises BusError for a value that is no bool."""
    given = settings.options.get(HARDWARE_STAMPS, False)
    if not isinstance(given, bool):
        raise BusError(f"bus.options.{HARDWARE_STAMPS}: true or false is allowed, not {given!r}")
    return given


def stamped_by(settings: BusSettings) -> str:
    """What stamps the received frames: `hardware`, or `the kernel`, and why in spite of the option."""
    if not _wants(settings):
        return "the kernel"
    return HARDWARE if _gives(settings.channel) else "the kernel: the driver gives no others"


def by_arrival(settings: BusSettings) -> BusSettings:
    """Settings without hardware stamps: frames have the time at which the program could read them."""
    options = {key: value for key, value in settings.options.items() if key != HARDWARE_STAMPS}
    return settings.model_copy(update={"options": options})


def _gives(channel: str) -> bool:
    """True if the driver of an interface reports that it stamps received frames in hardware."""
    import fcntl  # noqa: PLC0415 - not on Windows

    info = array.array("I", [_GET_TS_INFO] + [0] * (_INFO_WORDS - 1))
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, _SIOCETHTOOL, _REQUEST.pack(channel.encode(), info.buffer_info()[0]))
    return info[1] & _GIVEN == _GIVEN


def stamps_of(ancillary: list[tuple[int, int, bytes]]) -> tuple[int, int]:
    """Time stamps of the kernel and of the hardware in the ancillary data of a message, ns; 0 without one.

    The kernel's is of CLOCK_REALTIME.
    """
    for _, kind, value in ancillary:
        if kind in {SO_TIMESTAMPNS, SO_TIMESTAMPING}:
            times = [
                seconds * 1_000_000_000 + nanoseconds
                for seconds, nanoseconds in _TIMES.iter_unpack(value[: len(value) & -_TIMES.size])
            ]
            return times[0], times[-1] if kind == SO_TIMESTAMPING else 0
    return 0, 0


class ControllerClock:
    """Clock of a CAN controller. Mutable state: the last stamp, and its least difference to an arrival."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._least_ns = 0.0

    def forget(self) -> None:
        """Compare anew, after the controller was started again."""
        self._last_ns = None

    def taken_ns(self, arrival_ns: int, stamp_ns: int) -> int:
        """Instant of a frame with a hardware stamp, by the clock of its arrival; 0 is no stamp."""
        if not stamp_ns:
            return arrival_ns
        took_ns = arrival_ns - stamp_ns
        if self._last_ns is not None:
            least_ns = self._least_ns + _DRIFT * max(0, stamp_ns - self._last_ns)
            if least_ns < took_ns <= least_ns + _LATEST_NS:
                self._last_ns, self._least_ns = stamp_ns, least_ns
                return stamp_ns + round(least_ns)
        self._last_ns, self._least_ns = stamp_ns, float(took_ns)
        return arrival_ns
