"""The command `hil bringup`: commissions a real or an emulated machine and writes the files found."""

import contextlib
import time
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import count
from operator import or_
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drivers.can.bus import Bus
from drivers.clock import MONOTONIC, Clock
from drivers.errors import ConfigurationError, RunError
from drivers.protocol import Frame, Received
from drivers.signals import Fault
from drivers.tick_columns import Record, row_of
from hil.app.compose import attachments, build_protocol, build_scene
from hil.app.configuration.configuration import Configuration, loads
from hil.app.files import write_whole
from hil.app.homing.file import homing_file, homing_path, read_homing, write_homing
from hil.app.output import further, log_path
from hil.app.run.command import run_daemon
from hil.app.run.stretching import stood_still_line, stretches
from hil.lab.bringup.connection import bus_line, hands_socket, is_served, served_end
from hil.lab.bringup.context import Context, Finding, Operator, RefusedError, Request
from hil.lab.bringup.drives import Drives, Line
from hil.lab.bringup.machine import bringup_rate, build_machine, known_poses
from hil.lab.bringup.procedure import Outcome, bring_up, checklist
from hil.lab.bringup.rehearsal import Agree, BenchHands, BenchLine, build_bench, six_legs, wiring_of
from hil.lab.bringup.store import Store, identity
from hil.lab.bringup.terminal import Terminal
from hil.lab.bringup.written_configuration import FIRST_M, FIRST_deg, corrected, found_text
from hil.loop.clock import real_time
from hil.record import Recording
from plant_fmu.rehearsal.bench import RehearsalBench
from plant_fmu.rehearsal.wiring import MISTAKES

_SERVED = "a bench that another process serves"
_MOUNT = "Fix the platform to its legs, take the levers off the brakes, keep the hoist slack, and stand clear"
_TOGETHER = "together: six legs at reduced limits"


class Together(NamedTuple):
    """Result of the first motion of all six legs under the ordinary controller."""

    success: bool
    lines: list[str]
    """Lines for the checklist."""
    brake_failed: bool = False
    """A brake did not hold or did not open, so the brakes must be tested again."""


def files_of(
    configuration: str, c: Configuration, state: Path | None, *, rehearsal: bool
) -> tuple[Path, Path, Path]:
    """Paths of a bring-up's state file, of the configuration to write and of the checklist.

    They lie next to the given configuration file; for a shipped configuration, in the current folder. The
    last two get a number, so that no existing file is overwritten.
    """
    given = Path(configuration)
    folder = given.parent if given.is_file() else Path()
    stem = f"{given.stem if given.is_file() else c.name}.{'rehearsal' if rehearsal else 'bringup'}"
    for number in count(1):
        end = f"-{number}" if number > 1 else ""
        found, checked = (folder / f"{stem}{end}{tail}" for tail in (".yaml", ".txt"))
        if not found.exists() and not checked.exists():
            break
    return folder / f"{stem}.state.json" if state is None else state, found, checked


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
    """Commission a machine, or rehearse that on an emulated bench; return the summary of the run.

    mistakes: assembly mistakes to emulate; None: drives on the bus. yes: consent to all steps, allowed on a
    bench only. again: measure all again. Raises ConfigurationError, BusError, RunError before anything moves.
    """
    served = mistakes is None and is_served(hands_socket(c.bus.interface, c.bus.channel))
    rehearsed = mistakes is not None or served
    if mistakes is None:
        c.require("run")
    if yes and not rehearsed:
        raise RunError("--yes agrees to every step and is for a bench only: leave it out at a machine")
    protocol = build_protocol(c)
    bench = None if mistakes is None else build_bench(c, wiring_of(mistakes, protocol))
    state, found_file, checklist_file = files_of(configuration, c, state, rehearsal=bench is not None)
    store = Store(state, identity(c, [_SERVED] if served else mistakes or ()), again=again)
    if store.changed:
        say(f"other hardware than in {state} ({store.changed}): everything is measured again")
    elif store.facts:
        say(f"{state}: results stored there are not measured again; --again measures everything again")
    path = log_path(c.recording.folder, f"{c.name}-bringup", log)
    with contextlib.ExitStack() as outer:
        steps = outer.enter_context(contextlib.ExitStack())
        bus = None if bench is not None else steps.enter_context(Bus.open(c.bus, role="controller"))
        recording = outer.enter_context(_log(c, path, None if bus is None else bus.clock))
        journal = _Journal(say, recording)
        terminal = Terminal(journal)
        agree: Agree = (lambda *_: True) if yes else terminal.consent
        with steps:
            if bench is not None:
                line: Line = BenchLine(bench.nodes, bringup_rate(c))
                operator: Operator = BenchHands(bench, known_poses(c), agree, journal)
            elif served and bus is not None:
                line, operator = steps.enter_context(served_end(c, bus, protocol, terminal, agree, journal))
            else:
                assert bus is not None
                mark_moved(c, journal)
                steps.enter_context(real_time(c.loop.priority, c.loop.cpu))
                line, operator = bus_line(c, bus, protocol), terminal
            machine = build_machine(c, protocol)
            drives = Drives(protocol, line, machine.watchdog_s, journal.tick)
            context = Context(machine, drives, operator, store.facts, store.save)
            outcome, reason = _proceed(context, hang=bench is None)
        bench_time = stretches(np.array(journal.stood_ns, np.int64))
        text = found_text(c, context, outcome.findings, rehearsed=rehearsed)
        together = Together(success=False, lines=[])
        unwritten: dict[str, Any] = {}
        if outcome.success and not reason:
            write_whole(found_file, text)
            found = loads(text, str(found_file), c.folder)
            together = _release(found, bench, context, journal, agree, served=served)
            if together.success:
                with further(unwritten):
                    write_whole(found_file, found_text(c, context, (), released=True, rehearsed=rehearsed))
            if together.brake_failed:
                for step in ("held", "opens", "shuts", "hoisted", "passed"):  # brakes are tested again
                    store.facts.pop(step, None)
                store.save()
        lines = checklist(context, outcome, together.lines)
        lines += filter(None, [stood_still_line(bench_time)])
        if outcome.findings:
            with further(unwritten):
                next_ = _write_found(c, context, found_file, text, outcome.findings, rehearsed=rehearsed)
                journal(next_)
                lines.append(next_)
        stamp = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
        head = [f"bring-up of {c.name}, {stamp}", f"configuration {c.source}, log {path}", ""]
        if rehearsed:
            head.insert(0, "REHEARSAL on an emulated bench, no machine was measured:")
        with further(unwritten):
            write_whole(checklist_file, "\n".join([*head, *lines, ""]))
        for each in lines:
            journal.event(each)
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
        "checklist": str(checklist_file),
        **({"found": str(found_file)} if found_file.exists() else {}),
        "state": str(state),
        "log": str(path),
        **unwritten,
    }
    return summary | ({"bench_time": bench_time} if bench_time["stretches"] else {})


def _write_found(
    c: Configuration,
    context: Context,
    file: Path,
    text: str,
    findings: Sequence[Finding],
    *,
    rehearsed: bool,
) -> str:
    """Write the corrected configuration if it is valid; return a line with the next command or the error."""
    try:
        loads(text, "found", c.folder)
    except ConfigurationError as error:
        return f"no configuration written: with the values found it is invalid: {error}"
    write_whole(file, text)
    done = dict.fromkeys(finding.name for finding in corrected(c, context, findings))
    line = f"next: hil bringup {file}{' --rehearse' if rehearsed else ''}"
    if any(finding.name not in done for finding in findings):
        line += ", after the findings at the machine are fixed"
    if done:
        line += f"; that file already corrects {', '.join(done)}: do not fix that at the machine as well"
    return line


class _Journal:
    """Writes texts to the operator and into the log. Mutable state: the attributes."""

    def __init__(self, say: Callable[[str], None], recording: Recording) -> None:
        self._say, self._recording = say, recording
        self.t_ns = 0
        self.trouble = ""
        """Reason why the recorder ended; empty while it runs."""
        self.stood_ns: list[int] = []
        """Pauses of the bench time before ticks, ns; ticks without a pause have no entry."""

    def __call__(self, text: str) -> None:
        self.event(text)
        self._say(text)

    def event(self, text: str) -> None:
        if self._recorded():
            self._recording.event(self.t_ns, "info", text)

    def _recorded(self) -> bool:
        """True while the recorder runs; once it has stopped, report the reason one time."""
        if not self.trouble:
            self.trouble = self._recording.trouble
            if self.trouble:
                self._say(f"the log ends here ({self.trouble}); without a complete log this is not a success")
        return not self.trouble

    def tick(self, record: Record, received: Sequence[Received], sent: Sequence[Frame]) -> None:
        self.t_ns = int(record["t_ns"])
        if record["stretched_ns"]:
            self.stood_ns.append(int(record["stretched_ns"]))
        if self._recorded():
            self._recording.tick(row_of(record), received, sent)


def _proceed(context: Context, *, hang: bool) -> tuple[Outcome, str]:
    """Run all steps, then ask for the mounting of the platform if `hang`; return (outcome, early end)."""
    try:
        outcome = bring_up(context)
        if outcome.success and hang:
            context.ask(Request("mount", text=_MOUNT))
    except RefusedError as refusal:
        why = str(refusal)
    except KeyboardInterrupt:
        why = "interrupted: forces zero, brakes shut; results so far are kept"
    else:
        return outcome, ""
    return Outcome(tuple(context.facts.get("passed", {})), (), stopped="ended"), why


def _release(
    found: Configuration,
    bench: RehearsalBench | None,
    context: Context,
    journal: _Journal,
    agree: Agree,
    *,
    served: bool,
) -> Together:
    """Move all six legs together for the first time, by the ordinary controller with the limits found.

    Refused if the log is incomplete. The homing file is written after the operator's consent.
    """
    by = f"{1e3 * FIRST_M:g} mm and {max(FIRST_deg):g} deg"
    will = f"lets the brakes carry the platform, opens all six, and moves each axis by at most {by}"
    why = "not begun: the log is incomplete" if journal.trouble else ""
    try:
        if not why:
            journal(_TOGETHER)
            agree("six legs together", will, "Ctrl-C parks, twice stops")
    except (RefusedError, KeyboardInterrupt) as refusal:
        why = str(refusal) or "interrupted before it began"
    if why:
        return Together(success=False, lines=[f"[ ] together: {why}"])
    if bench is not None:
        ending = six_legs(found, bench)
        success, faults, words = ending.success, ending.faults, [ending.trouble]
    else:
        if not served:
            state_lengths(found, context, journal)
        summary = run_daemon(found, draw=False, arm=True, on_bench=served)
        success = summary["success"]
        faults = reduce(or_, (Fault[name] for name in summary.get("faults", ())), Fault.NONE)
        words = [summary["trouble"] or f"log {summary['log']}"]
        words += [stood_still_line(summary["bench_time"])] if "bench_time" in summary else []
    done = "brakes carried the platform, first motion done, parked" if success else "ended early"
    mark, figures = "x" if success else "!", "; ".join(filter(None, (done, *words)))
    lines = [f"[{mark}] {_TOGETHER}", f"      {figures}", *causes(faults)]
    together = Together(success, lines, Fault.BRAKE in faults)
    for line in together.lines:
        journal(line)
    return together


CAUSES: dict[Fault, tuple[str, ...]] = {
    Fault.BRAKE: ("brake_stuck_open", "brake_weak", "brake_inverted", "brake_late", "coupling_slips"),
    Fault.ENCODER: (
        *("encoder_frozen", "brake_stuck_shut", "backlash", "rate_sign", "rate_scale", "coupling_slips"),
        *("encoder_jumps", "motor_crossed"),
    ),
    Fault.FOLLOWING | Fault.SPEED | Fault.DRIVE: (
        *("motor_crossed", "payload", "force_sign", "force_scale", "force_saturates", "encoder_sign"),
        *("encoder_late", "force_lags", "coupling_slips", "friction", "brake_stuck_shut", "upside_down"),
    ),
    Fault.SPEED: ("brake_stuck_open", "brake_inverted"),
    Fault.STALE | Fault.BUS | Fault.REFUSED_FRAMES: ("frames_lost", "absent"),
}
"""Faults of the first motion -> assembly mistakes that can cause one of them."""


def causes(faults: Fault) -> list[str]:
    """Lines of text: assembly mistakes that can cause the given faults of the first motion; may be empty."""
    names = dict.fromkeys(name for kinds, fitting in CAUSES.items() if faults & kinds for name in fitting)
    if not names:
        return []
    head = "each leg passed its own tests: check first what has changed since, e.g. plugs. Possible causes:"
    return [f"      {head}", *(f"        {name}: {MISTAKES[name][-1]}" for name in names)]


def mark_moved(c: Configuration, say: Callable[[str], None]) -> None:
    """Mark an existing homing file as outdated before legs are moved by hand. Raises ConfigurationError."""
    path = None if c.drives.homing is None else homing_path(c, emulated=False)
    if path is None or not path.exists():
        return
    file = read_homing(c, path)
    write_homing(c, path, homing_file(c, "moved", file.lengths_m, file.turns))
    say(f"{path}: marked as moved, since legs are moved by hand; it is written again once the platform hangs")


def state_lengths(found: Configuration, context: Context, say: Callable[[str], None]) -> None:
    """Write the leg lengths of the last known pose to the homing file. Raises ConfigurationError."""
    path = None if found.drives.homing is None else homing_path(found, emulated=False)
    if path is not None:
        lengths = context.machine.pose_lengths[-1].tolist()
        write_homing(found, path, homing_file(found, "stated", lengths, None))
        say(f"{path}: now records that the platform hangs at the last known pose")


def _log(c: Configuration, path: Path, clock: Clock | None) -> Recording:
    """Start the recording. clock: clock of the bus; None for a rehearsal, which runs in simulated time."""
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
