"""Clock of a localcan bus: CLOCK_MONOTONIC, but it stands still while the machine delays a participant.

A participant may *hold* time: it publishes its due, the time by which it will have read the bus again. Bench
time is CLOCK_MONOTONIC minus an offset, and never passes the earliest due. A late participant first adds the
standstill to the offset, then sets its next due. A participant that does not come back loses its hold: at
once if its process has ended, else after DISMISS_NS.

Each reading is raised to the latest reading of any participant, so that time never runs backwards.
"""

import ctypes
import time

import numpy as np

from drivers.arrays import Ints
from drivers.atomics import load, raise_to, replace, store
from drivers.can.localcan import layout as at
from drivers.can.localcan.wire import Wire
from drivers.clock import Clock
from drivers.compiled.compiler import INTEGER, OUT_INTEGERS, helper, kernel
from drivers.compiled.pointed import call

PLAIN, HELD, FOREIGN = range(3)
"""Values at CLOCK_AT: time never stands still; it may; it no longer may, as a participant has sent that does
not hold time."""
DISMISS_NS = 250_000_000
"""Longest standstill for one participant that does not come back, while another one runs to see it."""
_LOOK_NS = 2_000_000
"""Most time counted between two checks: while nobody runs, nobody is late."""
NAP_S = 2e-4
"""Pause between two checks while time stands still."""
_NEVER = 1 << 62
_CLOCK_ID = getattr(time, "CLOCK_MONOTONIC", 1)
_AT, _NOW, _BEHIND, _FREE, _OVERDUE, _SECONDS, _NANOSECONDS, _GETTIME, _RESULT = range(9)
"""Indices of a clock's `state`: word of its own due; virtual time; lag of virtual time by a standstill;
CLOCK_MONOTONIC; slot of the participant with the earliest due, -1: none; seconds and nanoseconds of
clock_gettime; address of clock_gettime, and of the seconds."""


@helper
def _earliest(words: Ints) -> tuple[int, int]:
    """(earliest due of all participants, ns; its slot); slot -1 if no participant holds time."""
    cap, slot = _NEVER, -1
    for each in range(load(words, at.USED_AT)):
        due = load(words, at.slot_at(each) + at.SLOT_DUE)
        if 0 < due < cap and load(words, at.slot_at(each) + at.SLOT_SERIAL) != 0:
            cap, slot = due, each
    return cap, slot


@kernel(OUT_INTEGERS, OUT_INTEGERS)
def read(words: Ints, state: Ints) -> int:
    """Read virtual time, ns; stores the parts of the reading in `state` (int64, of this participant)."""
    while True:
        # a participant advances the offset before it sets a later due: read the due first, then the offset;
        # a due that was brought forward counts if it was there when the clock was read
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
    """Set this participant's due to `due_ns`; a value <= 0 means -due_ns from now. Resumes stopped time.

    The due is the virtual time by which the participant will have read the bus again; time stops there.
    """
    read(words, state)
    if 0 < load(words, state[_AT]) <= state[_NOW]:
        _go_on(words, state)
    if due_ns <= 0:
        due_ns = state[_NOW] - due_ns
    store(words, state[_AT], max(due_ns, state[_NOW]) if load(words, at.CLOCK_AT) == HELD else 0)


@kernel(OUT_INTEGERS, OUT_INTEGERS)
def dismiss(words: Ints, state: Ints) -> None:
    """End the hold of the participant with the earliest due, if that due is past; time then resumes."""
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
    """Let virtual time run from its present value and disable all further standstills."""
    read(words, state)
    _go_on(words, state)
    store(words, at.CLOCK_AT, FOREIGN)


@kernel(OUT_INTEGERS, OUT_INTEGERS)
def share(other: Ints, words: Ints) -> bool:
    """Copy this clock's offset to another wire; True if time may stand still on `words`, not on `other`."""
    raise_to(other, at.OFFSET_AT, load(words, at.OFFSET_AT))
    return bool(load(other, at.CLOCK_AT) == FOREIGN and load(words, at.CLOCK_AT) == HELD)


class BenchClock(Clock):
    """Clock of one participant on a localcan bus, which can make time stand still.

    `holds`: True while this participant's due stops time, if time may stop. `wires`: the shared words of its
    own bus and of all buses that follow this clock.

    Mutable state: the shared words; the last reading; whether this participant holds time, and how long it
    has waited for another participant that is late.
    """

    def __init__(self, wire: Wire, serial: int) -> None:
        self._words = wire.words
        self._serial = serial
        self._ring = wire.ring
        self._state = state = np.zeros(_RESULT + 1, np.int64)
        state[_AT] = at.slot_at(serial) + at.SLOT_DUE
        state[_GETTIME] = ctypes.cast(ctypes.CDLL(None).clock_gettime, ctypes.c_void_p).value or 0
        state[_RESULT] = state.ctypes.data + 8 * _SECONDS
        self.arguments = wire.words, state
        self.wires: list[Ints] = []
        self._waiting_for = (0, 0)
        self._waited_ns = self._looked_ns = 0
        self.holds = False

    def now(self) -> int:
        """Virtual time, ns: CLOCK_MONOTONIC less all standstills."""
        return int(read(*self.arguments))

    # holding time
    def begin(self, wake_ns: int, work_ns: int) -> None:
        """From now on let virtual time stand still on this bus for late participants that hold it.

        wake_ns: time to wake up after a due sleep; work_ns: time from then to the next wait.
        """
        words = self._words
        words[at.WAKE_AT], words[at.WORK_AT] = max(1, wake_ns), max(1, work_ns)
        for each in self.wires[::-1]:
            each[at.OFFSET_AT] = words[at.OFFSET_AT]
            each[at.CLOCK_AT] = HELD

    def working(self, allowed_ns: int = 0) -> None:
        """Hold virtual time for at most `allowed_ns`, ns, of work until the next wait; 0: usual work time."""
        self._promise(-(allowed_ns or int(self._words[at.WORK_AT])))

    def waiting(self, until_ns: int) -> None:
        """Hold virtual time at `until_ns`, ns: this participant sleeps until then."""
        self._promise(until_ns + int(self._words[at.WAKE_AT]))

    def _promise(self, due_ns: int) -> None:
        if self.holds:
            promise(*self.arguments, due_ns)
            for words in self.wires[1:]:
                if share(words, self._words):
                    interrupt(*self.arguments)

    def sends(self) -> None:
        """Call before each send; if this participant holds no virtual time, this ends all standstills."""
        if self.holds:
            self.working()
        elif self._words[at.CLOCK_AT] == HELD:
            interrupt(*self.arguments)

    def leave(self) -> None:
        """Stop holding virtual time: from now on this participant cannot make it stand still."""
        if self.holds:
            self._promise(0)
            self._words[self._state[_AT]] = 0
            self.holds = False

    @property
    def interrupted(self) -> bool:
        """True once a participant that does not hold time has sent: virtual time then always runs."""
        return bool(self._words[at.CLOCK_AT] == FOREIGN)

    def stretched(self) -> int:
        """Total standstill of virtual time since its start, ns."""
        return int(self._words[at.OFFSET_AT])

    # waiting
    def stands(self) -> bool:
        """True while virtual time stands still; ends the hold of the late participant after DISMISS_NS."""
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
        """Sleep until virtual time `t_ns` or later; busy-wait for the last `spin_ns` while time runs."""
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
