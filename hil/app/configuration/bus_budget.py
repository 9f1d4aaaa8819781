"""The bus time that a configuration's frames take."""

from drivers import PROTOCOLS
from drivers.can.bus_time import BitTiming, BusBudget, check
from drivers.config import BusSettings, DriveSettings, SensorSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.protocol import DriveSetup
from drivers.sensors import SensorProtocol


def bus_budget(
    bus: BusSettings, drives: DriveSettings, sensors: SensorSettings, rate_Hz: float
) -> BusBudget | None:
    """Return the bus time of the fullest tick at `rate_Hz`; None for the ideal layout, which takes no time.

    Raises ConfigurationError with the arithmetic when it is more than `max_load_percent`, for settings that
    the protocol does not have, and for sensors where layout or protocol have no room for them.
    """
    nodes = SensorProtocol(bus, sensors)
    protocol = PROTOCOLS[drives.protocol](bus, drives)
    try:
        protocol.start(DriveSetup(1e-3 * drives.watchdog_ms, protocol.reactions[0], rate_Hz))
    except ProtocolError as error:
        raise ConfigurationError(f"drives.watchdog_ms: {error}") from error
    frames = protocol.cyclic_frames()
    if nodes.kinds and all(frame.id != nodes.sync_id for frame in frames):
        raise ConfigurationError(
            f"drives.protocol: {drives.protocol} sends no SYNC that sensors can stamp their samples against"
        )
    if bus.layout == "ideal":
        return None
    frames += nodes.cyclic_frames(rate_Hz)
    return check(frames, BitTiming.of(bus), rate_Hz, bus.max_load_percent)
