"""The configured sensors: their tables for both ends, the frames that start and poll them, their bus time."""

from collections.abc import Iterable, Iterator
from math import ceil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.compiled.compiler import INTEGER, record
from drivers.compiled.pointed import Callee, call, data_at, integers_at, pointed
from drivers.config import UDP, BusSettings
from drivers.errors import ConfigurationError, HilError
from drivers.family import Family
from drivers.frame_array import FRAME, NO_FRAMES, sent_array
from drivers.frame_pointers import frame_at
from drivers.legs.crc import check_of
from drivers.protocol import BUS, EXTENDED, FD, Frame
from drivers.sensing.calibration import Correction
from drivers.sensing.family import CHANNELS, SYNC_ID, Device, Message, Wanted, fill_condition, fill_field
from drivers.sensing.layout import (
    CONDITIONS,
    FREE,
    OFFSET,
    ROW,
    SLOTS,
    SLOTS_OF,
    STAMPED,
    Reception,
    Tables,
    no_sensors,
    raw_ends,
)
from drivers.sensing.mocap import MotionCapture
from drivers.sensing.settings import SensorRole, SensorSettings

KINDS = tuple(CHANNELS)
"""Roles of sensors, the keys of section `sensors`."""
SIGMAS = 3.0
"""Standard deviations by which the mean of a sensor may differ from the legs."""
SILENT_SAMPLES = 5
"""A sensor is silent after this number of missing samples in a row."""
PATIENCE_S = 0.5
"""A device that has sent no sample for so long is started again while the drives are off."""
_START_EVERY_S = 0.02
_STAMP_BYTES = 2
"""Bytes of the SYNC of sensors.dbc: Cycle and CRC."""


class Sensor(NamedTuple):
    """One measurement of a device on a bus."""

    role: str
    slot: int
    bus: int
    rate_Hz: float
    device: Device
    std: tuple[float, ...]
    """Standard deviations (6,) by which its quantities may differ from the legs."""
    time_std_s: float
    correction: Correction
    late_s: float
    """By how much its stated instants are late."""

    def on_bus(self, frames: Iterable[Frame]) -> tuple[Frame, ...]:
        """Frames on its bus."""
        return tuple(frame._replace(flags=frame.flags + BUS * self.bus) for frame in frames)


OPENED = np.dtype(
    [(name, "<i8") for name in ("first", "context", "frames", "count")]
    + [(name, "<i8", (2 * SLOTS,)) for name in ("every", "stamps")]
)
"""Function and context of `ControllerEnd.opening`; address of `count` elements of FRAME to send as well; the
number of ticks from one of each to the next, and whether it carries the tick and a CRC."""
_BYTES, _WORDS = FRAME.itemsize, FRAME.itemsize // 8


@pointed(record(OPENED), INTEGER, INTEGER)
def _open(o: Any, number: int, into: int) -> int:
    """Write the frames that start a tick to an address, those of the drives first; return their number."""
    count = call(o.first, (o.context, number, into)) if o.first else 0
    for k in range(o.count):
        if number % o.every[k]:
            continue
        at = into + count * _BYTES
        integers_at(at, _WORDS)[:] = integers_at(o.frames + k * _BYTES, _WORDS)
        if o.stamps[k]:
            frame = frame_at(at)
            frame.data[0] = number & 0xFF
            frame.data[1] = check_of(SYNC_ID, frame.data, 1, 1)
        count += 1
    return int(count)


class SensorProtocol:
    """Codec of the configured sensors. Holds tables only.

    Raises ConfigurationError for settings that a sensor does not have, and for frames that its bus does not
    carry.
    """

    def __init__(self, bus: BusSettings, sensors: SensorSettings, folder: Path | None = None) -> None:
        self.sensors: dict[int, Sensor] = {}
        """Slot -> sensor."""
        for role in KINDS:
            settings = getattr(sensors, role)
            if settings is not None:
                for each in _sensors(role, settings, bus, folder or Path()):
                    self.sensors[each.slot] = each
        self.tables = _tables(self.sensors.values())
        """Messages of the configured sensors."""
        started: dict[Any, list[int]] = {}
        for slot, each in self.sensors.items():  # legs with the same frames are started by them once
            started.setdefault((each.role, each.device.start), []).append(slot)
        starts = [
            (slots, frame)
            for slots in started.values()
            for frame in self.sensors[slots[0]].on_bus(self.sensors[slots[0]].device.start)
        ]
        self._starts, self._started = sent_array(frame for _, frame in starts), [slots for slots, _ in starts]

    @property
    def databases(self) -> tuple[tuple[str, str], ...]:
        """Name and text of each DBC file: sensors.dbc, and that of a role as `sensors.ROLE.dbc`."""
        devices = [(each.role, each.device) for each in self.sensors.values()]
        found = {
            "sensors.dbc" if device.timing == STAMPED else f"sensors.{role}.dbc": device.database
            for role, device in devices
            if device.database is not None
        }
        return tuple(found.items())

    def cyclic_frames(self, rate_Hz: float) -> tuple[Frame, ...]:
        """One example of every frame that can fall into one tick at a loop of `rate_Hz`, polls included."""
        found: list[Frame] = []
        seen: set[tuple[int, ...]] = set()
        for each in self.sensors.values():
            device = each.device
            new = [of for of in device.messages if (each.bus, *of.key) not in seen]
            seen.update((each.bus, *of.key) for of in new)
            own = [Frame(of.id, bytes(of.length), of.flags) for of in new]
            polls = () if device.poll is None else (device.poll,)
            found += each.on_bus((*own, *polls)) * ceil(each.rate_Hz / rate_Hz * (1 - 1e-9))
        return tuple(found)

    def syncs(self, protocol: Family) -> tuple[Frame, ...]:
        """SYNC frames to send in addition to those of the drives, one for each bus that needs one.

        Raises ConfigurationError where the drives' own frames leave no identifier for it.
        """
        found: dict[int, Frame] = {}
        traits = protocol.traits
        used = [*traits.emergency_stop, *(frame for own in traits.identity_requests for frame in own)]
        for each in self.sensors.values():
            stamped = each.device.timing == STAMPED
            if each.device.poll is not None or each.device.timing == FREE:
                continue
            sent = [f for f in traits.cyclic_frames if f.bus == each.bus and f.id == SYNC_ID]
            if not any(f.bus == each.bus and f.id == SYNC_ID for f in used) and not sent:
                both = stamped or (each.bus in found and len(found[each.bus].data) > 0)
                found[each.bus] = Frame(SYNC_ID, bytes(_STAMP_BYTES * both), BUS * each.bus)
                continue
            fits = sent and traits.latches_together and (not stamped or len(sent[0].data) == _STAMP_BYTES)
            if not fits:
                raise ConfigurationError(
                    f"sensors.{each.role}.device: needs the SYNC {'of sensors.dbc ' * stamped}with "
                    f"identifier 0x{SYNC_ID:03X}, which drives of protocol {traits.family} there use "
                    "otherwise; allowed there: a device with trigger free, cyclic or change, or a polled "
                    "one; or give the sensor a bus of its own, an entry of bus.channels without legs"
                )
        return tuple(found.values())

    def refuse_clashes(self, protocol: Family) -> None:
        """Raise ConfigurationError for an identifier that two nodes of a bus use.

        Two roles may read one message of a DBC: it comes at one instant.
        """
        cyclic, asked = protocol.traits.cyclic_frames, protocol.traits.identity_requests
        drives = {_key(frame) for own in (cyclic, *asked) for frame in own}
        taken: dict[Any, tuple[Any, ...]] = {_key(frame): ("a drive",) for frame in cyclic}
        for each in self.sensors.values():
            mine, own = f"sensors.{each.role}", [each.rate_Hz, each.device.timing, each.device.database]
            frames = [Frame(of.id, b"", of.flags & EXTENDED) for of in each.device.messages]
            starts = [frame for frame in each.on_bus(each.device.start) if _key(frame) in drives]
            for frame in (*starts, *each.on_bus(frames)):
                key = _key(frame)
                other, *terms = taken.setdefault(key, (mine, *own))
                shares = bool(each.device.database) and each.device.timing != STAMPED and terms == own
                if frame in starts or not (other == mine or shares) or protocol.sender(frame) >= 0:
                    raise ConfigurationError(
                        f"{mine}: identifier 0x{frame.id:X} is also that of "
                        f"{other.replace(mine, 'a drive')}, allowed: one node for each, or the same rate_Hz "
                        "and trigger for two roles of one DBC; change a node number, or give the sensor a "
                        "bus of its own"
                    )

    def opening(self, drives: Callee, protocol: Family, rate_Hz: float) -> Callee:
        """Function of the frames that start a tick at a loop of `rate_Hz`: the drives', then SYNC and polls.

        drives: that of the drives alone. Arguments: (context, tick, address of elements of FRAME).
        """
        syncs = self.syncs(protocol)
        polls = [
            (frame, max(1, round(rate_Hz / each.rate_Hz)))
            for each in self.sensors.values()
            if each.device.poll is not None
            for frame in each.on_bus([each.device.poll])
        ]
        every = [1] * len(syncs) + [ticks for _, ticks in polls]
        frames, o = sent_array((*syncs, *(frame for frame, _ in polls))), np.zeros((), OPENED)
        o["first"], o["context"] = drives.address, drives.context
        o["frames"], o["count"] = data_at(frames), len(frames)
        o["every"][: len(every)] = every
        o["stamps"][: len(syncs)] = [len(frame.data) == _STAMP_BYTES for frame in syncs]
        return Callee(_open.address, data_at(o), (o, frames, drives))

    def begin(self, opening: Callee, number: int, into: Rows) -> Rows:
        """Frames that start a tick, elements of FRAME, by the function of `opening`."""
        return into[: _open(opening.keeps[0], number, data_at(into))]

    def starts(self, number: int) -> bool:
        """True while devices get their first frames."""
        return 2 * number < len(self._starts)

    def set_up(self, number: int, rate_Hz: float, heard: Reception) -> Rows:
        """Frames that start the devices in a tick before the drives are powered.

        Each is sent once, two a tick, and then again in turn to devices that are silent.
        """
        count = len(self._starts)
        if self.starts(number):
            return self._starts[2 * number : 2 * number + 2]
        every = max(1, round(_START_EVERY_S * rate_Hz))
        if count == 0 or number % every:
            return NO_FRAMES
        k = number // every % count
        of = heard.slots[self._started[k]]
        silent_s = (number - of["last_tick"]) / rate_Hz - of["last_s"]
        return self._starts[k : k + 1] if (silent_s > PATIENCE_S).any() else NO_FRAMES


def _key(frame: Frame) -> tuple[int, ...]:
    return frame.bus, frame.id, frame.flags & EXTENDED


def _sensors(role: str, settings: SensorRole, bus: BusSettings, folder: Path) -> Iterator[Sensor]:
    try:
        index = bus.index_of(settings.channel)
    except ConfigurationError as error:
        raise ConfigurationError(f"sensors.{role}.channel: {error}") from error
    nodes, there = settings.nodes, bus.buses[index]
    for leg, slot in enumerate(SLOTS_OF[role]):
        wanted = Wanted(role, nodes[leg], leg, settings.rate_Hz, folder)
        try:
            device = settings.device.device(wanted)
        except HilError as error:
            raise ConfigurationError(f"sensors.{role}.device.{error}") from error
        if (there.interface == UDP) != isinstance(settings.device, MotionCapture):
            raise ConfigurationError(
                f"sensors.{role}.channel: protocol {settings.device.protocol} on interface "
                f"{there.interface}, allowed: mocap on interface {UDP}, an entry of bus.channels without "
                "legs; every other protocol on CAN"
            )
        longest = max(device.messages, key=lambda each: each.flags & FD)
        if longest.flags & FD and there.layout == "classic":
            raise ConfigurationError(
                f"sensors.{role}: its frames of {longest.length} bytes need CAN FD, but bus {there.channel} "
                "has layout classic; allowed: a bus of layout fd, such as one of its own (an entry of "
                "bus.channels without legs and with layout: fd), or a device with classic frames "
                "(device.protocol ati, cia404, cia406, dbc)"
            )
        std, time_std_s, of = settings.std, 1e-3 * settings.time_std_ms, settings.calibration
        late_s = 1e-3 * of.time_offset_ms
        yield Sensor(role, slot, index, settings.rate_Hz, device, std, time_std_s, of.correction(leg), late_s)


def _tables(sensors: Iterable[Sensor]) -> Tables:
    found, rows = no_sensors(), []
    for each in sensors:
        device, of = each.device, found.slots[each.slot : each.slot + 1]
        of["present"], of["parts"], of["timing"] = 1, (1 << len(device.messages)) - 1, device.timing
        stamps = any(field.to == OFFSET for message in device.messages for field in message.fields)
        of["clocked"] = stamps and device.timing == FREE
        of["latency_s"], of["gap_ns"] = device.latency_s + each.late_s, round(0.5e9 / each.rate_Hz)
        of["limit"], of["time_s"] = SIGMAS * np.array(each.std), SIGMAS * each.time_std_s
        of["patience_s"] = np.inf if device.changes else SILENT_SAMPLES / each.rate_Hz + device.latency_s
        mix, shift, placed, frame, target, lever = each.correction
        mix = mix if device.mix is None else mix @ device.mix
        of["raw"], of["mixes"] = np.nan, shift.any() or (mix != np.eye(len(mix))).any()
        of["mix"], of["shift"], of["placed"], of["lever"] = mix, shift, placed, lever
        of["frame"], of["target"] = frame, target
        rows += [_row(each, part, message) for part, message in enumerate(device.messages)]
    return found._replace(rows=np.array(rows, ROW))


def _row(sensor: Sensor, part: int, message: Message) -> Any:
    row = np.zeros((), ROW)
    row["id"], row["flags"], row["bus"], row["length"] = message.id, message.flags, sensor.bus, message.length
    row["slot"], row["part"], row["exact"], row["checked"] = sensor.slot, part, message.exact, message.checked
    row["fields"], row["conditions"] = len(message.fields), len(message.conditions)
    if len(message.conditions) > CONDITIONS:
        raise ConfigurationError(
            f"sensors.{sensor.role}.device: more than {CONDITIONS} conditions for a message"
        )
    for k, field in enumerate(message.fields):
        ends = sorted(raw * field.scale + field.offset for raw in raw_ends(field.bits, field.kind))
        low = ends[0] if field.low is None else field.low
        fill_field(row, k, field._replace(low=low, high=ends[1] if field.high is None else field.high))
    for k, one in enumerate(message.conditions):
        fill_condition(row, k, one)
    return row
