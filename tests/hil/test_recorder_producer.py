"""The loop's end of a recording: what it puts into the ring, when it waits, and what it says of the end."""

from __future__ import annotations

import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.frame_array import FRAME
from drivers.frame_array import pack_frame as pack_item
from drivers.protocol import BUS, EXTENDED, FD, Frame, Received
from drivers.tick_columns import ROW
from hil.record import recording as module
from hil.record.recording import RecorderEndedError, Recording
from hil.record.ring import DROPPED, RECEIVED, SENT, WRITTEN, Ring
from hil.signals import Operator, Order, SetPoint


class Process:
    """A recorder's process: its pipes are others' business; `ended` says whether it has."""

    def __init__(self, ended=False):
        self.ended = ended

    def poll(self):
        return 1 if self.ended else None


# -- the ticks -----------------------------------------------------------------------------------------------


def recording_of(capacity=64, *, lockstep=False, dtype=ROW, process=None):
    ring = Ring.create(dtype, capacity)
    ring.close_fd()
    given: Any = process
    return Recording(ring, given, Path("b/a.mcap"), lockstep=lockstep)


def row_of(number):
    row = np.zeros((), ROW)
    row["tick"], row["t_ns"] = number, 1000 * number
    return row


def content(items):
    return [
        (
            int(i["t_ns"]),
            int(i["id"]),
            int(i["kind"]),
            int(i["flags"]),
            int(i["bus"]),
            bytes(i["data"][: i["length"]]),
        )
        for i in items
    ]


def test_all_that_a_tick_has_goes_into_the_ring_in_its_order_also_when_the_ring_has_turned():
    recording = recording_of(16)
    ring, counters = recording._ring, recording._ring.counters
    for number in range(40):
        recording.tick(
            row_of(number),
            [Received(7, Frame(1, b"\1" * 64, 0)), Received(8, Frame(2, b"", 3 * BUS + FD))],
            [Frame(3, b"\2" * 64, EXTENDED), Frame(4, b"34", BUS)],
            [1, 2],
            [SetPoint(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)],
            [Order(Operator.SPEED, (0.5,)), Order(Operator.HOLD)],
        )
        assert (counters[WRITTEN], recording.ticks, recording._items) == (
            number + 1,
            number + 1,
            9 * (number + 1),
        )
        batch = ring.take(1)
        now = 1000 * number
        assert batch.rows["tick"].tolist() == [number]
        assert content(batch.items) == [
            (7, 1, 0, 0, 0, b"\1" * 64), (8, 2, 0, FD, 3, b""), (now, 3, 1, EXTENDED, 0, b"\2" * 64),
            (now, 4, 1, 0, 1, b"34"), (now, 1, 2, 0, 0, b""), (now, 2, 2, 0, 0, b""),
            (now, int(Operator.SETPOINT), 2, 0, 0, struct.pack("<6d", 1, 2, 3, 4, 5, 6)),
            (now, int(Operator.SPEED), 2, 0, 0, struct.pack("<d", 0.5)), (now, int(Operator.HOLD), 2, 0, 0, b""),
        ]  # fmt: skip
        ring.release(batch)


def test_frames_as_arrays_go_into_the_ring_as_those_that_are_tuples_also_when_it_has_turned():
    one, other = recording_of(16), recording_of(16)
    for number in range(40):
        received = [Received(7 + k, Frame(k, bytes([k]) * 64, 3 * BUS + FD)) for k in range(number % 9)]
        sent = [Frame(100 + k, bytes([number]) * k, EXTENDED) for k in range(number % 7)]
        more: Any = ([5], [SetPoint(*range(6))], [Order(Operator.HOLD)]) if number % 5 == 0 else ()
        one.tick(row_of(number), received, sent, *more)
        kinds = [(t_ns, frame, RECEIVED) for t_ns, frame in received]
        kinds += [(1000 * number, frame, SENT) for frame in sent]
        items = np.zeros(len(kinds), FRAME)
        for k, (t_ns, (can_id, data, flags), kind) in enumerate(kinds):
            pack_item(items.view(np.uint8).data, 80 * k, t_ns, can_id, kind, len(data), flags, data)
        other.tick_of_items(row_of(number), items[: len(received)], items[len(received) :], *more)
        found, expected = other._ring.take(16), one._ring.take(16)
        assert found.items.tobytes() == expected.items.tobytes()
        assert (found.tick.tolist(), found.rows.tobytes()) == (
            expected.tick.tolist(),
            expected.rows.tobytes(),
        )
        for each in (one, other):
            each._ring.release(expected)
    for number in range(17):
        other.tick_of_items(row_of(number), items[:0], items[:0])
    assert (other.dropped, other.ticks) == (1, 40 + 16)


@pytest.mark.parametrize("sent", [False, True])
def test_a_frame_of_more_than_64_bytes_is_refused_and_its_tick_is_not_in_the_log(sent):
    recording = recording_of()
    for length in (64, 65):
        frame = Frame(0x1AB, bytes(length), FD)
        given: Any = ((), [frame]) if sent else ([Received(0, frame)], ())
        if length == 64:
            recording.tick(row_of(0), *given)
        else:
            with pytest.raises(LogError, match="frame 0x1AB has 65 data bytes: CAN FD carries at most 64"):
                recording.tick(row_of(1), *given)
    assert recording._ring.counters[WRITTEN] == recording.ticks == recording._items == 1


@pytest.mark.parametrize("kind", ["received", "sent"])
def test_what_a_refused_tick_had_before_its_long_frame_is_in_no_other_tick(kind):
    recording = recording_of()
    good, long = (Frame(0x1AB, bytes(length), FD) for length in (8, 65))
    received = [Received(0, good), *([Received(0, long)] if kind == "received" else ())]
    with pytest.raises(LogError, match="65 data bytes"):
        recording.tick(row_of(0), received, [good, long] if kind == "sent" else ())
    recording.tick(row_of(1), (), [Frame(0x2, b"", 0)])
    batch = recording._ring.take(1)
    assert batch.rows["tick"].tolist() == [1]
    assert [item["id"] for item in batch.items] == [0x2]


def test_an_event_is_pieces_of_64_bytes_that_count_down_each_with_the_level():
    recording = recording_of(16)
    for k, level in enumerate(["debug", "info", "warning", "error"], start=1):
        for text in (b"", b"a" * 64, b"a" * 65, b"ab" * 64, b"abc" * 100):
            recording.event(-5, level, text.decode())
            batch = recording._ring.take(1)
            pieces = [text[i : i + 64] for i in range(0, len(text), 64)] or [b""]
            assert content(batch.items) == [
                (-5, len(pieces) - 1 - n, 3, k, 0, piece) for n, piece in enumerate(pieces)
            ]
            recording._ring.release(batch)
    recording.event(0, "info", "a\udc80b")
    assert content(recording._ring.take(1).items) == [(0, 0, 3, 2, 0, b"a?b")]


def test_an_event_for_which_there_is_no_room_is_left_out_whole():
    recording = recording_of(16)
    recording.event(0, "info", "a" * 64 * 255)
    recording.event(0, "info", "b" * 65)
    recording.event(0, "info", "c" * 64)
    recording.event(0, "info", "")
    items = recording._ring.take(1).items
    assert [chr(piece["data"][0]) for piece in items] == ["a"] * 255 + ["c"]
    assert recording.dropped == 0


def test_in_real_time_a_tick_that_finds_the_ring_full_is_counted_and_those_behind_it_are_taken():
    recording = recording_of(16)
    ring = recording._ring
    for number in range(19):
        recording.tick(row_of(number), (), ())
    assert (recording.ticks, recording.dropped, ring.counters[DROPPED], ring.counters[WRITTEN]) == (
        16,
        3,
        3,
        16,
    )
    ring.release(ring.take(2))
    for number in range(19, 22):
        recording.tick(row_of(number), (), ())
    assert (recording.ticks, recording.dropped, ring.counters[DROPPED]) == (18, 4, 4)
    assert ring.take(16).rows["tick"].tolist() == [*range(2, 16), 19, 20]


class Draining(Process):
    """A recorder that drains the ring at the third look whether it lives."""

    def __init__(self):
        super().__init__()
        self.looks = 0

    def poll(self):
        self.looks += 1
        if self.looks == 3:
            self.ring.release(self.ring.take(16))
        return super().poll()

    ring: Ring


ONE = {
    "received": Received(0, Frame(1, b"", 0)),
    "sent": Frame(1, b"", 0),
    "operator": Operator.STOP,
    "setpoints": SetPoint(*(0.0,) * 6),
    "orders": Order(Operator.HOLD),
}


@pytest.mark.parametrize("kind", ONE)
def test_a_tick_that_has_more_of_whatever_kind_than_there_is_room_for_is_dropped_whole(kind):
    recording = recording_of(16)
    for number, count in enumerate((250, 7, 6)):
        recording.tick(row_of(number), **{"received": (), "sent": (), kind: [ONE[kind]] * count})
    assert (recording.ticks, recording.dropped) == (2, 1)
    batch = recording._ring.take(16)
    assert batch.rows["tick"].tolist() == [0]
    recording._ring.release(batch)
    assert recording._ring.take(16).rows["tick"].tolist() == [2]


@pytest.mark.parametrize("full", ["rows", "items"])
def test_in_lockstep_a_tick_waits_for_room_in_short_naps(monkeypatch, full):
    process = Draining()
    naps: list[float] = []
    recording = recording_of(16, lockstep=True, process=process)
    process.ring = recording._ring
    monkeypatch.setattr(time, "sleep", naps.append)
    for number in range(16 if full == "rows" else 1):
        recording.tick(row_of(number), (), (), [1] * (256 if full == "items" else 0))
    assert naps == []
    recording.tick(row_of(99), (), (), [1] * 256)
    assert naps == [0.0002] * 3
    assert recording.dropped == 0
    assert process.ring.take(16).rows["tick"].tolist() == [99]


def test_in_lockstep_an_event_waits_for_room_as_a_tick_does(monkeypatch):
    process = Draining()
    recording = recording_of(16, lockstep=True, process=process)
    process.ring = recording._ring
    monkeypatch.setattr(time, "sleep", lambda _: None)
    recording.tick(row_of(0), (), (), [1] * 256)
    recording.event(5, "warning", "late")
    assert content(recording._ring.take(1).items) == [(5, 0, 3, 3, 0, b"late")]


def test_in_lockstep_a_recorder_that_has_ended_is_told_with_its_reason(monkeypatch):
    monkeypatch.setattr(module, "answer", lambda of, timeout_s: {"error": f"disk_full: after {timeout_s:g}"})
    recording = recording_of(16, lockstep=True, process=Process(ended=True))
    for number in range(16):
        recording.tick(row_of(number), (), ())
    with pytest.raises(RecorderEndedError, match=r"^b/a.mcap: disk_full: after 0$"):
        recording.tick(row_of(16), (), ())


def test_in_lockstep_a_tick_that_the_ring_can_never_take_is_refused():
    recording = recording_of(16, lockstep=True, process=Process())
    recording.tick(row_of(0), (), (), [1] * 256)
    recording._ring.release(recording._ring.take(1))
    with pytest.raises(LogError, match="one tick with 257 frames: the ring holds 256"):
        recording.tick(row_of(1), (), (), [1] * 257)


# -- the end -------------------------------------------------------------------------------------------------

DIED = "the recorder died; recover the log with `hil replay --salvage`"
CLEAN = {"closed": "clean", "ticks": 3, "messages": 11, "size_bytes": 4096, "recorder_cpu_s": 0.25}


class Ended:
    """A recording of three ticks, two of them read, whose recorder says `reply` at the end."""

    def __init__(self, monkeypatch, folder, reply, *, ended=True, broken=False):
        self.did: list[Any] = []

        def send(process, data):
            self.did.append(data)
            if broken:
                raise BrokenPipeError

        def answer(process, timeout_s):
            self.did.append(timeout_s)
            return reply

        monkeypatch.setattr(module, "send", send)
        monkeypatch.setattr(module, "answer", answer)
        monkeypatch.setattr(module, "finish", lambda process: self.did.append("finish"))
        self.recording = recording_of(16, process=Process(ended))
        self.recording.path = folder / "a.mcap"
        self.recording._ring.close_fd = lambda: self.did.append("close")
        for number in range(3):
            self.recording.tick(row_of(number), (), ())
        self.recording._ring.release(self.recording._ring.take(2))


def test_the_end_is_asked_for_once_and_says_what_became_of_the_log(monkeypatch, tmp_path):
    ended = Ended(monkeypatch, tmp_path, CLEAN)
    summary = ended.recording.close(
        {"ending": "PARKED", "late": {"p99": 1.5}, "odd": "\udc80"}, timeout_s=7.0
    )
    assert summary == (tmp_path / "a.mcap", 3, 11, 0, 0, 4096, 0.25, True, "", False)
    said = {"ending": "PARKED", "late": '{"p99": 1.5}', "odd": "?"}
    assert ended.did == [said, 7.0, "finish", "close"]
    with ended.recording as again:
        assert again is ended.recording
    assert ended.recording.close() is summary
    assert len(ended.did) == 4
    assert ended.recording.trouble == ""


def test_a_recording_that_is_left_is_closed_and_waits_a_minute_at_most(monkeypatch, tmp_path):
    ended = Ended(monkeypatch, tmp_path, CLEAN)
    with ended.recording:
        pass
    assert ended.did == [{}, 60.0, "finish", "close"]


@pytest.mark.parametrize("there", [True, False])
def test_of_a_recorder_that_died_the_log_has_what_it_had_read_and_its_size_is_that_of_the_file(
    monkeypatch, tmp_path, there
):
    ended = Ended(monkeypatch, tmp_path, {}, broken=True)
    if there:
        (tmp_path / "a.mcap").write_bytes(b"12345")
    assert ended.recording.alive is False
    assert ended.recording.trouble == ended.recording.trouble == DIED
    assert ended.did == [0.0], "read once"
    summary = ended.recording.close()
    assert summary == (tmp_path / "a.mcap", 2, 0, 0, 1, 5 if there else 0, 0.0, False, DIED, False)


def test_a_recorder_that_gave_up_says_why_and_what_is_in_the_log(monkeypatch, tmp_path):
    reply = {**CLEAN, "ticks": 1, "error": "disk_full: and so on"}
    summary = Ended(monkeypatch, tmp_path, reply).recording.close()
    assert (summary.ticks, summary.lost, summary.complete) == (1, 2, False)
    assert (summary.error, summary.gave_up) == ("disk_full: and so on", True)


@pytest.mark.parametrize(("dropped", "ticks", "complete"), [(0, 3, True), (1, 3, False), (0, 2, False)])
def test_a_log_is_complete_when_it_holds_every_tick(monkeypatch, tmp_path, dropped, ticks, complete):
    ended = Ended(monkeypatch, tmp_path, {**CLEAN, "ticks": ticks})
    ended.recording.dropped = dropped
    summary = ended.recording.close()
    assert (summary.dropped, summary.lost, summary.complete) == (dropped, 3 - ticks, complete)


def test_a_recorder_that_lives_is_no_trouble(monkeypatch, tmp_path):
    ended = Ended(monkeypatch, tmp_path, CLEAN, ended=False)
    assert (ended.recording.alive, ended.recording.trouble, ended.did) == (True, "", [])
