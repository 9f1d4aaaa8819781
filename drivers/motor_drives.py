"""The drives' end of the families of single-motor drives: what such drives remember and send.

It is compiled in `drivers.motor_device_kernels`. The controller's end is `drivers.motors`.
"""

from abc import ABC
from collections.abc import Mapping, Sequence
from functools import cached_property
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from drivers import motor_device_kernels as kernels
from drivers.arrays import Array, Ints
from drivers.compiled.pointed import Pointed, data_at
from drivers.ends import CompiledEnd, Hearing
from drivers.errors import ProtocolError
from drivers.frame_array import sent_array
from drivers.motor_device_kernels import DEVICES
from drivers.protocol import DeviceMessage, Frame, Status, Sync
from drivers.signals import LEGS, DriveFault, DriveState, Reaction
from drivers.tick_columns import Record
from drivers.transmission import Transmission


class MotorMemory(NamedTuple):
    """The drives' end; one element a leg."""

    heard: tuple[int, ...] = (0,) * LEGS
    """Commands so far: none is a repetition."""
    enabled: tuple[bool, ...] = (False,) * LEGS
    registers: tuple[tuple[tuple[int, float], ...], ...] = ((),) * LEGS
    """What has been written, by leg."""
    asked: tuple[tuple[int, tuple[tuple[int, int], ...]], ...] = ((0, ()),) * LEGS
    """Who wants what of each drive, in families where a query says so."""


def put(values: tuple[Any, ...], leg: int, value: Any) -> tuple[Any, ...]:
    """Return the values with another one for a leg."""
    return (*values[:leg], value, *values[leg + 1 :])


def codes_of(codes: Mapping[DriveFault, int], otherwise: int) -> list[int]:
    """Return what a drive sends for each fault of its own."""
    return [codes.get(fault, otherwise) for fault in DriveFault]


_OFFSETS: Any = DEVICES.fields


class MotorDrivesEnd(CompiledEnd):
    """Six drives. Mutable state: the record, whose memory it is."""

    def __init__(self, family: "MotorDrives", buses: Any = None) -> None:
        """Take the family, and the `SeveralBuses` on which its drives are."""
        d = np.zeros((), DEVICES)
        super().__init__(d, kernels.parse, kernels.answer, family.reporting)
        self._family, self._buses = family, buses
        d["obey"], d["encode"] = family.obey.address, family.encode.address
        d["hear"], d["ear"] = family.ear.address, data_at(family.tables)
        d["nodes"], (d["shift"], d["mask"]) = family.tables["nodes"], family.number_at
        d["everyone"], d["requests"] = family.everyone, family.requests_id
        d["watchdog_ns"], d["reaction"] = round(family.delivered_s * 1e9), family.reactions[0]
        if buses is not None:
            d["buses"], d["bus_of"] = len(buses.legs), buses.bus_of
        family.transmission.fill(d)
        first, end = (_OFFSETS[name][1] for name in ("written", "scratch"))
        self._rest = d.reshape(1).view(np.uint8)[first:end]
        """The bytes of what is written and asked, and what they were when it was put in or taken out last."""
        self._put, self._registers, self._asked = b"", MotorMemory().registers, MotorMemory().asked
        self.memory = family.power_up() if buses is None else buses.power_up()

    @property
    def memory(self) -> Any:
        """`MotorMemory`, on several buses one a bus."""
        d: Any = self.record
        if self._rest.tobytes() != self._put:
            self._put = self._rest.tobytes()
            self._registers = tuple(
                tuple(zip(d["registers"][leg, :n].tolist(), d["values"][leg, :n].tolist(), strict=True))
                for leg, n in enumerate(d["written"].tolist())
            )
            self._asked = tuple(
                (host, tuple(zip(d["wanted"][leg, :n].tolist(), d["widths"][leg, :n].tolist(), strict=True)))
                for leg, (host, n) in enumerate(zip(d["host"].tolist(), d["asked"].tolist(), strict=True))
            )
        heard, enabled = tuple(d["heard"].tolist()), tuple(map(bool, d["enabled"].tolist()))
        memory = MotorMemory(heard, enabled, self._registers, self._asked)
        return memory if self._buses is None else (memory,) * len(self._buses.legs)

    @memory.setter
    def memory(self, memory: Any) -> None:
        d: Any = self.record
        if self._buses is not None:
            of = [memory[bus] for bus in self._buses.bus_of]
            memory = MotorMemory(*(tuple(each[k][leg] for leg, each in enumerate(of)) for k in range(4)))
        d["heard"], d["enabled"] = memory.heard, memory.enabled
        same = memory.registers is self._registers and memory.asked is self._asked
        if same and self._rest.tobytes() == self._put:
            return
        for leg in range(LEGS):
            d["written"][leg] = len(memory.registers[leg])
            for k, (register, value) in enumerate(memory.registers[leg]):
                d["registers"][leg, k], d["values"][leg, k] = register, value
            d["host"][leg], wanted = memory.asked[leg]
            d["asked"][leg] = len(wanted)
            for k, (register, width) in enumerate(wanted):
                d["wanted"][leg, k], d["widths"][leg, k] = register, width
        self._registers, self._asked, self._put = memory.registers, memory.asked, self._rest.tobytes()

    def reason(self, why: int, _counter: int, number: float, frame: Frame) -> str:
        """Return why a frame is rejected, in the family's words."""
        identifier, data, _ = frame
        return self._family.rejections[why - 1].format(number, size=len(data), kind=identifier & 0x1F)

    def hearing(self) -> Hearing:
        """Return the controller's end, as far as it hears."""
        return Hearing(
            kernels.fresh.address,
            kernels.addressed.address,
            self.context,
            self._family.feedback_by_leg,
            self,
        )


class MotorDrives(ABC):
    """What the drives' ends of all families share. Holds tables, and an end for callers in Python."""

    obey: Pointed
    encode: Pointed
    ear: Pointed
    """The family's functions: see `drivers.motor_device_kernels` and `drivers.motor_kernels`."""
    reporting = kernels.silent
    number_at: tuple[int, int]
    """Where an identifier has the number of a drive, and its bits there."""
    everyone = requests_id = -1
    """The number of all drives; the identifier of requests whose data name a drive. -1: there is none."""
    delivered_s = 1e6
    """The watchdog of a drive as it is delivered."""
    rejections: tuple[str, ...]
    """Why a frame is rejected, by the number of its kernel: of the number that is wrong, size and kind."""
    reactions: tuple[Reaction, ...] = (Reaction.BRAKE,)
    feedback_by_leg = tuple(range(LEGS))
    """Legs, as answers of several drives may share an identifier or change it; else identifiers."""

    def __init__(self, transmission: Transmission, tables: Record) -> None:
        """Take the transmission, and what `ear` works on."""
        self.transmission, self.tables = transmission, tables

    @cached_property
    def _end(self) -> MotorDrivesEnd:
        return MotorDrivesEnd(self)

    def drives_end(self, buses: Any = None) -> MotorDrivesEnd | None:
        """Return the drives' end by address, powered up; None for a protocol that changes it."""
        own = all(getattr(type(self), name) is vars(MotorDrives)[name] for name in _METHODS)
        return MotorDrivesEnd(self, buses) if own else None

    def hearing(self, buses: Any = None) -> Hearing | None:
        """Return the controller's end by address, as far as it hears; None as `drives_end`."""
        end = self.drives_end(buses)
        return None if end is None else end.hearing()

    def addressed(self, frame: Frame) -> tuple[int, ...]:
        """Return the legs that a frame of the controller's end is for."""
        legs = kernels.addressed(self._end.record, sent_array([frame]))
        return tuple(leg for leg in range(LEGS) if legs >> leg & 1)

    def power_up(self) -> MotorMemory:
        """Return the memory of six drives that have heard nothing."""
        return MotorMemory()

    def parse(self, memory: MotorMemory, frame: Frame) -> tuple[MotorMemory, tuple[DeviceMessage, ...]]:
        """Decode at the drives' end."""
        end = self._end
        end.memory = memory
        messages = end.messages(frame)
        return self.converse(memory, frame) if messages is None else (end.memory, messages)

    def converse(self, memory: MotorMemory, frame: Frame) -> tuple[MotorMemory, tuple[DeviceMessage, ...]]:
        """Decode what is not compiled: what sets drives up, asks who they are or stops them."""
        raise NotImplementedError

    def answer(
        self,
        memory: MotorMemory,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        fault: Ints | None = None,
    ) -> tuple[MotorMemory, list[tuple[int, Frame]]]:
        """Encode what the drives of `sync.legs` answer; see `DriveProtocol.answer`."""
        self._end.memory = memory
        frames = self._end.answers(sync, length, rate, force, state, fault)
        if frames is not None:
            return memory, frames
        t = self.transmission
        values = np.stack([t.turns(length), t.turns_per_s(rate), t.torque(force, rate)], axis=1).tolist()
        leg = next(leg for leg in sync.legs if not all(map(isfinite, values[leg])))
        raise ProtocolError(f"feedback of leg {leg} is not a number: {tuple(values[leg])}")

    def report(self, memory: MotorMemory, status: Status) -> tuple[MotorMemory, tuple[Frame, ...]]:
        """Encode what a drive says unasked of its state."""
        return memory, self._end.reports(status) or ()

    def restarted(self, memory: MotorMemory, legs: Sequence[int]) -> MotorMemory:
        """Return the memory with drives that were switched off and on: disabled, nothing written in them."""
        fresh = self.power_up()
        for leg in legs:
            parts = zip(memory, fresh, strict=True)
            memory = MotorMemory(*(put(now, leg, new[leg]) for now, new in parts))
        return memory

    def example_feedbacks(self) -> list[Frame]:
        """Return the feedbacks of six running drives at rest at position zero."""
        zeros, running = np.zeros(LEGS), np.full(LEGS, DriveState.RUN, np.int64)
        length = self.transmission.length(zeros)
        _, frames = self.answer(self.power_up(), Sync(0), length, zeros, zeros, running)
        return [frame for _, frame in frames]


_METHODS = ("parse", "answer", "report")
