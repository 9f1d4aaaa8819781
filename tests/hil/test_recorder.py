"""Recorder in one process: beginning and end of its log, its batches and chunks."""

from __future__ import annotations

import os
import pickle
import struct
import subprocess
from multiprocessing.connection import Pipe
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from mcap.reader import make_reader

from hil.record import Recording
from hil.record import recorder as module
from hil.record.child import RecorderEnd
from hil.record.encode import Encoder, Messages
from hil.record.mcap_file import CHUNK_SIZE, McapFile
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


# -- batches and chunks ----------------------------------------------------------------------------------------


def test_recorder_writes_a_batch_before_it_releases_the_room_in_the_ring(tmp_path):
    bench = Bench(tmp_path)
    recorder: Any = bench.recorder
    did: list[tuple[str, int]] = []
    ring, write = recorder._ring, recorder._write

    def written(messages):
        did.append(("write", len(messages.channel)))
        write(messages)

    def released(batch):
        did.append(("release", len(batch.rows)))
        ring.release(batch)

    recorder._write = written
    recorder._publisher = SimpleNamespace(drained=lambda batch: did.append(("show", len(batch.rows))))
    recorder.socket = SimpleNamespace(publish=lambda messages: did.append(("send", len(messages.channel))))
    recorder._ring = SimpleNamespace(take=ring.take, release=released)
    bench.tick(0, 1, 2)
    bench.producer.event(0, "info", "behind them")
    assert [recorder._drain(2) for _ in range(3)] == [True, True, False]
    first, second = ([("write", 2), ("show", n), ("release", n), ("send", 2)] for n in (2, 1))
    assert did == [*first, *second]
    recorder.file.discard()


def chunks_of(lengths: list[list[int]]) -> list[list[tuple[int, int]]]:
    """Write messages of these lengths, tick by tick: tick and number of the messages in each chunk.

    The arguments for each message are compared with the message on the way.
    """
    found: list[list[tuple[int, int]]] = []
    ticks = [(tick, size) for tick, sizes in enumerate(lengths) for size in sizes]
    data = [b"%08d" % number + bytes(size - 8) for number, (_, size) in enumerate(ticks)]

    def add_chunk(written, channel, log_time, offset):
        numbers = [int(bytes(written[at : at + 8])) for at in offset.tolist()]
        assert written == b"".join(data[n] for n in numbers)
        assert channel.tolist() == [n % 7 for n in numbers]
        assert log_time.tolist() == [1000 + n for n in numbers]
        found.append([(ticks[n][0], n) for n in numbers])

    recorder: Any = Recorder.__new__(Recorder)
    recorder.file = SimpleNamespace(add_chunk=add_chunk)
    count = np.arange(len(data))
    start, whole = np.cumsum([0, *map(len, data)]), np.frombuffer(b"".join(data), np.uint8)
    recorder._write(Messages(whole, start, count % 7, 1000 + count, np.array([tick for tick, _ in ticks])))
    assert [n for chunk in found for _, n in chunk] == count.tolist()
    return found


LARGE = CHUNK_SIZE // 8


@pytest.mark.parametrize(
    "lengths",
    [
        [[100, 50, 50]] * 4,
        [[LARGE]] * 8,
        [[LARGE, 8, 8]] * 8,
        [[LARGE, 40, 40, 40]] * 40,
        [[40, LARGE]] * 100,
        [[LARGE // 3] * 3] * 33,
        [[16]] * 3 + [[LARGE] * 5] * 3 + [[16]],
    ],
    ids=["few", "one", "a little more than one", "row and frames", "many", "equal", "unlike"],
)
def test_log_chunks_end_between_ticks_and_are_as_few_as_possible(lengths):
    found = chunks_of(lengths)
    sizes = [sum(sum(lengths[tick]) for tick in {tick for tick, _ in chunk}) for chunk in found]
    assert sum(sizes) == sum(map(sum, lengths)), "no tick is in two chunks"
    assert max(sizes) <= CHUNK_SIZE + max(map(sum, lengths))
    assert len(found) <= np.ceil(sum(sizes) / CHUNK_SIZE)


def test_a_tick_larger_than_a_chunk_gets_a_chunk_of_its_own():
    large = [CHUNK_SIZE, CHUNK_SIZE, 40]
    (chunk,) = [each for each in chunks_of([[40, 40], large, [40], [40]]) if 1 in {tick for tick, _ in each}]
    assert sum(tick == 1 for tick, _ in chunk) == 3
    assert chunks_of([large]) == [[(0, 0), (0, 1), (0, 2)]]
    assert chunks_of([[40], [40], large]) == [[(0, 0), (1, 1)], [(2, 2), (2, 3), (2, 4)]]


# -- its pace and its producer ---------------------------------------------------------------------------------


@pytest.mark.parametrize("lockstep", [False, True])
def test_real_time_writes_a_chunk_every_0_1_s_and_flushes_every_second(monkeypatch, lockstep):
    """0.1 s is half of the possible loss. A simulation writes whole batches and never flushes."""
    now, filled = [0.0], [7.13, 9.5]
    did: dict[str, list[float]] = {"show": [], "drain": [], "sync": []}
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    recorder: Any = Recorder.__new__(Recorder)
    recorder._live, recorder._lockstep, recorder.batch = None, lockstep, 16
    recorder._publisher = SimpleNamespace(publish=lambda _: did["show"].append(now[0]), close=lambda: None)
    recorder.file = SimpleNamespace(sync=lambda: did["sync"].append(now[0]), position=0)
    left = [True, True, False]

    def ready(limit: int) -> bool:
        assert limit == (16 if lockstep else 64), "a batch, or a quarter of the ring"
        return bool(filled and now[0] > filled[0] and filled.pop(0))

    def drain(limit: int) -> bool:
        assert limit == (16 if lockstep else 2048)
        did["drain"].append(now[0])
        return left.pop(0) if now[0] > 20.0 else False

    def ended(timeout_s: float) -> bool:
        now[0] += max(timeout_s, 1e-6)  # what it looks for is there at once, or never
        return now[0] > 20.0

    recorder._ring, recorder._drain = SimpleNamespace(ready=ready, capacity=256), drain
    recorder.run(SimpleNamespace(ended=ended))
    assert left == [], "the ring must be empty at the end"
    if lockstep:
        np.testing.assert_allclose(did["drain"][:2], [7.13, 9.5], atol=0.005)
        assert (len(did["drain"]), did["sync"]) == (2 + 3, [])
        return
    np.testing.assert_allclose(np.diff(did["show"]), 0.02, atol=1e-5)
    at = np.array(did["drain"][:-3])
    assert np.diff([0.0, *at]).max() == pytest.approx(0.1, abs=1e-3)
    assert any(abs(at - 7.14) < 0.011), "at once where a quarter of the ring is filled"
    np.testing.assert_allclose(np.diff([0.0, *did["sync"]]), 1.0, atol=0.11)


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
