"""localcan: what a participant counts as lost that has read the log too slowly."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.can.localcan import log
from drivers.can.localcan.layout import (
    FIRST,
    HINT_AT,
    LAP_SHIFT,
    LOG,
    LOG_AT,
    NUMBER,
    NUMBER_BITS,
    OUTBOX,
    SIZE,
    SLOTS,
    WORD,
    record_at,
)

KEPT = LOG - 1024
"""Entries that are kept for a slow reader."""


@pytest.mark.parametrize("slot", [0, 5, SLOTS - 1])
@pytest.mark.parametrize("behind", [1, OUTBOX, KEPT, KEPT + 1, LOG + 7, 3 * LOG])
def test_each_start_is_read_or_lost_and_a_reader_goes_on_with_the_last_of_a_log_that_has_gone_round(
    behind, slot
):
    words, state = np.zeros(SIZE // WORD, np.int64), np.array([3, FIRST, 0, 0, 0])
    queue = np.zeros((log.QUEUE_ROWS, log.ENTRY + 1), np.int64)
    for index in range(FIRST + max(0, behind - LOG), FIRST + behind):
        number = index - FIRST
        words[LOG_AT + index % LOG] = index // LOG << LAP_SHIFT | slot << NUMBER_BITS | number
        record = record_at(slot, number)
        # number, end, queued, priority, duration, sender
        words[record + NUMBER : record + NUMBER + 6] = [number, 1 + number, 0, 1, 1, slot]
    words[HINT_AT] = FIRST + behind
    frames = np.zeros((LOG, log.FRAME_WORDS), np.int64)
    taken = log.look(words, state, queue, 1 << 40, frames)
    assert taken == min(behind, OUTBOX)
    assert frames[:taken, 0].tolist() == list(range(behind - taken + 1, behind + 1))
    assert (state[log.CURSOR], state[log.LOST]) == (FIRST + behind, behind - taken)
