"""Six emulated CiA 402 drives behind one bus: which frame is for whom, and what they send. Pure."""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

from drivers.arrays import Array, Ints
from drivers.cia402 import objects as o
from drivers.cia402.device import (
    Device,
    at_sync,
    content,
    hears,
    on_nmt,
    on_rpdo,
    on_sdo,
    powered_up,
    reported,
    restarted,
)
from drivers.cia402.dictionary import Pdo, pdos, with_value
from drivers.cia402.plan import Settings, plan
from drivers.cia402.routes import FOREIGN
from drivers.cia402.states import State
from drivers.errors import ProtocolError
from drivers.protocol import Alive, DeviceMessage, DriveSetup, Frame, Rejected, Status, Sync
from drivers.signals import INVALID, LEGS, DriveState, Reaction
from drivers.transmission import Transmission

_STATES = {
    DriveState.BOOT: State.NOT_READY,
    DriveState.OFF: State.DISABLED,
    DriveState.READY: State.SWITCHED_ON,
    DriveState.RUN: State.ENABLED,
    DriveState.FAULT: State.FAULT,
}
_ANY = DriveSetup(1.0, Reaction.BRAKE, 100.0)
_WORD, _SHORT = (1 << 31) - 1, (1 << 15) - 1


class Memory(NamedTuple):
    """What the six drives remember."""

    devices: tuple[Device, ...]
    routes: Mapping[int, tuple[tuple[int, Pdo], ...]]
    """Identifier of an RPDO -> the legs whose drives listen to it."""
    sends: tuple[tuple[Pdo, ...], ...]
    """TPDOs of each drive that answer a SYNC."""


def _memory(devices: Sequence[Device]) -> Memory:
    routes: dict[int, tuple[tuple[int, Pdo], ...]] = {}
    for device in devices:
        for pdo in pdos(device.values, o.RPDO, o.RPDO_MAP):
            routes[pdo.id] = (*routes.get(pdo.id, ()), (device.leg, pdo))
    return Memory(tuple(devices), routes, tuple(device.transmits() for device in devices))


class Devices:
    """Codec of the drives' end. Holds tables only."""

    def __init__(
        self,
        nodes: tuple[int, ...],
        transmission: Transmission,
        rated_torque_mNm: int,
        N_per_permille: Sequence[float],
        velocity: bool,
    ) -> None:
        self._nodes = nodes
        self._legs = {node: leg for leg, node in enumerate(nodes)}
        self._transmission, self._velocity = transmission, velocity
        self._rated_torque_mNm = rated_torque_mNm
        self._N_per_permille = list(N_per_permille)
        self._set_up = lru_cache(maxsize=64)(self._made_set_up)

    def power_up(self) -> Memory:
        """Return six drives that have just been powered up."""
        return _memory([self._powered_up(leg) for leg in range(LEGS)])

    def _powered_up(self, leg: int) -> Device:
        counts = round(float(self._transmission.counts[leg]))
        scale = self._N_per_permille[leg]
        return powered_up(leg, self._nodes[leg], self._rated_torque_mNm, (counts, 1), scale)

    def set_up(self, settings: Settings, state: Ints) -> Memory:
        """Return six drives that hold our set-up, in the contract's states (6,)."""
        return self._set_up(settings, tuple(value & ~INVALID for value in state.tolist()))

    def _made_set_up(self, settings: Settings, states: tuple[int, ...]) -> Memory:
        devices = []
        for leg, state in enumerate(states):
            device = self._powered_up(leg)
            values = device.values
            for step in plan(device.node, _ANY, settings):
                if step.kind == "write":
                    values = with_value(values, step.key, step.value)
            held = _STATES[DriveState(state)]
            devices.append(device._replace(values=values, nmt=o.OPERATES, state=held))
        return _memory(devices)

    def parse(self, memory: Memory, frame: Frame) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        """Decode a frame; no messages for one that is for none of the drives.

        Rejected: a PDO that is shorter than its mapping, an NMT or heartbeat frame of a wrong length, SDO
        requests of another length than 8.
        """
        identifier, data, flags = frame
        if flags & FOREIGN:
            return memory, ()
        listeners = memory.routes.get(identifier)
        if listeners is not None:
            return self._on_rpdo(memory, listeners, data)
        if identifier == o.SYNC_ID:
            return self._on_sync(memory)
        if identifier == o.NMT_ID:
            return self._on_nmt(memory, data)
        if identifier & ~0x7F == o.HEARTBEAT_ID:
            return self._on_heartbeat(memory, identifier & 0x7F, data)
        if identifier & ~0x7F == o.SDO_REQUEST_ID and identifier & 0x7F in self._legs:
            if len(data) != 8:
                return memory, (Rejected(f"SDO request of {len(data)} bytes"),)
            leg = self._legs[identifier & 0x7F]
            device, messages = on_sdo(memory.devices[leg], data)
            return _with(memory, leg, device), messages
        return memory, ()

    @staticmethod
    def _on_rpdo(
        memory: Memory, listeners: tuple[tuple[int, Pdo], ...], data: bytes
    ) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        devices, messages = list(memory.devices), list[DeviceMessage]()
        for leg, pdo in listeners:
            devices[leg], found = on_rpdo(devices[leg], pdo, data)
            messages += found
        return memory._replace(devices=tuple(devices)), tuple(messages)

    @staticmethod
    def _on_sync(memory: Memory) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        devices = memory.devices
        legs = tuple(d.leg for d in devices if d.nmt == o.OPERATES and memory.sends[d.leg])
        if any(d.state is State.FAULT_REACTION for d in devices):
            memory = memory._replace(devices=tuple(map(at_sync, memory.devices)))
        return memory, (Sync(0, legs),)

    def _on_nmt(self, memory: Memory, data: bytes) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        if len(data) != 2:
            return memory, (Rejected(f"NMT command of {len(data)} bytes"),)
        command, node = data
        addressed = range(LEGS) if node == 0 else [self._legs[node]] if node in self._legs else []
        messages: list[DeviceMessage] = []
        for leg in addressed:
            device, found = on_nmt(memory.devices[leg], command)
            memory = _with(memory, leg, device)
            messages += found
        return memory, tuple(messages)

    @staticmethod
    def _on_heartbeat(memory: Memory, node: int, data: bytes) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        if len(data) != 1:
            return memory, (Rejected(f"heartbeat of {len(data)} bytes"),)
        legs = tuple(device.leg for device in memory.devices if hears(device, node))
        return memory, (Alive(legs),) if legs else ()

    def answer(
        self, memory: Memory, sync: Sync, length: Array, rate: Array, force: Array, state: Ints
    ) -> tuple[Memory, list[tuple[int, Frame]]]:
        """Encode the TPDOs of `sync.legs`; what exceeds its field saturates.

        length m, rate m/s, force N, each (6,); state (6,) DriveState, plus INVALID: such a drive has no
        position and sends nothing, as one that boots. Raises ProtocolError on NaN.
        """
        counts = self._transmission.counts_of_length(length).tolist()
        speeds = (self._transmission.turns_per_s(rate) * self._transmission.counts).tolist()
        torques, states = self._transmission.torque(force, rate).tolist(), state.tolist()
        devices, frames = [], []
        for leg, device in enumerate(memory.devices):
            torque = torques[leg] * 1e6 / self._rated_torque_mNm
            if counts[leg] != counts[leg] or speeds[leg] != speeds[leg] or torque != torque:  # noqa: PLR0124 - NaN
                raise ProtocolError(
                    f"feedback of leg {leg} is not a number: {length[leg]} m, {rate[leg]} m/s, {force[leg]} N"
                )
            boots = states[leg] & ~INVALID == DriveState.BOOT
            now = restarted(device) if boots and device.started else device
            actual = _whole(counts[leg], _WORD), _whole(speeds[leg], _WORD), _whole(torque, _SHORT)
            now = now._replace(actual=actual)
            devices.append(now)
            if leg in sync.legs and device.nmt == o.OPERATES and not boots and not states[leg] & INVALID:
                frames += [(leg, Frame(pdo.id, content(now, pdo))) for pdo in memory.sends[leg]]
        changed = [a.values is not b.values for a, b in zip(devices, memory.devices, strict=True)]
        return (_memory(devices) if any(changed) else memory._replace(devices=tuple(devices))), frames

    def report(self, memory: Memory, status: Status) -> tuple[Memory, tuple[Frame, ...]]:
        """Encode boot-up, EMCY and heartbeat of a drive."""
        device, frames = reported(memory.devices[status.leg], status)
        return _with(memory, status.leg, device), frames


def _with(memory: Memory, leg: int, device: Device) -> Memory:
    """Return the memory with another drive."""
    devices = (*memory.devices[:leg], device, *memory.devices[leg + 1 :])
    if device.values is memory.devices[leg].values:
        return memory._replace(devices=devices)
    return _memory(devices)


def _whole(value: float, most: int) -> int:
    """Return the nearest whole number, saturated."""
    return round(min(max(value, -most - 1), most))
