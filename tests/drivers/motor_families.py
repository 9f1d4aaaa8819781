"""The families of single-motor drives by value, and the content of one frame of such a drive."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from drivers import motor_kernels as kernels
from drivers.compiled.pointed import data_at
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.controller_end import ControllerEnd
from drivers.frame_array import FRAME, received_array, sent_frames
from drivers.frame_pointers import code, value
from drivers.mit.fields import TURN, VARIANTS, Ranges
from drivers.moteus import read as read_subframes
from drivers.motor_kernels import ANSWER, BROKEN, FEEDBACK, FOREIGN, MOTION, POWER, TORQUE
from drivers.protocol import ALWAYS, BRS, EXTENDED, FD, DriveSetup, Frame, Received
from drivers.registry import loaded
from drivers.signals import LEGS, DriveState, Reaction
from drivers.tick_columns import Record, new_record
from drivers.transmission import Transmission
from hil.contracts.by_value import ByValue, Remembered
from hil.contracts.drives_end import memory_of, plain
from hil.contracts.messages import Sync
from plant_fmu.drives.codec import DrivesEnd

GEAR = Transmission(TransmissionSettings(lead_m=0.1, sign=[1, -1, 1, -1, 1, -1], offset_m=1.75))
UNIT = Transmission(TransmissionSettings(lead_m=1.0))
UNLIKE_GEAR = TransmissionSettings(
    lead_m=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
    gear_ratio=[1.0, 2.0, 3.0, 4.0, 5.0, 7.0],
    sign=[1, -1, 1, -1, 1, -1],
    efficiency=0.8,
    back_driving_efficiency=0.5,
    full_loss_m_s=0.1,
    offset_m=[1.1, 1.2, 1.3, 1.4, 1.5, 1.6],
)
UNLIKE = Transmission(UNLIKE_GEAR)
RANGES = Ranges(95.5, 400.0, 144.0)
"""Wide enough for the contract's legs of 1.5 to 2 m and 6 kN with a lead of 0.1 m."""
ALL_NODES = (1, 2, 3, 4, 5, 6)
MIT_NODES = (1, 2, 3, 4, 5, 15)
ROBSTRIDE_NODES = (1, 2, 3, 4, 5, 127)
ODRIVE_NODES = (0, 1, 2, 3, 5, 62)
MOTEUS_NODES = (1, 2, 3, 4, 5, 126)


class Heard(NamedTuple):
    """Content of one frame of a drive; None and False: not in this frame.

    Motion in turns and turns/s, torque in N m, power as DriveState OFF (disabled), RUN (enabled) or FAULT,
    fault as DriveFault or the family's own code, answer as register and value of the start-up dialogue.
    """

    leg: int
    broken: bool = False
    foreign: bool = False
    motion: tuple[float, float] | None = None
    feedback: bool = False
    torque: float | None = None
    power: int | None = None
    fault: int = 0
    answer: tuple[int, float] | None = None


class MotorMemory(Remembered):
    @property
    def asked(self) -> tuple[tuple[int, tuple[tuple[int, int], ...]], ...]:
        """For each drive, the host that requests registers, and these registers with their widths."""
        d = self.state
        return tuple(
            (host, tuple(zip(d["wanted"][leg, :n].tolist(), d["widths"][leg, :n].tolist(), strict=True)))
            for leg, (host, n) in enumerate(zip(d["host"].tolist(), d["asked"].tolist(), strict=True))
        )


def last_tick(number: int = 12, age: int | list[int] = 0) -> Record:
    """Measurement of the tick before, with different numbers for each leg."""
    last = new_record()
    last["tick"], last["age"] = number, age
    last["length"] = [2.1, 2.2, 2.3, 2.4, 2.5, 2.6]
    last["rate"] = [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]
    last["drive_force"] = [11.0, 12.0, 13.0, 14.0, 15.0, 16.0]
    last["drive_state"] = [0, 1, 2, 3, 4, 1]
    last["drive_fault"] = [0, 1, 2, 3, 4, 5]
    return last


class Motors(ByValue):
    def _dialogue(self, end: ControllerEnd, setup: DriveSetup | None) -> Remembered:
        return Remembered(end.remembered(), setup, "mode")

    def _memory(self, end: DrivesEnd) -> Remembered:
        return MotorMemory(memory_of(end))

    def hear(self, frame: Frame) -> Any:
        """Content of a drive's frame as `Heard`; None for an unknown frame."""
        heard = self.protocol._heard(frame)
        if heard is None:
            return None
        leg, has, turns, speed, torque, power, fault, register, value, _ = heard.tolist()
        return Heard(
            leg,
            broken=bool(has & BROKEN),
            foreign=bool(has & FOREIGN),
            motion=(turns, speed) if has & MOTION else None,
            feedback=bool(has & FEEDBACK),
            torque=torque if has & TORQUE else None,
            power=power if has & POWER else None,
            fault=fault,
            answer=(register, value) if has & ANSWER else None,
        )

    def poll(self, dialogue: Remembered, leg: int) -> Frame:
        into = np.empty(LEGS, FRAME)
        kernels.begin(self._end(dialogue).state, 0, data_at(into))
        return sent_frames(into)[leg]


def pack_command(position: float, velocity: float, kp: float, kd: float, torque: float, r: Ranges) -> bytes:
    """Eight bytes of a command: 16, 12, 12, 12 and 12 bits, most significant first."""
    number = code(position, -r.position, r.position, 16)
    for x, low, high in (
        (velocity, -r.velocity, r.velocity),
        (kp, 0.0, 500.0),
        (kd, 0.0, 5.0),
        (torque, -r.torque, r.torque),
    ):
        number = number << 12 | code(x, low, high, 12)
    return number.to_bytes(8, "big")


def unpack_command(data: bytes, r: Ranges) -> tuple[float, float, float, float, float]:
    """Position rad, velocity rad/s, kp, kd and torque N m in the eight bytes of a command."""
    number = int.from_bytes(data, "big")
    p, *others = (
        number >> 48,
        number >> 36 & 0xFFF,
        number >> 24 & 0xFFF,
        number >> 12 & 0xFFF,
        number & 0xFFF,
    )
    ends = (-r.velocity, r.velocity), (0.0, 500.0), (0.0, 5.0), (-r.torque, r.torque)
    v, kp, kd, t = (value(x, *end, 12) for x, end in zip(others, ends, strict=True))
    return value(p, -r.position, r.position, 16), v, kp, kd, t


def made(
    protocol: str, nodes: Any, gear: Any, options: dict[str, Any], layout: Any = None, **drives: float
) -> Any:
    """Codec of such drives behind a gear, created with another gear that allows any force."""
    light = TransmissionSettings(lead_m=1e-9)
    given = DriveSettings(protocol=protocol, transmission=light, options=options)
    section = given.model_copy(update={"node_ids": list(nodes), **drives})
    bus = BusSettings(layout=layout or ("fd" if protocol == "moteus" else "classic"))
    found: Any = loaded("hil.protocols", protocol)(bus, section)
    found.transmission = gear
    return found


class MitProtocol(Motors):
    def __init__(
        self, variant: str, ranges: Ranges, nodes: Any, host: int, gear: Any, layout: str = "classic"
    ) -> None:
        model = next(iter(VARIANTS[variant].models))
        keys = dict(zip(("position_rad", "velocity_rad_s", "torque_N_m"), ranges, strict=True))
        options = {"variant": variant, "model": model, "host_id": host, **keys}
        super().__init__(made("mit", nodes, gear, options, layout))


@cache
def _mini_cheetahs(r: Ranges) -> MitProtocol:
    return MitProtocol("mini_cheetah", r, ALL_NODES, 0, UNIT)


def read_reply(data: bytes, r: Ranges) -> tuple[float, float, float]:
    """Position rad, velocity rad/s and torque N m that the controller reads in five bytes of a reply."""
    heard = _mini_cheetahs(r).hear(Frame(0, b"\1" + data))
    return heard.motion[0] * TURN, heard.motion[1] * TURN, heard.torque


class RobStrideProtocol(MitProtocol):
    def __init__(self, ranges: Ranges, nodes: Any, host: int, gear: Any) -> None:
        super().__init__("robstride", ranges, nodes, host, gear)


class ODriveProtocol(Motors):
    def __init__(self, nodes: Any, watchdog_s: float, gear: Any, unasked_s: float = 0.0) -> None:
        options = {"encoder_msg_rate_ms": round(1e3 * unasked_s)}
        super().__init__(made("odrive", nodes, gear, options, watchdog_ms=1e3 * watchdog_s))


class MoteusProtocol(Motors):
    def __init__(
        self, nodes: Any, host: int, mode: Reaction, most: float, gear: Any, *, brs: bool = True
    ) -> None:
        word = "stopped" if mode == Reaction.BRAKE else "zero_velocity"
        options = {"host_id": host, "timeout_mode": word, "torque_N_m": most, "brs": brs}
        super().__init__(made("moteus", nodes, gear, options))


def mit(variant: str, gear: Any = GEAR) -> MitProtocol:
    """Drives of a variant with 11-bit identifiers; a Damiao answers on 16 plus its number."""
    return MitProtocol(variant, RANGES, MIT_NODES, 16 if variant == "damiao" else 0, gear)


def robstride(gear: Any = GEAR) -> RobStrideProtocol:
    return RobStrideProtocol(RANGES, ROBSTRIDE_NODES, 253, gear)


def odrive(gear: Any = GEAR) -> ODriveProtocol:
    return ODriveProtocol(ODRIVE_NODES, 0.05, gear)


def moteus(gear: Any = GEAR, most_Nm: float = 1000.0) -> MoteusProtocol:
    return MoteusProtocol(MOTEUS_NODES, 0, Reaction.DAMP, most_Nm, gear)


def motors(gear: Any) -> dict[str, Any]:
    found: dict[str, Any] = {name: mit(name, gear) for name in ("mini_cheetah", "cubemars", "damiao")}
    return found | {"robstride": robstride(gear), "odrive": odrive(gear), "moteus": moteus(gear)}


MOTORS = motors(GEAR)


SINCE_NS = 1_000
LATE = SINCE_NS - 1


def sent_to(protocol: Motors, *frames: Frame, memory: Any = None) -> tuple[Remembered, list[Any]]:
    """Memory of drives after these frames, and the messages from each of them."""
    memory, found = memory or protocol.power_up(), []
    for frame in frames:
        memory, messages = protocol.parse(memory, frame)
        found.append(plain(messages))
    return memory, found


def begun(protocol: Motors, **fields: Any) -> Remembered:
    """Dialogue of drives that are set up and disabled, with changed fields."""
    start = protocol.start(DriveSetup(0.05, protocol.traits.reactions[0], 250.0))
    set_up = tuple(1 + n for n in start.exchanges)
    return start._replace(**{"done": set_up, "power": (int(DriveState.OFF),) * LEGS} | fields)


def measured(
    protocol: Motors,
    *frames: Frame | tuple[int, Frame],
    last: Record | None = None,
    number: int = 13,
    **fields: Any,
) -> tuple[Any, Remembered]:
    """Tick and dialogue after these frames; a pair has the time of a late frame, the others are in time."""
    timed: list[Any] = [each if type(each) is tuple else (SINCE_NS, each) for each in frames]
    tick = new_record()
    tick["tick"] = number
    for name in ("blind", "rejected", "doubled", "foreign"):
        tick[name] = 9
    run = received_array([Received(*each) for each in timed])
    since_ns = SINCE_NS if frames else ALWAYS
    return tick, protocol.decode(
        begun(protocol, **fields), run, last_tick() if last is None else last, tick, since_ns
    )


# subframes of moteus


_MOTEUS = moteus(UNIT, 2.0)


def asked(data: bytes) -> tuple[tuple[int, int], ...]:
    """Registers that a frame requests, each with its width."""
    memory, _ = _MOTEUS.parse(_MOTEUS.power_up(), Frame(0x8001, data, EXTENDED | FD | BRS))
    registers: tuple[tuple[int, int], ...] = memory.asked[0][1]
    return registers


def replied(
    data: bytes, turns: float = 0.5, speed: float = -1.0, torque: float = 1.5, state: int = DriveState.RUN
) -> bytes:
    memory, _ = _MOTEUS.parse(_MOTEUS.power_up(), Frame(0x8001, data, EXTENDED | FD | BRS))
    length, force = np.full(6, turns) * UNIT.m_per_turn, np.full(6, torque) * UNIT.N_per_Nm
    rate, states = np.full(6, speed) * UNIT.m_per_turn, np.full(6, state, np.int64)
    _, ((_, frame),) = _MOTEUS.answer(memory, Sync(0, (0,)), length + UNIT.offset_m, rate, force, states)
    return frame.data


def registers(data: bytes, kind: int) -> dict[int, float] | None:
    """Values in the subframes of a kind (WRITE, REPLY), NaN where unknown; None for a truncated frame."""
    names = tuple(range(0x180))
    values = np.full(len(names), np.nan)
    has = read_subframes(data, len(data), kind, names, values)
    return None if has < 0 else {name: values[name] for name in names if has >> name & 1}
