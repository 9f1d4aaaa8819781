"""A cycle with six drives on locked legs, and helpers that set up its state for tests."""

from __future__ import annotations

from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np

from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.signals import DriveMode, DriveState, Mode
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.config.reference import LiveReference
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, DeviceCommand, EmergencyStop, Status
from hil.contracts.records import record_of
from hil.loop.cycle import Cycle
from hil.loop.story.narrator import Narrator
from hil.robot.kinematics import leg_lengths
from hil.signals import Operator, Order, SetPoint, TickInput
from tests.drivers.legs_frames import one_feedback, parse
from tests.live_reference import LIVE_REFERENCE

PERIOD_NS = 1_000_000
VIRTUAL = load("virtual")
BRISK = VIRTUAL.engage.model_copy(
    update={"force_ramp_s": 0.02, "brake_release_s": 0.005, "brake_close_s": 0.005, "blend_s": 0.05}
)
LIVE = LiveReference.model_validate(LIVE_REFERENCE)
HIGHER = SetPoint(0.0, 0.0, 1.02, 0.0, 0.0, 0.0)
HOLDING_N = 3618.625746
"""Static leg force of the book's platform at home, confirmed by independent engines."""
LOAD = np.array([100.0, -50.0, -700.0, 20.0, 10.0, -5.0])
LAST = np.array([3100.0, 3200.0, 3300.0, 3400.0, 3500.0, 3600.0])


class Drives:
    """Six drives on locked legs: they obey modes and answer SYNC with fixed lengths."""

    def __init__(self, protocol, length):
        self.protocol, self.length = protocol, length
        self.state = [DriveState.BOOT] * 6
        self.commands, self.configured, self.estops = [], [], 0
        self.silent = set()
        self.rate = 0.0
        self.statuses: list[Frame] = []

    def feedback(self, tick):
        t_ns = tick * PERIOD_NS + 200_000
        statuses, self.statuses = self.statuses, []
        return tuple(Received(t_ns, frame) for frame in statuses) + tuple(
            Received(t_ns, one_feedback(self.protocol, i, l, self.rate, 0.0, s, tick & 15))
            for i, (l, s) in enumerate(zip(self.length, self.state, strict=True))
            if i not in self.silent
        )

    def obey(self, sent):
        reached = {
            DriveMode.OFF: DriveState.OFF,
            DriveMode.READY: DriveState.READY,
            DriveMode.RUN: DriveState.RUN,
            DriveMode.RESET: DriveState.OFF,
        }
        for frame in sent_frames(sent):
            match parse(self.protocol, frame):
                case Configure() as c:
                    self.configured.append(c)
                    self.state[c.leg] = DriveState.OFF
                    self.statuses += reports(self.protocol, Status(c.leg, DriveState.OFF, 0, c))
                case DeviceCommand() as c:
                    self.commands.append(c)
                    latched = () if c.mode == DriveMode.RESET else (DriveState.FAULT,)
                    self.state = [
                        s if s in (DriveState.BOOT, *latched) else reached.get(DriveMode(c.mode), s)
                        for s in self.state
                    ]
                case EmergencyStop():
                    self.estops += 1


class Bench:
    """A cycle and its drives, tick by tick."""

    def __init__(self, c=None, cycle=None):
        self.cycle = cycle or build_cycle(c or VIRTUAL, 1000.0, 0.01)
        parts = self.cycle.parts
        self.drives = Drives(parts.protocol, leg_lengths(parts.platform, parts.home_p, parts.home_R))
        self.tick = -1

    def step(self, operator=(), frames=None, **changes):
        self.tick += 1
        heard = self.drives.feedback(self.tick) if frames is None else frames
        inp = TickInput(
            tick=self.tick, t_ns=self.tick * PERIOD_NS, lateness_ns=0, skipped=0,
            frames=received_array(heard), sends_failed=0, bus_errors=0, bus_off=False, bus_overflow=0,
            recorder_alive=True, recorder_dropped=0, operator=operator, compute_ns=0,
        )._replace(**changes)  # fmt: skip
        out = self.cycle.step(inp)
        self.drives.obey(out.frames)
        return out

    def until(self, mode, limit=2000):
        """Reset, engage, and step until a mode is entered."""
        operator: tuple[Operator, ...] = (Operator.RESET,)
        for _ in range(limit):
            out = self.step(operator)
            operator = (Operator.ENGAGE,) if self.cycle.mode is Mode.IDLE else ()
            if self.cycle.mode is mode:
                return out
        raise AssertionError(f"{mode} not reached, but {self.cycle.mode}")

    def go_on(self, mode, limit=2000):
        """Step without operator commands until a mode is entered."""
        for _ in range(limit):
            if self.cycle.mode is mode:
                return
            self.step()
        raise AssertionError(f"{mode} not reached, but {self.cycle.mode}")

    def stopped(self, mode):
        """Stop in the approach, and step until a mode on the way to closed brakes."""
        self.until(Mode.APPROACH)
        self.step((Operator.STOP,))
        self.go_on(mode)

    @property
    def force(self):
        """Forces of the last command (6,) N."""
        return np.array(self.drives.commands[-1].force)


def a_bench(**changes: Any) -> Bench:
    """Bench with short engage times."""
    return Bench(VIRTUAL.model_copy(update={"engage": BRISK} | changes))


@contextmanager
def held_to(bench, **limits):
    """Change limits of safety for the duration of a `with` block."""
    own = bench.cycle.parts.safety.limits
    before = {name: own[name].item() for name in limits}
    for name, value in limits.items():
        own[name] = value
    yield
    for name, value in before.items():
        own[name] = value


# -- a cycle of which a test makes the state, and a tick as it is measured


def said(*operator: Operator, tick: int = 50) -> Any:
    """Input of a tick with these operator commands."""
    return SimpleNamespace(tick=tick, operator=operator, setpoints=(), orders=())


def measured(cycle: Cycle, **columns: Any) -> Any:
    """Tick with feedback of all legs, at rest at home, and all drives in RUN."""
    parts = cycle.parts
    home = {"p": parts.home_p, "R": parts.home_R, "J": np.eye(6), "age": 0, "tick": 50}
    return record_of(**home | {"drive_state": int(DriveState.RUN)} | columns)


def aside(cycle: Cycle) -> Any:
    """Position near home."""
    return cycle.parts.home_p + np.array([0.01, -0.02, 0.03])


def ticked(cycle: Cycle, number: int, *operator: Operator, orders: tuple[Order, ...] = ()) -> None:
    """Process the orders and choose the mode of a tick in which all drives are in RUN and the legs at
    rest.
    """
    cycle.operating.step(orders, number, cycle.mode, cycle.motion)
    cycle._change_mode(said(*operator, tick=number), measured(cycle, tick=number))


def fault_text(cycle: Cycle) -> str:
    """Faults of the last tick and their evidence, in one line."""
    narrator = Narrator(cycle)
    narrator.look()
    return narrator.short
