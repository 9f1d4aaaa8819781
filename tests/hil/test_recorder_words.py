"""What a recorder says: its log's beginning and end, and its answers to the producer."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import sys
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from mcap.reader import make_reader

from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record import Recording
from hil.record import recorder as module
from hil.record.encode import Encoder
from hil.record.mcap_file import McapFile
from hil.record.recorder import Histogram, Recorder
from hil.record.recording import Live, Scene
from hil.record.ring import DROPPED, Ring
from hil.record.row import TICKS, Run, Table, describe
from tests.hil.samples import random_rows

TICK, TIME = (Column("output", name, int, "", "", (), ()) for name in ("tick", "t_ns"))
SMALL = Table("/small", (TICK, TIME))
IDENTITY = {"mode": "lockstep", "epoch_ns": "1000", "can_channel": "can0"}
RUN = Run("/small", SMALL.columns, 0, ("can0",), lockstep=True)
FILES = [
    ("config.yaml", b"a: 1\n"), ("b.json", b"{}"), ("c.dbc", b"VERSION"), ("d.csv", b"1,2"), ("e.fmu", b"\0\1"),
]  # fmt: skip
CPU = SimpleNamespace(user=2.5, system=0.25)


def setup_of(folder, **more):
    return {"identity": IDENTITY | more.pop("identity", {}), "environment": {"version": "1.2.3", "cpu": "some"},
            "scene": None, "live": Live(), "mirror": None, "attachments": FILES,
            "path": str(folder / "a.mcap"), "created_ns": 77, **more}  # fmt: skip


class Bench:
    """Both ends of a ring, a recorder in this process."""

    def __init__(self, folder, table=TICKS, capacity=256, **more):
        self.ring = Ring.create(table.dtype, capacity)
        nobody: Any = None
        self.producer = Recording(self.ring, nobody, folder / "a.mcap", lockstep=False)
        setup = setup_of(folder, **more)
        setup["identity"] |= {"topic": table.topic, "columns": describe(table.columns)}
        run = Run.of(setup["identity"])._replace(columns=table.columns)
        self.recorder = Recorder(self.ring, run, setup)
        self.ring.close_fd()

    def tick(self, *numbers):
        for number in numbers:
            row = random_rows(1)[0]
            row["tick"], row["lateness_ns"], row["R"], row["R_d"] = number, 1000 * number, 0.0, 0.0
            self.producer.tick(row, (), ())


def read(path):
    """Return header, summary, metadata by name and attachments of a log."""
    with path.open("rb") as file:
        reader = make_reader(file)
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        return reader.get_header(), cast("Any", reader.get_summary()), metadata, [*reader.iter_attachments()]


def test_a_log_begins_with_what_it_is_where_it_was_made_and_what_was_attached(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(McapFile, "sync", lambda file: synced.append(file.position))
    recorder = Bench(tmp_path).recorder
    assert synced == [(tmp_path / "a.mcap").stat().st_size], "all that is put onto the disk at once"
    recorder.close({})
    header, summary, metadata, attachments = read(tmp_path / "a.mcap")
    assert header.library == "hexapod-hil/1.2.3"
    assert metadata["hil"] == {**IDENTITY, "topic": "/tick", "columns": describe(TICKS.columns)}
    assert metadata["environment"] == {"version": "1.2.3", "cpu": "some"}
    media = ["application/yaml", "application/json", "text/plain", "text/csv", "application/octet-stream"]
    assert [(a.name, a.data, a.media_type) for a in attachments] == [
        (name, data, kind) for (name, data), kind in zip(FILES, media, strict=True)
    ]
    assert {(a.create_time, a.log_time) for a in attachments} == {(77, 77)}
    expected = Encoder(TICKS, epoch_ns=1000, can_channels=["can0"], scene=None).channels
    assert sorted(summary.channels) == sorted(summary.schemas) == sorted(expected)
    for number, (topic, schema, said) in expected.items():
        channel, there = summary.channels[number], summary.schemas[number]
        assert (channel.topic, channel.schema_id, channel.metadata) == (topic, number, said)
        assert (channel.message_encoding, there.encoding) == ("protobuf", "protobuf")
        assert (there.name, there.data) == (schema.name, schema.descriptors)


def test_a_log_of_a_program_without_a_version_says_so(tmp_path):
    Bench(tmp_path, environment={}).recorder.close({})
    assert read(tmp_path / "a.mcap")[0].library == "hexapod-hil/unknown"


def test_the_set_up_says_what_the_bus_is_called_what_is_drawn_and_what_is_shown(tmp_path, monkeypatch):
    given: dict[str, Any] = {}
    shown: list[Any] = []

    def encoder(table, **options):
        given.update(options, table=table)
        return Encoder(table, **options)

    monkeypatch.setattr(module, "Encoder", encoder)
    monkeypatch.setattr(module, "LiveView", lambda out, length: shown.append((out, length)))
    out = io.StringIO()
    monkeypatch.setattr(sys, "stderr", out)
    corners = [[1.0, k, 0.0] for k in range(6)]
    Bench(
        tmp_path, scene=Scene(corners, corners, 5), live=Live(status=True, reference_s=12.5),
        identity={"can_channels": '["front", "rear"]', "epoch_ns": "123"},
    )  # fmt: skip
    assert given["scene"] == (corners, corners, 5)
    assert (given["epoch_ns"], given["can_channels"]) == (123, ("front", "rear"))
    assert given["table"] == TICKS
    assert shown == [(out, 12.5)]


@pytest.mark.parametrize(
    ("row_bytes", "capacity", "ticks"),
    [
        (16, 1024, 252),
        (16, 504, 252),
        (16, 503, 251),
        (16, 256, 128),
        (64, 1024, 240),
        (1024, 1024, 128),
        (3072, 1024, 64),
        (40_000, 256, 16),
    ],
)
def test_a_batch_is_about_a_chunk_of_rows_with_a_kilobyte_of_frames_each(
    tmp_path, row_bytes, capacity, ticks
):
    """16 ticks at least, however large, and half a ring at most: the producer fills the other half meanwhile."""
    more = [Column("output", "x", float, "", "", (), ((row_bytes - 16) // 8,))] if row_bytes > 16 else []
    bench = Bench(tmp_path, Table("/small", (TICK, TIME, *more)), capacity)
    assert bench.ring.rows.dtype.itemsize == row_bytes
    assert bench.recorder.batch == ticks
    bench.recorder.file.discard()


def test_wake_ups_are_counted_by_the_next_power_of_two_of_their_whole_microseconds():
    counts = Histogram()
    assert counts.table() == {}
    last = 2**19
    late_us = [-5.0, 0.0, 0.999, 1.0, 1.999, 2.0, 3.0, 4.0, last - 0.001, last, 2 * last, 1e9]
    counts.add((1000 * np.array(late_us)).astype(np.int64))
    counts.add(np.array([], np.int64))
    assert counts.table() == {"1": 3, "2": 2, "4": 2, "8": 1, "524288": 1, "inf": 3}
    counts.add(np.array([0, 7_000, 7_000]))
    assert counts.table() == {"1": 4, "2": 2, "4": 2, "8": 3, "524288": 1, "inf": 3}


def test_the_end_of_a_log_has_the_words_of_the_producer_and_what_was_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "times", lambda: CPU)
    bench = Bench(tmp_path)
    bench.tick(0, 1, 5)
    bench.producer.event(0, "info", "behind them")
    bench.ring.counters[DROPPED] = 9
    while bench.recorder._drain(2):
        pass
    told = bench.recorder.close({"ending": "PARKED", "ticks": "of another"})
    late = json.dumps({"1": 1, "2": 1, "8": 1})
    assert told == {
        "closed": "clean", "ticks": 3, "messages": 4, "dropped": 9, "wake_up_us": late,
        "size_bytes": (tmp_path / "a.mcap").stat().st_size, "recorder_cpu_s": 2.75,
    }  # fmt: skip
    assert read(tmp_path / "a.mcap")[2]["summary"] == {
        "ending": "PARKED", "closed": "clean", "ticks": "3", "messages": "4", "dropped": "9", "wake_up_us": late,
    }  # fmt: skip


def test_the_end_of_a_log_whose_producer_died_says_so_and_rows_without_wake_ups_count_none(tmp_path):
    bench = Bench(tmp_path, SMALL)
    told = bench.recorder.close(None)
    assert (told["closed"], told["ticks"], told["messages"]) == ("producer died", 0, 0)
    assert "wake_up_us" not in told
    counted = {"closed": "producer died", "ticks": "0", "messages": "0", "dropped": "0"}
    assert read(tmp_path / "a.mcap")[2]["summary"] == counted


def test_the_end_on_a_full_disk_says_how_many_ticks_are_left_and_how_large_the_log_is(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "times", lambda: CPU)
    bench = Bench(tmp_path)
    bench.tick(0, 1, 2)
    bench.producer.event(0, "info", "behind them")
    bench.ring.counters[DROPPED] = 9
    while bench.recorder._drain(2):
        pass
    told = bench.recorder.close_full(OSError(errno.EDQUOT, "Disk quota exceeded"))
    path = tmp_path / "a.mcap"
    size = path.stat().st_size
    assert told == {
        "closed": "disk_full", "ticks": 2, "messages": 2, "dropped": 9, "size_bytes": size, "recorder_cpu_s": 2.75,
        "error": f"disk_full: Disk quota exceeded; the log is closed and holds the first 2 ticks, {size} bytes: {path}",
    }  # fmt: skip
    counted = {"closed": "disk_full", "ticks": "2", "messages": "2", "dropped": "9"}
    assert read(path)[2]["summary"] == counted


def test_what_is_drained_is_written_counted_shown_and_only_then_given_back_and_sent_to_viewers(tmp_path):
    bench = Bench(tmp_path)
    recorder: Any = bench.recorder
    assert recorder._drain(4) is False
    did: list[tuple[str, Any]] = []
    ring, write = recorder._ring, recorder._write

    def written(messages):
        did.append(("write", len(messages.channel)))
        write(messages)

    recorder._write = written
    recorder._live = SimpleNamespace(show=lambda rows: did.append(("show", rows["tick"].tolist())))
    recorder._publisher = SimpleNamespace(drained=lambda b: did.append(("drained", b.rows["tick"].tolist())))
    recorder.socket = SimpleNamespace(publish=lambda m: did.append(("send", len(m.channel))))

    def released(given):
        did.append(("release", len(given.rows)))
        ring.release(given)

    recorder._ring = SimpleNamespace(take=ring.take, release=released)
    bench.tick(0, 1, 2)
    bench.producer.event(0, "info", "behind them")
    assert recorder._drain(2) is True
    assert did == [("write", 2), ("show", [0, 1]), ("drained", [0, 1]), ("release", 2), ("send", 2)]
    did.clear()
    assert recorder._drain(2) is True
    assert did == [("write", 2), ("show", [2]), ("drained", [2]), ("release", 1), ("send", 2)]
    bench.producer.event(0, "info", "alone")
    did.clear()
    assert recorder._drain(2) is True
    assert did == [("write", 1), ("show", []), ("drained", []), ("release", 0), ("send", 1)]
    assert recorder._drain(2) is False
    recorder.file.discard()


@pytest.mark.parametrize(("mode", "first_s"), [("lockstep", 0.004), ("realtime", 0.0)])
def test_the_set_up_says_whether_time_is_simulated_then_the_first_look_waits_too(tmp_path, mode, first_s):
    bench = Bench(tmp_path, identity={"mode": mode})
    waited: list[float] = []

    def ended(timeout_s):
        waited.append(timeout_s)
        return True

    control: Any = SimpleNamespace(ended=ended)
    bench.recorder.run(control)
    bench.recorder.file.discard()
    assert waited == [first_s]


def test_a_run_that_ends_is_shown_no_more_and_that_once():
    recorder: Any = Recorder.__new__(Recorder)
    did: list[str] = []
    recorder._live = SimpleNamespace(end=lambda: did.append("line"))
    recorder._publisher = SimpleNamespace(close=lambda: did.append("picture"))
    recorder._stop_showing()
    recorder._stop_showing()
    assert did == ["line", "picture"]


def test_an_undisturbed_recorder_closes_its_log_with_the_words_of_the_producer():
    did: list[Any] = []
    recorder: Any = SimpleNamespace(run=did.append, close=lambda summary: {"closed with": summary})
    control: Any = SimpleNamespace(summary={"ending": "PARKED"})
    assert module._recorded(recorder, control) == {"closed with": {"ending": "PARKED"}}
    assert did == [control]


class Main:
    """The recorder's main function with all it uses in its place; what it answered, and what happened."""

    def __init__(self, monkeypatch, folder, *, error=None, where="_recorded", messages=3):
        self.answers: list[Any] = []
        self.did: list[Any] = []
        self.handled: dict[str, Any] = {}
        file = SimpleNamespace(position=4096, messages=messages, discard=lambda: self.did.append("discard"))
        recorder = SimpleNamespace(file=file, socket=None)
        setup = {
            "identity": "described",
            "ring_ticks": 512,
            "path": "b/a.mcap",
        }

        def step(name, result):
            def call(*arguments):
                self.did.append((name, *arguments))
                if error is not None and name == where:
                    raise error
                return result

            return call

        ring = SimpleNamespace(close_fd=lambda: self.did.append("close"))
        for name, value in {
            "receive": step("receive", setup),
            "Run": SimpleNamespace(of=step("Run", RUN)),
            "Ring": step("Ring", ring),
            "Recorder": step("Recorder", recorder),
            "_Control": step("_Control", "control"),
            "_recorded": step("_recorded", {"closed": "clean"}),
            "answer": self.answers.append,
        }.items():
            monkeypatch.setattr(module, name, value)
        monkeypatch.setattr(signal, "signal", lambda number, what: self.handled.update({number.name: what}))
        monkeypatch.setattr(signal, "pthread_sigmask", lambda how, what: self.did.append((how.name, *what)))
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer="pipe"))
        self.ring, self.recorder, self.setup = ring, recorder, setup
        self.code = module.main(["5", "4242"])


def test_a_recorder_takes_the_ring_and_the_producer_it_is_told_and_no_signal_to_end(monkeypatch, tmp_path):
    ran = Main(monkeypatch, tmp_path)
    assert ran.did == [
        ("SIG_SETMASK",),
        ("receive", "pipe"),
        ("Run", "described"),
        ("Ring", 5, SMALL.dtype, 512),
        "close",
        ("Recorder", ran.ring, RUN, ran.setup),
        ("_Control", "pipe", 4242),
        ("_recorded", ran.recorder, "control"),
    ]
    assert ran.handled == dict.fromkeys(["SIGINT", "SIGTERM", "SIGHUP"], signal.SIG_IGN)
    assert (ran.code, ran.answers) == (0, [{"ready": True}, {"closed": "clean"}])


EXISTS = "a.mcap exists and is never overwritten: choose another name for the log"
FULL, BROKEN = OSError(errno.ENOSPC, "No space left"), OSError(errno.EIO, "Input/output error")


@pytest.mark.parametrize(
    ("where", "error", "messages", "said"),
    [
        ("Run", LogError("no table"), 0, [{"error": "no table"}]),
        ("Recorder", FileExistsError(17, "File exists", "a.mcap"), 0, [{"error": EXISTS}]),
        ("Recorder", FULL, 0, [{"error": "the log cannot be written: disk_full: No space left: b/a.mcap"}]),
        ("Recorder", BROKEN, 0, [{"error": "the log cannot be written: Input/output error: b/a.mcap"}]),
        (
            "_recorded", BROKEN, 1,
            [{"ready": True}, {"error": "the log cannot be written after 4096 bytes: Input/output error: b/a.mcap"}],
        ),
        (
            "_recorded", FULL, 0,
            [{"ready": True},
             {"error": "the log cannot be written after 4096 bytes: disk_full: No space left: b/a.mcap"}],
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)  # fmt: skip
def test_a_recorder_that_fails_says_why_in_one_line_and_leaves_no_log_without_a_message(
    monkeypatch, tmp_path, where, error, messages, said
):
    ran = Main(monkeypatch, tmp_path, where=where, error=error, messages=messages)
    assert (ran.code, ran.answers) == (1, said)
    assert ran.did.count("discard") == (where == "_recorded" and messages == 0)
