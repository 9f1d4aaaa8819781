"""The drives' end of the families of single-motor drives, compiled in `drivers.motor_device_kernels`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np

from drivers import motor_device_kernels as kernels
from drivers.arrays import Array
from drivers.compiled.pointed import data_at
from drivers.ends import CompiledDrives, Hearing
from drivers.errors import ProtocolError
from drivers.motor_device_kernels import DEVICES
from drivers.protocol import DeviceMessage, Frame, Sync, off_bus
from drivers.signals import DriveFault
from drivers.tick_columns import Record

_MEMORY = ("heard", "enabled", "written", "registers", "values", "host", "asked", "wanted", "widths")


def codes_of(codes: Mapping[DriveFault, int], otherwise: int) -> list[int]:
    """Return what a drive sends for each fault of its own."""
    return [codes.get(fault, otherwise) for fault in DriveFault]


def written(d: Record, leg: int) -> dict[int, float]:
    """Return the registers of a leg's drive that have been written."""
    n = int(d["written"][leg])
    return dict(zip(d["registers"][leg, :n].tolist(), d["values"][leg, :n].tolist(), strict=True))


def put_written(d: Record, leg: int, registers: Mapping[int, float]) -> None:
    """Put the registers of a leg's drive that have been written."""
    d["written"][leg] = len(registers)
    for k, (register, value) in enumerate(registers.items()):
        d["registers"][leg, k], d["values"][leg, k] = register, value


class MotorDrivesEnd(CompiledDrives):
    """Six drives. Mutable state: the record."""

    def __init__(self, family: Any) -> None:
        """Power the drives of a `drivers.motors.MotorProtocol` up."""
        d: Any = np.zeros((), DEVICES)
        super().__init__(d, kernels.parse, kernels.answer, family.reporting)
        self._family = family
        d["obey"], d["encode"] = family.obey.address, family.encode.address
        d["hear"], d["ear"] = family.ear.address, data_at(family.tables)
        d["nodes"], (d["shift"], d["mask"]) = family.tables["nodes"], family.number_at
        d["everyone"], d["requests"] = family.everyone, family.requests_id
        d["watchdog_ns"], d["reaction"] = round(family.delivered_s * 1e9), family.reactions[0]
        d["buses"], d["bus_of"] = family.buses, family.bus_of
        family.transmission.fill(d)
        family.power_up(d)

    def reason(self, why: int, _counter: int, number: float, frame: Frame) -> str:
        """Return why a frame is rejected, in the family's words."""
        identifier, data, _ = frame
        reason: str = self._family.rejections[why - 1]
        return reason.format(number, size=len(data), kind=identifier & 0x1F)

    def converse(self, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Let the family decode what sets drives up, asks who they are or stops them."""
        legs: tuple[int, ...] = self._family.addressed(frame)
        leg = legs[0] if legs else None
        messages: tuple[DeviceMessage, ...] = self._family.converse(self.record, leg, off_bus(frame))
        return messages

    def no_number(self, sync: Sync, length: Array, rate: Array, force: Array) -> ProtocolError:
        """Return what of a reading is not a number, as turns, turns/s and N m."""
        t = self._family.transmission
        values = np.stack([t.turns(length), t.turns_per_s(rate), t.torque(force, rate)], axis=1).tolist()
        leg = next(leg for leg in sync.legs if not all(map(isfinite, values[leg])))
        return ProtocolError(f"feedback of leg {leg} is not a number: {tuple(values[leg])}")

    def restart(self, legs: Sequence[int]) -> None:
        """Disable drives that were switched off and on, with nothing written in them."""
        fresh = np.zeros((), DEVICES)
        self._family.power_up(fresh)
        for name in _MEMORY:
            self.record[name][list(legs)] = fresh[name][list(legs)]

    def hearing(self) -> Hearing:
        """Return the controller's end, as far as it hears."""
        fresh, addressed = kernels.fresh.address, kernels.addressed.address
        return Hearing(fresh, addressed, self.context, self._family.feedback_by_leg, self)
