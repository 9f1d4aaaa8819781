"""Computes the bus time of a configuration's frames, and checks that the frames of a tick fit."""

from collections import Counter
from collections.abc import Iterable
from math import floor
from pathlib import Path
from typing import NamedTuple, Self

from drivers import build_protocol
from drivers.can.bus_time import BitTiming, frame_bits, frame_time_ns
from drivers.can.udp import addresses
from drivers.config import UDP, BusSettings, DriveSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.family import Family
from drivers.protocol import EXTENDED, FD, DriveSetup, Frame
from drivers.sensing.settings import SensorSettings
from drivers.sensors import SensorProtocol
from drivers.signals import LEGS, DriveState

_SET_UP_BYTES = 8
"""Bytes of a set-up frame in every family: CONFIG, an SDO, a parameter."""


class BusBudget(NamedTuple):
    """Bus time of the frames of one tick, and the load that it makes at the loop's rate."""

    frames: Counter[tuple[int, int]]
    """Number of frames by data length and flags, as in `Frame`."""
    timing: BitTiming
    rate_Hz: float
    max_load_percent: float
    total_ns: int
    """Bus time of all frames of one tick."""

    @property
    def load_percent(self) -> float:
        """Share of the tick's period that the frames take, %."""
        return self.total_ns * 1e-9 * self.rate_Hz * 100.0

    @property
    def highest_rate_Hz(self) -> float:
        """Loop rate, Hz, at which the frames fill the bus."""
        return 1e9 / self.total_ns if self.total_ns else float("inf")

    @property
    def allowed_rate_Hz(self) -> float:
        """Loop rate, Hz, at which the frames reach the allowed bus load."""
        return self.highest_rate_Hz * self.max_load_percent / 100.0

    def table(self) -> str:
        """The computation of the bus time as text, one line per length and kind of frame."""
        lines = []
        for (length, flags), count in self.frames.items():
            slow, fast = frame_bits(length, flags)
            ns = frame_time_ns(length, flags, self.timing)
            kind = "CAN FD" if flags & FD else "classic"
            fast_bits = f" + {fast} fast bit" if fast else ""
            lines.append(
                f"  {count:3d} x {kind:7s} {length:2d} byte: {slow} bit{fast_bits} = "
                f"{ns / 1e3:.1f} us each, {count * ns / 1e3:.1f} us"
            )
        lines.append(
            f"  total {self.total_ns / 1e3:.1f} us of a {1e6 / self.rate_Hz:.1f} us period = "
            f"{self.load_percent:.1f} % at {self.rate_Hz:g} Hz (allowed {self.max_load_percent:g} %)"
        )
        return "\n".join(lines)

    def require(self, where: str = "bus", *, either_layout: bool = False, sensors: str = "") -> Self:
        """Check that the frames fit, and return the budget itself.

        where: key of the bus. either_layout: the drives support CAN FD and classic frames. sensors: what
        would fit of them. Raises ConfigurationError with the arithmetic if the frames do not fit.
        """
        if self.load_percent <= self.max_load_percent * (1 + 1e-12):
            return self
        data_phase, instead = "", ", or use bus.layout: fd" if either_layout else ""
        if any(flags & FD for _, flags in self.frames):
            instead, data_phase = "", f" (data phase {self.timing.data_bitrate / 1e6:g} Mbit/s)"
        raise ConfigurationError(
            f"{where}: the frames of one tick do not fit at {self.timing.bitrate / 1e6:g} Mbit/s"
            f"{data_phase}, worst-case stuffing:\n{self.table()}\n"
            f"  these frames fit up to {self.allowed_rate_Hz:.0f} Hz ({self.highest_rate_Hz:.0f} Hz fill "
            "the bus): lower loop.rate_Hz, raise the bit rates, or spread the legs over several buses "
            f"(bus.channels){instead}{sensors}"
        )


def budget(
    frames: Iterable[Frame], timing: BitTiming, rate_Hz: float, max_load_percent: float = 70.0
) -> BusBudget:
    """Worst-case bus time of one tick's frames on their bus.

    frames: one example of every frame sent in a tick, repeated as often as it is sent. Raises BusError for a
    frame that cannot be on the bus.
    """
    shapes = Counter((len(frame.data), frame.flags) for frame in frames)
    total_ns = sum(count * frame_time_ns(*shape, timing) for shape, count in shapes.items())
    return BusBudget(shapes, timing, rate_Hz, max_load_percent, total_ns)


def bus_budgets(
    bus: BusSettings,
    drives: DriveSettings,
    sensors: SensorSettings,
    rate_Hz: float,
    folder: Path | None = None,
) -> tuple[BusBudget, ...]:
    """Bus time of the fullest tick at `rate_Hz`, bus by bus; empty for layout ideal.

    folder: of the configuration, at which relative paths start. Raises ConfigurationError: a bus load above
    `max_load_percent` (with the computation), settings that the protocol does not have, sensors for which
    layout or protocol have no room, or a bus of nobody.
    """
    nodes = SensorProtocol(bus, sensors, folder)
    protocol = build_protocol(bus, drives)
    try:
        protocol.controller_end(DriveSetup(1e-3 * drives.watchdog_ms, protocol.traits.reactions[0], rate_Hz))
    except ProtocolError as error:
        raise ConfigurationError(str(error)) from error
    measured = nodes.syncs(protocol) + nodes.cyclic_frames(rate_Hz)
    nodes.refuse_clashes(protocol)
    for index, legs in enumerate(bus.legs):
        if not legs and index not in {each.bus for each in nodes.sensors.values()}:
            raise ConfigurationError(f"bus.channels[{index}]: a bus needs legs or a sensor, given: neither")
        if legs and bus.buses[index].interface == UDP:
            raise ConfigurationError(f"bus: interface {UDP} carries a tracker, allowed there: no legs")
        if bus.buses[index].interface == UDP:
            addresses(bus.buses[index])
    if bus.layout == "ideal":
        return ()
    frames = protocol.traits.cyclic_frames + heartbeats(protocol, 1e-3 * drives.heartbeat_ms, rate_Hz)
    frames += timed_feedbacks(protocol, rate_Hz) + protocol.traits.echoes
    found = []
    for index, each in enumerate(bus.buses):
        of = -1 if each.interface == UDP else index  # no CAN, no bus time
        own, seen = ([frame for frame in some if frame.bus == of] for some in (frames, measured))
        where = f"bus.channels[{index}]" if bus.channels else "bus"
        given = BitTiming.of(each), rate_Hz, each.max_load_percent
        without, alone = budget(own, *given), budget(seen, *given)
        remedy = _remedy(without, alone) if seen else ""
        taken = budget([*own, *seen], *given)
        found.append(taken.require(where, either_layout=drives.protocol == "legs", sensors=remedy))
    return tuple(found)


def _remedy(without: BusBudget, alone: BusBudget) -> str:
    """What would fit of the sensors on a bus, in words; empty if the bus is too full without them."""
    if without.load_percent > without.max_load_percent:
        return ""
    left = without.max_load_percent - without.load_percent
    text = (
        f"; without the sensors it is {without.load_percent:.1f} %, they take {alone.load_percent:.1f} %: "
        f"{left:.1f} % would fit, by fewer sensors or a lower sensors.*.rate_Hz"
    )
    if without.total_ns and alone.load_percent <= alone.max_load_percent:
        text += "; all of them fit on a bus of their own, an entry of bus.channels without legs"
    return text


def heartbeats(protocol: Family, heartbeat_s: float, rate_Hz: float) -> tuple[Frame, ...]:
    """One example of each heartbeat frame of a tick in which some drive sends one: the six drives take turns.

    Rarer heartbeats use the free part of the bus, as does the set-up of the drives: see `set_up_ns`.
    """
    from plant_fmu.drives import drives_end  # noqa: PLC0415 - as above

    found: list[Frame] = []
    for turn in range(floor(LEGS / (heartbeat_s * rate_Hz) * (1 + 1e-9))):
        end, leg = drives_end(protocol), turn % LEGS
        end.announce(leg, DriveState.OFF)  # some families report their start once
        found += end.announce(leg, DriveState.OFF)
    return tuple(found)


def timed_feedbacks(protocol: Family, rate_Hz: float) -> tuple[Frame, ...]:
    """One example of every timer-driven feedback frame that occurs in every tick, on its drive's bus.

    Of drives without a poll, those that exceed one a tick, as `Traits.cyclic_frames` has that one.
    """
    if protocol.traits.unasked_s <= 0.0:
        return ()
    readings = protocol.traits.feedbacks
    found: list[Frame] = []
    for bus in {each.bus for each in readings}:
        own = [each for each in readings if each.bus == bus]
        turns = floor(len(own) / (protocol.traits.unasked_s * rate_Hz) * (1 + 1e-9))
        turns -= len(own) * protocol.traits.timed
        found += [own[turn % len(own)] for turn in range(turns)]
    return tuple(found)


def set_up_ns(bus: BusSettings, protocol: Family) -> tuple[int, ...]:
    """Bus time, ns, of the drives' set-up in one tick, bus by bus, as if each bus carried all of it.

    As many frames as the protocol sends in a tick, of up to 8 bytes, and an answer to each. They are sent
    only in modes WAITING and FAULT; frames that do not fit wait for the next tick.
    """
    extended = max((frame.flags & EXTENDED for frame in protocol.traits.cyclic_frames), default=0)
    return tuple(
        2 * protocol.traits.set_up_frames * frame_time_ns(_SET_UP_BYTES, extended, BitTiming.of(each))
        for each in bus.buses
    )


def shortest_answer_ns(bus: BusSettings, protocol: Family) -> int:
    """Shortest time, ns, from the end of SYNC or a poll to the end of its feedback on the same bus."""
    return min(
        frame_time_ns(len(frame.data), frame.flags, BitTiming.of(bus.buses[frame.bus]), least=True)
        for frame in protocol.traits.feedbacks
    )


def bus_names(bus: BusSettings) -> tuple[str, ...]:
    """Channel of each bus as text, with its legs if there are several buses."""
    if not bus.channels:
        return (bus.channel,)
    return tuple(
        f"{each.channel} ({f'legs {numbers}' if (numbers := ', '.join(map(str, legs))) else 'sensors'})"
        for each, legs in zip(bus.buses, bus.legs, strict=True)
    )


def loads(
    bus: BusSettings,
    drives: DriveSettings,
    sensors: SensorSettings,
    rate_Hz: float,
    folder: Path | None = None,
) -> dict[str, object]:
    """Bus load, %, for a summary: the largest, and for several buses also the load of each channel."""
    found = bus_budgets(bus, drives, sensors, rate_Hz, folder)
    most = max((each.load_percent for each in found), default=None)
    if len(found) < 2:
        return {"bus_load_percent": most}
    by_channel = {each.channel: own.load_percent for each, own in zip(bus.buses, found, strict=True)}
    return {"bus_load_percent": most, "bus_load_percent_by_channel": by_channel}
