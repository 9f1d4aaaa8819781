"""The real-time shell around Cycle: wait, SYNC, drain, step, send, record.

Rule of the room: it decides nothing about the platform; whatever it learns goes into TickInput. No other
thread runs in this process and no file is written here: the recorder is a process of its own.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

from drivers.bus import Bus
from drivers.signals import NEVER
from hil.clock import Deadlines
from hil.cycle import Cycle
from hil.record import Recording
from hil.signals import Fault, Mode, Operator, TickInput

NO_DRIVES_S = 2.0
"""A run in which no drive has been heard for this long ends."""
FAULT_TAIL_S = 0.25
"""After a fault the drives are told to switch off for this long before the run ends."""


@dataclass(frozen=True)
class Ending:
    """Why and in which mode a run ended."""

    mode: Mode
    faults: Fault
    reason: str
    ticks: int
    fault_tick: int = -1

    @property
    def success(self) -> bool:
        """Parked as planned, without a fault."""
        return self.mode is Mode.PARKED and not self.faults and not self.reason


class OperatorPanel:
    """Operator commands that wait for the next tick: signals, and what the command line asks for.

    Mutable state: the pending commands. SIGINT and SIGTERM ask for a controlled stop, a second one for
    an emergency stop.
    """

    def __init__(self) -> None:
        self.pending: list[Operator] = []
        self.interrupts = 0

    def press(self, command: Operator) -> None:
        """Add a command."""
        self.pending.append(command)

    def take(self) -> tuple[Operator, ...]:
        """Return and forget what is pending."""
        if not self.pending:
            return ()
        commands, self.pending = tuple(self.pending), []
        return commands

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle SIGINT and SIGTERM."""
        del signum, frame
        self.interrupts += 1
        self.press(Operator.STOP if self.interrupts == 1 else Operator.ESTOP)

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Route SIGINT and SIGTERM here."""
        before = {s: signal.signal(s, self.interrupt) for s in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for s, handler in before.items():
                signal.signal(s, handler)


def run(
    cycle: Cycle,
    bus: Bus,
    deadlines: Deadlines,
    recording: Recording,
    panel: OperatorPanel,
    feedback_window_ns: int,
    duration_s: float | None = None,
) -> Ending:
    """Run the cycle until it has parked, faulted, or found no drives.

    Engages by itself once the drives are there; `duration_s` asks for a stop that long after the start.
    """
    wanted = cycle.parts.protocol.feedback_ids
    rate = cycle.parts.rate_Hz
    last_tick = None if duration_s is None else round(duration_s * rate)
    no_drives_tick = round(NO_DRIVES_S * rate)
    fault_ticks = max(5, round(FAULT_TAIL_S * rate))
    ending: Ending | None = None
    sends_failed = 0
    compute_ns = 0
    panel.press(Operator.RESET)
    engaged = stopped = False
    first_fault_tick: int | None = None
    while ending is None:
        tick, t_ns, lateness_ns, skipped = deadlines.wait()
        frames = bus.drain_now()
        opening = cycle.begin(tick)
        sends_failed += bus.send(opening)
        frames += bus.drain(t_ns + feedback_window_ns, wanted)
        errors = bus.events()
        if not engaged and cycle.mode is Mode.IDLE:
            panel.press(Operator.ENGAGE)
            engaged = True
        if last_tick is not None and tick >= last_tick and not stopped:
            panel.press(Operator.STOP)
            stopped = True
        operator = panel.take()
        inp = TickInput(
            tick=tick,
            t_ns=t_ns,
            lateness_ns=lateness_ns,
            skipped=skipped,
            frames=tuple(frames),
            sends_failed=sends_failed,
            bus_errors=errors.errors,
            bus_off=errors.off,
            bus_overflow=errors.overflow,
            recorder_alive=recording.alive,
            recorder_dropped=recording.dropped,
            operator=operator,
            compute_ns=compute_ns,
        )
        begun = time.perf_counter_ns()
        out = cycle.step(inp)
        compute_ns = time.perf_counter_ns() - begun
        sends_failed = bus.send(out.frames)
        recording.tick(out.row, inp.frames, opening + out.frames, operator)

        mode = cycle.mode
        if mode is Mode.PARKED:
            ending = Ending(
                mode,
                cycle.faults,
                "safety asked for a controlled stop: late loop or lost recorder"
                if cycle.stop_requested
                else "",
                tick,
            )
        elif mode is Mode.FAULT:
            first_fault_tick = tick if first_fault_tick is None else first_fault_tick
            if tick - first_fault_tick >= fault_ticks:
                ending = Ending(mode, cycle.faults, "fault", tick, first_fault_tick)
        elif mode is Mode.WAITING and tick >= no_drives_tick and cycle.measurement.age.min() >= NEVER:
            ending = Ending(mode, cycle.faults, "no drives", tick)
    return ending
