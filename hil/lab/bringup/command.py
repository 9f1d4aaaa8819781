"""`hil bringup`: the procedure at a bus or on the rehearsal bench, its state, its log, its files."""

import contextlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.can.bus import Bus
from drivers.clock import MONOTONIC, Clock
from drivers.errors import ConfigurationError, RunError
from drivers.family import Family
from drivers.protocol import Frame, Received
from drivers.signals import Fault
from drivers.tick_columns import Record, row_of
from hil.app.compose import attachments, build_protocol, build_scene
from hil.app.configuration.configuration import Configuration, loads
from hil.app.files import write_whole
from hil.app.output import further, log_path
from hil.app.run.command import run_daemon
from hil.app.run.stretching import stood_still_line, stretches
from hil.lab.bringup.checklist import checklist
from hil.lab.bringup.context import Context, Finding, RefusedError, Request
from hil.lab.bringup.drives import Drives
from hil.lab.bringup.ends import End, bus_line, served_end
from hil.lab.bringup.found import FIRST_M, found_text, mended
from hil.lab.bringup.hands import asked, hands_socket
from hil.lab.bringup.machine import bringup_rate, build_machine, known_poses
from hil.lab.bringup.procedure import Outcome, bring_up
from hil.lab.bringup.rehearsal import Agree, BenchHands, BenchLine, build_bench, wiring_of
from hil.lab.bringup.release import Together, lines_of, mark_moved, six_legs, state_lengths
from hil.lab.bringup.store import Store, identity
from hil.lab.bringup.terminal import Terminal
from hil.loop.clock import real_time
from hil.record import Recording
from plant_fmu.rehearsal.bench import RehearsalBench

_SERVED = "a bench that another process serves"
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
    served = mistakes is None and asked(hands_socket(c.bus.interface, c.bus.channel))
    rehearsed = mistakes is not None or served
    if mistakes is None:
        c.require("run")
    if yes and not rehearsed:
        raise RunError("--yes agrees to everything, and that is for a bench: leave it out at a machine")
    protocol = build_protocol(c)
    bench = None if mistakes is None else build_bench(c, wiring_of(mistakes, protocol))
    files = files_of(configuration, c, state, rehearsal=bench is not None)
    store = Store(files.state, identity(c, [_SERVED] if served else mistakes or ()), again=again)
    if store.changed:
        say(f"other hardware than in {files.state} ({store.changed}): everything is measured again")
    elif store.facts:
        say(f"{files.state}: what it holds is not asked again; --again begins anew")
    path = log_path(c.recording.folder, f"{c.name}-bringup", log)
    with contextlib.ExitStack() as outer:
        steps = outer.enter_context(contextlib.ExitStack())
        bus = None if bench is not None else steps.enter_context(Bus.open(c.bus, role="controller"))
        recording = outer.enter_context(_log(c, path, None if bus is None else bus.clock))
        said = _Said(say, recording)
        terminal = Terminal(said)
        agree: Agree = (lambda *_: True) if yes else terminal.consent
        with steps:
            if bench is not None:
                line = BenchLine(bench.nodes, bringup_rate(c))
                end = End(line, BenchHands(bench, known_poses(c), agree, said))
            elif served and bus is not None:
                end = steps.enter_context(served_end(c, bus, protocol, terminal, agree, said))
            else:
                assert bus is not None
                mark_moved(c, said)
                steps.enter_context(real_time(c.loop.priority, c.loop.cpu))
                end = End(bus_line(c, bus, protocol), terminal)
            outcome, context, reason = _proceed(c, protocol, end, store, said, hang=bench is None)
        bench_time = stretches(np.array(said.stood_ns, np.int64))
        text = found_text(c, context, outcome.findings, rehearsed=rehearsed)
        together = Together(success=False, lines=[])
        unwritten: dict[str, Any] = {}
        if outcome.success and not reason:
            write_whole(files.found, text)
            found = loads(text, str(files.found), c.folder)
            together = _release(found, bench, context, said, agree, served=served)
            if together.success:
                with further(unwritten):
                    write_whole(files.found, found_text(c, context, (), released=True, rehearsed=rehearsed))
            if together.brake_failed:
                store.forget_brakes()
        lines = checklist(context, outcome, together.lines)
        lines += filter(None, [stood_still_line(bench_time)])
        if outcome.findings:
            with further(unwritten):
                next_ = _write_mended(c, context, files.found, text, outcome.findings, rehearsed=rehearsed)
                said(next_)
                lines.append(next_)
        stamp = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
        head = [f"bring-up of {c.name}, {stamp}", f"configuration {c.source}, log {path}", ""]
        if rehearsed:
            head.insert(0, "REHEARSAL on an emulated bench, no machine was measured:")
        with further(unwritten):
            write_whole(files.checklist, "\n".join([*head, *lines, ""]))
        for each in lines:
            said.event(each)
        store.forget(outcome.findings)
        closed = recording.close()
    if closed.error:
        cut = f"{closed.error}: {closed.dropped + closed.lost} ticks are not in the log"
        reason = "; ".join(filter(None, (reason, cut)))
    summary = {
        "success": together.success and not closed.error,
        "kind": "bringup",
        "trouble": reason or None,
        "configuration": c.source,
        "passed": list(outcome.passed),
        "not_provable": [f"{step}: {gap.line}" for step, gap in outcome.gaps],
        "findings": [finding.line for finding in outcome.findings],
        "checklist": str(files.checklist),
        **({"found": str(files.found)} if files.found.exists() else {}),
        "state": str(files.state),
        "log": str(path),
        **unwritten,
    }
    return summary | ({"bench_time": bench_time} if bench_time["stretches"] else {})


def _write_mended(
    c: Configuration,
    context: Context,
    file: Path,
    text: str,
    findings: Sequence[Finding],
    *,
    rehearsed: bool,
) -> str:
    """Write what was found with findings, where it can be loaded; return what is next, or why not."""
    try:
        loads(text, "found", c.folder)
    except ConfigurationError as error:
        return f"no configuration is written, since with what was found it is refused: {error}"
    write_whole(file, text)
    done = dict.fromkeys(finding.name for finding in mended(c, context, findings))
    line = f"next: hil bringup {file}{' --rehearse' if rehearsed else ''}"
    if any(finding.name not in done for finding in findings):
        line += ", once what was found at the machine is mended"
    return f"{line}; that file makes up for {', '.join(done)}: do not mend it there, too" if done else line


class _Said:
    """Says texts to the operator and into the log. Mutable state: the attributes."""

    def __init__(self, say: Callable[[str], None], recording: Recording) -> None:
        self._say, self._recording = say, recording
        self.t_ns = 0
        self.trouble = ""
        """Why the recorder has ended; empty while it lives."""
        self.stood_ns: list[int] = []
        """For how long bench time stood still before ticks, where it did."""

    def __call__(self, text: str) -> None:
        self.event(text)
        self._say(text)

    def event(self, text: str) -> None:
        """Record a text."""
        if self._recorded():
            self._recording.event(self.t_ns, "info", text)

    def _recorded(self) -> bool:
        """Whether the recorder lives; say once why not."""
        if not self.trouble:
            self.trouble = self._recording.trouble
            if self.trouble:
                self._say(f"the log ends here ({self.trouble}): without a whole log this is no success")
        return not self.trouble

    def tick(self, record: Record, received: Sequence[Received], sent: Sequence[Frame]) -> None:
        """Record a tick."""
        self.t_ns = int(record["t_ns"])
        if record["stretched_ns"]:
            self.stood_ns.append(int(record["stretched_ns"]))
        if self._recorded():
            self._recording.tick(row_of(record), received, sent)


def _proceed(
    c: Configuration, protocol: Family, end: End, store: Store, said: _Said, *, hang: bool
) -> tuple[Outcome, Context, str]:
    """Do the steps, then have the platform fixed if `hang`; return how far, what is known, why ended."""
    machine = build_machine(c, protocol)
    drives = Drives(protocol, end.line, machine.watchdog_s, said.tick)
    context = Context(machine, drives, end.operator, store.facts, store.save)
    try:
        outcome = bring_up(context)
        if outcome.success and hang:
            context.ask(Request("mount", text=_MOUNT))
    except RefusedError as refusal:
        why = str(refusal)
    except KeyboardInterrupt:
        why = "interrupted: forces zero, brakes shut; what was found is kept"
    else:
        return outcome, context, ""
    return Outcome(tuple(store.facts.get("passed", {})), (), stopped="ended"), context, why


def _release(
    found: Configuration,
    bench: RehearsalBench | None,
    context: Context,
    said: _Said,
    agree: Agree,
    *,
    served: bool,
) -> Together:
    """Let all six legs move together, by the ordinary controller at the limits that were found.

    Not with a log that was cut; the homing file is written once the operator has consented.
    """
    why = "not begun, since the log is not whole" if said.trouble else ""
    if not why:
        said("together: six legs at reduced limits")
        will = f"lets the brakes carry the platform, opens all six, and moves it by {1e3 * FIRST_M:g} mm"
        try:
            agree("six legs together", will, "Ctrl-C parks, twice stops")
        except (RefusedError, KeyboardInterrupt) as refusal:
            why = str(refusal) or "interrupted before it began"
    if why:
        return Together(success=False, lines=[f"[ ] together: {why}"])
    if bench is None:
        if not served:
            state_lengths(found, context, said)
        summary = run_daemon(found, draw=False, arm=True, on_bench=served)
        success, faults = summary["success"], summary.get("faults", ())
        stood = stood_still_line(summary["bench_time"]) if "bench_time" in summary else ""
        lines = lines_of(success, summary["trouble"] or f"log {summary['log']}", stood)
        together = Together(success, lines, "BRAKE" in faults)
    else:
        ending = six_legs(found, bench)
        lines = lines_of(ending.success, ending.trouble)
        together = Together(ending.success, lines, Fault.BRAKE in ending.faults)
    for line in together.lines:
        said(line)
    return together


def _log(c: Configuration, path: Path, clock: Clock | None) -> Recording:
    """Record a bring-up on a bus by its clock; None: a rehearsal, which has a time of its own."""
    return Recording.start(
        path,
        configuration=c.text,
        attachments=attachments(c),
        metadata={"kind": "bringup", "rate_Hz": bringup_rate(c), "protocol": c.drives.protocol},
        scene=build_scene(c),
        can_channel=[each.channel for each in c.bus.buses],
        ring_ticks=c.recording.ring_ticks,
        lockstep=clock is None,
        clock=clock or MONOTONIC,
    )
