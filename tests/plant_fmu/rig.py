"""Six emulated drives in front of six free masses: the controller's end, and motion in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.config import DriveSettings
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import Frame, Received
from drivers.signals import Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, new_record
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import WrenchStep
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant
from tests.drivers.legs_frames import command_frames, decode, opening

MS, US = 1_000_000, 1_000
MASS = 200.0
REST = np.array([1.5, 1.6, 1.7, 1.8, 1.9, 2.0])


class Masses(Plant):
    """m ddq = f + wrench; an engaged brake holds. Exact for constant inputs at any step."""

    internal_step_s = 1e-4

    def __init__(self) -> None:
        self.calls: list[tuple[float, list[float], list[float]]] = []
        self.reset()

    def reset(self) -> tuple[Array, Array]:
        self.q, self.dq = REST.copy(), np.zeros(6)
        return self.q, self.dq

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        self.calls.append((dt_s, force.tolist(), brake.tolist()))
        ddq = (force + wrench) / MASS
        free = brake == 0
        self.q = np.where(free, self.q + self.dq * dt_s + ddq * dt_s**2 / 2, self.q)
        self.dq = np.where(free, self.dq + ddq * dt_s, 0.0)
        return self.q, self.dq


class Rig:
    """The controller's end: sends, collects, decodes."""

    def __init__(
        self,
        layout: str = "fd",
        *,
        faults: Sequence[Fault] = (),
        reaction: Reaction = Reaction.BRAKE,
        emulation: DriveEmulation | None = None,
        t0_ns: int = 0,
    ) -> None:
        self.protocol = LegsProtocol(layout, (1, 2, 3, 4, 5, 6))
        self.plant = Masses()
        exact = DriveEmulation(encoder_resolution_m=0.0)
        self.nodes = Nodes(self.plant, self.protocol, emulation or exact, DriveSettings(), FaultPlan(faults))
        self.nodes.start(t0_ns)
        self.t0 = t0_ns
        self.tick = 0
        self.reaction = reaction
        self.measurement = new_record()

    def at(self, t_ns: int, *frames: Frame) -> list[tuple[int, Frame]]:
        """Advance to t0 + t_ns, with frames arriving at that instant."""
        t = self.t0 + t_ns
        return self.nodes.step(t, [Received(t, frame) for frame in frames])

    def sync(self, t_ns: int) -> Record:
        self.tick += 1
        sent = self.at(t_ns, *opening(self.protocol, self.tick))
        received = [Received(t, frame) for t, frame in sent]
        self.measurement = decode(self.protocol, received, self.tick, self.measurement)
        return self.measurement

    def command(
        self, t_ns: int, mode: DriveMode, force: float | Sequence[float] = 0.0
    ) -> list[tuple[int, Frame]]:
        self.tick += 1
        command = Command(mode, np.array(np.broadcast_to(force, 6), float))
        sync = opening(self.protocol, self.tick)
        return self.at(t_ns, *sync, *command_frames(self.protocol, command, self.tick))

    def configure(self, watchdog_s: float = 0.01) -> None:
        self.at(0, *self.protocol.configure(watchdog_s, self.reaction))

    def run(self, force: float | Sequence[float] = 0.0) -> None:
        """Take the drives from boot to RUN at t = 0."""
        self.configure()
        self.command(0, DriveMode.READY)
        self.command(0, DriveMode.RUN, force)

    @property
    def states(self) -> list[int]:
        return [int(state) for state in self.nodes.snapshot().state]

    @property
    def brakes(self) -> list[float]:
        return [float(brake) for brake in self.nodes.snapshot().brake]


def push(newton: float, **when: Any) -> WrenchStep:
    """Push every mass with a constant force, as gravity does."""
    return WrenchStep(force_N=(newton,) * 3, moment_N_m=(newton,) * 3, **when)


def starve(reaction: Reaction, *, seconds: float, load: float = 0.0) -> tuple[Rig, float]:
    """Accelerate for 10 ms at 10 m/s^2, then send nothing: 0.1 m/s at the fault."""
    rig = Rig(reaction=reaction, faults=[push(load, at_s=0.01)] if load else [])
    rig.run(10.0 * MASS)
    rig.at(10 * MS + 1)
    assert rig.states == [DriveState.FAULT] * 6
    rig.at(10 * MS + round(seconds * 1e9))
    return rig, 0.5 * 10.0 * 0.01**2


def accelerating(*faults: Fault, layout: str = "ideal") -> Rig:
    """Six drives in RUN, each mass accelerating by 10 m/s^2 from 0 s on."""
    rig = Rig(layout, faults=faults)
    rig.run(10 * MASS)
    return rig


def motion(t_ms: float) -> tuple[float, float]:
    t = 1e-3 * t_ms
    return 0.5 * 10 * t * t, 10 * t


def read(rig: Rig, t_ms: int, leg: int = 2) -> tuple[float, float]:
    found = rig.sync(t_ms * MS)
    return float(found["length"][leg] - REST[leg]), float(found["rate"][leg])
