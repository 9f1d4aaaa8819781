"""A CAN network interface as the kernel has it, and whether it is the one that the configuration means.

Read by netlink: IFLA_LINKINFO of linux/if_link.h, and within it IFLA_CAN_* of linux/can/netlink.h. Its error
frames are those of linux/can/error.h: classes in the identifier, more of each in eight bytes.
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
"""CAN_BITRATE_UNSET, CAN_BITRATE_UNKNOWN: the adapter was set up past the kernel."""
_STATES = (BusState.ACTIVE, BusState.WARNING, BusState.PASSIVE, BusState.OFF)
"""enum can_state; what comes after, stopped and sleeping, is a controller that is down."""
FD_MTU = 72
_CONTROLLER, _BUS_OFF, _RESTARTED = 0x004, 0x040, 0x100
"""Classes of error frames: a state or an overflow, in byte 1; gone off; back again."""
_OVERFLOW, _WARNS, _PASSIVE, _ACTIVE = 0x01, 0x0C, 0x30, 0x40
"""Bits of byte 1: of reception and of transmission, and the return to error active."""
RESTART_MS = "restart_ms"
"""The option that says what restart-ms has to be."""


class CanInterface(NamedTuple):
    """One network interface, and what its CAN controller is set to and how it fares."""

    name: str
    number: int
    """The kernel's, ifindex."""
    up: bool
    mtu: int
    kind: str
    """can, vcan, vxcan; empty where the kernel says none."""
    has_controller: bool = False
    """A virtual interface has none, and nothing of what follows."""
    bitrate_bit_s: int | None = None
    """None where the kernel does not know it."""
    data_bitrate_bit_s: int | None = None
    """Of CAN FD; None where it is off or not known."""
    state: BusState = BusState.UNKNOWN
    """UNKNOWN while the controller is down, too."""
    restart_ms: int = 0
    """It comes back by itself so long after bus-off; 0: it does not."""
    modes: int = 0
    """CAN_CTRLMODE_* bits."""
    errors: tuple[int, int] | None = None
    """Transmit and receive error counters, where it tells them."""

    @property
    def facts(self) -> str:
        """What was read, in one line."""
        if not self.has_controller:
            return (
                f"{self.name} is {self.kind or 'of no known kind'}: it has no bit rate, no controller state "
                "and no restart-ms, so nothing was compared"
            )
        rate = "unknown bit rate" if self.bitrate_bit_s is None else f"{self.bitrate_bit_s} bit/s"
        fast = "" if self.data_bitrate_bit_s is None else f", data {self.data_bitrate_bit_s} bit/s"
        tx_rx = self.errors
        errors = "" if tx_rx is None else f", error counters {tx_rx[0]} (tx) and {tx_rx[1]} (rx)"
        return f"{self.name}: {rate}{fast}, state {self.state.name}, restart-ms {self.restart_ms}{errors}"


def parse(name: str, answer: bytes) -> CanInterface:
    """Return the interface of an RTM_NEWLINK payload."""
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
    """Return the first member of struct can_bittiming."""
    rate = _word(timing)
    return None if rate in _UNKNOWN_RATES else rate


def read_error(identifier: int, data: bytes) -> tuple[BusState, bool]:
    """Return the state that an error frame reports, UNKNOWN without one, and whether a frame was lost."""
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
    """Say how an interface differs from the section `bus`; empty where it does not.

    What neither the kernel knows nor the configuration asks for is not compared.
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
        if asked is None:
            return ""
        return f"has no restart-ms, bus.options.{RESTART_MS} is {asked}: leave that option out"
    rates = [
        ("bitrate", "bus.bitrate_bit_s", found.bitrate_bit_s, settings.bitrate_bit_s),
        ("dbitrate", "bus.data_bitrate_bit_s", found.data_bitrate_bit_s, settings.data_bitrate_bit_s),
    ][: 1 + fd]
    wrong = [
        f"runs at {word} {has}, {key} is {wants}"
        for word, key, has, wants in rates
        if has not in (None, wants)
    ]
    if asked is not None and asked != found.restart_ms:
        wrong.append(f"has restart-ms {found.restart_ms}, bus.options.{RESTART_MS} is {asked}")
    if found.modes & _LISTEN_ONLY:
        wrong.append("only listens (listen-only on)")
    if found.modes & _LOOPBACK:
        wrong.append("sends to itself alone (loopback on)")
    if wrong:
        word = " ".join(f"{word} {wants}" for word, _, _, wants in rates)
        again = "" if asked is None else f" restart-ms {asked}"
        mend = f"ip link set {name} type can {word}{again} listen-only off loopback off"
        return (
            f"{'; '.join(wrong)}: 'ip link set {name} down', '{mend}' and '... up', or mend the configuration"
        )
    if found.state is BusState.OFF:
        return f"is bus-off: find out why, then 'ip link set {name} type can restart', or down and up"
    return ""
