"""Watches the cycle from tick to tick and tells the story of its faults."""

import json
from collections.abc import Callable, Sequence

from drivers.signals import LEGS, DriveMode, DriveState, Fault, Mode
from hil.loop.cycle import Cycle
from hil.loop.modes import drive_mode
from hil.loop.report import any_powered, moving_text, not_confirmed, not_told, unconfirmed
from hil.loop.story.faults import findings
from hil.loop.story.told import DONE, WITHOUT_FORCE, DriveSaid, Finding, Moment, Step, Story, listed, short
from hil.signals import Operator

PUSHED = (
    "leg {leg} stands still while a leg strays: it is pushed by up to {most_N:.3g} N to see whether it "
    "moves; if it was held by friction, state monitor.friction_N, if by a load, that load"
)
EventSink = Callable[[int, str, str], None]
"""Takes t_ns, level and text of an event."""


def no_event(t_ns: int, level: str, text: str) -> None:
    """Keep no event."""
    del t_ns, level, text


class Narrator:
    """Told every tick in which a cycle decides, it knows what its latched faults have to tell.

    It changes nothing. Most ticks have nothing to tell: only what has changed since the last is looked at.

    Mutable state: mode of the last tick, the faults told of, what was found and what the drives
    said then, the modes since, how commands to switch off and the emergency stop went.
    """

    def __init__(self, cycle: Cycle, event: EventSink = no_event) -> None:
        """Watch a cycle from its present tick on; each finding is an event."""
        self._cycle, self._event = cycle, event
        self._mode, self._mode_tick = cycle.mode, cycle.mode_tick
        self._reset_tick = cycle.reset_tick
        self._forget()

    def _forget(self) -> None:
        self._faults = Fault.NONE
        self._findings: list[Finding] = []
        self._drives: tuple[DriveSaid, ...] = ()
        self._steps: list[tuple[int, Mode, bool]] = []
        self._off_tick: int | None = None
        """When the drives were first asked to switch off."""
        self._told = False
        """The bus has taken a command to switch off."""
        self._all_off: tuple[int, str] | None = None
        """When all drives first said that they are, and their states."""
        self._estop_tick: int | None = None
        """When an emergency stop was first sent."""

    def look(self, operator: Sequence[Operator] = ()) -> None:
        """Take in the tick that was just stepped, and the operator's commands in it."""
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
        """Make an event of each push that begins."""
        safety = cycle.parts.safety
        began = (cycle.last["probe_force"] == 0.0) & (abs(safety.memory["push"]) == 1)
        for leg in began.nonzero()[0].tolist():
            most_N = float(safety.limits["push_N"][leg])
            self._event(int(cycle.tick["t_ns"]), "warning", PUSHED.format(leg=leg, most_N=most_N))

    def _wait(self, cycle: Cycle, off_tick: int) -> None:
        """See whether the drives are off that were told to be, and have all been heard since."""
        tick = cycle.tick
        since = int(tick["tick"]) - off_tick
        self._told = self._told or not (tick["sends_failed"] or tick["bus_off"])
        heard = bool(((tick["age"] < since) | (tick["blind"] != 0)).all())
        if self._told and heard and not any_powered(tick):
            self._all_off = int(tick["tick"]), " or ".join(sorted({each.state for each in said(cycle)}))

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
                self._drives = said(cycle)
            for each in found:
                self._event(int(tick["t_ns"]), "error", f"{each.line}\n{json.dumps(each.fields())}")
        if cycle.mode is not self._mode or (new and not self._steps):
            self._steps.append((number, cycle.mode, released and self._mode is Mode.HELD))
            if drive_mode(cycle.mode) is not DriveMode.OFF:
                self._off_tick, self._told, self._all_off = None, False, None
            elif self._off_tick is None:
                self._off_tick = number

    @property
    def short(self) -> str:
        """The faults and what shows them, in one line; empty without."""
        return short(self._findings)

    def story(self, plant: str = "") -> Story | None:
        """Return what there is to tell by now; None without a fault.

        `plant`: why it failed, which has ended the simulation.
        """
        if not self._findings and not plant:
            return None
        tick = self._cycle.tick
        moving = moving_text(self._cycle)
        rest = f"still moving: {moving}" if moving else "no leg that is heard moves"
        if tick["age"].all():
            rest = "no leg is heard, so nobody here knows whether one moves"
        done = self._done()
        if plant:
            number = int(tick["tick"])
            done.append(
                Step(number, number / self._cycle.parts.rate_Hz, "PLANT", "the simulation ended with it")
            )
        now = said(self._cycle)
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
                text += "; the brakes had passed their test"
            steps.append(Step(tick, tick / rate, mode.name, text))
            before = mode
        if self._estop_tick is not None:
            steps.append(Step(self._estop_tick, self._estop_tick / rate, "ESTOP", self._stopped()))
        return sorted(steps, key=lambda step: step.tick)

    def _braked(self, since: int) -> str:
        """Say which drives have not said since a tick that they brake."""
        now = int(self._cycle.tick["tick"])
        run = DriveState.RUN.name
        missing = [d.leg for d in said(self._cycle) if d.state == run or now - d.age <= since]
        return f"; not confirmed by drive {listed(missing)}" if missing else ""

    def _switched_off(self, off_tick: int) -> str:
        """Say what became of the command to switch off."""
        cycle, now = self._cycle, int(self._cycle.tick["tick"])
        if now == off_tick:
            return DONE[Mode.FAULT]
        running = any(d.state == DriveState.RUN.name for d in self._drives)
        reaction = cycle.parts.setup.reaction.name.lower() if running else "brake"
        if not self._told:
            return not_told(cycle.parts, reaction)
        if self._all_off is not None:
            tick, states = self._all_off
            later_ms = 1e3 * (tick - off_tick) / cycle.parts.rate_Hz
            return f"{DONE[Mode.FAULT]}: all six in {states} {later_ms:g} ms later"
        silent = listed([d.leg for d in said(cycle) if d.powered or now - d.age <= off_tick])
        return f"{DONE[Mode.FAULT]}: not confirmed by drive {silent}; {not_confirmed(cycle.parts, reaction)}"

    def _stopped(self) -> str:
        """Say what became of the emergency stop."""
        if self._off_tick is not None and not self._told and int(self._cycle.tick["tick"]) > self._off_tick:
            return "the emergency stop could not be sent: the bus takes no frames"
        silent = unconfirmed(self._cycle.tick, self._cycle.parts.protocol.traits.stop_latches)
        who = f"not confirmed by drive {listed(silent)}" if silent else "all six drives confirmed it"
        return f"the emergency stop was sent; {who}"


def said(cycle: Cycle) -> tuple[DriveSaid, ...]:
    """Return what each drive has said of itself up to the last tick, its maker's codes with their meaning."""
    tick, meaning = cycle.tick, cycle.parts.protocol.fault_text
    columns = (tick[name].tolist() for name in ("drive_state", "drive_fault", "age", "blind"))
    rows = zip(range(LEGS), *columns, strict=True)
    return tuple(
        DriveSaid(leg, DriveState(state).name, fault, 0 if blind else age, meaning(fault) if fault else "")
        for leg, state, fault, age, blind in rows
    )
