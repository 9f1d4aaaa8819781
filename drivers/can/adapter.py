"""A CAN adapter as the kernel describes it: driver and hardware, echo of sent frames, time stamps.

Layouts and constants follow linux/net_tstamp.h and linux/if.h; sysfs paths follow its ABI documents.
"""

import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers.can import netlink
from drivers.can.can_interface import parse
from drivers.config import BusSettings

IFF_ECHO = 1 << 18
"""Flag of an interface whose driver returns a sent frame when the wire has taken it."""
_SO_TIMESTAMPING = 37
_WANTED = 1 << 2 | 1 << 3 | 1 << 4 | 1 << 6
"""SOF_TIMESTAMPING_RX_HARDWARE, RX_SOFTWARE, SOFTWARE and RAW_HARDWARE."""
_THREE = struct.Struct("=6q")
"""struct scm_timestamping: software, unused, hardware; each is seconds and nanoseconds."""


def identity(bus: BusSettings, root: Path = Path("/")) -> str:
    """Driver and hardware of an interface, such as `gs_usb 1d50 606f 0042`; what python-can drives: its name.

    root: folder of the `sys` tree. A virtual interface has its kind.
    """
    if bus.interface != "socketcan":
        return bus.interface
    device = root / "sys/class/net" / bus.channel / "device"
    if not device.exists():
        with suppress(OSError):
            return parse(bus.channel, netlink.get_link(bus.channel)).kind or "unknown driver"
        return "missing"
    folder = device.resolve()
    usb = [_text(folder.parent / name) for name in ("idVendor", "idProduct", "serial")]
    words = usb if any(usb) else [_text(folder / "modalias")]
    return " ".join(filter(None, [(device / "driver").resolve().name, *words]))


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def echoes(bus: BusSettings) -> bool:
    """True if a sent frame that comes back to this machine has been on the wire."""
    if bus.interface != "socketcan":
        return True
    flags = Path(f"/sys/class/net/{bus.channel}/flags").read_text()
    return bool(int(flags, 16) & IFF_ECHO)


def time_stamps(channel: str, send: Callable[[], object]) -> list[str]:
    """Time stamps of the kernel, `software`, `hardware`, for a frame that `send` sends to a channel."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as raw, suppress(OSError):
        raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPING, _WANTED)
        raw.settimeout(0.1)
        raw.bind((channel,))
        send()
        for _, kind, value in raw.recvmsg(16, 256)[1]:
            if kind == _SO_TIMESTAMPING:
                words = _THREE.unpack(value[: _THREE.size])
                pairs = (("software", words[:2]), ("hardware", words[4:]))
                return [name for name, pair in pairs if any(pair)]
    return []
