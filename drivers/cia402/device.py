"""An emulated CiA 402 drive: NMT, SDO server, PDOs, state machine, EMCY, heartbeat. Pure; its owner keeps it.

It follows the documents, not our controller: CiA 301 for communication, IEC 61800-7-201 for the drive. What
it has of both is in `dictionary`. Its brake is its own. Quick stop and NMT stop end in the brake at once, as
the emulated power stage has no ramps.
"""

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.cia402 import device_kernels as kernels
from drivers.cia402 import objects as o
from drivers.cia402.device_kernels import ACTUAL, DEVICE, MAPPABLE, REMEMBERED
from drivers.cia402.dictionary import (
    ENTRIES,
    PLACE,
    Pdo,
    Values,
    defaults,
    missing,
    pdos,
    refused,
    signed,
    with_value,
)
from drivers.cia402.emergency import CODES, HEARTBEAT_LOST
from drivers.cia402.objects import Key
from drivers.cia402.states import STATUSWORDS, State
from drivers.compiled.pointed import data_at
from drivers.ends import MESSAGE, device_message
from drivers.protocol import (
    Answer,
    Configure,
    DeviceMessage,
    EmergencyStop,
    Frame,
    Rejected,
    Status,
    UnwatchedCommand,
)
from drivers.signals import DriveFault, DriveMode, DriveState, Reaction

_SETTINGS = {
    "mode": o.MODE,
    "shown": o.MODE_SHOWN,
    "most": o.MAX_TORQUE,
    "consumer": o.CONSUMER_HEARTBEAT,
    "producer": o.PRODUCER_HEARTBEAT,
}
"""Fields of DEVICE that are objects as they are."""
NO_WATCHDOG_s = 1e6
"""Time after which a drive without a consumer heartbeat time reacts."""
_SHORT_PDO = 0x8210


class Device(NamedTuple):
    """What one drive remembers."""

    leg: int
    node: int
    values: Values
    """Its object dictionary."""
    N_per_permille: float
    """Force at the leg of a permille of its rated torque, without losses."""
    nmt: int = o.BOOTS
    state: State = State.NOT_READY
    word: int = 0
    """Last controlword."""
    torque: int = 0
    """Target torque, thousandths of the rated one."""
    actual: tuple[int, int, int] = (0, 0, 0)
    """Position, velocity and torque at the last SYNC, in its units."""
    error: int = 0
    """Code of its last EMCY; 0: none."""
    commands: int = 0
    """Commands so far."""
    started: bool = False
    """It has been in Operational since power-up."""
    stops: bool = False
    """It has reported its quick stop once."""

    def get(self, key: Key) -> int:
        """Return an object as the number that it stands for."""
        return signed(key, self.raw(key))

    def raw(self, key: Key) -> int:
        """Return an object's raw value."""
        current = self._current(key)
        if current is None:
            return self.values[PLACE[key]]
        return current & ((1 << 8 * ENTRIES[key].size) - 1)

    def _current(self, key: Key) -> int | None:
        if key == o.STATUSWORD:
            return STATUSWORDS[self.state]
        if key in _ACTUAL:
            return self.actual[_ACTUAL[key]]
        if key == o.TARGET_TORQUE:
            return self.torque
        if key == o.CONTROLWORD:
            return self.word
        if key == o.ERROR_CODE:
            return self.error
        if key == (0x1001, 0):
            return _register(self.error)
        return None


Step = tuple[Device, tuple[DeviceMessage, ...]]
_ACTUAL: Mapping[Key, int] = {o.POSITION: 0, o.VELOCITY: 1, o.TORQUE: 2}


def _register(error: int) -> int:
    """Return the error register: generic, and communication for the codes of that class."""
    return (0x11 if error >> 8 == 0x81 else 0x01) if error else 0


def powered_up(leg: int, node: int, torque_mNm: int, encoder: tuple[int, int], scale: float) -> Device:
    """Return a drive at power-up. encoder: increments and motor revolutions; scale: `N_per_permille`."""
    return Device(leg, node, defaults(node, torque_mNm, *encoder), scale)


def restarted(device: Device) -> Device:
    """Return the drive after a reset: what was set in it is gone."""
    at = PLACE[o.RATED_TORQUE], PLACE[o.ENCODER_INCREMENTS], PLACE[o.MOTOR_REVOLUTIONS]
    torque, increments, revolutions = (device.values[k] for k in at)
    fresh = powered_up(device.leg, device.node, torque, (increments, revolutions), device.N_per_permille)
    return fresh._replace(commands=device.commands + 1)


def booted(device: Device) -> tuple[Device, Frame]:
    """Return the drive after initialisation, and its boot-up message."""
    device = device._replace(nmt=o.PREPARES, state=State.DISABLED)
    return device, Frame(o.HEARTBEAT_ID + device.node, bytes(1))


def emergency(device: Device, code: int) -> Frame:
    """Return an EMCY message."""
    return Frame(
        o.EMCY_ID + device.node, code.to_bytes(2, "little") + bytes((_register(code), 0, 0, 0, 0, 0))
    )


def _configure(device: Device) -> Configure:
    time_ms = device.values[PLACE[o.CONSUMER_HEARTBEAT]] & 0xFFFF
    at_once = device.get(o.FAULT_REACTION) == 0
    watchdog_s = time_ms * 1e-3 if time_ms else NO_WATCHDOG_s
    return Configure(device.leg, watchdog_s, Reaction.BRAKE if at_once else Reaction.DAMP)


def on_nmt(device: Device, command: int) -> Step:
    """Follow an NMT command that addresses the drive."""
    if device.nmt == o.BOOTS:
        return device, ()
    off = UnwatchedCommand((device.leg,), DriveMode.OFF, np.zeros(1), device.commands + 1)
    if command == o.START:
        device = device._replace(nmt=o.OPERATES, started=True)
        return device, (_configure(device),)
    if command == o.PRE_OPERATIONAL:
        return device._replace(nmt=o.PREPARES), ()
    if command == o.STOP:
        if device.state is not State.ENABLED:
            return device._replace(nmt=o.STOPPED), ()
        return device._replace(nmt=o.STOPPED, state=State.QUICK_STOP), (EmergencyStop((device.leg,)),)
    if command in (o.RESET_NODE, o.RESET_COMMUNICATION):
        device, frame = booted(restarted(device))
        return device, (off, Answer(device.leg, frame))
    return device, ()


def cut(device: Device, pdo: Pdo, data: bytes) -> tuple[DeviceMessage, ...]:
    """Return the messages of a PDO with fewer bytes than its mapping."""
    code = emergency(device, _SHORT_PDO)
    return Rejected(f"PDO of {len(data)} bytes, mapped are {pdo.size}"), Answer(device.leg, code)


def _stored(device: Device, key: Key, value: int) -> Device:
    """Return the drive with another value; a mode of operation is in force at once, and shown."""
    values = with_value(device.values, key, value)
    if key == o.MODE:
        values = with_value(values, o.MODE_SHOWN, value)
    return device._replace(values=values)


@lru_cache(maxsize=64)
def _objects(values: Values) -> Rows:
    """Return an element of DEVICE with the objects of a dictionary."""
    d: Rows = np.zeros((), DEVICE)
    for name, key in _SETTINGS.items():
        d[name] = values[PLACE[key]]
    d["quick"] = signed(o.QUICK_STOP, values[PLACE[o.QUICK_STOP]])
    for k, pdo in enumerate(pdos(values, o.RPDO, o.RPDO_MAP)):
        d["heard"][k], d["size"][k], d["entries"][k] = pdo.id, pdo.size, len(pdo.keys)
        d["takes"][k, : len(pdo.keys)] = [MAPPABLE.index(key) for key in pdo.keys]
    sent = [each for each in pdos(values, o.TPDO, o.TPDO_MAP) if each.transmission == o.AT_EVERY_SYNC]
    for k, pdo in enumerate(sent):
        d["sent"][k], d["sends"][k] = pdo.id, len(pdo.keys)
        d["holds"][k, : len(pdo.keys)] = [MAPPABLE.index(key) for key in pdo.keys]
    return d


def put(d: Any, device: Device) -> None:
    """Put a drive into an element of DEVICE."""
    d[()] = _objects(device.values)
    d["leg"], d["node"], d["scale"] = device.leg, device.node, device.N_per_permille
    for name in REMEMBERED:
        d[name] = getattr(device, name)
    for name, number in zip(ACTUAL, device.actual, strict=True):
        d[name] = number


def taken(d: Any, device: Device) -> Device:
    """Return a drive as its element of DEVICE remembers it."""
    nmt, state, word, torque, error, commands, started, stops = d[list(REMEMBERED)].item()
    position, velocity, current = d[list(ACTUAL)].item()
    if d["mode"] != device.values[PLACE[o.MODE]]:
        device = _stored(device, o.MODE, int(d["mode"]))
    return device._replace(
        nmt=nmt,
        state=State(state),
        word=word,
        torque=torque,
        error=error,
        commands=commands,
        started=bool(started),
        stops=bool(stops),
        actual=(position, velocity, current),
    )


def control(device: Device, word: int, torque: int) -> Step:
    """Let a controlword and a target torque act; without a mode of operation no torque follows."""
    d, messages = np.zeros((), DEVICE), np.zeros(2, MESSAGE)
    put(d, device)
    count = kernels.control(d, word, torque, data_at(messages))
    return taken(d, device), tuple(device_message(*each) for each in messages[:count].tolist())


def on_sdo(device: Device, data: bytes) -> Step:
    """Answer a request of an SDO client; segmented and block transfers are refused, no object needs them."""
    if len(data) != 8 or device.nmt in (o.BOOTS, o.STOPPED):
        return device, ()
    specifier, key = data[0], (data[1] | data[2] << 8, data[3])
    kind = specifier >> 5
    if kind == 4:
        return device, ()
    messages: tuple[DeviceMessage, ...] = ()
    code = missing(key) if kind in (1, 2) else o.BAD_COMMAND
    answer = b""
    if not code and kind == 2:
        size = ENTRIES[key].size
        answer = o.head(0x43 | 4 - size << 2, key) + device.raw(key).to_bytes(4, "little")
    elif not code:
        device, messages, code = _written(device, key, specifier, data[4:])
        answer = o.head(0x60, key) + bytes(4)
    reply = Frame(o.SDO_REPLY_ID + device.node, o.abort(key, code) if code else answer)
    return device, (*messages, Answer(device.leg, reply))


def _written(
    device: Device, key: Key, specifier: int, data: bytes
) -> tuple[Device, tuple[DeviceMessage, ...], int]:
    """Return the drive after a download, what it does, and the abort code."""
    if not specifier & 2:
        return device, (), o.TOO_LONG
    said = 4 - (specifier >> 2 & 3) if specifier & 1 else 0
    size = said or ENTRIES[key].size
    value = int.from_bytes(data[:size], "little")
    code = refused(device.values, key, value, said)
    if code:
        return device, (), code
    if key == o.CONTROLWORD:
        return *control(device, value, device.torque), 0
    if key == o.TARGET_TORQUE:
        return device._replace(torque=signed(key, value)), (), 0
    device = _stored(device, key, value)
    acts = key in (o.CONSUMER_HEARTBEAT, o.FAULT_REACTION) and device.started
    return device, (_configure(device),) if acts else (), 0


def reported(device: Device, status: Status) -> tuple[Device, tuple[Frame, ...]]:
    """Learn what the power stage is in, and return its boot-up or EMCY."""
    if status.state == DriveState.BOOT and device.started:
        device = restarted(device)
    if device.nmt == o.BOOTS:
        device, frame = booted(device)
        return device, (frame,)
    code = CODES.get(DriveFault(status.fault), 0) if status.state == DriveState.FAULT else 0
    if code and not device.error:
        device = device._replace(state=State.FAULT_REACTION, error=code)
        falls_back = code == HEARTBEAT_LOST and device.get(o.COMMUNICATION_ERROR) == 0
        if falls_back and device.nmt == o.OPERATES:
            device = device._replace(nmt=o.PREPARES)
        return device, (emergency(device, code),)
    return device._replace(error=0), (emergency(device, 0),)
