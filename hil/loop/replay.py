"""Replay: the recorded inputs through the same Cycle, compared to the bit."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from drivers.arrays import Rows
from hil.loop.cycle import Cycle
from hil.record.log import Tick
from hil.signals import COMPUTED_COLUMNS, INPUT_COLUMNS, Operator, TickInput

TOLERANCE = 1e-9
"""Computed columns on another CPU agree to this; frames agree to the bit."""


@dataclass
class Difference:
    """One column, or the sent frames, of one tick that came out differently."""

    tick: int
    column: str
    recorded: Any
    replayed: Any

    def __str__(self) -> str:
        a, b = np.atleast_1d(self.recorded), np.atleast_1d(self.replayed)
        if a.dtype.kind not in "if":
            return f"tick {self.tick}: {self.column}: recorded {self.recorded}, replayed {self.replayed}"
        n = int(np.flatnonzero(a.view(np.int64) != b.view(np.int64))[0])
        place = self.column if len(a) == 1 else f"{self.column}[{n}]"
        difference = f" (difference {b[n] - a[n]:.3g})" if a.dtype.kind == "f" else ""
        return f"tick {self.tick}: {place}: recorded {a[n].item()!r}, replayed {b[n].item()!r}{difference}"


@dataclass
class Verdict:
    """What a replay found."""

    ticks: int = 0
    frames: int = 0
    different_ticks: int = 0
    wire_different_ticks: int = 0
    """Ticks whose sent frames differ."""
    first: list[Difference] = field(default_factory=list)
    """All differences of the first tick that differs."""
    gaps: list[tuple[int, int]] = field(default_factory=list)
    """(first missing tick, how many) where the recorder lost ticks: nothing after the first is comparable."""
    largest: float = 0.0
    """Largest |replayed - recorded| / max(1, |recorded|) over all columns; inf where an integer differs."""

    @property
    def exact(self) -> bool:
        """Every sent frame and every computed column of every tick is identical."""
        return self.ticks > 0 and not self.different_ticks and not self.gaps

    @property
    def equivalent(self) -> bool:
        """Every sent frame is identical and every column within TOLERANCE: what another CPU may change."""
        return (
            self.ticks > 0 and not self.wire_different_ticks and self.largest <= TOLERANCE and not self.gaps
        )


_INPUT = struct.Struct(f"<{len(INPUT_COLUMNS)}q")
"""The columns of TickInput stand first in the row, in the order of INPUT_COLUMNS."""


class Recorded(Protocol):
    """Anything that gives recorded ticks in order; `hil.record.log.Log` above all."""

    def ticks(self) -> Iterator[Tick]:
        """Return the ticks."""


def replay(log: Recorded, cycle: Cycle, progress: Callable[[int], None] | None = None) -> Verdict:
    """Run `cycle` from its initial state over all ticks of a log and compare what it sends and computes.

    Raises LogError where the log cannot be read.
    """
    cycle.reset()
    verdict = Verdict()
    expected: int | None = None
    for entry in log.ticks():
        recorded = entry.row.tobytes()
        (
            tick, t_ns, lateness_ns, skipped, sends_failed, bus_errors, bus_off, bus_overflow, recorder_alive,
            recorder_dropped, compute_ns,
        ) = _INPUT.unpack_from(recorded)  # fmt: skip
        if expected is None:
            expected = skipped
        if tick != expected + (skipped if verdict.ticks else 0):
            verdict.gaps.append((expected, tick - expected - skipped))
            break
        expected = tick + 1
        inp = TickInput(
            tick=tick,
            t_ns=t_ns,
            lateness_ns=lateness_ns,
            skipped=skipped,
            frames=entry.received,
            sends_failed=sends_failed,
            bus_errors=bus_errors,
            bus_off=bool(bus_off),
            bus_overflow=bus_overflow,
            recorder_alive=bool(recorder_alive),
            recorder_dropped=recorder_dropped,
            operator=tuple(Operator(o) for o in entry.operator) if entry.operator else (),
            compute_ns=compute_ns,
            setpoints=entry.setpoints,
        )
        sent = cycle.begin(tick)
        out = cycle.step(inp)
        sent += out.frames
        verdict.ticks += 1
        verdict.frames += len(sent)
        wire = sent != entry.sent
        columns = out.row.tobytes() != recorded
        if wire or columns:
            verdict.different_ticks += 1
            verdict.wire_different_ticks += wire
            if columns:
                verdict.largest = max(verdict.largest, _largest(out.row, entry.row))
            if not verdict.first:
                verdict.first = _differences(tick, out.row, entry.row)
                if wire:
                    verdict.first.append(Difference(tick, "sent frames", entry.sent, sent))
        if progress is not None and verdict.ticks % 1000 == 0:
            progress(verdict.ticks)
    return verdict


def _differences(tick: int, replayed: Rows, recorded: np.void) -> list[Difference]:
    return [
        Difference(tick, name, recorded[name], replayed[name])
        for name in COMPUTED_COLUMNS
        if replayed[name].tobytes() != recorded[name].tobytes()
    ]


def _largest(replayed: Rows, recorded: np.void) -> float:
    worst = 0.0
    for name in COMPUTED_COLUMNS:
        a, b = np.asarray(replayed[name]), np.asarray(recorded[name])
        if a.dtype.kind == "f":
            error = np.abs(a - b) / np.maximum(1.0, np.abs(b))
            error = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, error)
            worst = max(worst, float(np.max(np.nan_to_num(error, nan=math.inf))))
        elif a.tobytes() != b.tobytes():
            worst = math.inf
    return worst
