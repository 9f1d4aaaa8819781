"""localcan: when the frames that a participant has sent ended on the wire, by its own word."""

from __future__ import annotations

import pytest

from drivers.can.localcan.participant import Participant
from drivers.frame_array import sent_array
from drivers.protocol import BRS, FD, Frame
from tests.drivers.frames_heard import got

FRAMES = [Frame(0x100 + k, bytes(8 * k), FD | BRS) for k in range(3)]
PATIENCE_NS = 5_000_000_000


def carried(sender: Participant, reader: Participant, frames: list[Frame]) -> list[int]:
    """Send frames and return when the reader has had each of them."""
    ends: dict[int, int] = {}
    assert sender.send(sent_array(frames)) == len(frames)
    until = reader.clock.now() + PATIENCE_NS
    while len(ends) < len(frames) and reader.clock.now() < until:
        reader.block(until, {frame.id for frame in frames} - ends.keys())
        ends |= {each.frame.id: each.t_ns for each in got(reader.receive())}
    return [ends[frame.id] for frame in frames]


@pytest.mark.parametrize("own", [False, True])
def test_the_first_and_each_frame_ended_when_the_others_have_had_it_at_each_sending(join, own):
    sender, reader = join(own=own), join()
    for frames in (FRAMES, FRAMES[:1], FRAMES[1:]):
        ends = carried(sender, reader, frames)
        got(sender.receive())
        assert ends == sorted(ends)
        assert sender.sent_ns() == ends


def test_who_has_sent_nothing_knows_of_no_end(join):
    sender, reader = join(), join()
    assert sender.sent_ns() == []
    carried(sender, reader, FRAMES)
    assert sender.send(sent_array(())) == 0
    assert sender.sent_ns() == []


def test_a_frame_that_is_still_on_the_wire_has_not_ended_yet_and_counts_from_when_it_was_taken(
    join, monkeypatch
):
    sender = join()
    monkeypatch.setattr(sender.clock, "now", lambda: 7)
    assert sender.send(sent_array(FRAMES)) == len(FRAMES)
    assert sender.sent_ns() == [7, 7, 7]


def test_a_flush_tells_how_many_frames_it_has_dropped_each_time(join, monkeypatch):
    sender, other = join(), join()
    for node in (sender, other):  # so early that no frame has started
        monkeypatch.setattr(node.clock, "now", lambda: 7)
    assert other.send(sent_array(FRAMES[:2])) == 2
    for frames in (FRAMES, [], FRAMES[:2], FRAMES[:1]):
        assert sender.send(sent_array(frames)) == len(frames)
        assert sender.flush_tx() == len(frames)
    assert other.flush_tx() == 2
