"""The real-time shell around Cycle: wait, SYNC, drain, step, send, record.

It decides nothing about the platform; whatever it learns goes into TickInput. No other thread runs in this
process and no file is written here: the recorder is a process of its own.
"""

from __future__ import annotations

import signal
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import FrameType

from drivers.can.bus import Bus
from drivers.errors import HilError
from drivers.signals import LEGS, NEVER, Command, DriveFault, DriveMode, DriveState, no_measurement
from hil.loop.clock import Deadlines
from hil.loop.cycle import Cycle
from hil.loop.setpoints import SetPointSocket
from hil.record import Recording
from hil.signals import Fault, Mode, Operator, Stop, TickInput, explain

NO_DRIVES_S = 2.0
"""A run in which no drive has been heard for this long ends."""
NOT_READY_S = 10.0
"""A run whose drives do not all become ready within this ends: real drives may take a while to boot."""
FAULT_TAIL_S = 0.25
"""After a fault the drives are told to switch off for this long before the run ends."""
SAFE_FRAMES = 5
"""Commands to switch off that a loop sends which has failed itself: the bus may lose some."""
_STOPS = {
    Stop.MISSED: "the loop missed limits.missed_stop_ticks periods in a row",
    Stop.RECORDER: "the recorder was lost or lost ticks (recording.on_recorder_loss is `stop`)",
}


@dataclass(frozen=True)
class Ending:
    """Why and in which mode a run ended."""

    mode: Mode
    faults: Fault
    reason: str
    """What went wrong; empty for a run that ended as planned or on request."""
    ticks: int
    fault_tick: int = -1
    requested: bool = False
    """The operator asked for the stop."""
    missed: bool = False
    """Safety asked for the stop because of missed periods."""
    raised: bool = False
    """The loop itself failed."""
    unexpected: str = ""
    """Traceback of a defect of this program, for the log."""

    @property
    def success(self) -> bool:
        """Parked as planned or on request, without a fault."""
        return self.mode is Mode.PARKED and not self.faults and not self.reason


class OperatorPanel:
    """Operator commands that wait for the next tick: signals, and what the program itself asks for.

    SIGINT, SIGTERM and SIGHUP ask for a controlled stop, a second one for an emergency stop.
    Mutable state: the pending commands, how many signals came and how many were handed out.
    """

    def __init__(self) -> None:
        self.pending: list[Operator] = []
        self.interrupts = 0
        self._answered = 0
        self._running = False

    def press(self, command: Operator) -> None:
        """Add a command."""
        self.pending.append(command)

    def take(self) -> tuple[Operator, ...]:
        """Return and forget what is pending."""
        if not self.pending and self._answered == self.interrupts:
            return ()
        commands, self.pending = self.pending, []
        while self._answered < self.interrupts:  # counted, not listed: a signal may strike between any two
            self._answered += 1
            commands.append(Operator.STOP if self._answered == 1 else Operator.ESTOP)
        return tuple(commands)

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle a signal: before the loop there is nothing to stop but the start."""
        del signum, frame
        self.interrupts += 1
        if not self._running:
            raise KeyboardInterrupt

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Route the signals here. Until `running` they raise KeyboardInterrupt."""
        before = {s: signal.signal(s, self.interrupt) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
        try:
            yield
        finally:
            for s, handler in before.items():
                signal.signal(s, handler)

    def running(self) -> None:
        """From now on signals wait for the next tick, and for ever once there is none."""
        self._running = True


def run(
    cycle: Cycle,
    bus: Bus,
    deadlines: Deadlines,
    recording: Recording,
    panel: OperatorPanel,
    feedback_window_ns: int,
    duration_s: float | None = None,
    *,
    reset: bool = False,
    setpoints: SetPointSocket | None = None,
) -> Ending:
    """Run the cycle until it has parked, faulted, or found no drives.

    Engages by itself once the drives are there; `duration_s` asks for a stop that long after the start.
    `reset` clears faults that the drives have latched before: without it they end the run. `setpoints` is
    where those of a live reference come in.
    Whatever fails in here, the drives are told to switch off before it returns.
    """
    try:
        return _run(
            cycle, bus, deadlines, recording, panel, feedback_window_ns, duration_s, setpoints, reset=reset
        )
    except Exception as error:  # noqa: BLE001 - a defect anywhere in the step must not leave drives powered
        switch_off(cycle, bus, deadlines)
        tick = deadlines.tick
        if isinstance(error, HilError):
            return Ending(Mode.FAULT, cycle.faults, f"tick {tick}: {error}", tick, tick, raised=True)
        what = f"{type(error).__name__}: {error}"
        reason = f"tick {tick}: defect of this program, {what}; the log has the details"
        return Ending(
            Mode.FAULT, cycle.faults, reason, tick, tick, raised=True, unexpected=traceback.format_exc()
        )
    except BaseException:
        switch_off(cycle, bus, deadlines)
        raise


def switch_off(cycle: Cycle, bus: Bus, deadlines: Deadlines) -> None:
    """Tell the drives to switch off, a few times at the loop's pace, past the cycle."""
    protocol = cycle.parts.protocol
    off = Command(DriveMode.OFF, no_measurement().force)
    with suppress(HilError):
        bus.flush_tx()
    for tick in range(deadlines.tick, deadlines.tick + SAFE_FRAMES):
        with suppress(HilError):
            bus.send(protocol.command(off, tick))
        time.sleep(deadlines.period_ns * 1e-9)


def _run(
    cycle: Cycle,
    bus: Bus,
    deadlines: Deadlines,
    recording: Recording,
    panel: OperatorPanel,
    feedback_window_ns: int,
    duration_s: float | None,
    setpoints: SetPointSocket | None,
    *,
    reset: bool,
) -> Ending:
    wanted, fresh = cycle.parts.protocol.feedback_ids, cycle.parts.protocol.fresh
    rate = cycle.parts.rate_Hz
    last_tick = None if duration_s is None else round(duration_s * rate)
    no_drives_tick, not_ready_tick = round(NO_DRIVES_S * rate), round(NOT_READY_S * rate)
    fault_ticks = max(5, round(FAULT_TAIL_S * rate))
    sends_failed = 0
    compute_ns = 0
    if reset:
        panel.press(Operator.RESET)
    panel.running()
    engaged = stopped = False
    fault_tick, fault_detail = -1, ""
    parked_tick = -1
    while True:
        tick, t_ns, lateness_ns, skipped = deadlines.wait()
        frames = bus.drain_now()
        opening = cycle.begin(tick)
        sends_failed += bus.send(opening)
        answers = bus.drain(t_ns + feedback_window_ns, wanted)
        missing = wanted.difference([frame.id for _, frame in answers if fresh(frame, tick)])
        if missing:  # a late answer to an older SYNC came in place of a fresh one
            answers += bus.drain(t_ns + feedback_window_ns, missing)
        frames += answers
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
            setpoints=() if setpoints is None else setpoints.take(),
        )
        begun = time.perf_counter_ns()
        out = cycle.step(inp)
        compute_ns = time.perf_counter_ns() - begun
        sends_failed = bus.send(out.frames)
        recording.tick(out.row, inp.frames, opening + out.frames, operator, setpoints=inp.setpoints)
        if setpoints is not None:
            _answer(setpoints, cycle, recording, t_ns)

        mode = cycle.mode
        if mode is Mode.PARKED:
            parked_tick = parked_tick if parked_tick >= 0 else tick
            if drives_off(cycle) or tick - parked_tick >= fault_ticks:
                why = cycle.stop_requested
                reason = f"safety asked for a controlled stop: {_STOPS[why]}" if why in _STOPS else ""
                requested = stopped or panel.interrupts > 0
                return Ending(
                    mode, cycle.faults, reason, tick, requested=requested, missed=why is Stop.MISSED
                )
        if mode is Mode.FAULT:
            if fault_tick < 0:
                fault_tick, fault_detail = tick, fault_text(cycle)
            if tick - fault_tick >= fault_ticks:
                return Ending(mode, cycle.faults, fault_detail, tick, fault_tick)
        elif mode is Mode.WAITING and tick >= no_drives_tick:
            if cycle.measurement.age.min() >= NEVER:
                return Ending(mode, cycle.faults, "no drives", tick)
            latched = (cycle.measurement.state == DriveState.FAULT).any()
            if latched or tick >= not_ready_tick:
                return Ending(mode, cycle.faults, waiting_text(cycle), tick)


def _answer(setpoints: SetPointSocket, cycle: Cycle, recording: Recording, t_ns: int) -> None:
    """Tell the senders what became of their set-points, and the log of those that were refused."""
    steering = cycle.parts.steering
    assert steering is not None
    if steering.answers:
        setpoints.answer(steering.answers)
    if steering.counts.refusal:
        recording.event(t_ns, "warning", f"set-point refused: {explain(steering.counts.refusal)}")


def drives_off(cycle: Cycle) -> bool:
    """Tell whether all six drives report OFF."""
    return all(state == DriveState.OFF for state in cycle.measurement.state.tolist())


def fault_text(cycle: Cycle) -> str:
    """Say which faults are latched, and which drives show them."""
    measurement = cycle.measurement
    names = ", ".join(str(fault.name) for fault in cycle.faults)
    legs: list[str] = []
    if cycle.faults & Fault.STALE:
        legs += _silent(measurement.age.tolist(), cycle.parts.rate_Hz)
    if cycle.faults & Fault.ENCODER:
        slipped = cycle.parts.fusion.slipped if cycle.parts.fusion else ()
        legs += [f"the encoder of leg {leg} contradicts the pose of the others" for leg in slipped]
    if cycle.faults & Fault.DRIVE:
        for leg, (state, fault) in enumerate(zip(measurement.state, measurement.fault, strict=True)):
            if state in (DriveState.FAULT, DriveState.BOOT):
                legs.append(f"drive {leg} in {DriveState(state).name}{_because(fault)}")
    return f"latched fault {names}" + (f" ({'; '.join(legs)})" if legs else "")


def _silent(ages: list[int], rate_Hz: float) -> list[str]:
    """Say which legs have not been heard for how many ticks, and where to look if it is all of them."""
    if min(ages) == 0:
        return [f"leg {leg} not heard for {age} ticks" for leg, age in enumerate(ages) if age > 0]
    stall_ms = 1e3 * min(ages) / rate_Hz
    why = f"the drives, the bus or this machine stalled for {stall_ms:.0f} ms"
    mend = "a machine that does needs a lower loop.rate_Hz with a longer drives.watchdog_ms"
    return [f"no leg heard for {min(ages)} ticks: {why}; {mend}"]


def waiting_text(cycle: Cycle) -> str:
    """Say what the drives still lack to be engaged."""
    measurement = cycle.measurement
    lacking = []
    for leg in range(LEGS):
        state = DriveState(int(measurement.state[leg]))
        if measurement.age[leg] >= NEVER:
            lacking.append(f"drive {leg} never answered")
        elif measurement.age[leg] > 1:
            lacking.append(f"drive {leg} is silent")
        elif state is not DriveState.OFF:
            lacking.append(f"drive {leg} stays in {state.name}{_because(measurement.fault[leg])}")
    if not lacking:
        lengths = ", ".join(f"{q:.4f}" for q in measurement.length)
        lacking.append(f"no pose near platform.home has the measured leg lengths {lengths} m")
    latched = (measurement.state == DriveState.FAULT).any()
    mend = "; find out why, then start with --reset to clear latched faults" if latched else ""
    return f"the drives are not ready: {'; '.join(lacking)}{mend}"


def _because(fault: int) -> str:
    """Return a drive's reason in brackets; its number where the drive says something of its own."""
    known = {int(f): f.name for f in DriveFault}
    return f" ({known.get(int(fault), int(fault))})" if fault else ""
