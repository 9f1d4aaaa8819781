"""Recorder in one process: beginning and end of its log, its batches and chunks."""

from __future__ import annotations

import os
import pickle
import struct
import subprocess
from multiprocessing.connection import Pipe
from typing import Any, cast

import pytest
from mcap.reader import make_reader

from hil.record import Recording
from hil.record.child import RecorderEnd
from hil.record.encode import Encoder
from hil.record.mcap_file import McapFile
from hil.record.recorder import Control, Recorder
from hil.record.recording import Live
from hil.record.ring import DROPPED, Ring
from hil.record.row import TICKS, Run, describe
from tests.hil.samples import random_rows

IDENTITY = {"mode": "lockstep", "epoch_ns": "1000", "can_channel": "can0"}
FILES = [
    ("config.yaml", b"a: 1\n"), ("b.json", b"{}"), ("c.dbc", b"VERSION"), ("d.csv", b"1,2"), ("e.fmu", b"\0\1"),
]  # fmt: skip


class Bench:
    """Both ends of a ring, with a recorder in this process."""

    def __init__(self, folder):
        self.ring = Ring.create(TICKS.dtype, 256)
        self.path = folder / "a.mcap"
        nobody: Any = None
        self.producer = Recording(self.ring, nobody, self.path, lockstep=False)
        identity = IDENTITY | {"topic": "/tick", "columns": describe(TICKS.columns)}
        setup = {
            "identity": identity, "environment": {"version": "1.2.3", "cpu": "some"}, "scene": None, "live": Live(),
            "mirror": None, "attachments": FILES, "path": str(self.path), "created_ns": 77,
        }  # fmt: skip
        self.recorder = Recorder(self.ring, Run.of(identity)._replace(columns=TICKS.columns), setup)
        self.ring.close_fd()

    def tick(self, *numbers):
        for number in numbers:
            row = random_rows(1)[0]
            row["tick"], row["lateness_ns"], row["R"], row["R_d"] = number, 1000 * number, 0.0, 0.0
            self.producer.tick(row, (), ())

    def drain(self, limit):
        while self.recorder._drain(limit):
            pass


def read(path):
    """Header, summary, metadata by name and attachments of a log."""
    with path.open("rb") as file:
        reader = make_reader(file)
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
        return reader.get_header(), cast("Any", reader.get_summary()), metadata, [*reader.iter_attachments()]


# -- beginning and end -----------------------------------------------------------------------------------------


def test_a_log_begins_with_metadata_attachments_and_channels(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(McapFile, "sync", lambda file: synced.append(file.position))
    bench = Bench(tmp_path)
    assert synced == [bench.path.stat().st_size], "all that is put onto the disk at once"
    bench.recorder.close({})
    header, summary, metadata, attachments = read(bench.path)
    assert header.library == "hexapod-hil/1.2.3"
    assert metadata["hil"] == {**IDENTITY, "topic": "/tick", "columns": describe(TICKS.columns)}
    assert metadata["environment"] == {"version": "1.2.3", "cpu": "some"}
    media = ["application/yaml", "application/json", "text/plain", "text/csv", "application/octet-stream"]
    found = [(a.name, a.data, a.media_type, a.create_time, a.log_time) for a in attachments]
    assert found == [(name, data, kind, 77, 77) for (name, data), kind in zip(FILES, media, strict=True)]
    expected = Encoder(TICKS, epoch_ns=1000, can_channels=["can0"], scene=None).channels
    assert sorted(summary.channels) == sorted(summary.schemas) == sorted(expected)
    for number, (topic, schema, about) in expected.items():
        channel, there = summary.channels[number], summary.schemas[number]
        assert (channel.topic, channel.schema_id, channel.metadata) == (topic, number, about)
        assert (channel.message_encoding, there.encoding) == ("protobuf", "protobuf")
        assert (there.name, there.data) == (schema.name, schema.descriptors)


def test_the_end_of_a_log_has_the_producers_summary_and_the_counts(tmp_path):
    bench = Bench(tmp_path)
    bench.tick(0, 1, 5)
    bench.producer.event(0, "info", "behind them")
    bench.ring.counters[DROPPED] = 9
    bench.drain(2)
    answer = bench.recorder.close({"ending": "PARKED", "ticks": "of another"})
    counts = {"closed": "clean", "ticks": 3, "messages": 4, "dropped": 9}
    assert float(cast("float", answer.pop("recorder_cpu_s"))) > 0.0
    assert answer == counts | {"size_bytes": bench.path.stat().st_size}
    assert read(bench.path)[2]["summary"] == {"ending": "PARKED", "duration_s": "0.0"} | {
        name: str(n) for name, n in counts.items()
    }


# -- its producer ----------------------------------------------------------------------------------------------

LONG_S = 10.0
"""Longer than a killed process needs to end."""


@pytest.fixture
def producer(monkeypatch):
    """A waiting process in the place of the parent."""
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as process:
        monkeypatch.setattr(os, "getppid", lambda: process.pid)
        yield process
        process.kill()


def test_a_killed_producer_is_noticed_although_a_child_holds_the_link(producer, monkeypatch):
    _held, link = Pipe()
    control = Control(link, producer.pid)
    assert not control.ended(0.0)
    producer.kill()
    assert control.ended(LONG_S)
    assert control.ended(0.0), "an ended producer must stay ended"
    assert control.summary is None
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert Control(link, producer.pid).ended(0.0), "a producer that died before the start has ended"


WHOLE = pickle.dumps({"ending": "PARKED"})
LENGTH = struct.pack("!i", len(WHOLE))


@pytest.mark.parametrize(
    ("sent", "closed", "summary"),
    [(WHOLE, False, {"ending": "PARKED"}), (WHOLE[:-5], True, None), (b"", True, None)],
    ids=["whole", "cut", "none"],
)
def test_a_living_producer_ends_with_its_summary_or_its_link(producer, sent, closed, summary):
    end, link = Pipe()
    control = Control(link, producer.pid)
    assert not control.ended(0.0)
    os.write(end.fileno(), LENGTH + sent if sent else b"")
    if closed:
        end.close()
    assert control.ended(LONG_S)
    assert control.summary == summary


@pytest.mark.parametrize(
    ("answered", "ends", "found"),
    [(WHOLE, False, {"ending": "PARKED"}), (WHOLE[:-4], True, {}), (b"", True, {}), (b"", False, None)],
    ids=["one", "half of one", "nothing and dead", "nothing"],
)
def test_first_complete_answer_of_the_recorder_within_the_timeout_counts(answered, ends, found):
    recorder: Any = RecorderEnd.__new__(RecorderEnd)
    recorder._link, other = Pipe()
    os.write(other.fileno(), LENGTH + answered if answered else b"")
    if ends:
        other.close()
    answer = recorder.answer(0.015)
    assert answer == found if found is not None else "0.015 s" in answer["error"]
