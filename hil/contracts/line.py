"""Both ends of a protocol with drives that stand somewhere, and trouble between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from drivers.arrays import Array
from drivers.config import DriveSettings
from drivers.errors import ProtocolError
from drivers.family import Family
from drivers.protocol import DriveSetup, Frame, Received
from drivers.signals import LEGS, Command, DriveMode
from hil.contracts.by_value import ByValue
from hil.contracts.ends import FORCE, LENGTH, PERIOD_NS, Ends, Given, reaction_of
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.plan import FaultPlan

RUN = Command(DriveMode.RUN, FORCE)
READY = Command(DriveMode.READY, np.zeros(LEGS))
OFF = Command(DriveMode.OFF, np.zeros(LEGS))
RESET = Command(DriveMode.RESET, np.zeros(LEGS))
CLIPS_N = 55_000.0
"""The emulated drives clip at 60 kN."""
LEG = 3
Tamper = Callable[[list[Received]], list[Received]]


class Placed(Given):
    """A plant whose legs are where they are put."""

    def __init__(self) -> None:
        self.length, self.rate = LENGTH.copy(), np.zeros(LEGS)

    def reset(self) -> tuple[Array, Array]:
        return self.length.copy(), self.rate.copy()


class Line(Ends):
    """Both ends, a plant that can be placed, and somebody between them who changes frames."""

    def __init__(self, protocol: Family | ByValue, *faults: Fault) -> None:
        super().__init__(protocol, *faults)
        self.plant = Placed()
        emulation, drives = DriveEmulation(encoder_resolution_m=0.0), DriveSettings(heartbeat_ms=24.0)
        self.nodes = Nodes(self.plant, self.protocol.protocol, emulation, drives, FaultPlan(faults))
        self.to_hear: Tamper = list
        """What happens to frames on their way to the controller."""
        self.to_obey: Callable[[Sequence[Frame]], Sequence[Frame]] = list
        """What happens to frames on their way to the drives."""

    def _to_drives(self, t_ns: int, frames: Sequence[Frame]) -> None:
        heard, self.to_controller = self.to_controller, []
        super()._to_drives(t_ns, self.to_obey(frames))
        self.to_controller = heard + self.to_hear(self.to_controller)

    def states(self) -> list[int]:
        return [int(state) for state in self.measurement["drive_state"]]

    def alone(self, ticks: int) -> None:
        """Let the drives run without a controller; their frames are lost."""
        for _ in range(ticks):
            self.tick += 1
            self._to_drives(self.tick * PERIOD_NS, ())
        self.to_controller.clear()

    def begin_anew(self) -> None:
        """Put another controller in the place of this one."""
        rate_Hz = 1e9 / PERIOD_NS
        self.dialogue = self.protocol.start(DriveSetup(0.05, reaction_of(self.protocol), rate_Hz))
        self.to_controller.clear()

    def recover(self) -> None:
        """Reset, park and set up, as the next run does with --reset."""
        for command in [OFF] * 3 + [RESET] * self.protocol.traits.reset_ticks:
            self.step(command)
        self.until_set_up()


def most_force(protocol: ByValue) -> float:
    """Return the largest force that a command takes."""
    dialogue, low, high = Ends(protocol).dialogue, 0.0, 2 * CLIPS_N
    for _ in range(50):
        middle = 0.5 * (low + high)
        try:
            protocol.command(dialogue, Command(DriveMode.RUN, np.full(LEGS, middle)), 0)
        except ProtocolError:
            high = middle
        else:
            low = middle
    return low
