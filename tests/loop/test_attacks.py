"""A second controller on the bus during a whole run: it is detected and reported, and moves nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.signals import Command, DriveMode, DriveState, Fault, Mode, Reaction
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import load
from hil.signals import Operator
from tests.drivers.legs_frames import command_frames, opening
from tests.loop.bench import new_cycle, until
from tests.loop.stepwise import Stepwise

FALL_m_s2 = 12.0
"""Upper bound of a leg's acceleration without any force."""
Attack = Callable[[int], tuple[Frame, ...]]


@dataclass
class Attacked(Stepwise):
    """A lockstep with a third node, which sends after the feedback and before the controller's command."""

    attack: Attack = field(default=lambda _tick: ())
    audible: bool = True
    """True if the controller receives its frames; behind a gateway it does not."""

    def exchange(self, t_ns, opening):
        feedback, w = super().exchange(t_ns, opening), self.wires.record
        forged = received_array([Received(int(w["step_ns"]), frame) for frame in self.attack(self.tick)])
        before = int(w["commands"])
        w["commands"] += len(forged)
        self.wires.commands[before : w["commands"]] = forged
        return np.concatenate([feedback, forged]) if self.audible else feedback


@pytest.fixture(scope="module")
def virtual():
    c = load("virtual")
    nodes, plant = build_nodes(c)
    yield c, nodes
    plant.close()


def begin(virtual, mode: Mode) -> Attacked:
    c, nodes = virtual
    attacked = Attacked(new_cycle(c), nodes, (BitTiming.of(c.bus),), c.loop.window_s(1000.0))
    until(attacked, mode)
    return attacked


def forged(bench: Attacked, counter: int, force: float) -> tuple[Frame, ...]:
    command = Command(DriveMode.RUN, np.full(6, force))
    return command_frames(bench.cycle.parts.protocol, command, counter)


ATTACKS: dict[str, Callable[[Attacked], Attack]] = {
    "the present counter": lambda bench: lambda tick: forged(bench, tick, 3e3),
    "the next counter": lambda bench: lambda tick: forged(bench, tick + 1, 3e3),
    "old commands": lambda bench: lambda tick: forged(bench, tick - 1 - tick % 2, 3e3),
    "SYNC and command": lambda bench: (
        lambda tick: (*opening(bench.cycle.parts.protocol, tick + 9), *forged(bench, tick + 9, 3e3))
    ),
}


@pytest.mark.parametrize("mode", [Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING])
@pytest.mark.parametrize("name", ATTACKS)
def test_forged_drive_commands_are_reported_and_move_no_leg(virtual, mode, name):
    bench = begin(virtual, mode)
    for _ in range(100 if mode is Mode.TRACKING else 20):
        bench.step()
    before = bench.nodes.snapshot()
    bench.attack = ATTACKS[name](bench)
    begun = bench.tick
    for _ in range(2):
        bench.step()
    assert bench.cycle.faults == Fault.SECOND_CONTROLLER
    assert bench.cycle.mode_tick - begun <= 2
    for _ in range(200):
        bench.step()
    after = bench.nodes.snapshot()
    assert after.brake.all(), "though the other one goes on"
    assert after.state.tolist() == [DriveState.FAULT] * 6
    speed = float(np.abs(before.rate).max())
    moved = float(np.abs(after.length - before.length).max())
    T = 5e-3 + 1e-3 * virtual[0].plant.drives.brake_close_ms
    assert moved <= 2e-3 + speed * T + 0.5 * FALL_m_s2 * T * T, "until the brakes have closed"


@pytest.mark.parametrize("audible", [True, False])
def test_foreign_config_frame_is_detected_before_the_drives_are_powered(virtual, audible):
    bench = begin(virtual, Mode.IDLE)
    config = bench.cycle.parts.protocol.configure(4000.0, Reaction.ZERO)  # type: ignore[attr-defined]
    bench.attack, bench.audible = lambda _tick: config, audible
    bench.step()
    bench.attack = lambda _tick: ()
    for _ in range(20):
        bench.step((Operator.ENGAGE,))
    assert bench.cycle.mode is Mode.FAULT
    assert bench.cycle.faults & (Fault.SECOND_CONTROLLER if audible else Fault.SET_UP)
    assert not bench.cycle.faults & ~(Fault.SECOND_CONTROLLER | Fault.SET_UP)
    assert set(bench.nodes.snapshot().state.tolist()) == {DriveState.OFF}


def test_emergency_stop_frame_is_repeated_until_the_drives_confirm_it(virtual):
    bench = begin(virtual, Mode.APPROACH)
    estop = bench.cycle.parts.protocol.traits.emergency_stop[0]
    hear, lost = bench.nodes._end.hear, [0]

    def deaf(frame):
        if frame == estop and lost[0] < 3:
            lost[0] += 1
            return ()
        return hear(frame)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.nodes._end, "hear", deaf)
        bench.step((Operator.ESTOP,))
        sent = [estop in sent_frames(bench.step()[2].frames) for _ in range(50)]
    assert lost == [3]
    assert sent[:3] == [True] * 3
    assert not any(sent[6:])
    assert bench.nodes.snapshot().brake.all()
