"""localcan: what a participant counts as lost that has read the log too slowly."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.can.localcan import log
from drivers.can.localcan.layout import FIRST, HINT_AT, LOG, LOG_AT, OUTBOX, QUEUE, SIZE, SLOTS, START, WORD

BEHIND = LOG - 100
"""Entries of the log that were not read: more than are kept for a slow reader, which are all but 1024."""
OLD = BEHIND - (LOG - 1024)
"""Those that may be overwritten at any time: it is not looked what they were, each second one was a start."""
OWN, OTHERS = 3, (5, 0, SLOTS - 1)
"""Slots."""


def lost(entries: dict[int, tuple[int, int]], serial: int = OWN) -> int:
    """Return what is lost of a log with some entries, place behind the first -> kind and slot."""
    words = np.zeros(SIZE // WORD, np.int64)
    for at, (kind, slot) in {0: (QUEUE, OTHERS[0]), **entries}.items():
        lap = (FIRST + at) // LOG
        words[LOG_AT + (FIRST + at) % LOG] = (lap << 8 | kind << 6 | slot) << 20 | 7
    words[HINT_AT] = FIRST + BEHIND
    state, waiting, flying = log.new_state(serial)
    state[log.CURSOR] = FIRST
    ended = np.zeros((4, log.ENDS + 1), np.int64)
    assert log.look(words, state, waiting, flying, ended, 0) == 0
    assert state[log.CURSOR] == FIRST + BEHIND - OUTBOX
    return int(state[log.LOST]) - OLD // 2


def test_each_second_entry_that_is_too_old_to_be_looked_at_was_a_frame():
    assert lost({}) == 0


@pytest.mark.parametrize("slot", OTHERS)
def test_a_frame_that_another_one_has_sent_meanwhile_is_lost(slot):
    places = (OLD, OLD + 1, BEHIND // 2, BEHIND - OUTBOX - 1)
    assert lost(dict.fromkeys(places, (START, slot))) == len(places)


@pytest.mark.parametrize("serial", [OWN, OWN + SLOTS, OWN + 7 * SLOTS])
def test_a_frame_of_its_own_is_not_lost_nor_one_that_was_queued_and_has_not_started(serial):
    own = dict.fromkeys(range(OLD, OLD + 9), (START, OWN))
    queued = dict.fromkeys(range(OLD + 9, OLD + 20), (QUEUE, OTHERS[0]))
    assert lost(own | queued, serial) == 0
    assert lost(own | queued | {OLD + 20: (START, OTHERS[0])}, serial) == 1
