"""What another controller would have answered to recorded measurements: its cycle on the inputs of a log.

The measurements did not follow its forces: past the first difference the loop is open.
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Rows
from drivers.errors import LogError
from drivers.frame_array import sent_frames
from drivers.protocol import Frame
from drivers.signals import LEGS, Fault, Warn
from drivers.tick_columns import COLUMNS, COMPUTED_COLUMNS, ROW
from hil.loop.cycle import Cycle
from hil.loop.replay import Recorded, Stepped, stepped
from hil.loop.story.narrator import Narrator
from hil.loop.story.told import Story
from hil.record.divergence import Divergence, named
from hil.signals import TickInput

BLOCK = 1024
"""Ticks whose rows are compared at once."""


class OtherFrames(NamedTuple):
    """The first tick whose sent frames differ, and the first frame of it that does."""

    tick: int
    time_s: float
    """Since the first tick of the log."""
    recorded: Frame | None
    """None: there was none in its place."""
    answered: Frame | None
    legs: tuple[int, ...]
    """Whom it is for."""


class Latched(NamedTuple):
    """A fault that latched."""

    tick: int
    time_s: float
    """Since the first tick of the log."""
    fault: str


class Acted(NamedTuple):
    """In how many ticks a warning stood, the force limits among them."""

    recorded: int
    answered: int
    first_tick: int | None
    """The first in which it stands in the answer and not in the log."""


@dataclass
class Forces:
    """How far the force in each leg is from the one that was sent, N: answered less recorded."""

    ticks: int = 0
    """How many count: those before the latched faults differ."""
    largest: Array = field(default_factory=lambda: np.zeros(LEGS))
    """(6,) N, absolute."""
    at: list[int | None] = field(default_factory=lambda: [None] * LEGS)
    """Tick of each, None without a difference."""
    squares: Array = field(default_factory=lambda: np.zeros(LEGS))
    """(6,) N^2, summed over the ticks."""

    @property
    def rms(self) -> Array:
        """(6,) N, root of the mean square."""
        found: Array = np.sqrt(self.squares / max(self.ticks, 1))
        return found

    def take(self, ticks: Array, difference: Array) -> None:
        """Take in n ticks and their differences (n, 6) N."""
        if not len(ticks):
            return
        size = np.abs(difference)
        self.ticks += len(ticks)
        self.squares = self.squares + (difference**2).sum(axis=0)
        for leg, row in enumerate(size.argmax(axis=0).tolist()):
            if size[row, leg] > self.largest[leg]:
                self.largest[leg], self.at[leg] = size[row, leg], int(ticks[row])


@dataclass
class Answer:
    """What was found. Mutable while the ticks come."""

    ticks: int = 0
    different_ticks: int = 0
    """Ticks of which a computed column or a sent frame differs."""
    wire_different_ticks: int = 0
    """Ticks whose sent frames differ."""
    first_frames: OtherFrames | None = None
    columns: Divergence = field(
        default_factory=lambda: Divergence([COLUMNS[name] for name in COMPUTED_COLUMNS])
    )
    forces: Forces = field(default_factory=Forces)
    parts_tick: int | None = None
    """The first tick in which the latched faults differ: from there on one of the two has stopped."""
    recorded_faults: list[Latched] = field(default_factory=list)
    answered_faults: list[dict[str, Any]] = field(default_factory=list)
    """What each finding of the answer tells, as `hil.loop.story.told.Finding.fields`."""
    warnings: dict[str, Acted] = field(default_factory=dict)
    """By name, those that stood on either side."""
    setpoints: int = 0
    """Set-points that the log has."""
    gaps: list[tuple[int, int]] = field(default_factory=list)
    """(first missing tick, how many): nothing after it is answered."""
    damage: str = ""
    """Why the log could not be read to its end; empty where it could."""
    last_mode: str = ""
    """In which the recorded controller is in the last tick."""
    story: Story | None = None
    """What the faults that are latched at the end have to tell."""

    @property
    def whole(self) -> bool:
        """Whether every tick of the log was answered."""
        return self.ticks > 0 and not self.gaps and not self.damage


class _Blocks:
    """Rows of both sides, compared a block at a time.

    Mutable state: the rows that wait, the faults of the last row, when the log began.
    """

    def __init__(self, answer: Answer, keep: Callable[[Rows, Rows], None] | None) -> None:
        self._answer, self._keep = answer, keep
        self._recorded, self._answered = np.zeros(BLOCK, ROW), np.zeros(BLOCK, ROW)
        self._wire = np.zeros(BLOCK, bool)
        self._count, self._faults = 0, 0
        self.origin_ns: int | None = None

    def add(self, step: Stepped) -> None:
        """Take in one tick."""
        if self.origin_ns is None:
            self.origin_ns = step.inp.t_ns
        self._recorded[self._count], self._answered[self._count] = step.entry.row, step.row
        self._wire[self._count] = not step.same_frames
        self._count += 1
        if self._count == BLOCK:
            self.flush()

    def flush(self) -> None:
        """Compare what waits."""
        recorded, answered = self._recorded[: self._count], self._answered[: self._count]
        wire = self._wire[: self._count]
        self._count = 0
        if not len(recorded):
            return
        answer = self._answer
        time_s = (recorded["t_ns"] - (self.origin_ns or 0)) * 1e-9
        different = answer.columns.take(answered, recorded, time_s)
        answer.different_ticks += int((different | wire).sum())
        answer.wire_different_ticks += int(wire.sum())
        parts = np.flatnonzero(recorded["faults"] != answered["faults"])
        if answer.parts_tick is None:
            together = int(parts[0]) if len(parts) else len(recorded)
            if len(parts):
                answer.parts_tick = int(recorded["tick"][together])
            difference = answered["tau"][:together] - recorded["tau"][:together]
            answer.forces.take(recorded["tick"][:together], difference)
        self._latched(recorded, time_s)
        _warn(answer, recorded, answered)
        if self._keep is not None:
            self._keep(recorded, answered)

    def _latched(self, recorded: Rows, time_s: Array) -> None:
        faults = recorded["faults"].tolist()
        for n, (before, now) in enumerate(zip([self._faults, *faults], faults, strict=False)):
            if now & ~before:
                self._answer.recorded_faults += [
                    Latched(int(recorded["tick"][n]), float(time_s[n]), str(fault.name))
                    for fault in Fault
                    if fault & now & ~before
                ]
        self._faults = faults[-1]
        self._answer.last_mode = named(COLUMNS["mode"], int(recorded["mode"][-1]))


def _warn(answer: Answer, recorded: Rows, answered: Rows) -> None:
    for warning in Warn:
        there, here = ((rows["warnings"] & warning) != 0 for rows in (recorded, answered))
        if not (there.any() or here.any()):
            continue
        name = str(warning.name)
        last = answer.warnings.get(name, Acted(0, 0, None))
        new = np.flatnonzero(here & ~there)
        first = int(recorded["tick"][new[0]]) if last.first_tick is None and len(new) else last.first_tick
        answer.warnings[name] = Acted(
            last.recorded + int(there.sum()), last.answered + int(here.sum()), first
        )


def what_if(
    log: Recorded,
    cycle: Cycle,
    *,
    observe: Callable[[TickInput, Rows, Rows], None] | None = None,
    keep: Callable[[Rows, Rows], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Answer:
    """Give `cycle` the recorded inputs of a log from its initial state on, and say what it answers.

    observe : called with the input, the sent frames and the row of each tick; keep : with the recorded and
    the answered rows of a block, which are its own no longer than the call; progress : with the ticks done,
    every thousand. Where the log is damaged on the way, the answer ends there and says so.
    """
    cycle.reset()
    answer = Answer()
    narrator = Narrator(cycle, lambda _, level, text: _find(answer, level, text))
    blocks = _Blocks(answer, keep)
    for step in _readable(stepped(log, cycle, answer.gaps, progress), answer):
        if step.now:
            narrator.look(step.inp.operator)
        blocks.add(step)
        answer.ticks += 1
        answer.setpoints += len(step.inp.setpoints)
        if answer.first_frames is None and not step.same_frames:
            time_s = (step.inp.t_ns - (blocks.origin_ns or 0)) * 1e-9
            answer.first_frames = _first_frames(cycle, step, time_s)
        if observe is not None:
            observe(step.inp, step.sent, step.row)
    blocks.flush()
    answer.story = narrator.story()
    return answer


def _readable(steps: Iterator[Stepped], answer: Answer) -> Iterator[Stepped]:
    """Yield the steps as far as the log can be read."""
    try:
        yield from steps
    except LogError as error:
        answer.damage = str(error)


def _find(answer: Answer, level: str, text: str) -> None:
    """Keep a finding of the narrator: a line, and its fields as JSON below it."""
    del level
    answer.answered_faults.append(json.loads(text.partition("\n")[2]))


def _first_frames(cycle: Cycle, step: Stepped, time_s: float) -> OtherFrames:
    """Return the first frame of a tick that differs."""
    there, here = step.entry.sent, sent_frames(step.sent)
    n = next((n for n, pair in enumerate(zip(there, here, strict=False)) if pair[0] != pair[1]), None)
    n = min(len(there), len(here)) if n is None else n
    recorded, answered = (frames[n] if n < len(frames) else None for frames in (there, here))
    either = answered or recorded
    assert either is not None  # the frames differ
    return OtherFrames(step.inp.tick, time_s, recorded, answered, cycle.parts.protocol.addressed(either))
