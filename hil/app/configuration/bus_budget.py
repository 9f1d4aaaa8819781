"""The bus time that a configuration's frames take."""

from math import floor

from drivers import build_protocol
from drivers.can.bus_time import BitTiming, BusBudget, check, frame_time_ns
from drivers.config import BusSettings, DriveSettings, SensorSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.protocol import EXTENDED, DriveProtocol, DriveSetup, Frame
from drivers.sensors import SensorProtocol
from drivers.signals import LEGS, DriveFault, DriveState
from plant_fmu.messages import Status

_SET_UP_BYTES = 8
"""Of a frame that sets up, in every family: CONFIG, an SDO, a parameter."""


def bus_budgets(
    bus: BusSettings, drives: DriveSettings, sensors: SensorSettings, rate_Hz: float
) -> tuple[BusBudget, ...]:
    """Return the bus time of the fullest tick at `rate_Hz`, bus by bus; none for layout ideal.

    Raises ConfigurationError with the arithmetic of a bus on which it is more than `max_load_percent`, for
    settings that the protocol does not have, and for sensors where layout or protocol have no room for them.
    """
    from drivers.controller_end import controller_end  # noqa: PLC0415 - compiled code: not for all that read a configuration

    nodes = SensorProtocol(bus, sensors)
    protocol = build_protocol(bus, drives)
    try:
        controller_end(protocol, DriveSetup(1e-3 * drives.watchdog_ms, protocol.traits.reactions[0], rate_Hz))
    except ProtocolError as error:
        raise ConfigurationError(f"drives.watchdog_ms: {error}") from error
    frames = protocol.traits.cyclic_frames
    if nodes.kinds and all(frame.id != nodes.sync_id for frame in frames):
        raise ConfigurationError(
            f"drives.protocol: {drives.protocol} sends no SYNC that sensors can stamp their samples against"
        )
    if bus.layout == "ideal":
        return ()
    frames += nodes.cyclic_frames(rate_Hz) + heartbeats(protocol, 1e-3 * drives.heartbeat_ms, rate_Hz)
    frames += unasked_readings(protocol, rate_Hz)
    return tuple(
        check(
            [frame for frame in frames if frame.bus == index],
            BitTiming.of(each),
            rate_Hz,
            each.max_load_percent,
            f"bus.channels[{index}]" if bus.channels else "bus",
            either_layout=drives.protocol == "legs",
        )
        for index, each in enumerate(bus.buses)
    )


def heartbeats(protocol: DriveProtocol, heartbeat_s: float, rate_Hz: float) -> tuple[Frame, ...]:
    """Return one example of every heartbeat that no tick is without, as the six drives take turns.

    Rarer ones are left to the free part of the bus, as is what sets the drives up: see `set_up_ns`.
    """
    from plant_fmu.drives import drives_end  # noqa: PLC0415 - as above

    found: list[Frame] = []
    for turn in range(floor(LEGS / (heartbeat_s * rate_Hz) * (1 + 1e-9))):
        status = Status(turn % LEGS, DriveState.OFF, DriveFault.NONE)
        end = drives_end(protocol)
        end.announce(status)  # some say once that they have started
        found += end.announce(status)
    return tuple(found)


def unasked_readings(protocol: DriveProtocol, rate_Hz: float) -> tuple[Frame, ...]:
    """Return one example of every reading by a timer that no tick is without, on the bus of each drive."""
    if protocol.traits.unasked_s <= 0.0:
        return ()
    readings = protocol.traits.feedbacks
    found: list[Frame] = []
    for bus in {each.bus for each in readings}:
        own = [each for each in readings if each.bus == bus]
        turns = floor(len(own) / (protocol.traits.unasked_s * rate_Hz) * (1 + 1e-9))
        found += [own[turn % len(own)] for turn in range(turns)]
    return tuple(found)


def set_up_ns(bus: BusSettings, protocol: DriveProtocol) -> tuple[int, ...]:
    """Return the bus time, ns, of what sets the drives up in one tick, bus by bus, as if it were all there.

    As many frames as the protocol sends in a tick, of up to 8 bytes, and an answer to each. They go out in
    modes WAITING and FAULT alone: what does not fit waits for the next tick.
    """
    extended = max((frame.flags & EXTENDED for frame in protocol.traits.cyclic_frames), default=0)
    return tuple(
        2 * protocol.traits.set_up_frames * frame_time_ns(_SET_UP_BYTES, extended, BitTiming.of(each))
        for each in bus.buses
    )


def bus_budget(
    bus: BusSettings, drives: DriveSettings, sensors: SensorSettings, rate_Hz: float
) -> BusBudget | None:
    """Return the budget of the fullest bus, see `bus_budgets`; None for layout ideal, which takes no time."""
    found = bus_budgets(bus, drives, sensors, rate_Hz)
    return max(found, key=lambda each: each.load_percent) if found else None


def shortest_answer_ns(bus: BusSettings, protocol: DriveProtocol) -> int:
    """Return the least time, ns, from the end of SYNC or a poll to that of a feedback to it on its bus."""
    return min(
        frame_time_ns(len(frame.data), frame.flags, BitTiming.of(bus.buses[frame.bus]), least=True)
        for frame in protocol.traits.feedbacks
    )


def bus_names(bus: BusSettings) -> tuple[str, ...]:
    """Return the channel of each bus, with its legs where there are several."""
    if not bus.channels:
        return (bus.channel,)
    return tuple(
        f"{each.channel} (legs {', '.join(map(str, legs))})"
        for each, legs in zip(bus.buses, bus.legs, strict=True)
    )


def loads(
    bus: BusSettings, drives: DriveSettings, sensors: SensorSettings, rate_Hz: float
) -> dict[str, object]:
    """Return what a summary says of the bus load: of several buses, of each by its channel too."""
    found = bus_budgets(bus, drives, sensors, rate_Hz)
    most = max((each.load_percent for each in found), default=None)
    if len(found) < 2:
        return {"bus_load_percent": most}
    by_channel = {each.channel: own.load_percent for each, own in zip(bus.buses, found, strict=True)}
    return {"bus_load_percent": most, "bus_load_percent_by_channel": by_channel}
