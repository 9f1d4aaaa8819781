"""The real-time shell around Cycle: wait, SYNC, drain, step, send, record.

It decides nothing about the platform; whatever it learns goes into TickInput. No other thread runs in this
process and no file is written here: the recorder is a process of its own.
"""

import signal
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from types import FrameType
from typing import NamedTuple

from drivers.arrays import ZERO6
from drivers.can.bus import Bus
from drivers.errors import HilError
from drivers.protocol import Received
from drivers.signals import Command, DriveMode, Mode
from hil.loop.clock import Deadlines
from hil.loop.cycle import Cycle
from hil.loop.release import ReleaseSocket
from hil.loop.run_end import Course, Ending
from hil.loop.setpoints import SetPointSocket
from hil.record import Recording
from hil.signals import Operator, TickInput, explain

CONSENT = "all six drives are ready: Enter lets the platform move, Ctrl-C ends the run"
_AFTER_FAULT = frozenset({Mode.FAULT, Mode.HELD})
SAFE_FRAMES = 5
"""Commands to switch off that a loop sends which has failed itself: the bus may lose some."""
_TOLD = "drives were told to switch off"
_NOT_TOLD = (
    "drives could not be told to switch off, since the bus takes no frames: the watchdog of each acts "
    "{:g} ms after the last command it heard"
)


@contextmanager
def signals_to(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Route the signals that ask for an end to `handler`."""
    before = {s: signal.signal(s, handler) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for s, previous in before.items():
            signal.signal(s, previous)


class OperatorPanel:
    """The operator's signals, which wait for the next tick.

    SIGINT, SIGTERM and SIGHUP ask for a controlled stop, a second one for an emergency stop. While the drives
    hold a platform whose brakes are not proven shut, none of them drops it.
    Mutable state: how many signals came and how many were handed out.
    """

    def __init__(self) -> None:
        self.interrupts = 0
        self._answered = 0
        self._running = False

    def take(self, *, held: bool = False) -> tuple[Operator, ...]:
        """Return the commands that have come since the last call; held: only force holds the platform."""
        commands: tuple[Operator, ...] = ()
        while self._answered < self.interrupts:  # counted, not listed: a signal may strike between any two
            self._answered += 1
            commands += (Operator.STOP if self._answered == 1 or held else Operator.ESTOP,)
        return commands

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle a signal: before the loop there is nothing to stop but the start."""
        del signum, frame
        self.interrupts += 1
        if not self._running:
            raise KeyboardInterrupt

    def attached(self) -> AbstractContextManager[None]:
        """Route the signals here. Until `running` they raise KeyboardInterrupt."""
        return signals_to(self.interrupt)

    def running(self) -> None:
        """From now on signals wait for the next tick, and for ever once there is none."""
        self._running = True


class Shell(NamedTuple):
    """What the loop reads from and writes to."""

    bus: Bus
    deadlines: Deadlines
    recording: Recording
    panel: OperatorPanel
    feedback_window_ns: int
    setpoints: SetPointSocket | None = None
    """Where those of a live reference come in."""
    release: ReleaseSocket | None = None
    """Where the operator's word to let go of a held platform comes in."""
    consent: Callable[[], bool] | None = None
    """Tells whether the operator has said that the platform may move; None: that was said at the start."""
    say: Callable[[str], None] = lambda _: None
    """Tells the operator what the run waits for, or why it goes on after a fault."""


def run(course: Course, shell: Shell) -> Ending:
    """Run a cycle on its course until that ends.

    Whatever fails in here, the drives are commanded off before it returns.
    """
    cycle = course.cycle
    try:
        return _run(course, shell)
    except Exception as error:  # noqa: BLE001 - a defect anywhere in the step must not leave drives powered
        told = switch_off(cycle, shell.bus, shell.deadlines)
        tick = shell.deadlines.tick
        if isinstance(error, HilError):
            reason, unexpected = f"tick {tick}: {error}", ""
        else:
            what = f"{type(error).__name__}: {error}"
            reason = f"tick {tick}: defect of this program, {what}; the log has the details"
            unexpected = traceback.format_exc()
        done = _TOLD if told else _NOT_TOLD.format(1e3 * cycle.parts.setup.watchdog_s)
        return Ending(
            Mode.FAULT,
            cycle.faults,
            reason,
            tick,
            tick,
            raised=True,
            unexpected=unexpected,
            done=done,
            story=course.story(),
        )
    except BaseException:
        switch_off(cycle, shell.bus, shell.deadlines)
        raise


def switch_off(cycle: Cycle, bus: Bus, deadlines: Deadlines) -> bool:
    """Tell the drives to switch off, a few times one a period, past the cycle.

    Returns whether the bus took a whole one of these commands.
    """
    protocol = cycle.parts.protocol
    dialogue, off = cycle.dialogue, Command(DriveMode.OFF, ZERO6)
    told = False
    with suppress(HilError):
        bus.flush_tx()
    for tick in range(deadlines.tick + 1, deadlines.tick + 1 + SAFE_FRAMES):
        with suppress(HilError):
            polls = protocol.command_delay_ticks > 0
            opening = () if polls else protocol.begin(dialogue, tick)  # drives obey the present SYNC alone
            dialogue, frames = protocol.command(dialogue, off, tick)
            failed = bus.send(protocol.begin(dialogue, tick) if polls else opening + frames)
            told = told or not failed
        time.sleep(deadlines.period_ns * 1e-9)
    return told


def _run(course: Course, shell: Shell) -> Ending:
    cycle, (bus, deadlines, recording, panel, window_ns, setpoints, *_) = course.cycle, shell
    sends_failed = compute_ns = 0
    said = ""
    clock, stood_ns = bus.clock, bus.clock.stretched()
    panel.running()
    while True:
        tick, t_ns, lateness_ns, skipped = deadlines.wait()
        stood_before_ns, stood_ns = stood_ns, clock.stretched()
        frames = bus.drain_now()
        opening = cycle.begin(tick)
        sends_failed += bus.send(opening)
        frames += _answers(cycle, bus, tick, t_ns + lateness_ns, t_ns + window_ns)
        clock.working(deadlines.period_ns - window_ns)
        errors = bus.events()
        inp = TickInput(
            tick=tick,
            t_ns=t_ns,
            lateness_ns=lateness_ns,
            skipped=skipped,
            stretched_ns=stood_ns - stood_before_ns,
            frames=tuple(frames),
            sends_failed=sends_failed,
            bus_errors=errors.errors,
            bus_off=errors.off,
            bus_overflow=errors.overflow,
            recorder_alive=recording.alive,
            recorder_dropped=recording.dropped,
            operator=course.commands(tick, _asked(shell, course)),
            compute_ns=compute_ns,
            setpoints=() if setpoints is None else setpoints.take(),
        )
        begun = time.perf_counter_ns()
        out = cycle.step(inp)
        compute_ns = time.perf_counter_ns() - begun
        sends_failed = bus.send(out.frames)
        recording.tick(out.row, inp.frames, opening + out.frames, inp.operator, setpoints=inp.setpoints)
        if setpoints is not None:
            _answer(setpoints, cycle, recording, t_ns)
        ending = course.ending(tick)
        if ending is not None:
            return ending
        if course.waits_for_consent and said != CONSENT:
            said = CONSENT
            shell.say(said)
        if cycle.mode in _AFTER_FAULT and course.stays_for != said:
            said = course.stays_for
            shell.say(said)
            recording.event(t_ns, "error", said)


def _asked(shell: Shell, course: Course) -> tuple[Operator, ...]:
    """Return what the operator has asked for since the last tick."""
    held = course.cycle.mode is Mode.HELD
    operator = shell.panel.take(held=held)
    if course.waits_for_consent and shell.consent is not None and shell.consent():
        operator += (Operator.ENGAGE,)
    if held and shell.release is not None and shell.release.take():
        operator += (Operator.RELEASE,)
    return operator


def _answers(cycle: Cycle, bus: Bus, tick: int, begun_ns: int, deadline_ns: int) -> list[Received]:
    """Wait for the six feedbacks of a tick that began at `begun_ns`."""
    wanted, fresh = cycle.parts.protocol.feedback_ids, cycle.parts.protocol.fresh
    answers: list[Received] = []
    missing = wanted
    while missing:
        heard = bus.drain(deadline_ns, missing)
        if not heard:
            break
        answers += heard  # of a node, maybe an answer to an older tick, or one that is damaged or forged
        missing = missing.difference([each.frame.id for each in heard if fresh(each, tick, begun_ns)])
    return answers


def _answer(setpoints: SetPointSocket, cycle: Cycle, recording: Recording, t_ns: int) -> None:
    """Tell the senders what became of their set-points, and the log of those that were refused."""
    steering = cycle.parts.steering
    assert steering is not None
    if steering.answers:
        setpoints.answer(steering.answers)
    if steering.counts.refusal:
        recording.event(t_ns, "warning", f"set-point refused: {explain(steering.counts.refusal)}")
