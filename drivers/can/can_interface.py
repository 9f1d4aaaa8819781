"""Settings and state of a CAN network interface as the kernel reports them, compared with the configuration.

Read by netlink: IFLA_LINKINFO of linux/if_link.h, and within it IFLA_CAN_* of linux/can/netlink.h. Error
frames follow linux/can/error.h: classes in the identifier, details in eight data bytes.
"""

import struct
from typing import NamedTuple

from drivers.can.netlink import IFF_UP, attributes, split_link
from drivers.config import BusSettings
from drivers.signals import BusState

_IFLA_MTU, _IFLA_LINKINFO = 4, 18
_INFO_KIND, _INFO_DATA = 1, 2
_BITTIMING, _STATE, _CTRLMODE, _RESTART_MS, _BERR_COUNTER, _DATA_BITTIMING = 1, 4, 5, 6, 8, 9
_LOOPBACK, _LISTEN_ONLY, _FD = 0x01, 0x02, 0x20
_UNKNOWN_RATES = (0, 0xFFFFFFFF)
"""CAN_BITRATE_UNSET, CAN_BITRATE_UNKNOWN: the bit rate was not set through the kernel."""
_STATES = (BusState.ACTIVE, BusState.WARNING, BusState.PASSIVE, BusState.OFF)
"""enum can_state; the later values, stopped and sleeping, mean that the controller is down."""
FD_MTU = 72
_CONTROLLER, _BUS_OFF, _RESTARTED = 0x004, 0x040, 0x100
"""Classes of error frames: state or overflow of the controller, in byte 1; bus-off; restarted."""
_OVERFLOW, _WARNS, _PASSIVE, _ACTIVE = 0x01, 0x0C, 0x30, 0x40
"""Bits of byte 1, for reception and transmission: overflow, warning, error passive; back to error active."""
RESTART_MS = "restart_ms"
"""Option with the required restart-ms."""


class CanInterface(NamedTuple):
    """One network interface, with the settings and the state of its CAN controller."""

    name: str
    number: int
    """Index in the kernel, ifindex."""
    up: bool
    mtu: int
    kind: str
    """can, vcan or vxcan; empty if the kernel reports none."""
    has_controller: bool = False
    """False for a virtual interface; the fields below then keep their defaults."""
    bitrate_bit_s: int | None = None
    """Arbitration bit rate; None if the kernel does not know it."""
    data_bitrate_bit_s: int | None = None
    """Data bit rate of CAN FD; None if CAN FD is off or the rate is unknown."""
    state: BusState = BusState.UNKNOWN
    """UNKNOWN also while the controller is down."""
    restart_ms: int = 0
    """Delay of the automatic restart after bus-off, ms; 0: no automatic restart."""
    modes: int = 0
    """CAN_CTRLMODE_* bits."""
    errors: tuple[int, int] | None = None
    """Transmit and receive error counters, if the driver reports them."""

    @property
    def facts(self) -> str:
        """Bit rates, options and state of the interface, as one line of text for the log and the terminal."""
        if not self.has_controller:
            return (
                f"{self.name} is {self.kind or 'of unknown kind'}: it has no bit rate, no controller state "
                "and no restart-ms, so nothing was compared with the configuration"
            )
        rate = "unknown bit rate" if self.bitrate_bit_s is None else f"{self.bitrate_bit_s} bit/s"
        fast = "" if self.data_bitrate_bit_s is None else f", data {self.data_bitrate_bit_s} bit/s"
        tx_rx = self.errors
        errors = "" if tx_rx is None else f", error counters {tx_rx[0]} (tx) and {tx_rx[1]} (rx)"
        return f"{self.name}: {rate}{fast}, state {self.state.name}, restart-ms {self.restart_ms}{errors}"


def parse(name: str, answer: bytes) -> CanInterface:
    """CanInterface from an RTM_NEWLINK payload; name: of the interface."""
    index, flags, link = split_link(answer)
    info = attributes(link.get(_IFLA_LINKINFO, b""))
    kind = info.get(_INFO_KIND, b"").rstrip(b"\0").decode(errors="replace")
    data = attributes(info.get(_INFO_DATA, b""))
    found = CanInterface(name, index, bool(flags & IFF_UP), _word(link.get(_IFLA_MTU)), kind)
    if _STATE not in data:
        return found
    state, errors = _word(data[_STATE]), data.get(_BERR_COUNTER, b"")
    return found._replace(
        has_controller=True,
        bitrate_bit_s=_rate(data.get(_BITTIMING)),
        data_bitrate_bit_s=_rate(data.get(_DATA_BITTIMING)),
        state=_STATES[state] if state < len(_STATES) else BusState.UNKNOWN,
        restart_ms=_word(data.get(_RESTART_MS)),
        modes=_word(data.get(_CTRLMODE, b"")[4:]),
        errors=struct.unpack_from("=HH", errors) if len(errors) >= 4 else None,
    )


def _word(raw: bytes | None) -> int:
    return int(struct.unpack_from("=I", raw)[0]) if raw and len(raw) >= 4 else 0


def _rate(timing: bytes | None) -> int | None:
    rate = _word(timing)
    return None if rate in _UNKNOWN_RATES else rate


def read_error(identifier: int, data: bytes) -> tuple[BusState, bool]:
    """(controller state in an error frame, UNKNOWN without one; True if a received frame was lost)."""
    detail = data[1] if identifier & _CONTROLLER and len(data) > 1 else 0
    state = BusState.UNKNOWN
    if identifier & _BUS_OFF:
        state = BusState.OFF
    elif detail & _PASSIVE:
        state = BusState.PASSIVE
    elif detail & _WARNS:
        state = BusState.WARNING
    elif detail & _ACTIVE or identifier & _RESTARTED:
        state = BusState.ACTIVE
    return state, bool(detail & _OVERFLOW)


def refusal(found: CanInterface, settings: BusSettings) -> str:
    """Text that lists where an interface differs from the section `bus`; empty if both agree.

    A bit rate unknown to the kernel and a restart-ms that is not configured are not compared.
    """
    name, fd = found.name, settings.layout == "fd"
    if not found.up:
        return f"is down: 'ip link set {name} up' (bit rates first)"
    if fd and (found.mtu < FD_MTU or (found.has_controller and not found.modes & _FD)):
        return (
            f"carries classic CAN only: 'ip link set {name} mtu 72' (vcan) or "
            f"'ip link set {name} type can ... fd on', or use bus.layout: classic"
        )
    asked = settings.options.get(RESTART_MS)
    if not found.has_controller:
        why = f"has no restart-ms, but bus.options.{RESTART_MS} is {asked}: remove that option"
        return "" if asked is None else why
    rows = [
        ("bitrate", found.bitrate_bit_s, "bus.bitrate_bit_s", settings.bitrate_bit_s),
        *[("dbitrate", found.data_bitrate_bit_s, "bus.data_bitrate_bit_s", settings.data_bitrate_bit_s)] * fd,
        *[("restart-ms", found.restart_ms, f"bus.options.{RESTART_MS}", asked)] * (asked is not None),
    ]
    wrong = [
        f"has {what} {has}, but {key} is {wants}"
        for what, has, key, wants in rows
        if has not in (None, wants)
    ]
    if found.modes & _LISTEN_ONLY:
        wrong.append("only receives (listen-only on)")
    if found.modes & _LOOPBACK:
        wrong.append("sends only to itself (loopback on)")
    if wrong:
        given = " ".join(f"{what} {wants}" for what, _, _, wants in rows)
        fix = f"ip link set {name} type can {given} listen-only off loopback off"
        return f"{'; '.join(wrong)}: 'ip link set {name} down', '{fix}' and '... up', or change bus.*"
    if found.state is BusState.OFF:
        return f"is bus-off: find the cause, then 'ip link set {name} type can restart', or down and up"
    return ""
