"""A CAN adapter as the kernel describes it: driver and hardware, echo of sent frames, time stamps.

Constants follow linux/if.h; sysfs paths follow its ABI documents.
"""

import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from drivers.can import netlink
from drivers.can.can_interface import parse
from drivers.can.hardware_stamps import SO_TIMESTAMPING, WANTED, stamps_of
from drivers.config import BusSettings

IFF_ECHO = 1 << 18
"""Flag of an interface whose driver returns a sent frame when the wire has taken it."""


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
        raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPING, WANTED)
        raw.settimeout(0.1)
        raw.bind((channel,))
        send()
        stamps = zip(("software", "hardware"), stamps_of(raw.recvmsg(16, 256)[1]), strict=True)
        return [name for name, ns in stamps if ns]
    return []
