"""The shared memory of one localcan channel: where things are, in words of 8 bytes.

Header, one slot a participant, the log, one outbox a participant. A word has one writer, or is changed by
atomic operations alone; a frame is written into its sender's outbox before the slot counts it. So a process
that is stopped or killed between any two instructions leaves nothing half done, and nobody waits for it.
"""

from drivers.compiled.compiler import helper

VERSION = 4
"""Part of the file's name: programs with another layout meet on another wire."""
SLOTS = 64
"""Participants at most."""
LOG = 1 << 15
"""Entries of the log, one a frame: 2 s at 14 000 frames/s are there for a slow reader."""
OUTBOX = 1 << 13
"""Frames of one sender that a slow reader can lag behind: 1.2 s at 7000 frames/s."""
WORD = 8

TIMING_AT, SERIAL_AT, USED_AT, CLOCK_AT, WAKE_AT, WORK_AT = range(6)
"""Header: bit timing, 0 while nobody has stated one; participants so far; slots ever used; and for
`bench_clock` whether it may stand still, and the two times that it allows, ns."""
HINT_AT, OFFSET_AT, LATEST_AT = 16, 24, 32
"""Words that change all the time, far from each other: an index near the log's end; bench time lags
CLOCK_MONOTONIC by so many ns; the latest bench time that anybody has read, ns."""
SLOTS_AT = 64
SLOT = 16
SLOT_SERIAL, SLOT_PID, SLOT_RUNG, SLOT_COUNT, SLOT_DUE, SLOT_FIRST = range(6)
"""Of a slot: serial number of who has it, unique on this wire, serial % SLOTS is the slot, 0 where it is
empty; its process; when its doorbell was rung, 0 while it waits for a ring; frames ever put into its outbox;
when it will have looked again, beyond which bench time does not go, 0 if it does not hold time; number of
the first frame in its outbox that may still wait."""
LOG_AT = 2048
OUTBOX_AT = LOG_AT + LOG
NUMBER, END, QUEUED, PRIORITY, DURATION, SENDER, DETAIL = range(7)
"""A frame in an outbox: number, end ns (less than 0 until it starts, 0 if it was taken back), queued at ns,
priority, duration ns, sender's serial number; from DETAIL on as in FRAME identifier to bus, and data."""
RECORD_WORDS = DETAIL + 9
SIZE = WORD * (OUTBOX_AT + SLOTS * OUTBOX * RECORD_WORDS)
"""Bytes; what nobody has used takes no memory."""

NUMBER_BITS, LAP_SHIFT = 20, 26
"""Of an entry of the log, which is a frame that starts: number, slot and, from LAP_SHIFT on, lap."""
FIRST = LOG
"""Index of the first entry ever: the words of an empty log are entries of the lap before."""


@helper
def slot_at(serial: int) -> int:
    """Return where the slot of a participant begins."""
    return SLOTS_AT + serial % SLOTS * SLOT


@helper
def record_at(serial: int, number: int) -> int:
    """Return where a participant's frame of this number is."""
    return OUTBOX_AT + (serial % SLOTS * OUTBOX + number % OUTBOX) * RECORD_WORDS
