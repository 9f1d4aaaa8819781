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

HARDWARE_STAMPS, HARDWARE = "hardware_stamps", "hardware"
"""Option that uses them, and what then stamps received frames."""
SO_TIMESTAMPNS, SO_TIMESTAMPING, WANTED = 35, 37, 1 << 2 | 1 << 3 | 1 << 4 | 1 << 6
"""Socket options; SOF_TIMESTAMPING_RX_HARDWARE, RX_SOFTWARE, SOFTWARE and RAW_HARDWARE."""
_GIVEN, _SIOCETHTOOL, _GET_TS_INFO, _INFO_WORDS = 1 << 2 | 1 << 6, 0x8946, 0x41, 11
_REQUEST, _TIMES = struct.Struct("=16sQ16x"), struct.Struct("=qq")
"""struct ifreq; struct timespec, of which scm_timestamping has three: software, unused, hardware."""
_DRIFT, _LATEST_NS, _NEVER_NS = 10_000, 5_000_000, 1 << 62
"""1 / largest difference of the clocks' rates; time by which a frame may take longer than the fastest,
else the comparison starts again; a difference before any.
"""


def stamped_by(settings: BusSettings) -> str:
    """What stamps the received frames: `hardware`, or `the kernel`, and why in spite of the option."""
    if not settings.options.get(HARDWARE_STAMPS, False):
        return "the kernel"
    import fcntl  # noqa: PLC0415 - not on Windows

    info = array.array("I", [_GET_TS_INFO] + [0] * (_INFO_WORDS - 1))
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        request = _REQUEST.pack(settings.channel.encode(), info.buffer_info()[0])
        fcntl.ioctl(some, _SIOCETHTOOL, request)
    return HARDWARE if info[1] & _GIVEN == _GIVEN else "the kernel: the driver gives no others"


def stamps_of(ancillary: list[tuple[int, int, bytes]]) -> tuple[int, int]:
    """Time stamps of the kernel (CLOCK_REALTIME) and of the hardware in a message, ns; 0 without one."""
    for _, kind, value in ancillary:
        if kind in {SO_TIMESTAMPNS, SO_TIMESTAMPING}:
            whole = value[: len(value) & -_TIMES.size]
            times = [seconds * 1_000_000_000 + ns for seconds, ns in _TIMES.iter_unpack(whole)]
            return times[0], times[-1] if kind == SO_TIMESTAMPING else 0
    return 0, 0


class ControllerClock:
    """Clock of a CAN controller. Mutable state: the last stamp, and its least difference to an arrival."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin to compare the two clocks from the start, as after a restart of the controller."""
        self._last_ns, self._least_ns = 0, _NEVER_NS

    def taken_ns(self, arrival_ns: int, stamp_ns: int) -> int:
        """Instant of a frame with a hardware stamp, by the clock of its arrival; 0 is no stamp."""
        if not stamp_ns:
            return arrival_ns
        took_ns = arrival_ns - stamp_ns
        least_ns = self._least_ns + max(0, stamp_ns - self._last_ns) // _DRIFT
        if not least_ns < took_ns <= least_ns + _LATEST_NS:
            least_ns = took_ns
        self._last_ns, self._least_ns = stamp_ns, least_ns
        return stamp_ns + least_ns
