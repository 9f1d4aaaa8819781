"""Six emulated CiA 402 drives behind one bus: which frame is for whom, and what they send. Pure."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.cia402 import device_kernels as kernels
from drivers.cia402 import objects as o
from drivers.cia402.device import (
    Device,
    cut,
    on_nmt,
    on_sdo,
    powered_up,
    put,
    reported,
    restarted,
    taken,
)
from drivers.cia402.device_kernels import DEVICE, DEVICES
from drivers.cia402.dictionary import pdos, with_value
from drivers.cia402.emergency import CODES
from drivers.cia402.plan import Settings, plan
from drivers.cia402.states import State
from drivers.compiled.pointed import data_at
from drivers.ends import CompiledEnd, Hearing
from drivers.errors import ProtocolError
from drivers.frame_array import received_array, sent_array
from drivers.protocol import DeviceMessage, DriveSetup, Frame, Received, Rejected, Status, Sync
from drivers.signals import INVALID, LEGS, DriveFault, DriveState, Reaction
from drivers.transmission import Transmission

_STATES = {
    DriveState.BOOT: State.NOT_READY,
    DriveState.OFF: State.DISABLED,
    DriveState.READY: State.SWITCHED_ON,
    DriveState.RUN: State.ENABLED,
    DriveState.FAULT: State.FAULT,
}
_ANY = DriveSetup(1.0, Reaction.BRAKE, 100.0)


class Memory(NamedTuple):
    """What the six drives remember."""

    devices: tuple[Device, ...]


class DevicesEnd(CompiledEnd):
    """Six drives. Mutable state: their elements of DEVICE; the rest of each is as it was put in last."""

    def __init__(self, tables: Rows, memory: Memory, buses: Any = None) -> None:
        """Take the tables, which are copied, the drives, and the `SeveralBuses` on which they are."""
        c = tables.copy()
        super().__init__(c, kernels.parse, kernels.answer, kernels.report)
        self._rows, self._buses = np.zeros(LEGS, DEVICE), buses
        c["devices"] = data_at(self._rows)
        if buses is not None:
            c["buses"], c["bus_of"] = len(buses.legs), buses.bus_of
        self._places = [self._rows[leg : leg + 1].reshape(()) for leg in range(LEGS)]
        self._devices: list[Any] = [None] * LEGS
        self._put = [b""] * LEGS
        """What each element was when its drive was put in or taken out."""
        self.memory = memory if buses is None else buses.power_up()

    @property
    def memory(self) -> Any:
        """`Memory`, on several buses one a bus."""
        for leg, place in enumerate(self._places):
            if place.tobytes() != self._put[leg]:
                self._devices[leg], self._put[leg] = taken(place, self._devices[leg]), place.tobytes()
        memory = Memory(tuple(self._devices))
        return memory if self._buses is None else (memory,) * len(self._buses.legs)

    @memory.setter
    def memory(self, memory: Any) -> None:
        buses = self._buses
        for leg, place in enumerate(self._places):
            device = (memory if buses is None else memory[buses.bus_of[leg]]).devices[leg]
            if device is not self._devices[leg] or place.tobytes() != self._put[leg]:
                put(place, device)
                self._devices[leg], self._put[leg] = device, place.tobytes()


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
        self._transmission = transmission
        self._rated_torque_mNm = rated_torque_mNm
        self._N_per_permille = list(N_per_permille)
        self._set_up = lru_cache(maxsize=64)(self._made_set_up)
        c = np.zeros((), DEVICES)
        c["nodes"], c["velocity"], c["rated_mNm"] = nodes, velocity, rated_torque_mNm
        c["codes"] = [CODES.get(fault, 0) for fault in DriveFault]
        transmission.fill(c)
        self._tables = c
        self.wanted = tuple(kind + node for kind in o.TPDO_ID[: 1 + velocity] for node in nodes)
        """TPDOs that answer a SYNC."""
        self._end = DevicesEnd(c, self.power_up())
        self._end.record["stops"] = True

    def end(self, buses: Any = None) -> DevicesEnd:
        """Return the drives' end by address, powered up, on several buses where these are given."""
        return DevicesEnd(self._tables, self.power_up(), buses)

    def hearing(self, buses: Any = None) -> Hearing:
        """Return the controller's end by address, as far as it hears."""
        end = self.end(buses)
        return Hearing(kernels.fresh.address, kernels.addressed.address, end.context, self.wanted, end)

    def fresh(self, received: Received, tick: int, since_ns: int) -> bool:
        """Tell whether a frame is a TPDO that arrived after the tick's SYNC."""
        return kernels.fresh(self._end.record, received_array([received]), tick, since_ns) > 0

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the legs that a frame is for."""
        legs = kernels.addressed(self._end.record, sent_array([frame]))
        return tuple(leg for leg in range(LEGS) if legs >> leg & 1)

    def power_up(self) -> Memory:
        """Return six drives that have just been powered up."""
        return Memory(tuple(self._powered_up(leg) for leg in range(LEGS)))

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
        return Memory(tuple(devices))

    def parse(self, memory: Memory, frame: Frame) -> tuple[Memory, tuple[DeviceMessage, ...]]:
        """Decode a frame; no messages for one that is for none of the drives.

        Rejected: a PDO that is shorter than its mapping, an NMT or heartbeat frame of a wrong length, SDO
        requests of another length than 8.
        """
        self._end.memory = memory
        messages = self._end.messages(frame)
        if messages is not None:
            return self._end.memory, messages
        identifier, data, _ = frame
        short = [
            (device, pdo)
            for device in memory.devices
            for pdo in pdos(device.values, o.RPDO, o.RPDO_MAP)
            if pdo.id == identifier and device.nmt == o.OPERATES
        ]
        if short:
            return memory, tuple(message for each in short for message in cut(*each, data))
        if identifier == o.NMT_ID:
            return self._on_nmt(memory, data)
        if identifier & ~0x7F == o.HEARTBEAT_ID:
            return memory, (Rejected(f"heartbeat of {len(data)} bytes"),)
        if len(data) != 8:
            return memory, (Rejected(f"SDO request of {len(data)} bytes"),)
        leg = self._legs[identifier & 0x7F]
        device, answered = on_sdo(memory.devices[leg], data)
        return _with(memory, leg, device), answered

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

    def answer(
        self, memory: Memory, sync: Sync, length: Array, rate: Array, force: Array, state: Ints
    ) -> tuple[Memory, list[tuple[int, Frame]]]:
        """Encode the TPDOs of `sync.legs`; what exceeds its field saturates.

        length m, rate m/s, force N, each (6,); state (6,) DriveState, plus INVALID: such a drive has no
        position and sends nothing, as one that boots. Raises ProtocolError on NaN.
        """
        for leg, device in enumerate(memory.devices):
            if state[leg] & ~INVALID == DriveState.BOOT and device.started:
                memory = _with(memory, leg, restarted(device))
        end, t = self._end, self._transmission
        end.memory = memory
        frames = end.answers(sync, length, rate, force, state)
        if frames is None:
            unknown = (
                np.isnan(t.turns(length)) | np.isnan(t.turns_per_s(rate)) | np.isnan(t.torque(force, rate))
            )
            leg = int(np.flatnonzero(unknown)[0])
            raise ProtocolError(
                f"feedback of leg {leg} is not a number: {length[leg]} m, {rate[leg]} m/s, {force[leg]} N"
            )
        return end.memory, frames

    def report(self, memory: Memory, status: Status) -> tuple[Memory, tuple[Frame, ...]]:
        """Encode boot-up, EMCY and heartbeat of a drive."""
        end, leg = self._end, status.leg
        first: tuple[Frame, ...] = ()
        end.memory = memory
        frames = end.reports(status)
        if frames is None:
            device, first = reported(memory.devices[leg], status)
            end.memory = memory = _with(memory, leg, device)
            frames = end.reports(status) or ()
        return end.memory, (*first, *frames)


def _with(memory: Memory, leg: int, device: Device) -> Memory:
    """Return the memory with another drive."""
    return Memory((*memory.devices[:leg], device, *memory.devices[leg + 1 :]))
