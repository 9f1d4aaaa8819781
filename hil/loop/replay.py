"""Replay: runs the recorded inputs through the same Cycle and compares the results to the bit."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from drivers.arrays import Flags, Rows
from drivers.compiled.compiler import INTEGERS, MATRIX_OF_INTEGERS, OUT_FLAGS, helper, kernel, record, records
from drivers.compiled.pointed import address_of, data_at, integers_at
from drivers.errors import LogError
from drivers.frame_array import FRAME, joined, sent_frames
from drivers.signals import BusState
from drivers.tick_columns import COMPUTED_COLUMNS, INPUT_ELEMENTS, LATER, RECORDED, ROW, Column
from hil.loop import tick_row as part
from hil.loop.cycle import Cycle
from hil.loop.story.narrator import Narrator
from hil.loop.story.story import Story
from hil.loop.tick_input import input_of
from hil.loop.tick_row import CAPACITY, NOTHING, Given, TickRow, Ticks
from hil.record.log import Tick
from hil.signals import Operator, TickInput

TOLERANCE = 1e-9
"""Largest relative difference of computed columns on another CPU; frames must agree to the bit."""


@dataclass
class Difference:
    """A difference between log and replay in a tick: in a column, or in the sent frames."""

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
    """Result of a replay: numbers of ticks, frames and differences."""

    ticks: int = 0
    end: int = 0
    """Number of the last compared tick plus one."""
    frames: int = 0
    different_ticks: int = 0
    wire_different_ticks: int = 0
    """Ticks whose sent frames differ."""
    first: list[Difference] = field(default_factory=list)
    """All differences in the first tick with any."""
    gaps: list[tuple[int, int]] = field(default_factory=list)
    """(first missing tick, number of missing ticks) where the recorder lost ticks; the comparison ends at the
    first gap."""
    largest: float = 0.0
    """Largest |replayed - recorded| / max(1, |recorded|) over all columns; inf where an integer differs."""
    story: Story | None = None
    """Report of the faults that are latched at the end of the log."""

    @property
    def exact(self) -> bool:
        """True if every sent frame and every computed column of every tick is identical."""
        return self.ticks > 0 and not self.different_ticks and not self.gaps

    @property
    def equivalent(self) -> bool:
        """True if all sent frames are identical and all columns within TOLERANCE, as on another CPU."""
        return (
            self.ticks > 0 and not self.wire_different_ticks and self.largest <= TOLERANCE and not self.gaps
        )


_WORDS = FRAME.itemsize // 8
_STATES = frozenset(map(int, BusState))


def other_columns(columns: Sequence[Column]) -> str:
    """Text: how a log's columns differ from RECORDED; empty if a replay can compare them."""
    log, own = (
        {c.name: (c.kind, c.shape, c.elements, c.names) for c in table} for table in (columns, RECORDED)
    )
    found = {
        "only the log has": [name for name in log if name not in own],
        "only this version has": [name for name in own if name not in log],
        "of another type or with other names:": [
            n
            for n in own
            if n in log and not (log[n][:3] == own[n][:3] and log[n][3].items() <= own[n][3].items())
        ],
    }
    parts = [
        f"{what} {', '.join(names[:3])}" + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        for what, names in found.items()
        if names
    ]
    return "; ".join(parts) or ("in another order" if list(log) != list(own) else "")


class Recorded(Protocol):
    """Source of recorded ticks, such as `hil.record.log.Log`."""

    def ticks(self) -> Iterator[Tick]:
        """The recorded ticks in their order."""


def recorded_input(entry: Tick) -> TickInput:
    """Cycle input of a recorded tick. Raises LogError for values that no cycle writes."""
    return input_of(entry.row, entry.received_items, entry.operator, entry.setpoints, entry.orders)


class Block(NamedTuple):
    """Consecutive recorded ticks and a cycle's results; Python decides in the last tick at most."""

    entries: Sequence[Tick]
    """The recorded ticks."""
    recorded: Rows
    """Rows of the recorded ticks."""
    ticks: Ticks
    """Memory of the cycle's ticks: frames received, frames sent, records."""
    span: slice
    """Place of the block's ticks within `ticks`."""

    @property
    def operator(self) -> tuple[Operator, ...]:
        """Operator's commands in the last tick of the block."""
        return tuple(map(Operator, self.entries[-1].operator))

    @property
    def rows(self) -> Rows:
        """Recorded columns as the replaying cycle computes them, one row per tick."""
        return self.ticks.recorded(self.span)[0]

    def sent(self, k: int) -> Rows:
        """Frames that the cycle sends in tick k of the block, FRAME records."""
        _, opened, command = self.ticks.spans(self.span.start + k)
        return self.ticks.frames[opened.start : command.stop]

    def differs(self) -> tuple[Flags, Flags]:
        """(n,) flags of ticks whose sent frames differ, apart from times; (n,) flags of differing columns."""
        count, ends = len(self.entries), self.ticks.ends[self.span]
        words = self.ticks.records[self.span].view(np.int64)[:, :_ROW_WORDS]
        recorded = self.recorded.view(np.float64).reshape(count, _ROW_WORDS)
        unlike = words != recorded.view(np.int64)
        for new in _LATER_WORDS:
            if np.isnan(recorded[:, new]).all():
                unlike[:, new] = False
        columns: Flags = unlike.any(axis=1)
        sent = [entry.sent_items for entry in self.entries]
        wire = np.zeros(count, np.bool_)
        _compare_frames(self.ticks.frames, ends, joined(sent), np.cumsum([0, *map(len, sent)]), wire)
        return wire, columns


@kernel(records(FRAME), MATRIX_OF_INTEGERS, records(FRAME), INTEGERS, OUT_FLAGS)
def _compare_frames(own: Any, ends: Any, recorded: Any, bounds: Any, differs: Any) -> None:
    """Flag the ticks whose sent frames differ: own ones at `ends` (n, 3), recorded ones at `bounds`."""
    for k in range(differs.shape[0]):
        first, count = ends[k, 0], ends[k, 2] - ends[k, 0]
        differs[k] = count != bounds[k + 1] - bounds[k]
        for n in range(0 if differs[k] else count):
            a = integers_at(address_of(own[first + n]), _WORDS)
            b = integers_at(address_of(recorded[bounds[k] + n]), _WORDS)
            for word in range(1, _WORDS):  # the first one is the time
                differs[k] = differs[k] or a[word] != b[word]


REPLAY = np.dtype([*part.ROW_OF_TICKS, *((name, "<i8") for name in ("entry", "rows", "items", "bounds"))])
"""The fields of a row of ticks, then of the recorded ticks: index of the next one; addresses of their rows,
of their received frames, and of the bounds of these, (n + 1,)."""
_ROW_BYTES, _ROW_WORDS = ROW.itemsize, ROW.itemsize // 8
_PLACES: Any = ROW.fields
_LATER_WORDS = [
    slice(_PLACES[new[0].name][1] // 8, _PLACES[new[-1].name][1] // 8 + new[-1].size) for new in LATER
]
"""Places in a row of the columns that each version added."""


@helper
def _begins(s: Any) -> int:
    """Run the observe stage of a tick with recorded input and frames; returns 0 or a reason to stop."""
    bounds = integers_at(s.bounds + 8 * s.entry, 2)
    s.heard_at, s.heard = s.items + bounds[0] * part.BYTES, bounds[1] - bounds[0]
    if not part.has_room(s):
        return part.NO_ROOM
    tick = part.begin_tick(s)
    given = integers_at(s.rows + s.entry * _ROW_BYTES, INPUT_ELEMENTS)
    integers_at(address_of(tick), INPUT_ELEMENTS)[:] = given
    return part.observe(s, tick)


@kernel(record(REPLAY), unlocked=True)
def again(s: Any) -> int:
    """Replay ticks until `count` are done; returns 0, or the status of the stage that stopped."""
    while s.done < s.count:
        status = 0
        if s.stage == part.START:
            status = part.start(s, integers_at(s.rows + s.entry * _ROW_BYTES, 1)[0])
            following = part.OBSERVE
        elif s.stage == part.OBSERVE:
            status = _begins(s)
            following = part.ACT
        elif s.stage == part.ACT:
            status = part.act(s)
            following = part.COMMAND
        else:
            part.end_tick(s)
            s.entry += 1
            following = part.START
        if status != 0:
            return status
        s.stage = following
    return 0


def _gathered(log: Recorded) -> Iterator[list[Tick]]:
    """The ticks of a log in groups; a LogError is raised after the last readable tick."""
    gathered: list[Tick] = []
    try:
        for entry in log.ticks():
            gathered.append(entry)
            if len(gathered) == CAPACITY:
                yield gathered
                gathered = []
    except LogError:
        if gathered:
            yield gathered
        raise
    if gathered:
        yield gathered


def _odd(entries: Sequence[Tick], recorded: Rows, last: int) -> list[int]:
    """Indices of ticks with operator input, after a gap, or with values that no cycle writes."""
    tick, skipped = recorded["tick"], recorded["skipped"]
    gap = tick - skipped - np.concatenate(([last], tick[:-1])) != 1
    flags = zip(recorded["recorder_alive"].tolist(), recorded["bus_state"].tolist(), strict=True)
    unknown = [alive not in (0, 1) or state not in _STATES for alive, state in flags]
    given = [bool(entry.operator or entry.setpoints or entry.orders) for entry in entries]
    return [int(k) for k in np.flatnonzero(gap | (skipped < 0) | unknown | given)]


def blocks(
    log: Recorded, cycle: Cycle, gaps: list[tuple[int, int]], progress: Callable[[int], None] | None = None
) -> Iterator[Block]:
    """Reset `cycle` and run it on the recorded inputs of a log; yields its results in blocks.

    Ends at the first gap, which is appended to `gaps`: first missing tick and number. With latched faults a
    cycle runs one tick at a time. Raises LogError where the log cannot be read.
    """
    row, last, done = TickRow(cycle, REPLAY, again), -1, 0
    for entries in _gathered(log):
        recorded = np.frombuffer(b"".join([entry.row.tobytes() for entry in entries]), ROW)
        heard = [entry.received_items for entry in entries]
        items, bounds = joined(heard), np.cumsum([0, *map(len, heard)])
        s = row.record
        s["entry"], s["rows"], s["items"], s["bounds"] = 0, data_at(recorded), data_at(items), data_at(bounds)
        odd, first = _odd(entries, recorded, last), 0
        while first < len(entries):
            said = NOTHING
            if odd and odd[0] == first:
                del odd[0]
                inp = recorded_input(entries[first])
                missing = inp.tick - inp.skipped - last - 1
                if missing < 0 or inp.skipped < 0:
                    raise LogError(
                        f"the row of tick {inp.tick} is damaged: {inp.skipped} ticks cannot have been "
                        "skipped before it"
                    )
                if missing:
                    gaps.append((last + 1, missing))
                    return
                said = Given(inp.operator, inp.orders, inp.setpoints)
            new = row.go(1 if cycle.faults else (odd[0] if odd else len(entries)) - first, said)
            end = first + new.stop - new.start
            yield Block(entries[first:end], recorded[first:end], row.ticks, new)
            last, done = int(recorded["tick"][end - 1]), done + end - first
            if progress is not None and done // 1000 > (done - end + first) // 1000:
                progress(done // 1000 * 1000)
            first = end


def replay(log: Recorded, cycle: Cycle, progress: Callable[[int], None] | None = None) -> Comparison:
    """Run `cycle` from its initial state over all ticks of a log, and compare its frames and columns.

    Raises LogError where the log cannot be read.
    """
    cycle.reset()
    comparison, narrator = Comparison(), Narrator(cycle)
    for block in blocks(log, cycle, comparison.gaps, progress):
        if cycle.looked or cycle.faults:
            narrator.look(block.operator)
        comparison.ticks += len(block.entries)
        comparison.end = int(block.rows["tick"][-1]) + 1
        wire, columns = block.differs()
        ends = block.ticks.ends[block.span]
        comparison.frames += int((ends[:, 2] - ends[:, 0]).sum())
        for k in np.flatnonzero(wire | columns).tolist():
            _compare(comparison, block, k, wire=bool(wire[k]))
    comparison.story = narrator.story()
    return comparison


def _compare(comparison: Comparison, block: Block, k: int, *, wire: bool) -> None:
    row, entry = block.rows[k], block.entries[k]
    comparison.different_ticks += 1
    comparison.wire_different_ticks += wire
    comparison.largest = max(comparison.largest, _largest(row, entry.row))
    if not comparison.first:
        tick = int(row["tick"])
        comparison.first = _differences(tick, row, entry.row)
        if wire:
            sent = sent_frames(block.sent(k))
            comparison.first.append(Difference(tick, "sent frames", entry.sent, sent))


def _compared(recorded: np.void) -> list[str]:
    lacking = {c.name for new in LATER if all(np.isnan(recorded[c.name]).all() for c in new) for c in new}
    return [name for name in COMPUTED_COLUMNS if name not in lacking]


def _differences(tick: int, replayed: Rows, recorded: np.void) -> list[Difference]:
    return [
        Difference(tick, name, recorded[name], replayed[name])
        for name in _compared(recorded)
        if replayed[name].tobytes() != recorded[name].tobytes()
    ]


def _largest(replayed: Rows, recorded: np.void) -> float:
    worst = 0.0
    for name in _compared(recorded):
        a, b = np.asarray(replayed[name]), np.asarray(recorded[name])
        if a.dtype.kind == "f":
            with np.errstate(invalid="ignore", over="ignore"):
                error = np.abs(a - b) / np.maximum(1.0, np.abs(b))
            error = np.where((a == b) | (np.isnan(a) & np.isnan(b)), 0.0, error)
            worst = max(worst, float(np.max(np.nan_to_num(error, nan=math.inf))))
        elif a.tobytes() != b.tobytes():
            worst = math.inf
    return worst
