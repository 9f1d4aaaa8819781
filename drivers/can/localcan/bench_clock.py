"""The clock of a virtual bench: CLOCK_MONOTONIC, but time stands still while the machine holds somebody up.

A participant that holds time says by when it will have looked again, its due. Bench time is CLOCK_MONOTONIC
less an offset, and never beyond the earliest due. Who comes back late advances the offset by what time
stood, before it sets its next due. A participant that does not come back is dismissed: at once where its
process is gone, else after DISMISS_NS.

Each reading is raised to the latest that anybody has had, so that time runs backwards for nobody.
"""

import ctypes
import time
from typing import Any

import numpy as np

from drivers.arrays import Ints
from drivers.atomics import load, raise_to, replace, store
from drivers.can.localcan import layout as at
from drivers.can.localcan.wire import Wire
from drivers.clock import Clock
from drivers.compiled.compiler import INTEGER, OUT_INTEGERS, helper, kernel
from drivers.compiled.pointed import call

_libc: Any = ctypes.CDLL(None)
PLAIN, HELD, FOREIGN = range(3)
"""What stands at CLOCK_AT: time never stands still; it may; it did, until somebody sent who does not hold."""
DISMISS_NS = 250_000_000
"""Time does not stand longer than this, as far as somebody runs to see it, for one who does not come back."""
_LOOK_NS = 2_000_000
"""Of the time between two looks so much counts at most: while nobody runs, nobody is late."""
NAP_S = 2e-4
"""Between two looks while time stands still."""
_NEVER = 1 << 62
_CLOCK_ID = time.CLOCK_MONOTONIC
_AT, _NOW, _BEHIND, _FREE, _OVERDUE, _SECONDS, _NANOSECONDS, _GETTIME, _RESULT = range(9)
"""Of a clock's `state`: the word of its own due; bench time; by how much it stands back; CLOCK_MONOTONIC;
slot of the participant with the earliest due, -1: none; where clock_gettime puts seconds and nanoseconds;
its address, and that of the seconds."""


@helper
def _earliest(words: Ints) -> tuple[int, int]:
    """Return the earliest due and whose slot has it; -1 where nobody holds time."""
    cap, slot = _NEVER, -1
    for each in range(load(words, at.USED_AT)):
        due = load(words, at.slot_at(each) + at.SLOT_DUE)
        if 0 < due < cap and load(words, at.slot_at(each) + at.SLOT_SERIAL) != 0:
            cap, slot = due, each
    return cap, slot


@kernel(OUT_INTEGERS, OUT_INTEGERS)
def read(words: Ints, state: Ints) -> int:
    """Read the clock into `state`; return bench time, ns."""
    while True:
        # who sets a later due has advanced the offset before: first the due, then the offset; and a due that
        # was brought forward counts if it was there when the clock was read
        cap, slot = _earliest(words)
        offset = load(words, at.OFFSET_AT)
        call(state[_GETTIME], (_CLOCK_ID, state[_RESULT]))
        later_cap, later_slot = _earliest(words)
        if load(words, at.OFFSET_AT) == offset:
            break
    if later_cap < cap:
        cap, slot = later_cap, later_slot
    held = load(words, at.CLOCK_AT) == HELD
    state[_FREE] = load(state, _SECONDS) * 1_000_000_000 + load(state, _NANOSECONDS)
    free = state[_FREE] - offset
    now = min(free, cap) if held else free
    state[_NOW] = max(now, raise_to(words, at.LATEST_AT, now))
    state[_BEHIND] = max(0, free - state[_NOW])
    state[_OVERDUE] = slot if held else -1
    return int(state[_NOW])


@helper
def _go_on(words: Ints, state: Ints) -> None:
    raise_to(words, at.OFFSET_AT, state[_FREE] - state[_NOW])


@kernel(OUT_INTEGERS, OUT_INTEGERS, INTEGER)
def promise(words: Ints, state: Ints, due_ns: int) -> None:
    """Set the own due; 0 or less: so long from now. Where time stood for this participant, it goes on."""
    read(words, state)
    if 0 < load(words, state[_AT]) <= state[_NOW]:
        _go_on(words, state)
    if due_ns <= 0:
        due_ns = state[_NOW] - due_ns
    store(words, state[_AT], max(due_ns, state[_NOW]) if load(words, at.CLOCK_AT) == HELD else 0)


@kernel(OUT_INTEGERS, OUT_INTEGERS)
def dismiss(words: Ints, state: Ints) -> None:
    """Let time go on without the participant of the earliest due, if that is past."""
    read(words, state)
    if state[_OVERDUE] < 0:
        return
    place = at.slot_at(state[_OVERDUE]) + at.SLOT_DUE
    due = load(words, place)
    if 0 < due <= state[_NOW]:
        _go_on(words, state)
        replace(words, place, due, 0)


@kernel(OUT_INTEGERS, OUT_INTEGERS)
def interrupt(words: Ints, state: Ints) -> None:
    """Let time stand still no more, and go on from where it is."""
    read(words, state)
    _go_on(words, state)
    store(words, at.CLOCK_AT, FOREIGN)


@kernel(OUT_INTEGERS, OUT_INTEGERS)
def share(other: Ints, words: Ints) -> bool:
    """Let the clock of another wire lag by as much; tell whether time may stand still here alone."""
    raise_to(other, at.OFFSET_AT, load(words, at.OFFSET_AT))
    return bool(load(other, at.CLOCK_AT) == FOREIGN and load(words, at.CLOCK_AT) == HELD)


class BenchClock(Clock):
    """The clock of one participant on a localcan wire. `holds`: it holds time, where that may stand still.

    `wires`: the mode words of its own wire and of all wires that follow this clock.

    Mutable state: the shared words; the last reading; whether this participant holds time, and for how long
    it has waited for another one that holds time back.
    """

    def __init__(self, wire: Wire, serial: int) -> None:
        self._words = wire.words
        self._serial = serial
        self._ring = wire.ring
        self._state = state = np.zeros(_RESULT + 1, np.int64)
        state[_AT] = at.slot_at(serial) + at.SLOT_DUE
        state[_GETTIME] = ctypes.cast(_libc.clock_gettime, ctypes.c_void_p).value or 0
        state[_RESULT] = state.ctypes.data + 8 * _SECONDS
        self.arguments = wire.words, state
        self.wires: list[Ints] = []
        self._waiting_for = (0, 0)
        self._waited_ns = self._looked_ns = 0
        self.holds = False

    def now(self) -> int:
        """Return bench time."""
        return int(read(*self.arguments))

    # holding time
    def begin(self, wake_ns: int, work_ns: int) -> None:
        """Let time stand still on this wire from now on, for all who hold it.

        Each has `wake_ns` to wake up after its time, and `work_ns` from then to its next wait.
        """
        words = self._words
        words[at.WAKE_AT], words[at.WORK_AT] = max(1, wake_ns), max(1, work_ns)
        for each in self.wires[::-1]:
            each[at.OFFSET_AT] = words[at.OFFSET_AT]
            each[at.CLOCK_AT] = HELD

    def working(self, allowed_ns: int = 0) -> None:
        """Say that this participant will wait again within so long, or 0: within what work may take."""
        self._promise(-(allowed_ns or int(self._words[at.WORK_AT])))

    def waiting(self, until_ns: int) -> None:
        """Say that this participant sleeps until then."""
        self._promise(until_ns + int(self._words[at.WAKE_AT]))

    def _promise(self, due_ns: int) -> None:
        if self.holds:
            promise(*self.arguments, due_ns)
            for words in self.wires[1:]:
                if share(words, self._words):
                    interrupt(*self.arguments)

    def sends(self) -> None:
        """Take note that this participant sends: time does not stand still for a stranger."""
        if self.holds:
            self.working()
        elif self._words[at.CLOCK_AT] == HELD:
            interrupt(*self.arguments)

    def leave(self) -> None:
        """Stop holding bench time."""
        if self.holds:
            self._promise(0)
            self._words[self._state[_AT]] = 0
            self.holds = False

    @property
    def interrupted(self) -> bool:
        """Whether a participant that does not hold time has sent, so that it cannot stand still any more."""
        return bool(self._words[at.CLOCK_AT] == FOREIGN)

    def stretched(self) -> int:
        """Return by how many ns bench time has stood still in all."""
        return int(self._words[at.OFFSET_AT])

    # waiting
    def stands(self) -> bool:
        """Tell whether time stands still; look after whom it stands for."""
        now = self.now()
        if not self._state[_BEHIND]:
            return False
        other, real_ns = int(self._state[_OVERDUE]), int(self._state[_FREE])
        if (other, now) != self._waiting_for:
            self._waiting_for, self._waited_ns = (other, now), 0
        else:
            self._waited_ns += min(real_ns - self._looked_ns, _LOOK_NS)
        self._looked_ns = real_ns
        serial = int(self._words[at.slot_at(other) + at.SLOT_SERIAL])
        if self._waited_ns > DISMISS_NS or (serial != self._serial and not self._ring(serial)):
            dismiss(*self.arguments)
        return True

    def sleep_until(self, t_ns: int, spin_ns: int = 0) -> None:
        """Return at bench time t_ns or later; sleep, never spin, while time stands still."""
        self.waiting(t_ns)
        while (now := self.now()) < t_ns:
            rest = t_ns - now - spin_ns
            if self.stands():
                if self._state[_OVERDUE] == self._serial % at.SLOTS:  # a ring has brought the promise forward
                    self.waiting(t_ns)
                else:
                    time.sleep(NAP_S)
            elif rest > 0:
                time.sleep(rest * 1e-9)
        self.working()
