"""Narrator: watches the cycle from tick to tick and collects the report of its faults."""

import json
from collections.abc import Callable, Sequence

from drivers.signals import LEGS, DriveMode, DriveState, Fault, Mode
from hil.loop.cycle import Cycle
from hil.loop.modes import drive_mode
from hil.loop.report import any_powered, moving_text, not_confirmed, off_not_sent, unconfirmed
from hil.loop.story.faults import findings
from hil.loop.story.story import DONE, WITHOUT_FORCE, DriveReport, Finding, Moment, Step, Story, listed, short
from hil.signals import Operator

PUSHED = (
    "leg {leg} stands still while a leg strays from its reference: it is pushed by up to {most_N:.3g} N to "
    "test whether it moves. If friction held it, set monitor.friction_N; if a load held it, model the load"
)
EventSink = Callable[[int, str, str], None]
"""Receives t_ns, level and text of an event."""


def no_event(t_ns: int, level: str, text: str) -> None:
    """Event sink that discards the event."""
    del t_ns, level, text


class Narrator:
    """Collects the report of the latched faults from every tick in which the cycle decides.

    It changes nothing in the cycle. In most ticks there is nothing new; it looks only at changes.

    Mutable state: mode of the last tick, the reported faults, their findings and the drives' reports at that
    time, the modes since, the fate of commands to switch off and of the emergency stop.
    """

    def __init__(self, cycle: Cycle, event: EventSink = no_event) -> None:
        """Watch a cycle from its present tick on; `event` receives each finding of a fault."""
        self._cycle, self._event = cycle, event
        self._mode, self._mode_tick = cycle.mode, cycle.mode_tick
        self._reset_tick = cycle.reset_tick
        self._forget()

    def _forget(self) -> None:
        self._faults = Fault.NONE
        self._findings: list[Finding] = []
        self._drives: tuple[DriveReport, ...] = ()
        self._steps: list[tuple[int, Mode, bool]] = []
        self._off_tick: int | None = None
        """Tick of the first command to switch off."""
        self._sent = False
        """True once the bus has accepted a command to switch off."""
        self._all_off: tuple[int, str] | None = None
        """First tick in which all drives report to be off, and their states."""
        self._estop_tick: int | None = None
        """Tick of the first emergency stop frame."""

    def look(self, operator: Sequence[Operator] = ()) -> None:
        """Update the report from the tick that was just stepped; operator: its commands."""
        cycle = self._cycle
        if cycle.reset_tick != self._reset_tick:
            self._reset_tick = cycle.reset_tick
            self._forget()
        faults, mode = cycle.faults, cycle.mode
        if cycle.tick["probe_force"].any():
            self._push(cycle)
        if faults:
            if cycle.estop and self._estop_tick is None:
                self._estop_tick = int(cycle.tick["tick"])
            if self._off_tick is not None and self._all_off is None:
                self._wait(cycle, self._off_tick)
            if mode is not self._mode or faults != self._faults:
                self._follow(cycle, faults, Operator.RELEASE in operator)
        self._mode, self._mode_tick = mode, cycle.mode_tick

    def _push(self, cycle: Cycle) -> None:
        safety = cycle.parts.safety
        began = (cycle.last["probe_force"] == 0.0) & (abs(safety.memory["push"]) == 1)
        for leg in began.nonzero()[0].tolist():
            most_N = float(safety.limits["push_N"][leg])
            self._event(int(cycle.tick["t_ns"]), "warning", PUSHED.format(leg=leg, most_N=most_N))

    def _wait(self, cycle: Cycle, off_tick: int) -> None:
        """Note when all drives have reported since the command to switch off that they are off."""
        tick = cycle.tick
        since = int(tick["tick"]) - off_tick
        self._sent = self._sent or not (tick["sends_failed"] or tick["bus_off"])
        heard = bool(((tick["age"] < since) | (tick["blind"] != 0)).all())
        if self._sent and heard and not any_powered(tick):
            self._all_off = (
                int(tick["tick"]),
                " or ".join(sorted({each.state for each in reports(cycle)})),
            )

    def _follow(self, cycle: Cycle, faults: Fault, released: bool) -> None:
        tick = cycle.tick
        number = int(tick["tick"])
        if self._faults & ~faults:
            self._forget()
        new = faults & ~self._faults
        if new:
            first = not self._findings
            elapsed_s = (number - self._mode_tick) / cycle.parts.rate_Hz
            found = list(findings(Moment(cycle, cycle.last, self._mode, elapsed_s), new))
            self._findings += found
            self._faults = faults
            if first:
                self._drives = reports(cycle)
            for each in found:
                self._event(int(tick["t_ns"]), "error", f"{each.line}\n{json.dumps(each.fields())}")
        if cycle.mode is not self._mode or (new and not self._steps):
            self._steps.append((number, cycle.mode, released and self._mode is Mode.HELD))
            if drive_mode(cycle.mode) is not DriveMode.OFF:
                self._off_tick, self._sent, self._all_off = None, False, None
            elif self._off_tick is None:
                self._off_tick = number

    @property
    def short(self) -> str:
        """The faults and their evidence in one line; empty without faults."""
        return short(self._findings)

    def story(self, plant: str = "") -> Story | None:
        """Report of the faults so far; None without a fault.

        `plant`: reason of a plant failure, which has ended the simulation.
        """
        if not self._findings and not plant:
            return None
        tick = self._cycle.tick
        moving = moving_text(self._cycle)
        rest = f"still moving: {moving}" if moving else "all legs that report are at rest"
        if tick["age"].all():
            rest = "no leg reports, so a leg may still move"
        done = self._done()
        if plant:
            number = int(tick["tick"])
            done.append(Step(number, number / self._cycle.parts.rate_Hz, "PLANT", "the simulation ended too"))
        now = reports(self._cycle)
        return Story(tuple(self._findings), self._drives or now, tuple(done), now, rest, plant)

    def _done(self) -> list[Step]:
        cycle, rate = self._cycle, self._cycle.parts.rate_Hz
        done = DONE if cycle.parts.protocol.traits.force_on_brakes else DONE | WITHOUT_FORCE
        off = [n for n, (_, mode, _) in enumerate(self._steps) if drive_mode(mode) is DriveMode.OFF]
        steps: list[Step] = []
        before: Mode | None = None
        for n, (tick, mode, released) in enumerate(self._steps):
            text = done[mode]
            if self._off_tick is not None and off[-1:] == [n]:
                text = self._switched_off(self._off_tick)
            if mode is Mode.HELD and n == len(self._steps) - 1:
                text += self._braked(tick)
            if released:
                text = f"the platform was released on request; {text}"
            tested = before is Mode.UNLOADING and cycle.proven and cycle.durations.load > 0.0
            if mode is Mode.PARKED and tested:
                text += "; the brakes passed their test"
            steps.append(Step(tick, tick / rate, mode.name, text))
            before = mode
        if self._estop_tick is not None:
            steps.append(Step(self._estop_tick, self._estop_tick / rate, "ESTOP", self._stopped()))
        return sorted(steps, key=lambda step: step.tick)

    def _braked(self, since: int) -> str:
        """Text: drives that have not reported a closed brake since a tick; empty if all have."""
        now = int(self._cycle.tick["tick"])
        run = DriveState.RUN.name
        missing = [d.leg for d in reports(self._cycle) if d.state == run or now - d.age <= since]
        return f"; not confirmed by drive {listed(missing)}" if missing else ""

    def _switched_off(self, off_tick: int) -> str:
        """Text: which drives have switched off since the command in `off_tick`, and which have not."""
        cycle, now = self._cycle, int(self._cycle.tick["tick"])
        if now == off_tick:
            return DONE[Mode.FAULT]
        running = any(d.state == DriveState.RUN.name for d in self._drives)
        reaction = cycle.parts.setup.reaction.name.lower() if running else "brake"
        if not self._sent:
            return off_not_sent(cycle.parts, reaction)
        if self._all_off is not None:
            tick, states = self._all_off
            later_ms = 1e3 * (tick - off_tick) / cycle.parts.rate_Hz
            return f"{DONE[Mode.FAULT]}: all six in {states} {later_ms:g} ms later"
        silent = listed([d.leg for d in reports(cycle) if d.powered or now - d.age <= off_tick])
        return f"{DONE[Mode.FAULT]}: not confirmed by drive {silent}; {not_confirmed(cycle.parts, reaction)}"

    def _stopped(self) -> str:
        """Text: whether the emergency stop was sent, and which drives have not confirmed it."""
        if self._off_tick is not None and not self._sent and int(self._cycle.tick["tick"]) > self._off_tick:
            return "the emergency stop could not be sent: the bus takes no frames"
        silent = unconfirmed(self._cycle.tick, self._cycle.parts.protocol.traits.stop_latches)
        who = f"not confirmed by drive {listed(silent)}" if silent else "all six drives confirmed it"
        return f"the emergency stop was sent; {who}"


def reports(cycle: Cycle) -> tuple[DriveReport, ...]:
    """Last state report of each drive, with the meaning of its fault code."""
    tick, meaning = cycle.tick, cycle.parts.protocol.fault_text
    columns = (tick[name].tolist() for name in ("drive_state", "drive_fault", "age", "blind"))
    rows = zip(range(LEGS), *columns, strict=True)
    return tuple(
        DriveReport(leg, DriveState(state).name, fault, 0 if blind else age, meaning(fault) if fault else "")
        for leg, state, fault, age, blind in rows
    )
