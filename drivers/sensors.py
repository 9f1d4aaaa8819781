"""Sensors beside the drives: tracker, IMU and wrench sensor, both ends of one table.

A sample is stamped in the controller's own time: Offset after the end of the SYNC that carried Cycle. No
clock has to be set, and a sample may be late by up to 127 ticks.
"""

from collections.abc import Sequence
from math import ceil, isfinite

from drivers.config import BusSettings, SensorSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.legs.codec import Codec, Layout, compile_message, layout_of, parsed, read_dbc
from drivers.legs.crc import crc8, identifier_state
from drivers.legs.device_kernels import intact
from drivers.legs.kernels import FOREIGN
from drivers.protocol import BUS, OTHER_BUSES, Frame
from drivers.sensor_kernels import FIELDS, QUANTITIES
from drivers.tick_columns import Record

KINDS = ("tracker", "imu", "wrench")
_MESSAGES = {
    "tracker": ("TRACKER_7", 7, ("X", "Y", "Z", "RX", "RY", "RZ")),
    "imu": ("IMU_8", 8, ("WX", "WY", "WZ", "FX", "FY", "FZ")),
    "wrench": ("WRENCH_9", 9, ("FX", "FY", "FZ", "MX", "MY", "MZ")),
}
"""Kind -> message of sensors.dbc, the node number in its identifier, its six quantities."""
_TRAILER = ("Offset", "Cycle", "Counter", "Validity", "CRC")
_STRANGE = FOREIGN & ~OTHER_BUSES


class SensorProtocol:
    """Codec of the configured sensors. Holds compiled tables only.

    Raises ConfigurationError where the layout has no room for them.
    """

    def __init__(self, bus: BusSettings, sensors: SensorSettings) -> None:
        self.rates_Hz = {k: s.rate_Hz for k in KINDS if (s := getattr(sensors, k)) is not None}
        if self.rates_Hz and bus.layout == "classic":
            given = ", ".join(f"sensors.{kind}" for kind in self.rates_Hz)
            raise ConfigurationError(
                f"bus.layout: classic carries 8 bytes a frame and a sample takes up to 32, given: {given}; "
                "use layout fd, or leave the sensors out"
            )
        self.database = "sensors.dbc", read_dbc("drivers", "sensors.dbc")
        database = parsed(self.database[1])
        self.sync_id: int = database.get_message_by_name("SYNC").frame_id
        self._sync_register = identifier_state(self.sync_id)
        self._codecs: dict[str, tuple[int, int, Codec]] = {}
        """Kind -> identifier, CRC register after it, codec."""
        self._layouts: dict[str, Layout] = {}
        self._bus: dict[str, int] = {}
        for kind in self.rates_Hz:
            name, node, quantities = _MESSAGES[kind]
            message = database.get_message_by_name(name)
            codec = compile_message(message, *quantities, *_TRAILER)
            self._layouts[kind] = layout_of(message, *quantities, *_TRAILER)
            identifier = codec.id - node + getattr(sensors, kind).node_id
            self._codecs[kind] = identifier, identifier_state(identifier), codec
            try:
                self._bus[kind] = bus.index_of(getattr(sensors, kind).channel)
            except ConfigurationError as error:
                raise ConfigurationError(f"sensors.{kind}.channel: {error}") from error

    @property
    def kinds(self) -> tuple[str, ...]:
        """The configured ones of KINDS."""
        return tuple(self._codecs)

    def bus_of(self, kind: str) -> int:
        """Return the index of the bus that a sensor is on: it hears SYNC and sends there."""
        return self._bus[kind]

    def fill_hearing(self, record: Record) -> None:
        """Fill in where the configured sensors have what in their frames, `drivers.sensor_kernels.SENSORS`.

        A frame with the counter of the one before is a repetition and passed over; a gap in the counter
        counts as lost, whatever the reason. A sample that its node calls invalid is none. Refused, and
        counted in `rejected`: wrong length or CRC, a stamp in the future, before tick 0 or more than OLDEST
        ticks back, an unknown validity, a turn of more than pi, a value outside the range of sensors.dbc.
        Foreign frames are ignored.
        """
        for kind, (identifier, register, codec) in self._codecs.items():
            k = KINDS.index(kind)
            record["id"][k], record["bus"][k], record["register"][k] = identifier, self._bus[kind], register
            record["length"][k] = codec.length
            places = self._layouts[kind].places[:FIELDS]
            record["start"][k], record["bits"][k] = zip(*((p.start, p.size) for p in places), strict=True)
            record["scale"][k] = codec.scale[: QUANTITIES + 1]
            record["low"][k], record["high"][k] = codec.low[:QUANTITIES], codec.high[:QUANTITIES]

    def encode(self, kind: str, values: Sequence[float], cycle: int, offset_s: float, counter: int) -> Frame:
        """Return the frame of one sample; what exceeds a field saturates and makes the sample invalid.

        values: six, as in `Sample`; cycle and offset_s say when: offset_s after the SYNC that carried cycle.
        Raises ProtocolError on NaN and on an offset that is not 0 .. 65.535 ms.
        """
        identifier, register, codec = self._codecs[kind]
        if any(value != value for value in values):  # noqa: PLR0124 - only NaN differs from itself
            raise ProtocolError(f"sample of {kind} is not a number: {list(values)}")
        offset = round(offset_s / codec.scale[6]) if isfinite(offset_s) else -1
        if not 0 <= offset <= 0xFFFF:
            raise ProtocolError(f"sample of {kind}: offset of {offset_s} s, allowed: 0 to 0.065535")
        bounded = [
            min(max(v, low), high) for v, low, high in zip(values, codec.low, codec.high, strict=False)
        ]
        raw = [round(v / scale) for v, scale in zip(bounded, codec.scale, strict=False)]
        invalid = bounded != list(values)
        data = codec.pack(*raw, offset, cycle & 0xFF, int(invalid) << 4 | counter & 0xF)
        return Frame(identifier, data + bytes([crc8(data, register)]), codec.flags + BUS * self._bus[kind])

    def cycle_of(self, frame: Frame) -> int | None:
        """Return the Cycle of a SYNC, at a sensor's end; None for any other frame and for a damaged one.

        On whichever bus it came: a sensor hears that of its own.
        """
        if frame.id != self.sync_id or frame.flags & _STRANGE or len(frame.data) != 2:
            return None
        return frame.data[0] if intact(frame.data, self._sync_register) else None

    def cyclic_frames(self, rate_Hz: float) -> tuple[Frame, ...]:
        """Return one example of every frame that can fall into one tick at a loop of `rate_Hz`."""
        found: list[Frame] = []
        for kind, rate in self.rates_Hz.items():
            found += [self.encode(kind, (0.0,) * 6, 0, 0.0, 0)] * ceil(rate / rate_Hz * (1 - 1e-9))
        return tuple(found)
