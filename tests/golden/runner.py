"""Runs of a golden case in lockstep and in replay, and its frozen result: digests of frames and columns."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import configs
from drivers.arrays import Rows
from drivers.frame_array import received_frames, sent_frames
from drivers.protocol import BUS, Frame, Received
from drivers.signals import Fault, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.changes import with_changes, without_operator
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.fault_words import show_fault, with_faults
from hil.app.sim.build import build_lockstep
from hil.app.sim.commands import CommandScript, TimedCommand
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.loop.replay import Comparison, replay
from hil.record.entries import Tick
from hil.signals import TickInput, TickOutput

CONFIGS = Path(str(configs.__path__[0]))
DIGITS = 16
"""Hexadecimal digits kept of each SHA-256."""
_FRAME = struct.Struct("<qBBIB")
"""Header of each frame: t_ns (0 for a sent frame), bus, flags without the bus, id, length."""


class Case(NamedTuple):
    """One run: a shipped configuration with changes, faults and the operator's commands."""

    configuration: str
    changes: Mapping[str, Any] = {}
    faults: Sequence[str] = ()
    """As given to `hil sim --fault`."""
    commands: Sequence[TimedCommand] = ()
    duration_s: float | None = None
    """As given to `hil sim --duration`."""
    longest_s: float = 3.0
    """Time at which the run is cut, in whatever mode it is."""
    altered: Mapping[int, Mapping[str, Any]] = {}
    """Tick -> fields of its TickInput to replace for a second, final run of the cycle; a tick with `skipped`
    replaces that many ticks before it.
    """


class Trace(NamedTuple):
    """Recorded ticks and end of a case."""

    entries: list[Tick]
    mode: Mode
    faults: Fault
    unmet: list[str]
    """Faults that did not strike, and the number of commands not given."""


class Enough(Exception):  # noqa: N818 - not an error
    """The case has reached its longest time."""


def frame_bytes(frames: Sequence[Received] | Sequence[Frame]) -> bytes:
    """Bytes of the frames of one tick for the digests, independent of the frames' type."""
    parts = [struct.pack("<I", len(frames))]
    for each in frames:
        t_ns, frame = each if isinstance(each, Received) else (0, each)
        bus, flags = divmod(frame.flags, BUS)
        parts += [_FRAME.pack(t_ns, bus, flags, frame.id, len(frame.data)), frame.data]
    return b"".join(parts)


WARNED = {"limits": {"stale_warn_ticks": 2}}
"""Setting of every case; column `warnings` was frozen with it."""


def configured(case: Case) -> Configuration:
    """Configuration of a case, faults included."""
    text = (CONFIGS / f"{case.configuration}.yaml").read_text(encoding="utf-8")
    text = with_changes(with_changes(text, WARNED), case.changes)
    c = loads(text, f"{case.configuration}.yaml with changes", CONFIGS)
    c = with_faults(c, case.faults)
    return c if case.commands else without_operator(c)


def new_cycle(c: Configuration) -> Cycle:
    return build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)


def entry_of(inp: TickInput, sent: Rows, row: Rows) -> Tick:
    copied: Any = row.copy()
    received = received_frames(inp.frames)
    return Tick(copied, received, sent_frames(sent), inp.operator, inp.setpoints, inp.orders)


def run(case: Case) -> Trace:
    """Run a case in lockstep without a recorder; with altered inputs, then run its cycle alone on these."""
    c = configured(case)
    c.require("sim")
    cycle = new_cycle(c)
    script = CommandScript(case.commands, c.loop.rate_Hz)
    inputs: list[TickInput] = []
    entries: list[Tick] = []
    most = round(case.longest_s * c.loop.rate_Hz)

    def observe(inp: TickInput, opening: Rows, out: TickOutput) -> None:
        inputs.append(inp)
        entries.append(entry_of(inp, np.concatenate((opening, out.frames)), out.row))
        if len(entries) >= most:
            raise Enough

    nodes, plant = build_nodes(c)
    try:
        lockstep = build_lockstep(c, cycle, nodes, attended=bool(case.commands))
        with collector_paused():
            lockstep.run(
                case.duration_s,
                observe,
                commands=script,
                armed=not script.arms,
                over=lambda: script.over,
            )
    except Enough:
        pass
    finally:
        plant.close()
    assert c.plant is not None
    unmet = [show_fault(fault) for fault in c.plant.faults if fault not in nodes.schedule.begun(nodes.now_ns)]
    unmet += [f"{script.left} commands"] if script.left else []
    if case.altered:
        cycle = new_cycle(c)
        entries = [_stepped(cycle, inp) for inp in _altered(inputs, case.altered)]
    return Trace(entries, cycle.mode, cycle.faults, unmet)


def _stepped(cycle: Cycle, inp: TickInput) -> Tick:
    opening = cycle.begin(inp.tick)
    out = cycle.step(inp)
    return entry_of(inp, np.concatenate((opening, out.frames)), out.row)


def _altered(inputs: Sequence[TickInput], altered: Mapping[int, Mapping[str, Any]]) -> Iterator[TickInput]:
    gone = {k for tick, fields in altered.items() for k in range(tick - fields.get("skipped", 0), tick)}
    for inp in inputs:
        if inp.tick not in gone:
            yield inp._replace(**altered.get(inp.tick, {}))


class Captured:
    """The ticks of a trace, in the form that `hil.loop.replay.replay` reads."""

    def __init__(self, trace: Trace) -> None:
        self._entries = trace.entries

    def ticks(self) -> Iterator[Tick]:
        return iter(self._entries)


def replayed(case: Case, trace: Trace) -> Comparison:
    """Comparison of a new cycle's outputs for the recorded inputs."""
    with collector_paused():
        return replay(Captured(trace), new_cycle(configured(case)))


def digests(trace: Trace) -> dict[str, Any]:
    """Frozen result of a trace: plain values, digests as hexadecimal digits."""
    received, sent = hashlib.sha256(), hashlib.sha256()
    for entry in trace.entries:
        received.update(frame_bytes(entry.received))
        sent.update(frame_bytes(entry.sent))
    rows = np.array([entry.row for entry in trace.entries])
    entered = np.flatnonzero(np.diff(rows["mode"], prepend=-1))
    return {
        "ticks": len(trace.entries),
        "modes": " ".join(Mode(int(mode)).name for mode in rows["mode"][entered]),
        "mode": trace.mode.name,
        "faults": [str(fault.name) for fault in Fault if fault and fault in trace.faults],
        "received": received.hexdigest()[:DIGITS],
        "sent": sent.hexdigest()[:DIGITS],
        "columns": {
            name: hashlib.sha256(np.ascontiguousarray(rows[name]).tobytes()).hexdigest()[:DIGITS]
            for name in rows.dtype.names or ()
        },
    }


def differences(kept: Mapping[str, Any], found: Mapping[str, Any], *, same_cpu: bool = True) -> list[str]:
    """Differences between a run and the frozen result; on another CPU columns may differ."""
    plain = [
        f"{key}: {found[key]}, kept: {kept[key]}"
        for key in ("ticks", "modes", "mode", "faults")
        if found[key] != kept[key]
    ]
    frames = [f"frames {key}" for key in ("received", "sent") if found[key] != kept[key]]
    now = found["columns"]
    columns = [name for name, digest in kept["columns"].items() if now.get(name) != digest]
    if columns and same_cpu:
        frames.append(f"{len(columns)} of {len(now)} columns: {', '.join(columns)}")
    return plain + frames
