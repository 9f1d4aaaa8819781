"""What an emulated moteus is asked for by a frame, and what it answers."""

from __future__ import annotations

import numpy as np

from drivers.moteus import read
from drivers.protocol import BRS, EXTENDED, FD, Frame
from drivers.signals import DriveState
from hil.contracts.messages import Sync
from tests.drivers.motor_families import UNIT, moteus

P = moteus(UNIT, 2.0)


def asked(data: bytes) -> tuple[tuple[int, int], ...]:
    """Return the registers that a frame asks for, each with its width."""
    memory, _ = P.parse(P.power_up(), Frame(0x8001, data, EXTENDED | FD | BRS))
    registers: tuple[tuple[int, int], ...] = memory.asked[0][1]
    return registers


def replied(
    data: bytes, turns: float = 0.5, speed: float = -1.0, torque: float = 1.5, state: int = DriveState.RUN
) -> bytes:
    """Return what a drive answers to a frame."""
    memory, _ = P.parse(P.power_up(), Frame(0x8001, data, EXTENDED | FD | BRS))
    length, force = np.full(6, turns) * UNIT.m_per_turn, np.full(6, torque) * UNIT.N_per_Nm
    rate, states = np.full(6, speed) * UNIT.m_per_turn, np.full(6, state, np.int64)
    _, ((_, frame),) = P.answer(memory, Sync(0, (0,)), length + UNIT.offset_m, rate, force, states)
    return frame.data


def registers(data: bytes, kind: int) -> dict[int, float] | None:
    """Return what the subframes of a kind (WRITE, REPLY) hold, NaN for what is not known; None: not whole."""
    names = tuple(range(0x180))
    values = np.full(len(names), np.nan)
    has = read(data, len(data), kind, names, values)
    return None if has < 0 else {name: values[name] for name in names if has >> name & 1}
