"""`hil bringup`: the procedure at a bus or on the rehearsal bench, its state, its log, its files."""

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from drivers.bus_address import BusAddress
from drivers.can.bus import Bus
from drivers.can.localcan.bench_clock import BenchClock
from drivers.errors import ConfigurationError, RunError
from drivers.protocol import Frame, Received
from drivers.signals import Fault
from drivers.tick_columns import Record, row_of
from hil.app.bringup.bus_line import BusLine
from hil.app.bringup.checklist import checklist
from hil.app.bringup.found import FIRST_M, found_text, mended
from hil.app.bringup.hands import RemoteHands, asked, hands_socket
from hil.app.bringup.homing import mark_moved, state_lengths
from hil.app.bringup.machine import WINDOW, bringup_rate, build_machine, known_poses
from hil.app.bringup.rehearsal import BenchHands, BenchLine, build_bench
from hil.app.bringup.store import Store, identity
from hil.app.bringup.terminal import Terminal
from hil.app.bringup.together import Together, lines_of, six_legs
from hil.app.bringup.words import wiring_of
from hil.app.compose import attachments, build_protocol, build_scene, drive_setup
from hil.app.configuration.configuration import Configuration, loads
from hil.app.files import write_whole
from hil.app.output import log_path
from hil.app.run.command import run_daemon
from hil.app.run.stretching import begin, bench_clock
from hil.bringup.context import Context, Finding, Operator, RefusedError, Request
from hil.bringup.drives import Drives
from hil.bringup.line import Line
from hil.bringup.procedure import Outcome, bring_up
from hil.loop.clock import real_time
from hil.record import Recording
from plant_fmu.rehearsal.bench import RehearsalBench

_MOUNT = "Fix the platform to its legs, take the levers off the brakes, keep the hoist slack, and stand clear"


class Files(NamedTuple):
    """Where a bring-up writes."""

    state: Path
    found: Path
    checklist: Path


def files_of(configuration: str, c: Configuration, state: Path | None, *, rehearsal: bool) -> Files:
    """Return files beside a given configuration, in this folder for a shipped one; none is written over."""
    given = Path(configuration)
    folder = given.parent if given.is_file() else Path()
    stem = given.stem if given.is_file() else c.name
    kind = "rehearsal" if rehearsal else "bringup"
    number, end = 1, ""
    while any((folder / f"{stem}.{kind}{end}{tail}").exists() for tail in (".yaml", ".txt")):
        number += 1
        end = f"-{number}"
    return Files(
        folder / f"{stem}.{kind}.state.json" if state is None else state,
        folder / f"{stem}.{kind}{end}.yaml",
        folder / f"{stem}.{kind}{end}.txt",
    )


def run_bringup(
    configuration: str,
    c: Configuration,
    *,
    mistakes: Sequence[str] | None = None,
    log: Path | None = None,
    state: Path | None = None,
    again: bool = False,
    yes: bool = False,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Bring a machine up, or rehearse it with some mistakes (a list, maybe empty); return the summary.

    yes: agree to all steps, on a bench only. again: begin anew, whatever the state file holds.
    Raises ConfigurationError, BusError, RunError before anything moves.
    """
    rehearsal = mistakes is not None
    words = tuple(mistakes or ())
    served = not rehearsal and asked(hands_socket(c.bus.interface, c.bus.channel))
    rehearsed = rehearsal or served
    if not rehearsal:
        c.require("run")
        if yes and not rehearsed:
            raise RunError("--yes agrees to everything, and that is for a bench: leave it out at a machine")
    wiring = wiring_of(words, build_protocol(c)) if rehearsal else None
    files = files_of(configuration, c, state, rehearsal=rehearsal)
    store = Store(files.state, identity(c, words), again=again)
    if store.changed:
        say(f"other hardware than in {files.state} ({store.changed}): everything is measured again")
    elif store.facts:
        say(f"{files.state}: what it holds is not asked again; --again begins anew")
    path = log_path(c.recording.folder, f"{c.name}-bringup", log)
    with _log(c, path, lockstep=rehearsal) as recording:
        said = _Said(say, recording)
        if not rehearsal:
            mark_moved(c, said)
        bench = build_bench(c, wiring) if wiring is not None else None
        outcome, context, reason = _proceed(c, bench, store, said, yes=yes, served=served)
        text = found_text(c, context, outcome.findings, rehearsed=rehearsed)
        together = Together(success=False, lines=[])
        if outcome.success and not reason:
            write_whole(files.found, text)
            together = _release(
                loads(text, str(files.found), c.folder), bench, context, said, yes=yes, served=served
            )
            if together.success:
                text = found_text(c, context, (), released=True, rehearsed=rehearsed)
                write_whole(files.found, text)
            if together.brake_failed:
                store.forget_brakes()
        lines = checklist(context, outcome, together.lines)
        if outcome.findings:
            lines += _write_mended(c, files.found, text, outcome.findings, said, rehearsal=rehearsal)
        write_whole(files.checklist, "\n".join([*_head(c, path, rehearsed=rehearsed), *lines]) + "\n")
        for line in lines:
            said.event(line)
        store.forget(outcome.findings)
        closed = recording.close()
    if closed.error:
        cut = f"{closed.error}: {closed.dropped + closed.lost} ticks are not in the log"
        reason = "; ".join(filter(None, (reason, cut)))
    return _summary(c, outcome, files, path, reason, success=together.success and not closed.error)


def _write_mended(
    c: Configuration,
    file: Path,
    text: str,
    findings: Sequence[Finding],
    said: "_Said",
    *,
    rehearsal: bool,
) -> list[str]:
    """Write what was found with findings, where it can be loaded; say and return what is next, or why not."""
    try:
        loads(text, c.name, c.folder)
    except ConfigurationError as error:
        refusal = str(error).replace(f"{c.name}:", "line ", 1)
        line = f"no configuration is written, since with what was found it is refused: {refusal}"
        said(line)
        return [line]
    write_whole(file, text)
    done = [finding.name for finding in mended(c, findings)]
    line = f"next: hil bringup {file}{' --rehearse' if rehearsal else ''}"
    if len(done) < len(findings):
        line += ", once what was found at the machine is mended"
    if done:
        line += (
            f"; that file makes up for {', '.join(dict.fromkeys(done))}: do not mend it at the machine, too"
        )
    said(line)
    return [line]


def _summary(
    c: Configuration, outcome: Outcome, files: Files, log: Path, reason: str, *, success: bool
) -> dict[str, Any]:
    return {
        "success": success,
        "kind": "bringup",
        "trouble": reason or None,
        "configuration": c.source,
        "passed": list(outcome.passed),
        "not_provable": [f"{step}: {gap.line}" for step, gap in outcome.gaps],
        "findings": [finding.line for finding in outcome.findings],
        "checklist": str(files.checklist),
        **({"found": str(files.found)} if files.found.exists() else {}),
        "state": str(files.state),
        "log": str(log),
    }


class _Said:
    """Says texts to the operator and into the log.

    Mutable state: the time of the last tick, and why the log was cut.
    """

    def __init__(self, say: Callable[[str], None], recording: Recording) -> None:
        self._say, self._recording = say, recording
        self.t_ns = 0
        self.trouble = ""
        """Why the recorder has ended; empty while it lives."""

    def __call__(self, text: str) -> None:
        self.event(text)
        self._say(text)

    def event(self, text: str) -> None:
        """Record a text."""
        if self._recorded():
            self._recording.event(self.t_ns, "info", text)

    def _recorded(self) -> bool:
        """Tell whether the recorder lives; say once why not."""
        if not self.trouble:
            self.trouble = self._recording.trouble
            if self.trouble:
                self._say(f"the log ends here ({self.trouble}): without a whole log this is no success")
        return not self.trouble

    def tick(self, record: Record, received: Sequence[Received], sent: Sequence[Frame]) -> None:
        """Record a tick."""
        self.t_ns = int(record["t_ns"])
        if self._recorded():
            self._recording.tick(row_of(record), received, sent)


def _proceed(
    c: Configuration,
    bench: RehearsalBench | None,
    store: Store,
    said: _Said,
    *,
    yes: bool,
    served: bool,
) -> tuple[Outcome, Context, str]:
    """Do the steps on an open line; return how far they came, what is known, and why they were ended.

    served: a bench that another process serves is on the bus.
    """
    protocol, rate = build_protocol(c), bringup_rate(c)
    machine = build_machine(c, protocol)
    with contextlib.ExitStack() as stack:
        terminal = Terminal(said)
        agree = _agreed if yes else terminal.consent
        line: Line
        operator: Operator = terminal
        if bench is not None:
            line, operator = BenchLine(bench.nodes, rate), BenchHands(bench, known_poses(c), agree, said)
        else:
            bus = stack.enter_context(Bus.open(c.bus, role="controller"))
            window_s = WINDOW / rate
            if served:
                said("a rehearsal bench is served on this bus: its hands do what you are asked")
                address = BusAddress(c.bus.interface, c.bus.channel)
                operator = stack.enter_context(contextlib.closing(RemoteHands(address, terminal, agree)))
                clock = bench_clock(c, bus)
                if clock is not None:
                    begin(clock, c, protocol, protocol.start(drive_setup(c, rate)), round(1e9 * window_s))
                    stack.callback(_leave, clock, clock.stretched(), said)
            stack.enter_context(real_time(c.loop.priority, c.loop.cpu))
            line = BusLine(bus, rate, window_s, watched=protocol.has_watchdog)
        drives = Drives(protocol, line, machine.watchdog_s, said.tick)
        context = Context(machine, drives, operator, store.facts, store.save)
        try:
            outcome = bring_up(context)
            if outcome.success and bench is None:
                context.ask(Request("mount", text=_MOUNT))
        except RefusedError as refusal:
            why = str(refusal)
        except KeyboardInterrupt:
            why = "ended by Ctrl-C: forces zero, brakes shut; what was found is kept"
        else:
            return outcome, context, ""
        return Outcome(tuple(store.facts.get("passed", {})), (), stopped="ended"), context, why


def _leave(clock: BenchClock, since_ns: int, said: _Said) -> None:
    """Hold a bench's time no longer, and say by how much it has stood still since it was `since_ns`."""
    clock.leave()
    stood_ms = 1e-6 * (clock.stretched() - since_ns)
    if stood_ms >= 1.0:
        said(
            f"bench time stood still for {stood_ms:.0f} ms where this machine was late: a real drive goes on"
        )


def _release(
    found: Configuration,
    bench: RehearsalBench | None,
    context: Context,
    said: _Said,
    *,
    yes: bool,
    served: bool,
) -> Together:
    """Let all six legs move together, by the ordinary controller at the limits that were found.

    Not with a log that was cut; the homing file is written once the operator has consented.
    """
    if said.trouble:
        return Together(success=False, lines=["[ ] together: not begun, since the log is not whole"])
    said("together: six legs at reduced limits")
    will = f"lets the brakes carry the platform, opens all six, and moves it by {1e3 * FIRST_M:g} mm"
    try:
        (_agreed if yes else Terminal(said).consent)("six legs together", will, "Ctrl-C parks, twice stops")
    except RefusedError as refusal:
        return Together(success=False, lines=[f"[ ] together: {refusal}"])
    if bench is None:
        state_lengths(found, context, said)
        summary = run_daemon(found, draw=False, arm=True, on_bench=served)
        success, faults = summary["success"], summary.get("faults", ())
        lines = lines_of(success, summary["trouble"] or f"log {summary['log']}")
        together = Together(success, lines, str(Fault.BRAKE.name) in faults)
    else:
        ending = six_legs(found, bench)
        lines = lines_of(ending.success, ending.trouble)
        together = Together(ending.success, lines, Fault.BRAKE in ending.faults)
    for line in together.lines:
        said(line)
    return together


def _agreed(*_: str) -> bool:
    """Agree to a step of a rehearsal."""
    return True


def _head(c: Configuration, log: Path, *, rehearsed: bool) -> list[str]:
    stamp = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    kind = "REHEARSAL on an emulated bench, no machine was measured: bring-up" if rehearsed else "bring-up"
    return [f"{kind} of {c.name}, {stamp}", f"configuration {c.source}, log {log}", ""]


@contextlib.contextmanager
def _log(c: Configuration, path: Path, *, lockstep: bool) -> Iterator[Recording]:
    with Recording.start(
        path,
        configuration=c.text,
        attachments=attachments(c),
        metadata={"kind": "bringup", "rate_Hz": bringup_rate(c), "protocol": c.drives.protocol},
        scene=build_scene(c),
        can_channel=c.bus.channel,
        ring_ticks=c.recording.ring_ticks,
        lockstep=lockstep,
    ) as recording:
        yield recording
