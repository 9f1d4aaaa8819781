"""The loop's end of a recording: content of the ring, waiting, dropping, and the final report."""

from __future__ import annotations

import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.frame_array import received_array, sent_array, sent_at
from drivers.protocol import BUS, EXTENDED, FD, Frame, Received
from drivers.tick_columns import ROW, Column
from hil.record import recording as module
from hil.record.recording import Recording
from hil.record.ring import WRITTEN, Ring
from hil.record.row import Table, describe
from hil.signals import Operator, Order, SetPoint


class End:
    """Fake recorder; with `drains` it drains the ring at the third check of its life. `did`: its calls."""

    ring: Ring

    def __init__(self, *, ended=False, drains=False, reply=None):
        self.ended, self.drains, self.looks, self.reply = ended, drains, 0, reply
        self.did: list[Any] = []

    @property
    def alive(self):
        self.looks += 1
        if self.drains and self.looks == 3:
            self.ring.release(self.ring.take(16))
        return not self.ended

    def send(self, message):
        self.did.append(message)

    def answer(self, timeout_s):
        self.did.append(timeout_s)
        return self.reply

    def finish(self):
        self.did.append("finish")


def recording_of(capacity=16, *, lockstep=False, end=None):
    ring = Ring.create(ROW, capacity)
    ring.close_fd()
    given: Any = end
    if end is not None:
        end.ring = ring
    return Recording(ring, given, Path("b/a.mcap"), lockstep=lockstep)


def row_of(number):
    row = np.zeros((), ROW)
    row["tick"], row["t_ns"] = number, 1000 * number
    return row


def content(items):
    names = ("t_ns", "id", "kind", "flags", "bus")
    return [(*(int(i[name]) for name in names), bytes(i["data"][: i["length"]])) for i in items]


def test_a_tick_enters_the_ring_in_order_also_after_wrap_round():
    """Frames as tuples and as arrays give the same content."""
    one, other = recording_of(), recording_of()
    received = [Received(7, Frame(1, b"\1" * 64, 0)), Received(8, Frame(2, b"", 3 * BUS + FD))]
    sent = [Frame(3, b"\2" * 64, EXTENDED), Frame(4, b"34", BUS)]
    pose, orders = (
        SetPoint(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        [Order(Operator.SPEED, (0.5,)), Order(Operator.HOLD)],
    )
    for number in range(40):
        now = 1000 * number
        one.tick(row_of(number), received, sent, [1, 2], [pose], orders)
        items = received_array(received), sent_at(now, sent_array(sent))
        other.tick(row_of(number), *items, [1, 2], [pose], orders)
        for recording in (one, other):
            ring = recording._ring
            assert ring.counters[WRITTEN] == recording.ticks == number + 1
            batch = ring.take(1)
            assert batch.rows["tick"].tolist() == [number]
            assert content(batch.items) == [
                (7, 1, 0, 0, 0, b"\1" * 64), (8, 2, 0, FD, 3, b""), (now, 3, 1, EXTENDED, 0, b"\2" * 64),
                (now, 4, 1, 0, 1, b"34"), (now, 1, 2, 0, 0, b""), (now, 2, 2, 0, 0, b""),
                (now, int(Operator.SETPOINT), 2, 0, 0, struct.pack("<6d", *pose)),
                (now, int(Operator.SPEED), 2, 0, 0, struct.pack("<d", 0.5)), (now, int(Operator.HOLD), 2, 0, 0, b""),
            ]  # fmt: skip
            ring.release(batch)


def test_an_event_may_contain_a_file_name_that_is_not_utf_8():
    recording = recording_of()
    recording.event(0, "info", "a\udc80b")
    assert content(recording._ring.take(1).items) == [(0, 0, 3, 2, 0, b"a?b")]


def test_an_event_without_room_is_left_out_completely():
    recording = recording_of()
    for text in ("a" * 64 * 255, "b" * 65, "c" * 64, ""):
        recording.event(0, "info", text)
    items = recording._ring.take(1).items
    assert [chr(piece["data"][0]) for piece in items] == ["a"] * 255 + ["c"]
    assert recording.dropped == 0


def test_in_lockstep_a_tick_larger_than_the_ring_is_refused():
    recording = recording_of(lockstep=True, end=End())
    recording.tick(row_of(0), (), (), [1] * 256)
    recording._ring.release(recording._ring.take(1))
    with pytest.raises(LogError, match="257 frames, but the ring holds 256"):
        recording.tick(row_of(1), (), (), [1] * 257)


SMALL = Table("/small", tuple(Column("output", n, int, "", "", (), ()) for n in ("tick", "t_ns")))
EPOCH_2000 = 946_684_800_000_000_000  # date -u -d 2000-01-01 +%s


class At:
    """A stopped clock."""

    def now(self):
        return 1_200


@pytest.mark.parametrize("lockstep", [False, True])
def test_recorder_setup_has_clock_buses_and_metadata_of_the_run(monkeypatch, tmp_path, lockstep):
    """t_ns = 0 is the zero of the clock in real time, and the year 2000 in lockstep."""
    found: list[Any] = []
    monkeypatch.setattr(module, "_start", lambda ring, setup: found.append(setup))
    monkeypatch.setattr(time, "time_ns", lambda: 5_000)
    clock: Any = At()
    for buses in ("front", ["front"], ["front", "rear"]):
        recording = Recording.start(
            tmp_path / "a.mcap", configuration="ä: 1\n", table=SMALL, attachments=[("b", b"12")], lockstep=lockstep,
            metadata={"kind": "run", "seed": 7}, can_channel=buses, clock=clock, ring_ticks=64,
        )  # fmt: skip
        recording._ring.close_fd()
        setup = found.pop()
        several = {"can_channels": '["front", "rear"]'} if len(buses) == 2 else {}
        assert setup["identity"] == several | {
            "kind": "run", "seed": "7", "topic": "/small", "columns": describe(SMALL.columns),
            "epoch_ns": str(EPOCH_2000) if lockstep else "3800", "can_channel": "front",
            "mode": "lockstep" if lockstep else "realtime",
        }  # fmt: skip
    assert setup["created_ns"] == (EPOCH_2000 if lockstep else 5_000)
    assert setup["attachments"] == [("config.yaml", "ä: 1\n".encode()), ("b", b"12")]
    assert ("scheduler" in setup["environment"]) is lockstep


CLEAN = {"closed": "clean", "ticks": 3, "messages": 11, "size_bytes": 4096, "recorder_cpu_s": 0.25}


@pytest.fixture
def ended(tmp_path):
    """Function that makes a recording of three ticks, two of them read, with this final reply of the
    recorder.
    """

    def make(reply, *, ended=True):
        end = End(ended=ended, reply=reply)
        recording = recording_of(end=end)
        recording.path = tmp_path / "a.mcap"
        for number in range(3):
            recording.tick(row_of(number), (), ())
        recording._ring.release(recording._ring.take(2))
        return recording, end.did

    return make


def test_end_of_the_recording_is_requested_once_and_its_result_describes_the_log(ended, tmp_path):
    recording, did = ended(CLEAN)
    summary = recording.close({"ending": "PARKED", "late": {"p99": 1.5}}, timeout_s=7.0)
    assert summary == (tmp_path / "a.mcap", 3, 11, 0, 0, 4096, 0.25, True, "", False)
    assert did == [{"ending": "PARKED", "late": '{"p99": 1.5}'}, 7.0, "finish"]
    with recording as again:
        assert again is recording
    assert recording.close() is summary
    assert (len(did), recording.trouble) == (3, "")


@pytest.mark.parametrize(("dropped", "ticks", "complete"), [(0, 3, True), (1, 3, False), (0, 2, False)])
def test_a_log_is_complete_when_it_holds_every_tick(ended, dropped, ticks, complete):
    recording, did = ended({**CLEAN, "ticks": ticks}, ended=False)
    assert (recording.alive, recording.trouble, did) == (True, "", []), "a living recorder is not reported"
    recording.dropped = dropped
    summary = recording.close()
    assert (summary.dropped, summary.lost, summary.complete) == (dropped, 3 - ticks, complete)
