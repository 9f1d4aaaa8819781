"""`hil bringup`: the procedure at a bus or on the rehearsal bench, its state, its log, its files."""

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from drivers.can.bus import Bus
from drivers.errors import ConfigurationError
from drivers.protocol import Frame, Received
from drivers.tick_columns import Record, row_of
from hil.app.bringup.bus_line import BusLine
from hil.app.bringup.checklist import checklist
from hil.app.bringup.found import found_text
from hil.app.bringup.machine import bringup_rate, build_machine, known_poses
from hil.app.bringup.rehearsal import BenchHands, BenchLine, build_bench
from hil.app.bringup.store import Store, identity
from hil.app.bringup.terminal import Terminal
from hil.app.bringup.together import lines_of, six_legs
from hil.app.bringup.words import wiring_of
from hil.app.compose import attachments, build_protocol, build_scene
from hil.app.configuration.configuration import Configuration, loads
from hil.app.files import write_whole
from hil.app.output import log_path
from hil.bringup.context import Context, Operator, Refused
from hil.bringup.drives import Drives
from hil.bringup.line import Line
from hil.bringup.procedure import Outcome, bring_up
from hil.loop.clock import real_time
from hil.record import Recording
from plant_fmu.rehearsal.bench import RehearsalBench


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
    agree: Callable[[str, str, str], bool] = lambda *_: True,
    say: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Bring a machine up, or rehearse it with some mistakes (a list, maybe empty); return the summary.

    `agree` is asked before each step of a rehearsal: title, what it will do, how to stop it. again: begin
    anew, whatever the state file holds. Raises ConfigurationError, BusError, RunError before anything moves.
    """
    rehearsal = mistakes is not None
    words = tuple(mistakes or ())
    files = files_of(configuration, c, state, rehearsal=rehearsal)
    if again:
        files.state.unlink(missing_ok=True)
    store = Store(files.state, identity(c, words))
    if store.changed:
        say(f"other hardware than in {files.state} ({store.changed}): everything is measured again")
    elif store.facts:
        say(f"{files.state}: what it holds is not asked again; --again begins anew")
    path = log_path(c.recording.folder, f"{c.name}-bringup", log)
    with _log(c, path, lockstep=rehearsal) as recording:
        said = _Said(say, recording)
        outcome, context, bench, reason = _proceed(c, words, store, said, agree, rehearsal=rehearsal)
        text = found_text(c, context, outcome.findings)
        together: list[str] = []
        success = False
        if outcome.success and not reason:
            found = loads(text, str(files.found), c.folder)
            success, together = _release(found, bench, agree, said)
            write_whole(files.found, text)
        elif outcome.findings:
            with contextlib.suppress(ConfigurationError):
                loads(text, str(files.found), c.folder)
                write_whole(files.found, text)
        lines = checklist(context, outcome, together)
        write_whole(files.checklist, "\n".join([*_head(c, path), *lines]) + "\n")
        for line in lines:
            recording.event(int(context.drives.record["t_ns"]), "info", line)
        store.forget(outcome.findings)
    return {
        "success": success,
        "kind": "bringup",
        "trouble": reason or None,
        "configuration": c.source,
        "passed": list(outcome.passed),
        "findings": [finding.line for finding in outcome.findings],
        "checklist": str(files.checklist),
        **({"found": str(files.found)} if files.found.exists() else {}),
        "state": str(files.state),
        "log": str(path),
    }


class _Said:
    """Says texts to the operator and into the log. Mutable state: the time of the last tick."""

    def __init__(self, say: Callable[[str], None], recording: Recording) -> None:
        self._say, self._recording = say, recording
        self.t_ns = 0

    def __call__(self, text: str) -> None:
        self._recording.event(self.t_ns, "info", text)
        self._say(text)

    def tick(self, record: Record, received: Sequence[Received], sent: Sequence[Frame]) -> None:
        """Record a tick."""
        self.t_ns = int(record["t_ns"])
        self._recording.tick(row_of(record), received, sent)


def _proceed(
    c: Configuration,
    words: Sequence[str],
    store: Store,
    said: _Said,
    agree: Callable[[str, str, str], bool],
    *,
    rehearsal: bool,
) -> tuple[Outcome, Context, RehearsalBench | None, str]:
    protocol, rate = build_protocol(c), bringup_rate(c)
    machine = build_machine(c, protocol)
    with contextlib.ExitStack() as stack:
        bench = build_bench(c, wiring_of(words)) if rehearsal else None
        line: Line
        operator: Operator
        if bench is not None:
            line, operator = BenchLine(bench.nodes, rate), BenchHands(bench, known_poses(c), agree, said)
        else:
            bus = stack.enter_context(Bus.open(c.bus, role="controller"))
            stack.enter_context(real_time(c.loop.priority, c.loop.cpu))
            line, operator = BusLine(bus, rate), Terminal(said)
        drives = Drives(protocol, line, machine.watchdog_s, said.tick)
        context = Context(machine, drives, operator, store.facts, store.save)
        try:
            return bring_up(context), context, bench, ""
        except Refused as refusal:
            return Outcome((), (), "ended"), context, bench, str(refusal)
        except KeyboardInterrupt:
            why = "ended by Ctrl-C: forces zero, brakes shut; what was found is kept"
            return Outcome((), (), "ended"), context, bench, why


def _release(
    found: Configuration,
    bench: RehearsalBench | None,
    agree: Callable[[str, str, str], bool],
    said: _Said,
) -> tuple[bool, list[str]]:
    """Let all six legs move together in a rehearsal; at a machine that is the operator's, by `hil run`."""
    if bench is None:
        line = f"[ ] together: hil run {found.source}, first motion at reduced limits, Enter lets it move"
        said(line)
        return True, [line]
    said("together: six legs at reduced limits")
    will = "lets the brakes carry the platform, opens all six, and moves it by 2 mm"
    if not agree("six legs together", will, "Ctrl-C"):
        return False, ["[ ] together: not agreed to"]
    ending = six_legs(found, bench)
    lines = lines_of(ending)
    for line in lines:
        said(line)
    return ending.success, lines


def _head(c: Configuration, log: Path) -> list[str]:
    stamp = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime())
    return [f"bring-up of {c.name}, {stamp}", f"configuration {c.source}, log {log}", ""]


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
