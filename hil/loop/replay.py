"""Replay: the recorded inputs through the same Cycle, compared to the bit."""

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.arrays import Rows
from drivers.compiled.compiler import direct, records
from drivers.compiled.pointed import address_of, integers_at
from drivers.errors import LogError
from drivers.frame_array import FRAME, joined, sent_frames
from drivers.signals import BusState
from drivers.tick_columns import (
    COMPUTED_COLUMNS,
    INPUT_COLUMNS,
    INPUT_ELEMENTS,
    RECORDED,
    Column,
)
from hil.loop.cycle import Cycle
from hil.loop.story.narrator import Narrator
from hil.loop.story.told import Story
from hil.record.log import Tick
from hil.signals import Operator, TickInput

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
        a, b = np.ravel(self.recorded), np.ravel(self.replayed)
        if a.dtype.kind not in "if" or a.shape != b.shape:  # sent frames, of which a log may have none
            return f"tick {self.tick}: {self.column}: recorded {self.recorded}, replayed {self.replayed}"
        n = int(np.flatnonzero(a.view(np.int64) != b.view(np.int64))[0])
        place = self.column if len(a) == 1 else f"{self.column}[{n}]"
        with np.errstate(over="ignore"):
            difference = f" (difference {b[n] - a[n]:.3g})" if a.dtype.kind == "f" else ""
        return f"tick {self.tick}: {place}: recorded {a[n].item()!r}, replayed {b[n].item()!r}{difference}"


@dataclass
class Comparison:
    """What a replay found."""

    ticks: int = 0
    end: int = 0
    """The tick behind the last one."""
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
    story: Story | None = None
    """What the latched faults at the end of the log have to tell."""

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


_INPUT = struct.Struct(f"<{INPUT_ELEMENTS}q")
"""The columns of TickInput stand first in the row, in the order of INPUT_COLUMNS."""
_WORDS = FRAME.itemsize // 8
_FRAMES = TickInput._fields.index("frames")
_STATE, _ALIVE, _COMPUTE = map(INPUT_COLUMNS.index, ("bus_state", "recorder_alive", "compute_ns"))
"""Where TickInput has what no column holds or is no integer. latch_ns, the last column, is six."""
_STATES = {int(state): state for state in BusState}


def other_columns(columns: Sequence[Column]) -> str:
    """Return how the columns of a log differ from RECORDED; empty where a replay can compare them."""
    log, own = (
        {c.name: (c.kind, c.shape, c.elements, c.names) for c in table} for table in (columns, RECORDED)
    )
    found = {
        "only the log has": [name for name in log if name not in own],
        "only this version has": [name for name in own if name not in log],
        "of another type or with other names:": [n for n in own if n in log and log[n] != own[n]],
    }
    parts = [
        f"{what} {', '.join(names[:3])}" + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        for what, names in found.items()
        if names
    ]
    return "; ".join(parts) or ("in another order" if list(log) != list(own) else "")


class Recorded(Protocol):
    """Anything that gives recorded ticks in order; `hil.record.log.Log` above all."""

    def ticks(self) -> Iterator[Tick]:
        """Return the ticks."""


def recorded_input(entry: Tick) -> TickInput:
    """Return what the cycle was given in a recorded tick. Raises LogError: one that no cycle writes."""
    row: Any = entry.row
    numbers = _INPUT.unpack_from(row)
    tick, alive, state = numbers[0], numbers[_ALIVE], _STATES.get(numbers[_STATE])
    if alive not in (0, 1):
        raise LogError(f"the row of tick {tick} is damaged: {alive} is not a valid recorder_alive")
    if state is None:
        raise LogError(f"the row of tick {tick} is damaged: {numbers[_STATE]} is not a valid BusState")
    try:
        operator = tuple(map(Operator, entry.operator))
    except ValueError as error:
        raise LogError(f"the row of tick {tick} is damaged: {error}") from None
    values: Sequence[Any] = (
        *numbers[:_FRAMES],
        entry.received_items,
        *numbers[_FRAMES:_STATE],
        state,
        alive == 1,
        *numbers[_ALIVE + 1 : _COMPUTE],
        operator,
        numbers[_COMPUTE],
        numbers[_COMPUTE + 1 :],
        entry.setpoints,
        entry.orders,
    )
    return TickInput(*values)


class Stepped(NamedTuple):
    """One recorded tick, and what a cycle makes of its inputs."""

    entry: Tick
    """What was recorded."""
    inp: TickInput
    """What the cycle was given: the recorded inputs."""
    opening: Rows
    """What it sends to start the tick."""
    frames: Rows
    """What it sends then."""
    row: Rows
    """What it records, one element of ROW."""

    @property
    def sent(self) -> Rows:
        """What it sends in all."""
        return joined((self.opening, self.frames))

    @property
    def same_frames(self) -> bool:
        """Whether it sends what was recorded, whatever the times."""
        return bool(_same(self.opening, self.frames, self.entry.sent_items))


@direct(records(FRAME), records(FRAME), records(FRAME))
def _same(opening: Any, frames: Any, recorded: Any) -> int:
    first = opening.shape[0]
    if first + frames.shape[0] != recorded.shape[0]:
        return 0
    for n in range(recorded.shape[0]):
        own = address_of(opening[n] if n < first else frames[n - first])
        a, b = integers_at(own, _WORDS), integers_at(address_of(recorded[n]), _WORDS)
        for k in range(1, _WORDS):  # the first one is the time
            if a[k] != b[k]:
                return 0
    return 1


def stepped(
    log: Recorded, cycle: Cycle, gaps: list[tuple[int, int]], progress: Callable[[int], None] | None = None
) -> Iterator[Stepped]:
    """Give `cycle`, which was reset, the recorded inputs of each tick of a log; yield what it makes of them.

    Ends at the first gap, which is added to `gaps`: the first missing tick, and how many. Raises LogError
    where the log cannot be read.
    """
    expected = 0
    for done, entry in enumerate(log.ticks()):
        inp = recorded_input(entry)
        tick, missing = inp.tick, inp.tick - inp.skipped - expected
        if missing < 0 or inp.skipped < 0:
            raise LogError(
                f"the row of tick {tick} is damaged: {inp.skipped} ticks cannot have been skipped before it"
            )
        if missing:
            gaps.append((expected, missing))
            return
        expected = tick + 1
        opening = cycle.begin(tick)
        out = cycle.step(inp)
        yield Stepped(entry, inp, opening, out.frames, out.row)
        if progress is not None and (done + 1) % 1000 == 0:
            progress(done + 1)


def replay(log: Recorded, cycle: Cycle, progress: Callable[[int], None] | None = None) -> Comparison:
    """Run `cycle` from its initial state over all ticks of a log and compare what it sends and computes.

    Raises LogError where the log cannot be read.
    """
    cycle.reset()
    comparison, narrator = Comparison(), Narrator(cycle)
    for step in stepped(log, cycle, comparison.gaps, progress):
        entry, inp, opening, frames, row = step
        narrator.look(inp.operator)
        comparison.ticks, comparison.end = comparison.ticks + 1, inp.tick + 1
        comparison.frames += len(opening) + len(frames)
        wire = not step.same_frames
        columns = row.tobytes() != entry.row.tobytes()
        if wire or columns:
            comparison.different_ticks += 1
            comparison.wire_different_ticks += wire
            if columns:
                comparison.largest = max(comparison.largest, _largest(row, entry.row))
            if not comparison.first:
                comparison.first = _differences(inp.tick, row, entry.row)
                if wire:
                    comparison.first.append(
                        Difference(inp.tick, "sent frames", entry.sent, sent_frames(step.sent))
                    )
    comparison.story = narrator.story()
    return comparison


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
            with np.errstate(invalid="ignore", over="ignore"):
                error = np.abs(a - b) / np.maximum(1.0, np.abs(b))
            error = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, error)
            worst = max(worst, float(np.max(np.nan_to_num(error, nan=math.inf))))
        elif a.tobytes() != b.tobytes():
            worst = math.inf
    return worst
