"""Order of the frames on a localcan wire: a log to which all participants append without a lock.

An entry is one word for a frame that starts, put at the log's end by an atomic exchange. Waiting frames are
in the outboxes. The first reader that sees the bus free appends the next start, by the rule of
`drivers.can.arbitration`: the smallest priority among the frames queued by then. A frame's end follows from
log and record alone: the later of the end before it and its time of queueing, plus its duration. The first
reader of an entry writes the end into the record, always before the next entry. So all readers have one order
and one time for each frame. A frame that its sender counts late misses the starts before it.
"""

from drivers.arrays import Ints
from drivers.atomics import load, lower_to, raise_to, replace, store
from drivers.can import arbitration as bus
from drivers.can.link import OWN
from drivers.can.localcan import bench_clock
from drivers.can.localcan import layout as at
from drivers.compiled.compiler import (
    INTEGER,
    MATRIX_OF_INTEGERS,
    OUT_INTEGER_MATRIX,
    OUT_INTEGERS,
    helper,
    kernel,
)
from drivers.protocol import ERROR

SERIAL, CURSOR, FREE, LOST, HEARS_OWN = range(5)
"""Indices of a reader's `state`: its serial number; next entry to read; end of the entries before it, ns;
frames lost by reading too slowly; not 0: own frames are received, too."""
PLACE, ENTRY = bus.WIRE + 1, bus.WIRE + 2
"""Columns of a reader's `queue` after those of `arbitration`: index of the record; its entry without lap."""
QUEUE_ROWS = 8192
FRAME_WORDS = 10
"""Words of a FRAME record: t_ns, and the words of a record from DETAIL on."""
_KEPT = at.LOG - 1024
"""Entries before the log's end that cannot be overwritten during a read."""
_NUMBERS = (1 << at.NUMBER_BITS) - 1
_LENGTH, _FLAGS = 40, 48
"""Shifts in the word of a record that has identifier, kind, length, flags and bus."""
_SENT_AS_IT_IS = 0xFFFFFFFF | (0xFF & ~OWN) << _FLAGS


@helper
def _gather(words: Ints, queue: Ints) -> int:
    """Fill `queue` with the waiting frames of all outboxes; the result is their number."""
    rows = 0
    for slot in range(load(words, at.USED_AT)):
        place = at.slot_at(slot)
        count, first, begun = load(words, place + at.SLOT_COUNT), -1, load(words, place + at.SLOT_FIRST)
        for number in range(begun, count):
            record = at.record_at(slot, number)
            if load(words, record + at.END) != -1 - number:
                continue
            first = number if first < 0 else first
            if rows < queue.shape[0]:
                queue[rows, bus.QUEUED_NS] = queue[rows, bus.NUMBER] = words[record + at.QUEUED]
                queue[rows, bus.PRIORITY] = words[record + at.PRIORITY]
                queue[rows, bus.DURATION_NS] = words[record + at.DURATION]
                queue[rows, bus.WIRE], queue[rows, PLACE] = 0, record
                queue[rows, ENTRY] = slot << at.NUMBER_BITS | number & _NUMBERS
                rows += 1
        if begun < count and first != begun:
            raise_to(words, place + at.SLOT_FIRST, count if first < 0 else first)
    return rows


@helper
def _settle(words: Ints, index: int, free_ns: int) -> tuple[int, int, int]:
    """(record, number, end ns) of the frame of log entry `index`; end 0: withdrawn, negative: overwritten."""
    entry = load(words, at.LOG_AT + index % at.LOG)
    record = at.record_at(entry >> at.NUMBER_BITS, entry & _NUMBERS)
    number = load(words, record + at.NUMBER)
    if number & _NUMBERS != entry & _NUMBERS:
        return record, number, -1
    if load(words, record + at.END) == -1 - number:
        end = max(free_ns, words[record + at.QUEUED]) + words[record + at.DURATION]
        replace(words, record + at.END, -1 - number, end)
    return record, number, load(words, record + at.END)


@kernel(OUT_INTEGERS, OUT_INTEGERS, OUT_INTEGER_MATRIX, INTEGER, OUT_INTEGER_MATRIX)
def look(words: Ints, state: Ints, queue: Ints, now_ns: int, frames: Ints) -> int:
    """Start all transmissions due by `now_ns` and copy ended frames into `frames`; returns their number.

    words: shared memory; state: this reader's position; frames: FRAME records. Call again when it is
    full.
    """
    taken = 0
    while taken < frames.shape[0]:
        index = state[CURSOR]
        entry = load(words, at.LOG_AT + index % at.LOG)
        lap = entry >> at.LAP_SHIFT
        if lap < index // at.LOG:
            row, _ = bus.transmit(queue, _gather(words, queue), 0, state[FREE], now_ns)
            if row < 0:
                break
            start = index // at.LOG << at.LAP_SHIFT | queue[row, ENTRY]
            if replace(words, at.LOG_AT + index % at.LOG, entry, start):
                raise_to(words, at.HINT_AT, index + 1)
            continue
        if lap > index // at.LOG or load(words, at.HINT_AT) - index > _KEPT:
            state[CURSOR] = load(words, at.HINT_AT) - at.OUTBOX
            state[LOST] += state[CURSOR] - index
            continue
        record, number, end = _settle(words, index, state[FREE])
        if end > now_ns:
            break
        state[CURSOR], state[FREE] = index + 1, max(state[FREE], end)
        if end == 0:
            continue
        foreign, frame = words[record + at.SENDER] != state[SERIAL], frames[taken]
        frame[0] = end
        frame[1:] = words[record + at.DETAIL : record + at.RECORD_WORDS]
        if not foreign:
            frame[1] |= OWN << _FLAGS
        if end < 0 or load(words, record + at.NUMBER) != number:
            state[LOST] += 1
        elif foreign or state[HEARS_OWN]:
            taken += 1
    return taken


@kernel(OUT_INTEGERS, OUT_INTEGERS, OUT_INTEGER_MATRIX, OUT_INTEGERS)
def foresee(words: Ints, state: Ints, queue: Ints, missing: Ints) -> int:
    """Time, ns, at which all identifiers in `missing` (empty: another node's next frame) will have been sent.

    -1: unknown. A frame queued later can only delay this time, unless it is itself awaited. Overwrites
    `missing`.
    """
    index, free, rows, left = state[CURSOR], state[FREE], -1, missing.shape[0]
    while True:
        if rows < 0 and load(words, at.LOG_AT + index % at.LOG) >> at.LAP_SHIFT == index // at.LOG:
            record, _, end = _settle(words, index, free)
            index += 1
            if end <= 0:
                continue
        else:
            rows = _gather(words, queue) if rows < 0 else rows
            row, end = bus.transmit(queue, rows, 0, free, bus.FOREVER)
            if row < 0:
                return -1
            record, queue[row, bus.WIRE] = queue[row, PLACE], bus.SENT
        free = end
        if words[record + at.SENDER] == state[SERIAL] and not state[HEARS_OWN]:
            continue
        detail = words[record + at.DETAIL]
        for k in range(missing.shape[0]):
            if missing[k] == detail & 0xFFFFFFFF and not detail >> _FLAGS & ERROR:
                missing[k] = -1
                left -= 1
        if left == 0:
            return int(free)


@kernel(*(OUT_INTEGERS,) * 4, OUT_INTEGER_MATRIX, MATRIX_OF_INTEGERS, OUT_INTEGER_MATRIX, INTEGER)
def put(
    words: Ints,
    state: Ints,
    clock_words: Ints,
    clock: Ints,
    queue: Ints,
    frames: Ints,
    costs: Ints,
    limit: int,
) -> int:
    """Queue this participant's frames, FRAME records as words, until there is no room; returns how many.

    costs: priority, duration ns and length of each frame. clock_words, clock: shared words and state of its
    `bench_clock`, which may belong to another wire. After the call at most `limit` of its own frames wait.
    The time of queueing is read just before the frame is counted.
    """
    slot, own = state[SERIAL] % at.SLOTS, 0
    for row in range(_gather(words, queue)):
        own += words[queue[row, PLACE] + at.SENDER] == state[SERIAL]
    count_at = at.slot_at(slot) + at.SLOT_COUNT
    count = words[count_at]
    unread = count - load(words, at.slot_at(slot) + at.SLOT_FIRST)
    room = max(0, min(frames.shape[0], limit - own, at.OUTBOX - unread))
    for row in range(room):
        number, record = count + row, at.record_at(slot, count + row)
        # a reader of the frame that was there detects the new number
        store(words, record + at.NUMBER, number)
        store(words, record + at.END, -1 - number)
        words[record + at.PRIORITY], words[record + at.DURATION] = costs[row, 0], costs[row, 1]
        words[record + at.SENDER] = state[SERIAL]
        words[record + at.DETAIL : record + at.RECORD_WORDS] = frames[row, 1:]
        words[record + at.DETAIL] = frames[row, 1] & _SENT_AS_IT_IS | costs[row, 2] << _LENGTH
        words[record + at.QUEUED] = bench_clock.read(clock_words, clock)
        store(words, count_at, number + 1)
    return int(room)


@kernel(OUT_INTEGERS, OUT_INTEGERS, OUT_INTEGER_MATRIX)
def withdraw(words: Ints, state: Ints, queue: Ints) -> int:
    """Withdraw this participant's frames that have not started; the result is their number."""
    taken_back = 0
    for row in range(_gather(words, queue)):
        record = queue[row, PLACE]
        if words[record + at.SENDER] == state[SERIAL]:
            taken_back += replace(words, record + at.END, -1 - words[record + at.NUMBER], 0)
    return taken_back


@kernel(OUT_INTEGERS, INTEGER, INTEGER, INTEGER)
def change(words: Ints, place: int, expected: int, new: int) -> bool:
    """Set a word to `new` if it equals `expected`; True if so. A barrier: later reads stay after it."""
    return bool(replace(words, place, expected, new))


@kernel(OUT_INTEGERS, OUT_INTEGERS, INTEGER, INTEGER, OUT_INTEGERS)
def to_ring(words: Ints, state: Ints, now_ns: int, again_ns: int, serials: Ints) -> int:
    """Fill `serials` with the participants whose doorbell is to be rung; the result is their number.

    They wait for a ring or have not answered one for `again_ns`. The due of those that hold virtual time is
    brought forward: they have frames to read.
    """
    found = 0
    for slot in range(load(words, at.USED_AT)):
        place = at.slot_at(slot)
        serial, rung = load(words, place + at.SLOT_SERIAL), load(words, place + at.SLOT_RUNG)
        if serial == 0 or serial == state[SERIAL] or (rung != 0 and now_ns - rung <= again_ns):
            continue
        if store(words, place + at.SLOT_RUNG, now_ns) == rung:
            if rung == 0 and load(words, place + at.SLOT_DUE) > 0:
                lower_to(words, place + at.SLOT_DUE, now_ns + load(words, at.WAKE_AT))
            serials[found] = serial
            found += 1
    return found
