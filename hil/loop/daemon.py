"""The real-time shell around Cycle: wait, SYNC, receive, step, send, record.

It decides nothing about the platform; everything it learns goes into TickInput. No other thread runs in this
process, and no file is written here: the recorder is a process of its own.
"""

import time
import traceback
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from drivers.arrays import ZERO6, Rows
from drivers.can.bus import Bus
from drivers.errors import BusError, HilError
from drivers.frame_array import joined, sent_at
from drivers.signals import Command, DriveMode, Mode
from hil.loop.clock import Deadlines, Wake
from hil.loop.console import Console
from hil.loop.cycle import Cycle
from hil.loop.latch_times import checked, fresh_ids, latch_ns
from hil.loop.panel import OperatorPanel
from hil.loop.report import off_not_sent
from hil.loop.run_end import Course, Ending
from hil.operate.channel import OperatorChannel
from hil.record import Recording
from hil.signals import Operator, TickInput

_READY = "all six drives are ready: {} lets the platform move, Ctrl-C ends the run"
CONSENT, WORD = _READY.format("Enter"), _READY.format("`hil ctl CONFIG arm`")
_UNRECORDED = {
    False: "the run goes on without a log (recording.on_recorder_loss: continue)",
    True: "the platform stops along the path and parks (recording.on_recorder_loss: stop)",
}
_AFTER_FAULT = frozenset({Mode.FAULT, Mode.HELD})
SAFE_FRAMES = 5
"""Number of OFF commands that a failed loop sends: the bus may lose some."""
_SWITCHED_OFF = "the drives were commanded to switch off"


class Shell(NamedTuple):
    """Bus, clock, recorder and operator's inputs of the real-time loop."""

    bus: Bus
    deadlines: Deadlines
    recording: Recording
    panel: OperatorPanel
    feedback_window_ns: int
    channel: OperatorChannel | None = None
    """Source of the operator's lines."""
    consent: Callable[[], bool] | None = None
    """True once the operator has given consent to motion; None: consent was given at the start, or comes over
    `channel`."""
    say: Callable[[str], None] = lambda _: None
    """Shows the operator what the run waits for, or why it goes on after a fault."""
    answer_ns: int | None = None
    """Shortest time of a feedback on the bus, 0 on a bus without transmission time; None: the bus itself
    reports when its frames were sent, so no answer has to show it."""


def run(course: Course, shell: Shell) -> Ending:
    """Run the real-time loop until its course ends; returns the reason.

    Whatever fails in here, the drives are commanded off before it returns.
    """
    cycle = course.cycle
    try:
        return _run(course, shell)
    except Exception as error:  # noqa: BLE001 - a defect anywhere in the step must not leave drives powered
        sent_off = switch_off(cycle, shell.bus, shell.deadlines)
        tick = shell.deadlines.tick
        if isinstance(error, HilError):
            reason, unexpected = f"tick {tick}: {error}", ""
        else:
            what = f"{type(error).__name__}: {error}"
            reason = f"tick {tick}: defect of this program, {what}; the log has the details"
            unexpected = traceback.format_exc()
        done = _SWITCHED_OFF if sent_off else off_not_sent(cycle.parts)
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
    """Command the drives off without the cycle, SAFE_FRAMES times, once a period.

    The commands queue behind waiting frames: dropping these takes a while, and a bus that cannot be flushed
    accepts nothing more. If the bus has accepted no command, it is flushed if it is off, and all are
    repeated. Returns True if the bus has accepted at least one complete command.
    """
    protocol = cycle.parts.protocol
    end, off = cycle.end, Command(DriveMode.OFF, ZERO6)
    sent_off, first = False, deadlines.tick + 1
    for tick in range(first, first + 2 * SAFE_FRAMES):
        if tick == first + SAFE_FRAMES:
            if sent_off:
                break
            with suppress(HilError):
                if bus.events().off:
                    bus.flush_tx()
        with suppress(HilError):
            polls = protocol.traits.command_delay_ticks > 0
            opening = end.begin(tick)  # drives obey the present SYNC alone
            frames = end.give(off, tick)
            failed = bus.send(end.begin(tick) if polls else joined((opening, frames)))
            sent_off = sent_off or not failed
        time.sleep(deadlines.period_ns * 1e-9)
    return sent_off


def _run(course: Course, shell: Shell) -> Ending:
    cycle, (bus, deadlines, recording, panel, window_ns, *_) = course.cycle, shell
    console = Console(course, panel, shell.channel, shell.consent)
    sends_failed = compute_ns = 0
    said, ask = "", WORD if shell.consent is None else CONSENT
    recorded = True
    clock, stood_ns = bus.clock, bus.clock.stretched()
    panel.running()
    while True:
        tick, t_ns, lateness_ns, skipped = wake = deadlines.wait()
        stood_before_ns, stood_ns = stood_ns, clock.stretched()
        opening = cycle.begin(tick)
        frames, latched_ns, refused = _ask(cycle, shell, wake, opening)
        sends_failed += refused
        clock.working(deadlines.period_ns - window_ns)
        errors = bus.events()
        if recorded and not recording.alive:
            recorded = False
            shell.say(f"{recording.trouble}: {_UNRECORDED[cycle.parts.safety.stops_unrecorded]}")
        heard = console.take()
        operator = course.commands(tick, heard.operator)
        if Operator.RESET in operator:
            _revive(bus, recording, t_ns)
        inp = TickInput(
            tick=tick,
            t_ns=t_ns,
            lateness_ns=lateness_ns,
            skipped=skipped,
            stretched_ns=stood_ns - stood_before_ns,
            sync_skew_ns=bus.skew_ns(),
            frames=frames,
            sends_failed=sends_failed,
            bus_errors=errors.errors,
            bus_off=errors.off,
            bus_overflow=errors.overflow,
            bus_state=errors.state,
            recorder_alive=recorded,
            recorder_dropped=recording.dropped,
            operator=operator,
            compute_ns=compute_ns,
            latch_ns=latched_ns,
            setpoints=heard.setpoints,
            orders=heard.orders,
        )
        begun = time.perf_counter_ns()
        out = cycle.step(inp)
        compute_ns = time.perf_counter_ns() - begun
        sends_failed = bus.send(out.frames)
        sent = sent_at(t_ns, opening, out.frames)
        recording.tick(out.row, frames, sent, inp.operator, inp.setpoints, inp.orders)
        console.answer(recording, t_ns)
        ending = course.ending(tick)
        if ending is not None:
            return ending
        if course.waits_for_consent and said != ask:
            said = ask
            shell.say(said)
        if cycle.mode in _AFTER_FAULT and course.stays_for not in {"", said}:
            said = course.stays_for
            shell.say(said)
            recording.event(t_ns, "error", said)


def _revive(bus: Bus, recording: Recording, t_ns: int) -> None:
    """Drop the frames queued on a dead bus and restart it; an error is logged."""
    try:
        bus.flush_tx()
    except BusError as error:
        recording.event(t_ns, "error", str(error))


def _ask(cycle: Cycle, shell: Shell, wake: Wake, opening: Rows) -> tuple[Rows, tuple[int, ...], int]:
    """Send the frames that start a tick, and wait for the drives' feedback.

    Returns the frames received since the last tick, the time at which each drive sampled its encoder (ns
    after the wake-up), and the number of frames that the bus refused.
    """
    bus, protocol = shell.bus, cycle.parts.protocol
    tick, t_ns, lateness_ns, _ = wake
    before = bus.drain_now()
    begun_ns = bus.clock.now()
    refused = bus.send(opening)
    given_ns = bus.clock.now()
    answers = _answers(cycle, bus, tick, begun_ns, t_ns + shell.feedback_window_ns)
    sent_ns, answer_ns = bus.sent_ns(), shell.answer_ns
    if answer_ns is not None:
        sent_ns = checked(protocol, opening, sent_ns, answers, tick, begun_ns, given_ns, answer_ns)
    frames = joined([before, answers]) if len(before) else answers
    return frames, latch_ns(protocol, opening, sent_ns, t_ns + lateness_ns), refused


def _answers(cycle: Cycle, bus: Bus, tick: int, begun_ns: int, deadline_ns: int) -> Rows:
    """Wait for the six feedbacks of a tick; `begun_ns`: when its first frames were given to the bus.

    Waits at most until the deadline, however many other frames arrive.
    """
    protocol = cycle.parts.protocol
    answers: list[Rows] = []
    shared, missing = protocol.traits.shares_identifiers, protocol.traits.feedback_ids
    while missing:
        heard = bus.wait(deadline_ns) if shared else bus.drain(deadline_ns, missing)
        if not len(heard):
            break
        answers.append(heard)  # of a node, maybe an answer to an older tick, or one that is damaged or forged
        missing = missing.difference(fresh_ids(protocol, heard, tick, begun_ns))
        if missing and bus.clock.now() >= deadline_ns:
            answers.append(bus.drain_now())  # what came while this process was held up
            break
    return answers[0] if len(answers) == 1 else joined(answers)
