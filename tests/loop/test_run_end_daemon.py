"""The daemon and the lockstep begin and end a run by the same rule; what a daemon records of its bus."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Received
from drivers.signals import BusState, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load
from hil.app.sim.lockstep import Lockstep
from hil.loop.daemon import Shell, run
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course
from plant_fmu.faults.kinds import DriveSilence, EncoderJump, FramesLoss
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad


class Wire:
    """The ideal bus of a lockstep behind the calls that the daemon makes."""

    def __init__(self, nodes, period_ns):
        self.nodes, self.period_ns, self.tick = nodes, period_ns, -1
        self.period_s = 0.0
        self.commands, self.answers, self.late = [], [], []
        self.clock = SimpleNamespace(stretched=lambda: 0, working=lambda _: None, now=self.now)
        nodes.start(0)

    def now(self):
        return self.tick * self.period_ns

    # what the daemon asks of its deadlines
    def wait(self):
        self.tick += 1
        return self.tick, self.tick * self.period_ns, 0, 0

    # ... and of the bus
    def skew_ns(self):
        return 0

    def sent_ns(self):
        return []

    def flush_tx(self):
        pass

    def send(self, frames):
        t_ns = self.tick * self.period_ns
        self.commands += [Received(t_ns, frame) for frame in sent_frames(frames)]
        if not self.answers:
            self.answers = [Received(*reply) for reply in self.nodes.step(t_ns, self.commands)] or [None]
            self.commands = []
        return 0

    def drain_now(self):
        late, self.late, self.answers = self.late, [], []
        return received_array(late)

    def drain(self, deadline_ns, wanted):
        """Return the feedbacks; a status loses the arbitration against the last of them, and is late."""
        answers = [answer for answer in self.answers if answer is not None]
        self.answers = [None]
        self.late += [answer for answer in answers if answer.frame.id not in wanted]
        return received_array([answer for answer in answers if answer.frame.id in wanted])

    def events(self):
        return SimpleNamespace(errors=0, off=0, overflow=0, state=BusState.UNKNOWN)


ALL_LOST = FramesLoss()
LEG_0 = DriveSilence(leg=0)


@pytest.mark.parametrize(
    ("faults", "mode", "seconds"),
    broad(
        [
            ([], Mode.PARKED, None),
            ([ALL_LOST], Mode.WAITING, 2.0),
            ([FramesLoss(at_s=1.0)], Mode.FAULT, None),
            ([DriveSilence(leg=4, at_s=0.3)], Mode.HELD, None),
            ([EncoderJump(leg=5, by_m=0.3, at_s=1.1)], Mode.HELD, None),
            ([LEG_0], Mode.WAITING, 10.0),
            ([DriveSilence(leg=2, at_s=1.2)], Mode.HELD, None),
        ],
        quick=5,
    ),
)
def test_the_same_faults_end_the_daemon_and_the_lockstep_alike(faults, mode, seconds):
    c = load("ideal")
    rate, duration_s = c.loop.rate_Hz, None if mode is Mode.WAITING else 1.4

    def ends():
        nodes, plant = build_nodes(c, FaultPlan(faults))
        return build_cycle(c, rate, c.drives.watchdog_ms * 1e-3), nodes, plant

    here, nodes, plant = ends()
    rows = []
    stepped = Lockstep(here, nodes, (None,), 0.0).run(duration_s, lambda *args: rows.append(args[2].row))
    plant.close()

    there, nodes, plant = ends()
    wire, seen = Wire(nodes, round(1e9 / rate)), []
    recording = SimpleNamespace(alive=True, dropped=0, tick_of_items=lambda row, *_, **__: seen.append(row))
    shell = Shell(wire, wire, recording, OperatorPanel(), 0)  # type: ignore[arg-type]
    ran = run(Course(there, duration_s), shell)
    plant.close()

    assert (ran, ran.story) == (stepped, stepped.story)
    assert ran.mode is mode, ran
    assert len(seen) == len(rows) == ran.ticks + 1
    assert all((a["mode"], a["faults"]) == (b["mode"], b["faults"]) for a, b in zip(rows, seen, strict=True))
    if seconds is not None:
        assert ran.ticks == round(seconds * rate)


class Stamped(Wire):
    """Each SYNC is out 123 us after the wake-up."""

    def sent_ns(self):
        return [self.tick * self.period_ns + 123_000]


class Stalled(Stamped):
    """Giving a SYNC to the bus takes 0.3 ms; the answers are there after 45 us."""

    def __init__(self, nodes, period_ns):
        super().__init__(nodes, period_ns)
        self.given = False

    def now(self):
        return self.tick * self.period_ns + 300_000 * self.given

    def send(self, frames):
        self.given = True
        return super().send(frames)

    def drain_now(self):
        self.given = False
        return super().drain_now()

    def drain(self, deadline_ns, wanted):
        came_ns = self.tick * self.period_ns + 45_000
        answers = super().drain(deadline_ns, wanted).copy()
        answers["t_ns"] = came_ns
        return answers


@pytest.mark.parametrize(("answer_ns", "delay_ns"), [(None, 123_000), (0, 45_000)])
def test_answers_are_asked_where_the_bus_does_not_know_when_its_frames_were_out(answer_ns, delay_ns):
    assert latched(Stalled, answer_ns) == [[delay_ns] * 6] * 3


def test_the_daemon_records_when_each_drive_latched():
    assert latched(Stamped, None) == [[123_000] * 6] * 3


def latched(kind, answer_ns):
    """Return the latches that three ticks on such a wire are recorded with, ns."""
    c = load("ideal")
    nodes, plant = build_nodes(c)
    wire, rows = kind(nodes, round(1e9 / c.loop.rate_Hz)), []

    def tick(row, *_, **__):
        rows.append(row)
        if len(rows) == 3:
            raise RuntimeError("enough")

    recording = SimpleNamespace(alive=True, dropped=0, tick_of_items=tick)
    shell = Shell(wire, wire, recording, OperatorPanel(), 0, answer_ns=answer_ns)  # type: ignore[arg-type]
    run(Course(build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)), shell)
    plant.close()
    return [row["latch_ns"].tolist() for row in rows]
