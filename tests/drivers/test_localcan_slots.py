"""localcan: whose wire it is, who is taken for dead, and what a newcomer has of who had its slot before."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drivers.can.localcan.layout import SLOT_DUE, SLOT_PID, SLOT_RUNG, SLOT_SERIAL, SLOTS, slot_at
from drivers.can.localcan.wire import Wire
from drivers.frame_array import sent_array
from drivers.protocol import Frame

pytestmark = pytest.mark.usefixtures("runtime")


def test_a_wire_of_this_users_alone_is_the_bus_as_often_as_it_is_opened(tmp_path):
    for _ in range(2):
        wire = Wire(tmp_path / "t.wire")
        assert wire.mode is None
        wire.close()


def test_who_does_not_take_the_rings_at_its_doorbell_is_not_taken_for_dead(runtime):
    listener = Wire(runtime / "t.wire")
    serial = listener.enter()
    listener.unlock()
    caller = Wire(runtime / "t.wire")
    try:
        assert {caller.ring(serial) for _ in range(3000)} == {True}
        with pytest.raises(BlockingIOError):  # there is no room for more
            caller.bell.sendto(b"", caller.bell_of(serial))
        listener.silence()
        assert caller.ring(serial)
        listener.bell.close()
        assert not caller.ring(serial), "its socket has gone with it"
        Path(listener.bell_of(serial)).unlink()
        assert not caller.ring(serial), "nor is its name there any more"
        assert not caller.ring(serial + 1), "nobody ever had that one"
    finally:
        listener.close()
        caller.close()


def test_who_takes_the_slot_of_one_killed_while_it_held_time_does_not_hold_it(join):
    viewer, killed = join(), join()
    # 1 ns to wake up, 1 ns to work: who does so holds time up at once
    killed.clock.begin(1, 1)
    killed.clock.holds = True
    killed.clock.working()
    assert viewer.clock.stands()
    words = viewer._wire.words
    words[slot_at(killed.serial) + SLOT_RUNG] = 5
    killed._wire.bell.close()  # without a word to the others, as the kernel does it
    newcomer = join()
    at = slot_at(newcomer.serial)
    assert newcomer.serial % SLOTS == killed.serial % SLOTS
    assert [int(words[at + each]) for each in (SLOT_SERIAL, SLOT_PID)] == [newcomer.serial, os.getpid()]
    assert [int(words[at + each]) for each in (SLOT_DUE, SLOT_RUNG)] == [0, 0]
    assert not viewer.clock.stands()
    assert not newcomer.clock.stands()
    killed._closed = True


def test_who_has_left_may_leave_again_and_takes_nothing_of_those_who_stay_or_come(join):
    left, stays = join(), join()
    left.close()
    comes = join()
    left.close()
    assert comes.serial % SLOTS == left.serial % SLOTS, "it has the same slot"
    words = stays._wire.words
    for node in (stays, comes):
        assert int(words[slot_at(node.serial) + SLOT_SERIAL]) == node.serial
    assert stays.send(sent_array([Frame(1, b"")])) == 1
