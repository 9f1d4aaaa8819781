"""Frames that faults and bench mistakes add are on the bus of `hil plant`, too, as they are in lockstep."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.arrays import Rows
from drivers.config import DriveSettings
from drivers.frame_array import NO_FRAMES, received_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.tick_columns import new_record
from hil.app import plant
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.app.configuration.fault_words import read_fault
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.plan import FaultPlan
from tests.drivers.legs_frames import decode, opening
from tests.plant_fmu.test_nodes import MS, Masses

C = load("virtual")
PROTOCOL = build_protocol(C)
ROUNDS = 6
TWICE = {
    "forged": ("frames_forged_feedback leg={leg} by=2e-3", [2] * ROUNDS),
    "doubled": ("frames_duplicate identifier={identifier}", [2] * ROUNDS),
    "old": ("frames_old identifier={identifier} back=2", [1, 1, 2, 2, 2, 2]),
    "out of order": ("frames_reorder identifier={identifier}", [0, 2, 0, 2, 0, 2]),
}
"""How often the drive of the leg then answers, SYNC by SYNC."""


def feedback_of(leg: int, frame: Frame) -> bool:
    return PROTOCOL.sender(frame) == leg and PROTOCOL.awaited(frame) in PROTOCOL.traits.feedback_ids


IDENTIFIERS = [
    next(frame.id for frame in PROTOCOL.traits.cyclic_frames if feedback_of(leg, frame)) for leg in range(6)
]


class Rounds:
    """A bus with so many SYNCs a round, one a ms. State: its time, the tick, what was sent in each round."""

    def __init__(self, stop: plant._Stop, syncs: int) -> None:
        self.t_ns = self.tick = 0
        self.clock = SimpleNamespace(now=lambda: self.t_ns)
        self.sent: list[list[Frame]] = []
        self._stop, self._syncs = stop, syncs

    def drain_now(self) -> Rows:
        if not self.tick:  # what was there before the plant
            self.tick = 1
            return NO_FRAMES
        found = []
        for _ in range(self._syncs):
            self.t_ns += MS
            self.tick += 1
            found += [Received(self.t_ns, frame) for frame in opening(PROTOCOL, self.tick)]
        self.sent.append([])
        if len(self.sent) == ROUNDS:
            self._stop.reason = "enough"
        return received_array(found)

    def send(self, frames: Rows) -> None:
        self.sent[-1] += sent_frames(frames)


def served(nodes: Nodes, syncs: int = 1) -> Rounds:
    """Return the bus after ROUNDS rounds of the plant's process."""
    stop = plant._Stop()
    bus: Any = Rounds(stop, syncs)
    strikes: Any = SimpleNamespace(strike=lambda _: None)
    bench = plant.Bench(nodes, None, lambda: None)  # type: ignore[arg-type]
    plant._serve(bench, bus, None, stop, None, None, strikes, PROTOCOL)
    return bus  # type: ignore[no-any-return]


def with_fault(words: str) -> Nodes:
    return Nodes(Masses(), PROTOCOL, DriveEmulation(), DriveSettings(), FaultPlan([read_fault(words)]))


def answers(bus: Rounds, leg: int) -> list[int]:
    return [sum(feedback_of(leg, frame) for frame in sent) for sent in bus.sent]


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("kind", TWICE)
def test_a_drive_that_answers_twice_to_a_sync_by_a_fault_does_so_on_the_bus(kind: str, leg: int) -> None:
    words, times = TWICE[kind]
    bus = served(with_fault(words.format(leg=leg, identifier=IDENTIFIERS[leg])))
    assert answers(bus, leg) == times
    others = [answers(bus, other) for other in range(6) if other != leg]
    assert others == [[1] * ROUNDS] * 5


@pytest.mark.parametrize("syncs", [1, 3])
@pytest.mark.parametrize("leg", range(6))
def test_a_controller_is_told_of_a_second_node_in_the_first_round_after_a_stall_as_in_any_other(
    leg: int, syncs: int
) -> None:
    """Of three SYNCs that are answered at once the last one's answers go out, both of them."""
    bus = served(with_fault(f"frames_forged_feedback leg={leg} by=1e-4"), syncs)
    assert answers(bus, leg) == [2] * ROUNDS
    received = [Received(bus.t_ns, frame) for frame in bus.sent[-1]]
    assert decode(PROTOCOL, received, bus.tick, new_record())["doubled"] == 1 << leg


def test_a_flood_is_on_the_bus_with_all_of_its_frames() -> None:
    bus = served(with_fault("bus_flood rate=8000"))
    assert sum(frame.id == 0 for sent in bus.sent for frame in sent) == 8 * ROUNDS + 1
