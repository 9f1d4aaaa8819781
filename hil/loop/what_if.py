"""What-if: another controller's cycle runs on the inputs of a log, and its answers are compared.

The measurements do not follow its forces: after the first difference the loop is open.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array, Flags, Rows
from drivers.errors import LogError
from drivers.frame_array import sent_frames
from drivers.protocol import Frame
from drivers.signals import LEGS, Fault, Warn
from drivers.tick_columns import COLUMNS, COMPUTED_COLUMNS
from hil.loop.cycle import Cycle
from hil.loop.replay import Block, Recorded, blocks
from hil.loop.story.narrator import Narrator
from hil.loop.story.story import Story
from hil.record.divergence import Divergence
from hil.record.selection import name_of

BLOCK = 1024
"""Ticks whose rows are compared in one go."""


class OtherFrames(NamedTuple):
    """First tick whose sent frames differ, and the first different frame in it."""

    tick: int
    time_s: float
    """Time since the first tick of the log, s."""
    recorded: Frame | None
    """Frame in the log; None: the log has no frame in this place."""
    answered: Frame | None
    legs: tuple[int, ...]
    """Legs that the frame addresses."""


@dataclass
class Forces:
    """Differences of the leg forces, N, between another controller and the log: answered minus recorded."""

    ticks: int = 0
    """Number of compared ticks: those before the latched faults differ."""
    largest: Array = field(default_factory=lambda: np.zeros(LEGS))
    """Largest absolute difference of each leg, (6,) N."""
    at: list[int | None] = field(default_factory=lambda: [None] * LEGS)
    """Tick of each largest difference; None without a difference."""
    squares: Array = field(default_factory=lambda: np.zeros(LEGS))
    """Sum of squared differences over the ticks, (6,) N^2."""

    @property
    def rms(self) -> Array:
        """Root mean square of the force differences, (6,) N."""
        found: Array = np.sqrt(self.squares / max(self.ticks, 1))
        return found

    def take(self, ticks: Array, difference: Array) -> None:
        """Add n ticks and their force differences (n, 6) N."""
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
    """Result of a what-if comparison; it grows while the ticks are processed."""

    ticks: int = 0
    different_ticks: int = 0
    """Ticks with a different computed column or sent frame."""
    wire_different_ticks: int = 0
    """Ticks whose sent frames differ."""
    first_frames: OtherFrames | None = None
    columns: Divergence = field(
        default_factory=lambda: Divergence([COLUMNS[name] for name in COMPUTED_COLUMNS])
    )
    forces: Forces = field(default_factory=Forces)
    parts_tick: int | None = None
    """First tick in which the latched faults differ: from there on one of the two has stopped."""
    recorded_faults: list[dict[str, Any]] = field(default_factory=list)
    """tick, time_s since the first tick of the log, and the fault's name."""
    answered_faults: list[dict[str, Any]] = field(default_factory=list)
    """Fields of each finding in the answer, as `hil.loop.story.story.Finding.fields`."""
    warnings: dict[str, dict[str, int | None]] = field(default_factory=dict)
    """By name, for warnings on either side: numbers of ticks `recorded` and `answered`, and first_tick, the
    first tick with the warning in the answer and not in the log."""
    gaps: list[tuple[int, int]] = field(default_factory=list)
    """(first missing tick, number of missing ticks): the answer ends there."""
    damage: str = ""
    """Reason why the log could not be read to its end; else empty."""
    last_mode: str = ""
    """Mode of the recorded controller in the last tick."""
    story: Story | None = None
    """Report of the faults that are latched at the end."""

    @property
    def whole(self) -> bool:
        """True if every tick of the log was answered."""
        return self.ticks > 0 and not self.gaps and not self.damage


class _Blocks:
    """Rows of log and other controller, compared many at a time.

    Mutable state: rows not yet compared, the faults of the last row, the start time of the log.
    """

    def __init__(self, answer: Answer) -> None:
        self._answer = answer
        self._waiting: list[tuple[Rows, Rows, Flags]] = []
        self._count, self._faults = 0, 0
        self._origin_ns: int | None = None

    def add(self, block: Block, addressed: Callable[[Frame], tuple[int, ...]]) -> None:
        if self._origin_ns is None:
            self._origin_ns = int(block.recorded["t_ns"][0])
        wire = block.differs()[0]
        if self._answer.first_frames is None and wire.any():
            k = int(wire.argmax())
            time_s = (int(block.recorded["t_ns"][k]) - self._origin_ns) * 1e-9
            self._answer.first_frames = _first_frames(block, k, time_s, addressed)
        self._waiting.append((block.recorded, block.rows, wire))
        self._count += len(wire)
        if self._count >= BLOCK:
            self.flush()

    def flush(self) -> None:
        if not self._waiting:
            return
        recorded, answered, wire = map(np.concatenate, zip(*self._waiting, strict=True))
        self._waiting, self._count = [], 0
        answer = self._answer
        time_s = (recorded["t_ns"] - (self._origin_ns or 0)) * 1e-9
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

    def _latched(self, recorded: Rows, time_s: Array) -> None:
        faults = recorded["faults"].tolist()
        for n, (before, now) in enumerate(zip([self._faults, *faults], faults, strict=False)):
            if now & ~before:
                when = {"tick": int(recorded["tick"][n]), "time_s": float(time_s[n])}
                new = [fault for fault in Fault if fault & now & ~before]
                self._answer.recorded_faults += [when | {"fault": str(fault.name)} for fault in new]
        self._faults = faults[-1]
        self._answer.last_mode = name_of(COLUMNS["mode"], int(recorded["mode"][-1]))


def _warn(answer: Answer, recorded: Rows, answered: Rows) -> None:
    for warning in Warn:
        there, here = ((rows["warnings"] & warning) != 0 for rows in (recorded, answered))
        if there.any() or here.any():
            last = answer.warnings.get(str(warning.name), {})
            first, new = last.get("first_tick"), recorded["tick"][here & ~there].tolist()
            answer.warnings[str(warning.name)] = {
                "recorded": (last.get("recorded") or 0) + int(there.sum()),
                "answered": (last.get("answered") or 0) + int(here.sum()),
                "first_tick": new[0] if first is None and new else first,
            }


def what_if(
    log: Recorded,
    cycle: Cycle,
    *,
    observe: Callable[[Block], None] | None = None,
    progress: Callable[[int], None] | None = None,
) -> Answer:
    """Run `cycle` from its initial state on the recorded inputs of a log, and compare its answers.

    observe : called with blocks of ticks and answers; progress : called every thousand ticks with the number
    of ticks done. If the log is damaged on the way, the comparison ends there; `damage` has the reason.
    """
    cycle.reset()
    answer = Answer()
    narrator = Narrator(cycle, lambda _, level, text: _find(answer, level, text))
    sides = _Blocks(answer)
    try:
        for block in blocks(log, cycle, answer.gaps, progress):
            narrator.look(block.operator)
            sides.add(block, cycle.parts.protocol.addressed)
            answer.ticks += len(block.entries)
            if observe is not None:
                observe(block)
    except LogError as error:
        answer.damage = str(error)
    sides.flush()
    answer.story = narrator.story()
    return answer


def _find(answer: Answer, level: str, text: str) -> None:
    """Append a fault finding: `text` is a line, with its fields as JSON below."""
    if level == "error":
        answer.answered_faults.append(json.loads(text.partition("\n")[2]))


def _first_frames(
    block: Block, k: int, time_s: float, addressed: Callable[[Frame], tuple[int, ...]]
) -> OtherFrames:
    """First frame of tick k of a block that differs, with its legs; time_s: since the log's start."""
    there, here = block.entries[k].sent, sent_frames(block.sent(k))
    recorded, answered = next(pair for pair in zip_longest(there, here) if pair[0] != pair[1])
    either = answered or recorded
    assert either is not None  # the frames differ
    return OtherFrames(int(block.recorded["tick"][k]), time_s, recorded, answered, addressed(either))
