"""What happened on a localcan wire, in one order for all: a log that everybody appends to and nobody locks.

An entry is one word, put by an atomic exchange at the log's end. Each participant reads the log for itself
and so knows which frames wait, which has the bus and until when; whoever sees first that the bus falls free
appends the next start. The rule is that of `drivers.can.arbitration`: the frame of the smallest priority
among those queued when the bus falls free, which by the log is one answer. A frame that its sender was slow
to append has missed the starts before it.
"""

import numpy as np

from drivers.arrays import Ints
from drivers.can.localcan.bench_clock import NOW, read_clock
from drivers.can.localcan.layout import (
    DURATION,
    END,
    FIRST,
    HINT_AT,
    KIND_BITS,
    LAP_SHIFT,
    LOG,
    LOG_AT,
    NUMBER,
    NUMBER_BITS,
    OUTBOX,
    OUTBOX_AT,
    PRIORITY,
    QUEUE,
    QUEUED,
    RECORD_WORDS,
    SLOT,
    SLOT_BITS,
    SLOT_DUE,
    SLOT_RUNG,
    SLOT_SERIAL,
    SLOTS,
    SLOTS_AT,
    START,
    USED_AT,
    WAKE_AT,
    WHO,
    WITHDRAW,
)
from drivers.compiled.atomics import exchange, load, lower_to, raise_to, replace, store
from drivers.compiled.compiler import BOOLEAN, INTEGER, OUT_INTEGER_MATRIX, OUT_INTEGERS, direct, helper

SERIAL, CURSOR, FREE, STARTED, WAITING, FLYING, OWN_WAITING, LOST, WITHDRAWN = range(9)
"""Of a reader's `state`: its serial number; next entry to read; when the bus falls free, and when the last
frame started, ns; frames that wait, that have started but not ended, that wait and are its own; frames that
reading too slowly has lost, and that it has itself withdrawn."""
STATE = 9
PLACE, COUNTED, SINCE, KEY, TAKES, SENDER = range(6)
"""Columns of `waiting`: the word where the record begins, the frame's number, queued at ns, priority,
duration ns, serial number of the sender."""
WAITING_ROWS, WAITING_COLUMNS = 8192, 6
ENDS = 2
"""Third column of `flying` and of what `look` gives out, after PLACE and COUNTED: when the frame ends, ns."""
DETAIL, DATA_WORDS = 6, 8
"""Of a record: the word with flags and length, before those of data."""
FRAME_WORDS = 2 + DATA_WORDS
"""Of an element of FRAME: t_ns; identifier, kind, length, flags; data."""
FLYING_ROWS = 64
_KEPT = LOG - 1024
"""Entries before the log's end that are not overwritten while somebody reads them."""
_NUMBERS, _SLOTS, _KINDS = (1 << NUMBER_BITS) - 1, (1 << SLOT_BITS) - 1, (1 << KIND_BITS) - 1
_IDENTITIES = 0xFFFFFFFF


@helper
def _entry(index: int, kind: int, slot: int, number: int) -> int:
    return (((index // LOG) << KIND_BITS | kind) << SLOT_BITS | slot) << NUMBER_BITS | (number & _NUMBERS)


@helper
def _append(words: Ints, index: int, seen: int, kind: int, slot: int, number: int) -> bool:
    """Put an entry at `index`, where `seen` was; tell whether nobody else was first."""
    if not replace(words, LOG_AT + index % LOG, seen, _entry(index, kind, slot, number)):
        return False
    raise_to(words, HINT_AT, index + 1)
    return True


@helper
def _withdraw(state: Ints, waiting: Ints, slot: int, number: int) -> None:
    kept = 0
    for row in range(state[WAITING]):
        sender = waiting[row, SENDER]
        if sender % SLOTS == slot and (sender // SLOTS & _NUMBERS) == number:
            if sender == state[SERIAL]:
                state[OWN_WAITING] -= 1
                state[WITHDRAWN] += 1
            continue
        waiting[kept] = waiting[row]
        kept += 1
    state[WAITING] = kept


@helper
def _due(state: Ints, waiting: Ints) -> tuple[int, int]:
    """Return which of the waiting frames has the bus next, and when it starts; there is at least one."""
    earliest = waiting[0, SINCE]
    for row in range(1, state[WAITING]):
        earliest = min(earliest, waiting[row, SINCE])
    start = max(state[FREE], earliest)
    winner = -1
    for row in range(state[WAITING]):
        if waiting[row, SINCE] <= start and (winner < 0 or waiting[row, KEY] < waiting[winner, KEY]):
            winner = row
    return winner, start


@helper
def _start(words: Ints, state: Ints, waiting: Ints, place: int, number: int) -> tuple[int, int]:
    """Take a frame that starts from those that wait; return its number and when it ends.

    The end is -1 if the frame is no longer known.
    """
    found = -1
    for row in range(state[WAITING]):
        if waiting[row, PLACE] == place and (waiting[row, COUNTED] & _NUMBERS) == number:
            found = row
            break
    if found < 0:
        end = load(words, place + END)
        if end >= 0 and (load(words, place + NUMBER) & _NUMBERS) == number:
            state[FREE] = end
        # its record was overwritten before this reader came to its entry
        state[LOST] += (place - OUTBOX_AT) // (OUTBOX * RECORD_WORDS) != state[SERIAL] % SLOTS
        return 0, -1
    _, start = _due(state, waiting)
    end, counted = start + waiting[found, TAKES], waiting[found, COUNTED]
    # who comes late to the log finds it here
    if not replace(words, place + END, -1 - counted, end):
        settled = load(words, place + END)
        if settled >= 0 and load(words, place + NUMBER) == counted:
            end = settled
    state[FREE], state[STARTED] = end, end - waiting[found, TAKES]
    state[OWN_WAITING] -= waiting[found, SENDER] == state[SERIAL]
    for row in range(found + 1, state[WAITING]):
        waiting[row - 1] = waiting[row]
    state[WAITING] -= 1
    return counted, end


@helper
def _queue(words: Ints, state: Ints, waiting: Ints, place: int, number: int) -> None:
    counted = load(words, place + NUMBER)
    if (counted & _NUMBERS) != number or state[WAITING] >= waiting.shape[0]:
        return
    row = state[WAITING]
    waiting[row, PLACE] = place
    waiting[row, COUNTED] = counted
    waiting[row, SINCE] = max(words[place + QUEUED], state[STARTED])
    waiting[row, KEY] = words[place + PRIORITY]
    waiting[row, TAKES] = words[place + DURATION]
    waiting[row, SENDER] = words[place + WHO] & _IDENTITIES
    if load(words, place + NUMBER) != counted:  # overwritten meanwhile
        return
    state[OWN_WAITING] += waiting[row, SENDER] == state[SERIAL]
    state[WAITING] = row + 1


@helper
def _read(words: Ints, state: Ints, waiting: Ints, entry: int) -> tuple[int, int, int]:
    """Take in the entry at the cursor; return place, number and end of a frame that starts, else end -1."""
    state[CURSOR] += 1
    number = entry & _NUMBERS
    slot = entry >> NUMBER_BITS & _SLOTS
    kind = entry >> (NUMBER_BITS + SLOT_BITS) & _KINDS
    # OUTBOX divides the numbers that an entry can tell apart
    place = OUTBOX_AT + (slot * OUTBOX + number % OUTBOX) * RECORD_WORDS
    if kind == QUEUE:
        _queue(words, state, waiting, place, number)
    elif kind == WITHDRAW:
        _withdraw(state, waiting, slot, number)
    elif kind == START:
        counted, end = _start(words, state, waiting, place, number)
        return place, counted, end
    return place, 0, -1


@helper
def _follow(words: Ints, state: Ints, waiting: Ints, first: int, until: int) -> None:
    """Learn what waits at entry `until` from those since `first`, and give none of it out."""
    lost, withdrawn = state[LOST], state[WITHDRAWN]
    state[CURSOR] = first
    state[FREE] = state[STARTED] = state[WAITING] = state[FLYING] = state[OWN_WAITING] = 0
    while state[CURSOR] < until:
        entry = load(words, LOG_AT + state[CURSOR] % LOG)
        if entry >> LAP_SHIFT == state[CURSOR] // LOG:
            _read(words, state, waiting, entry)
        else:
            state[CURSOR] += 1
    state[LOST], state[WITHDRAWN] = lost, withdrawn


@direct(OUT_INTEGERS, OUT_INTEGERS, OUT_INTEGER_MATRIX)
def join(words: Ints, state: Ints, waiting: Ints) -> int:
    """Begin to read at the log's end; return its index."""
    end = max(load(words, HINT_AT), FIRST)
    _follow(words, state, waiting, max(FIRST, end - _KEPT), end)
    return int(end)


@helper
def _catch_up(words: Ints, state: Ints, waiting: Ints) -> None:
    """Go on with what can still be read, after reading too slowly; count what is lost."""
    end = load(words, HINT_AT)
    at = end - OUTBOX
    lost = max(0, end - _KEPT - state[CURSOR]) // 2  # so old that it cannot be counted
    for index in range(max(state[CURSOR], end - _KEPT), at):
        entry = load(words, LOG_AT + index % LOG)
        foreign = (entry >> NUMBER_BITS & _SLOTS) != state[SERIAL] % SLOTS
        lost += foreign and (entry >> (NUMBER_BITS + SLOT_BITS) & _KINDS) == START
    state[LOST] += lost + state[FLYING]
    _follow(words, state, waiting, max(FIRST, end - _KEPT), at)


@direct(OUT_INTEGERS, OUT_INTEGERS, OUT_INTEGER_MATRIX, OUT_INTEGER_MATRIX, OUT_INTEGER_MATRIX, INTEGER)
def look(words: Ints, state: Ints, waiting: Ints, flying: Ints, ended: Ints, now_ns: int) -> int:
    """Read the log to its end, start what is due by now, fill `ended` with what has ended; return how many.

    Call again when `ended` is full. Changes state, waiting and flying, which are this reader's own.
    """
    given = kept = 0
    for row in range(state[FLYING]):
        if flying[row, ENDS] <= now_ns and given < ended.shape[0]:
            ended[given] = flying[row]
            given += 1
        else:
            flying[kept] = flying[row]
            kept += 1
    state[FLYING] = kept
    while given < ended.shape[0] and state[FLYING] < flying.shape[0]:
        index = state[CURSOR]
        entry = load(words, LOG_AT + index % LOG)
        lap = entry >> LAP_SHIFT
        if lap > index // LOG or (lap == index // LOG and load(words, HINT_AT) - index > _KEPT):
            _catch_up(words, state, waiting)
            continue
        if lap < index // LOG:
            if state[WAITING] == 0:
                break
            winner, start = _due(state, waiting)
            if start > now_ns:
                break
            slot = waiting[winner, SENDER] % SLOTS
            _append(words, index, entry, START, slot, waiting[winner, COUNTED])
            continue
        place, counted, end = _read(words, state, waiting, entry)
        if end < 0:
            continue
        if end <= now_ns:
            ended[given, PLACE], ended[given, COUNTED], ended[given, ENDS] = place, counted, end
            given += 1
        else:
            row = state[FLYING]
            flying[row, PLACE], flying[row, COUNTED], flying[row, ENDS] = place, counted, end
            state[FLYING] = row + 1
    return given


@direct(OUT_INTEGERS, OUT_INTEGERS, OUT_INTEGER_MATRIX, INTEGER, INTEGER, OUT_INTEGER_MATRIX)
def take(words: Ints, state: Ints, ended: Ints, count: int, own: int, frames: Ints) -> int:
    """Fill `frames`, elements of FRAME as words, with the first `count` of `ended`; return how many.

    own: the flag of this reader's own frames; 0 leaves them out. One that is overwritten meanwhile is lost.
    """
    taken = 0
    for row in range(count):
        place = ended[row, PLACE]
        who, detail, frame = words[place + WHO], words[place + DETAIL], frames[taken]
        frame[0] = ended[row, ENDS]
        frame[2:] = words[place + DETAIL + 1 : place + DETAIL + 1 + DATA_WORDS]
        foreign = (who & _IDENTITIES) != state[SERIAL]
        flags = detail & 0xFF if foreign else detail & 0xFF | own
        frame[1] = (who >> 32 & _IDENTITIES) | (detail >> 16 & 0xFF) << 40 | flags << 48
        if load(words, place + NUMBER) != ended[row, COUNTED]:
            state[LOST] += 1
        elif foreign or own:
            taken += 1
    return taken


@direct(OUT_INTEGERS, OUT_INTEGERS, OUT_INTEGERS, OUT_INTEGERS, INTEGER, INTEGER, INTEGER, INTEGER)
def append(
    words: Ints,
    clock_words: Ints,
    clock: Ints,
    state: Ints,
    gettime: int,
    at: int,
    kind: int,
    number: int,
) -> None:
    """Append an entry of this participant: frame `number` of its outbox is queued, or it withdraws.

    clock_words, clock, gettime, at: of the participant's `bench_clock`, which may be that of another wire.
    The frame is queued at the instant of the entry.
    """
    index = max(state[CURSOR], load(words, HINT_AT))
    slot = state[SERIAL] % SLOTS
    place = OUTBOX_AT + (slot * OUTBOX + number % OUTBOX) * RECORD_WORDS
    while True:
        seen = load(words, LOG_AT + index % LOG)
        if seen >> LAP_SHIFT > index // LOG:
            index = load(words, HINT_AT)
        elif seen >> LAP_SHIFT == index // LOG:
            index += 1
        else:
            if kind == QUEUE:
                read_clock(clock_words, clock, gettime, at)
                store(words, place + QUEUED, clock[NOW])
            if _append(words, index, seen, kind, slot, number):
                return


@direct(OUT_INTEGERS, OUT_INTEGERS, BOOLEAN)
def news(words: Ints, state: Ints, idle: bool) -> bool:
    """Tell whether the log has more than has been read; `idle`: or anything is waiting or under way."""
    if idle and (state[WAITING] or state[FLYING]):
        return True
    index = state[CURSOR]
    return bool(load(words, LOG_AT + index % LOG) >> LAP_SHIFT >= index // LOG)


@direct(OUT_INTEGERS, INTEGER)
def vacate(words: Ints, serial: int) -> bool:
    """Empty the slot of a participant; what it has queued is still sent. Tell whether it was there."""
    return bool(replace(words, SLOTS_AT + serial % SLOTS * SLOT + SLOT_SERIAL, serial, 0))


@direct(OUT_INTEGERS, OUT_INTEGERS)
def ask_for_ring(words: Ints, state: Ints) -> None:
    """Let the next sender ring this participant. Look for `news` after it, not before."""
    store(words, SLOTS_AT + state[SERIAL] % SLOTS * SLOT + SLOT_RUNG, 0)


@direct(OUT_INTEGERS, OUT_INTEGERS, INTEGER, INTEGER, OUT_INTEGERS)
def to_ring(words: Ints, state: Ints, now_ns: int, again_ns: int, serials: Ints) -> int:
    """Fill in the others that wait for a ring, or have not answered one for so long; return how many.

    Of those who hold bench time the due is brought forward: they have something to see.
    """
    found = 0
    for slot in range(load(words, USED_AT)):
        at = SLOTS_AT + slot * SLOT
        serial = load(words, at + SLOT_SERIAL)
        if serial == 0 or serial == state[SERIAL]:
            continue
        rung = load(words, at + SLOT_RUNG)
        if rung != 0 and now_ns - rung <= again_ns:
            continue
        if exchange(words, at + SLOT_RUNG, now_ns) == rung:
            if rung == 0 and load(words, at + SLOT_DUE) > 0:
                lower_to(words, at + SLOT_DUE, now_ns + load(words, WAKE_AT))
            serials[found] = serial
            found += 1
    return found


def new_state(serial: int) -> tuple[Ints, Ints, Ints]:
    """Return state, waiting and flying of a reader."""
    state = np.zeros(STATE, np.int64)
    state[SERIAL] = serial
    return (
        state,
        np.zeros((WAITING_ROWS, WAITING_COLUMNS), np.int64),
        np.zeros((FLYING_ROWS, ENDS + 1), np.int64),
    )
