"""Reports, records and inputs of the real-time loop, with test doubles for its surroundings."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import BusError
from drivers.frame_array import received_array, received_frames, sent_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.signals import DriveMode, Fault, Mode
from hil.loop import daemon
from hil.loop.clock import Wake
from hil.loop.daemon import CONSENT, SAFE_FRAMES, WORD, Shell, _ask, run
from hil.loop.panel import OperatorPanel
from hil.signals import Operator, Order, SetPoint

PERIOD_NS = 1_000_000
ORDERS = 0x700
OLDER, ANSWER = Received(90, Frame(0x182, b"")), Received(120, Frame(0x181, b""))
OPENING, COMMANDS = (Frame(0x80, b""),), (Frame(0x201, b"\1"), Frame(0x202, b"\2"))
POINT, ORDER = SetPoint(0.0, 0.0, 1.0, 0.0, 0.0, 0.0), Order(Operator.HOLD)


class World:
    """A bus, a clock, a recorder, a cycle and a course that behave as specified for each tick."""

    def __init__(self, *ticks: dict[str, Any], stops_unrecorded: bool = False) -> None:
        self.ticks, self.now = ticks, -1
        self.passed_ns = 1_000
        self.said: list[str] = []
        self.rows: list[tuple[Any, ...]] = []
        self.events: list[tuple[Any, ...]] = []
        self.inputs: list[Any] = []
        self.done: list[str] = []
        self.panel = OperatorPanel()
        self.course: Any = None
        protocol = SimpleNamespace(
            traits=SimpleNamespace(
                feedback_ids=frozenset(), shares_identifiers=False, command_delay_ticks=0, has_watchdog=True
            ),
            addressed=lambda _: (), fresh=None, awaited=None,
        )  # fmt: skip
        end = SimpleNamespace(
            begin=lambda _: sent_array(OPENING),
            give=lambda command, _: sent_array([Frame(ORDERS + command.mode, b"")]),
        )
        safety = SimpleNamespace(stops_unrecorded=stops_unrecorded)
        setup = SimpleNamespace(watchdog_s=0.02)
        parts = SimpleNamespace(protocol=protocol, safety=safety, rate_Hz=1000.0, steering=None, setup=setup)
        self.cycle: Any = SimpleNamespace(
            parts=parts, begin=lambda _: sent_array(OPENING), step=self.step, mode=Mode.WAITING, end=end,
            faults=Fault.SPEED, operating=SimpleNamespace(answers=[]), tick={"tick": 0},
        )  # fmt: skip
        self.clock: Any = SimpleNamespace(
            now=lambda: 0, stretched=lambda: self.of("stood_ns", 0), working=lambda _: None
        )  # fmt: skip
        self.recording: Any = SimpleNamespace(
            dropped=0, trouble="the recorder is gone", alive=True,
            tick=lambda *what: self.rows.append(what), event=lambda *what: self.events.append(what),
        )  # fmt: skip
        self.ending: Any = SimpleNamespace(name="the end")

    def of(self, name: str, default: Any) -> Any:
        return self.ticks[self.now].get(name, default)

    def wait(self) -> Wake:
        self.now += 1
        self.cycle.mode = self.of("mode", Mode.WAITING)
        self.recording.alive = self.of("alive", True)
        self.course.waits_for_consent = self.of("waits", False)
        self.course.stays_for = self.of("stays_for", "")
        return Wake(self.now, self.now * PERIOD_NS, 0, 0)

    def step(self, inp: Any) -> Any:
        self.inputs.append(inp)
        self.passed_ns += self.of("took_ns", 0)
        if "error" in self.ticks[self.now]:
            raise self.ticks[self.now]["error"]
        return SimpleNamespace(frames=sent_array(COMMANDS), row=f"row {inp.tick}")

    def send(self, frames: Any) -> int:
        self.passed_ns += 50
        given = sent_frames(frames)
        self.done += [DriveMode(frame.id - ORDERS).name for frame in given if frame.id >= ORDERS]
        return int(self.of("unasked" if given == OPENING else "refused", 0))

    def flush_tx(self) -> None:
        self.done.append("flushed")
        raise BusError("no right to flush")

    def run(self, *, consent: bool = False, heard: Any = None) -> Any:
        ended = len(self.ticks) - 1
        self.course = SimpleNamespace(
            cycle=self.cycle, goes_on=False, commands=lambda _tick, said: said + self.of("operator", ()),
            ending=lambda tick: self.ending if tick == ended else None, story=lambda: ("its story",),
        )  # fmt: skip
        bus: Any = SimpleNamespace(
            clock=self.clock, drain_now=lambda: received_array([Received(7, Frame(0x181, b""))]), send=self.send,
            sent_ns=list, skew_ns=lambda: 0, flush_tx=self.flush_tx,
            events=lambda: SimpleNamespace(errors=0, off=0, overflow=0, state=0),
        )  # fmt: skip
        deadlines: Any = SimpleNamespace(wait=self.wait, period_ns=PERIOD_NS, tick=ended)
        channel: Any = None
        if heard is not None:
            channel = SimpleNamespace(take=lambda **_: heard, waited_for=False, old=frozenset())
        shell = Shell(
            bus, deadlines, self.recording, self.panel, 0, channel, (lambda: False) if consent else None,
            self.said.append,
        )  # fmt: skip
        return run(self.course, shell)


@pytest.fixture(autouse=True)
def slept(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    times: list[float] = []
    monkeypatch.setattr(time, "sleep", times.append)
    return times


@pytest.mark.parametrize("consent", [False, True])
def test_request_for_consent_and_each_reason_to_stay_held_are_reported_once(consent):
    ready = {"mode": Mode.IDLE, "waits": True}
    one, two = ({"mode": Mode.HELD, "stays_for": f"leg {k} moved"} for k in (1, 2))
    tracking, fault = (
        {"mode": Mode.TRACKING, "stays_for": "x"},
        {"mode": Mode.FAULT, "stays_for": "it still moves"},
    )
    world = World({}, ready, ready, one, one, {"mode": Mode.HELD}, two, tracking, fault, ready, {})
    assert world.run(consent=consent) is world.ending
    ask = CONSENT if consent else WORD
    assert world.said == [ask, "leg 1 moved", "leg 2 moved", "it still moves", ask]
    assert ("Enter" in ask, "`hil ctl CONFIG arm`" in ask) == (consent, not consent)
    assert world.events == [
        (3 * PERIOD_NS, "error", "leg 1 moved"),
        (6 * PERIOD_NS, "error", "leg 2 moved"),
        (8 * PERIOD_NS, "error", "it still moves"),
    ]


@pytest.mark.parametrize(
    ("stops", "what"),
    [(False, "the run goes on without a log"), (True, "the platform stops along the path and parks")],
)
def test_lost_recorder_counts_as_lost_until_the_end_and_is_reported_once(stops, what):
    gone = {"alive": False}
    world = World({}, gone, {}, gone, {}, stops_unrecorded=stops)
    world.run()
    assert [inp.recorder_alive for inp in world.inputs] == [True, False, False, False, False]
    assert len(world.said) == 1
    assert world.said[0].startswith(f"the recorder is gone: {what} (recording.on_recorder_loss: ")


def test_log_has_received_frames_sent_frames_and_operator_commands_of_each_tick():
    heard = SimpleNamespace(operator=(), setpoints=(POINT,), orders=(ORDER,))
    heard._replace = lambda **new: SimpleNamespace(**{**vars(heard), **new})
    world = World({"operator": (Operator.STOP,)}, {})
    world.cycle.parts.steering = SimpleNamespace(counts=SimpleNamespace(refusal=0))
    world.run(heard=heard)
    frames = (Received(7, Frame(0x181, b"")),)
    said = (Operator.STOP,), (POINT,), (ORDER,)
    row, received, sent, *others = world.rows[0]
    assert (row, *others) == ("row 0", *said)
    assert (received_frames(received), sent_frames(sent)) == (frames, OPENING + COMMANDS)
    assert (received_frames(world.inputs[0].frames), world.inputs[0].setpoints) == (frames, (POINT,))


def test_each_step_gets_the_computing_time_of_the_previous_one(monkeypatch):
    world = World({"took_ns": 300}, {"took_ns": 700}, {"took_ns": 1})
    monkeypatch.setattr(time, "perf_counter_ns", lambda: world.passed_ns)
    world.run()
    assert [inp.compute_ns for inp in world.inputs] == [0, 300, 700]
    world.panel.interrupt(2, None)
    assert world.panel.take() == (Operator.STOP,)


def test_a_failed_flush_of_the_bus_at_a_reset_does_not_end_the_run():
    world = World({}, {"operator": (Operator.RESET,)}, {})
    assert world.run() is world.ending
    assert world.done == ["flushed"]
    assert world.events == [(PERIOD_NS, "error", "no right to flush")]


@pytest.mark.parametrize("refused", [0, 1])
@pytest.mark.parametrize(
    "error", [BusError("the cable is out"), ZeroDivisionError("?"), ValueError("?"), OSError("?"), KeyError()]
)
def test_a_failing_loop_switches_the_drives_off_and_reports_the_reason(slept, error, refused):
    world = World({}, {"error": error, "refused": refused})
    ended = world.run()
    times = SAFE_FRAMES * (1 + refused)
    assert world.done == ["OFF"] * times
    assert slept == [pytest.approx(1e-3)] * times
    assert (ended.mode, ended.faults, ended.raised) == (Mode.FAULT, Fault.SPEED, True)
    assert (ended.ticks, ended.fault_tick, ended.story) == (1, 1, ("its story",))
    if isinstance(error, BusError):
        assert (ended.reason, ended.unexpected) == ("tick 1: the cable is out", "")
    else:
        assert ended.reason.startswith(f"tick 1: defect of this program, {type(error).__name__}: {error}")
        assert "raise self.ticks" in ended.unexpected
    promised = "the watchdog of each acts 20 ms after the last command that it received"
    assert (promised in ended.done) is bool(refused)
    assert ("were commanded to switch off" in ended.done) is not refused


@pytest.mark.parametrize("answer_ns", [None, 0, 111])
def test_sending_time_of_a_frame_is_derived_from_the_answers_if_the_bus_reports_none(monkeypatch, answer_ns):
    """The bus gets the frames at 100 ns; sending lasts until 130 ns."""
    told: list[Any] = []
    opening, answer = sent_array(OPENING), received_array([ANSWER])
    times = iter([100, 130])
    bus: Any = SimpleNamespace(
        clock=SimpleNamespace(now=lambda: next(times)), drain_now=lambda: received_array([OLDER]), send=lambda _: 2,
        sent_ns=lambda: ["the clock's"],
    )  # fmt: skip
    protocol = SimpleNamespace(name="protocol")

    def answers(*asked: Any) -> Any:
        told.append(asked[1:])
        return answer

    def checked(*asked: Any) -> list[str]:
        told.append(asked)
        return ["the answers'"]

    monkeypatch.setattr(daemon, "_answers", answers)
    monkeypatch.setattr(daemon, "checked", checked)
    monkeypatch.setattr(daemon, "latch_ns", lambda *asked: asked)
    shell: Any = SimpleNamespace(bus=bus, feedback_window_ns=700, answer_ns=answer_ns)
    cycle: Any = SimpleNamespace(parts=SimpleNamespace(protocol=protocol))
    found: Any = _ask(cycle, shell, Wake(9, 50, 30, 0), opening)
    heard, latched, refused = found
    assert told[0] == (bus, 9, 100, 750)
    assert (received_frames(heard), refused) == ((OLDER, ANSWER), 2)
    known = answer_ns is None
    assert latched == (protocol, opening, ["the clock's" if known else "the answers'"], 80)
    asked = (protocol, opening, ["the clock's"], answer, 9, 100, 130, answer_ns)
    assert told[1:] == ([] if known else [asked])
