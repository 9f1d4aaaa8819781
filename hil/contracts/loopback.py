"""Both ends of a drive protocol connected tick by tick, without bit time, for tests."""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drivers.arrays import Array, Rows
from drivers.config import DriveSettings
from drivers.errors import ProtocolError
from drivers.family import Family
from drivers.frame_array import received_array
from drivers.protocol import ALWAYS, DriveSetup, Frame, Received
from drivers.signals import LEGS, Command, DriveMode, DriveState, Reaction
from drivers.tick_columns import Record, copy_of, new_record
from hil.contracts.by_value import ByValue, Remembered
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.plant import Plant

PERIOD_NS = 4_000_000
SETUP = DriveSetup(0.05, Reaction.DAMP, 1e9 / PERIOD_NS)
LENGTH = np.array([1.5, 1.6, 1.7, 1.8, 1.9, 2.0])
RATE = np.array([0.25, -0.25, 0.5, -0.5, 0.75, -0.75])
FORCE = np.array([1000.0, -2000.0, 3000.0, 4.0, -60.0, 0.0])
RUN = Command(DriveMode.RUN, FORCE)
READY = Command(DriveMode.READY, np.zeros(LEGS))
OFF = Command(DriveMode.OFF, np.zeros(LEGS))
RESET = Command(DriveMode.RESET, np.zeros(LEGS))
LEG = 3
CLIPS_N = 55_000.0
"""Force, N, that no emulated drive limits; they limit at 60 kN."""
BEAT_TICKS = 6
"""Ticks between two heartbeats of a drive."""
PATIENCE = 200
"""Ticks within which a dialogue without lost frames ends."""


class Placed(Plant):
    """Plant whose leg lengths and rates stay as the test sets them, whatever the forces."""

    internal_step_s = 1e-4

    def __init__(self, rate: Array) -> None:
        self.length, self.rate = LENGTH.copy(), rate.copy()

    def reset(self) -> tuple[Array, Array]:
        return self.length.copy(), self.rate.copy()

    def step(self, _force: Array, _brake: Array, _wrench: Array, _dt_s: float) -> tuple[Array, Array]:
        return self.reset()


class Twice(ByValue):
    """Protocol that makes each call twice, and checks that results are equal and inputs unchanged."""

    def decode(
        self, dialogue: Remembered, frames: Rows, last: Record, tick: Record, since_ns: int = ALWAYS
    ) -> Remembered:
        """Decode the same frames twice, into the tick and a copy, and compare both."""
        given, other = (dialogue, frames, last), copy_of(tick)
        before = pickle.dumps(given)
        first = super().decode(*given, other, since_ns)
        again = super().decode(*given, tick, since_ns)
        assert pickle.dumps(given) == before
        assert (pickle.dumps(first), other.tobytes()) == (pickle.dumps(again), tick.tobytes())
        return again


def _checked(name: str) -> Callable[..., Any]:
    method = getattr(ByValue, name)

    def call(*given: Any) -> Any:
        before = pickle.dumps(given[1:])
        first = pickle.dumps(method(*given))
        again = method(*given)
        assert pickle.dumps(given[1:]) == before
        assert pickle.dumps(again) == first
        return again

    return call


for _name in ("begin", "command", "set_up", "legs_set_up", "set_up_lacks"):
    setattr(Twice, _name, _checked(_name))


def at_tick(tick: int) -> Any:
    """Record of tick number `tick` before any feedback."""
    record = new_record()
    record["tick"] = tick
    return record


def reaction_of(protocol: Family | ByValue) -> Reaction:
    """Reaction to a silent controller used in tests: DAMP, or the protocol's first one if it lacks DAMP."""
    return Reaction.DAMP if Reaction.DAMP in protocol.traits.reactions else protocol.traits.reactions[0]


class Ends:
    """Controller's end and drives' end of one protocol. State: both ends, and the frames between them."""

    def __init__(self, protocol: Family | ByValue, *faults: Fault, rate: Array = RATE) -> None:
        """Connect both ends of a protocol; the drives inject `faults` and measure the leg rates (6,) m/s."""
        self.protocol, self.plant = ByValue.of(protocol), Placed(rate)
        settings = DriveSettings(heartbeat_ms=1e-6 * BEAT_TICKS * PERIOD_NS)
        emulation = DriveEmulation(encoder_resolution_m=0.0)
        self.nodes = Nodes(self.plant, self.protocol.protocol, emulation, settings, FaultPlan(faults))
        self.to_hear: Callable[[list[Received]], list[Received]] = list
        """Function that may change the frames on their way to the controller."""
        self.to_obey: Callable[[Sequence[Frame]], Sequence[Frame]] = list
        """Function that may change the frames on their way to the drives."""
        self.dialogue = self.protocol.start(SETUP._replace(reaction=reaction_of(protocol)))
        self.measurement = new_record()
        self.tick = -1
        self.to_controller: list[Received] = []
        self.opening: tuple[Frame, ...] = ()
        self.sent: tuple[Frame, ...] = ()
        self.set_up: tuple[Frame, ...] = ()
        self.received: list[Received] = []

    def step(
        self, command: Command = OFF, *, set_up: bool = True, first: Sequence[Frame] = ()
    ) -> tuple[Frame, ...]:
        """Run one tick; return its set-up frames. The frames `first` are sent before the command."""
        self.tick += 1
        t_ns, protocol = self.tick * PERIOD_NS, self.protocol
        self.opening = protocol.begin(self.dialogue, self.tick)
        self._to_drives(t_ns + 100_000, self.opening)
        self.received, self.to_controller = self.to_controller, []
        last, self.measurement = self.measurement, at_tick(self.tick)
        self.dialogue = protocol.decode(
            self.dialogue, received_array(self.received), last, self.measurement, t_ns
        )
        self.dialogue, self.sent = protocol.command(self.dialogue, command, self.tick)
        self.set_up = ()
        if set_up:
            self.dialogue, self.set_up = protocol.set_up(self.dialogue, self.measurement)
        self._to_drives(t_ns + 2_000_000, (*first, *self.sent, *self.set_up))
        return self.set_up

    def _to_drives(self, t_ns: int, frames: Sequence[Frame]) -> None:
        replies = self.nodes.step(t_ns, [Received(t_ns, frame) for frame in self.to_obey(frames)])
        self.to_controller += self.to_hear([Received(t, frame) for t, frame in replies])

    def states(self) -> list[int]:
        return [int(state) for state in self.measurement["drive_state"]]

    def alone(self, ticks: int) -> None:
        """Run the drives for some ticks without a controller, which loses their frames."""
        for _ in range(ticks):
            self.tick += 1
            self._to_drives(self.tick * PERIOD_NS, ())
        self.to_controller.clear()

    def replace_controller(self) -> None:
        """Replace the controller by a new one that has not yet sent anything."""
        self.dialogue = self.protocol.start(SETUP._replace(reaction=reaction_of(self.protocol)))
        self.to_controller.clear()

    def recover(self) -> None:
        """Switch the drives off, reset their faults and set them up, as the next run with --reset does."""
        for command in [OFF] * 3 + [RESET] * self.protocol.traits.reset_ticks:
            self.step(command)
        self.until_set_up()

    def until_set_up(self, legs: Sequence[int] = range(LEGS)) -> None:
        """Run ticks until the drives of `legs` are set up and off; AssertionError after PATIENCE ticks."""
        for _ in range(PATIENCE):
            self.step()
            there = self.protocol.legs_set_up(self.dialogue)
            if all(there[leg] and self.measurement["drive_state"][leg] == DriveState.OFF for leg in legs):
                return
        raise AssertionError(f"not set up: {self.measurement}")

    @property
    def report_ticks(self) -> int:
        """Ticks within which drives change and report their state: at once, or by the next heartbeat."""
        return 3 + BEAT_TICKS * int(self.protocol.traits.power_told == "heartbeat")

    def restart(self, force: Array = FORCE) -> None:
        """Bring drives that are set up to the state RUN, with force commands (6,) N."""
        for mode in (DriveMode.READY, DriveMode.RUN):
            for _ in range(self.report_ticks):
                self.step(Command(mode, force), set_up=False)
        assert self.measurement["drive_state"].tolist() == [DriveState.RUN] * LEGS

    def running(self, force: Array = FORCE) -> None:
        """Set the drives up and bring them to the state RUN, with force commands (6,) N."""
        self.until_set_up()
        self.restart(force)


class Line(Ends):
    """Controller's end and drives' end of one protocol, with legs at rest."""

    def __init__(self, protocol: Family | ByValue, *faults: Fault) -> None:
        super().__init__(protocol, *faults, rate=np.zeros(LEGS))


def most_force(protocol: ByValue) -> float:
    """Largest force, N, that a command of this protocol accepts, at most 110 kN."""
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


def shapes(frames: Sequence[Frame], *, named: bool) -> Counter[tuple[int, int, int]]:
    """Number of frames of each (identifier, data length, flags); without `named` the identifier is 0."""
    return Counter((frame.id if named else 0, len(frame.data), frame.flags) for frame in frames)
