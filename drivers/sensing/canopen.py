"""CANopen sensors: encoders and linear sensors of CiA 406, measuring devices of CiA 404.

The PDO is read by its place, not by its mapping: makers deviate from the profiles' default mappings. A device
is set up by expedited SDO in PRE-OPERATIONAL, where all devices allow it, and then started by NMT.
"""

from struct import pack
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator
from pydantic import Field as Key

from drivers.errors import ConfigurationError
from drivers.protocol import Frame
from drivers.section import PerLeg, of_leg
from drivers.sensing.family import Device, Field, Message, Timed, Wanted
from drivers.sensing.layout import FLOAT, SIGNED, UNSIGNED

_FORMATS = {
    "int16": (16, SIGNED), "uint16": (16, UNSIGNED), "int32": (32, SIGNED), "uint32": (32, UNSIGNED),
    "float32": (32, FLOAT),
}  # fmt: skip
_START, _PREPARE = 0x01, 0x80
"""NMT commands: to OPERATIONAL, to PRE-OPERATIONAL."""
_TYPES = {"sync": 1, "cyclic": 254, "change": 255}
"""Trigger -> transmission type of CiA 301: every SYNC, by event timer, by the device."""
_TIMERS = {"cyclic": (5, 1e3), "change": (3, 1e4)}
"""Trigger -> subindex of the event timer or inhibit time in the PDO's parameters, and 1 / its unit, Hz."""
_LONGEST, _ROUNDING = 0xFFFF, 0.01
"""Largest value of a timer; largest relative error of its period. A timer of 0 is off."""


def _not_0(value: PerLeg) -> PerLeg:
    if 0.0 in (value if isinstance(value, list) else [value]):
        raise ValueError("0 has no inverse, allowed: any other number")
    return value


PerLegNot0 = Annotated[PerLeg, AfterValidator(_not_0)]
Format = Literal["int16", "uint16", "int32", "uint32", "float32"]


def written(node: int, index: int, sub: int, value: int, size: int) -> Frame:
    """Expedited SDO download of `size` bytes to an object (CiA 301)."""
    command = 0x23 | (4 - size) << 2
    return Frame(0x600 + node, pack("<BHBI", command, index, sub, value))


class CanopenSensor(Timed):
    """Section `device` of a CANopen sensor with one value in a PDO."""

    measures: ClassVar[str]
    """Its role."""
    pdo: Annotated[int, Key(ge=1, le=4)] = 1
    """TPDO that carries the value; its identifier is the default one, 0x80 + 0x100 pdo + node."""
    first_byte: Annotated[int, Key(ge=0, le=7)] = 0
    """Place of the value in the PDO."""
    trigger: Literal["sync", "cyclic", "change"] = "sync"
    """`sync`: sampled at every SYNC. `cyclic`: every 1 / rate_Hz by the device's clock. `change`: when the
    value has changed, at most every 1 / rate_Hz."""
    set_up: bool = True
    """Write transmission type and timer of the PDO. False: the device keeps its own, and is only started."""

    def value(self, wanted: Wanted, form: Format, scale: PerLeg, offset: PerLeg) -> Device:
        """Device with one value of a leg."""
        if wanted.role != self.measures:
            raise ConfigurationError(f"protocol: measures {self.measures}, given: {wanted.role}")
        bits, kind = _FORMATS[form]
        if 8 * self.first_byte + bits > 64:
            raise ConfigurationError(
                f"first_byte: a value of {bits // 8} bytes does not fit into the 8 of a PDO there, allowed: "
                f"at most {8 - bits // 8}, given: {self.first_byte}"
            )
        factors = of_leg(scale, wanted.leg), of_leg(offset, wanted.leg)
        field = Field(0, 8 * self.first_byte, bits, *factors, kind)
        identifier = 0x080 + 0x100 * self.pdo + wanted.node
        return self.timed(
            "sync" if self.trigger == "sync" else "free",
            messages=(Message(identifier, self.first_byte + bits // 8, (field,)),),
            start=tuple(self._start(wanted.node, wanted.rate_Hz)),
            changes=self.trigger == "change",
        )

    def _start(self, node: int, rate_Hz: float) -> list[Frame]:
        frames = []
        if self.set_up:
            parameters = 0x1800 + self.pdo - 1
            type_ = written(node, parameters, 2, _TYPES[self.trigger], 1)
            frames = [Frame(0, bytes([_PREPARE, node])), type_]
            if self.trigger in _TIMERS:
                sub, unit_Hz = _TIMERS[self.trigger]
                count = round(unit_Hz / rate_Hz)
                if not 1 <= count <= _LONGEST or abs(count * rate_Hz / unit_Hz - 1.0) > _ROUNDING:
                    raise ConfigurationError(
                        f"trigger: {self.trigger} at {rate_Hz:g} Hz is not a whole number of the timer's "
                        f"{1e3 / unit_Hz:g} ms, allowed: rate_Hz {unit_Hz:g} / n with n from 1 to {_LONGEST}"
                    )
                frames.append(written(node, parameters, sub, count, 2))
        return [*frames, Frame(0, bytes([_START, node]))]


class Cia406Sensor(CanopenSensor):
    """Encoders and linear sensors of CiA 406: absolute, draw-wire, magnetostrictive."""

    protocol: Literal["cia406"]
    measures = "lengths"
    format: Literal["uint32", "int32", "uint16", "int16"] = "uint32"
    """Of the position: 0x6004 is uint32; 0x6020:1 of linear sensors is int32."""
    step_m: PerLegNot0
    """Leg length per step, < 0 if the position falls as the leg extends."""
    zero_m: PerLeg = 0.0
    """Leg length, joint centre to joint centre, at position 0."""

    def device(self, wanted: Wanted) -> Device:
        """Messages of one leg's sensor."""
        return self.value(wanted, self.format, self.step_m, self.zero_m)


class Cia404Sensor(CanopenSensor):
    """Measuring devices of CiA 404: load cells."""

    protocol: Literal["cia404"]
    measures = "forces"
    format: Format = "float32"
    """Of the process value: 0x6130 is float32, 0x7130 int16, 0x9130 int32."""
    scale_N: PerLegNot0 = 1.0
    """Force per unit of the process value; < 0 for a load cell that reads compression as < 0."""
    zero_N: PerLeg = 0.0
    """Force at process value 0."""

    def device(self, wanted: Wanted) -> Device:
        """Messages of one leg's load cell."""
        return self.value(wanted, self.format, self.scale_N, self.zero_N)
