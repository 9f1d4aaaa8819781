"""Log messages over a websocket: a viewer reads every tick, and no client makes the log lose one."""

import base64
import os
import socket
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from hil.app.compose import build_cycle, record
from hil.app.configuration.configuration import load, loads
from hil.record import Live, Recording
from hil.record.encode import Encoder
from hil.record.log import Log
from hil.record.publish import LiveSocket
from hil.record.row import TICKS
from hil.record.schema import Schema, message_class
from tests.hil.foxglove_client import Client
from tests.hil.samples import random_ticks

COUNT = 3000
EXTRA = "optional extra `viewers`"
SAMPLES = random_ticks(50, seed=5)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def run(recording, count=COUNT):
    """Record `count` ticks at about 1 kHz, like the loop."""
    due = time.monotonic()
    for tick in range(count):
        sample = SAMPLES[tick % len(SAMPLES)]
        row = sample.row.copy()
        row["tick"], row["t_ns"] = tick, time.monotonic_ns()
        recording.tick(row, sample.received, sample.sent)
        due += 1e-3
        time.sleep(max(0.0, due - time.monotonic()))


@pytest.fixture
def port():
    pytest.importorskip("foxglove", reason=EXTRA)
    return free_port()


@pytest.mark.long
def test_a_client_reads_every_tick_although_others_never_read(tmp_path, port):
    with Recording.start(
        tmp_path / "a.mcap", configuration="", live=Live(websocket=("127.0.0.1", port))
    ) as recording:
        client, others = Client(port), [Client(port) for _ in range(8)]
        for each in others:
            each.subscribe("/tick", "/can", "/scene")
        mute = socket.create_connection(("127.0.0.1", port))  # says nothing at all
        noise = socket.create_connection(("127.0.0.1", port))
        noise.sendall(os.urandom(4096))
        assert set(client.channels) == {"/tick", "/can", "/operator", "/events", "/tf", "/scene"}
        client.subscribe("/tick", "/can")
        read: list[tuple[int, int, bytes]] = []
        reader = threading.Thread(target=lambda: read.extend(client.messages(3.0)))
        reader.start()
        time.sleep(0.3)
        run(recording)
        begun = time.monotonic()
        summary = recording.close()
        assert time.monotonic() - begun < 4.0, "the recorder must end by itself"
        reader.join(10.0)
    opened: list[Any] = [client, *others, mute, noise]
    for each in opened:
        each.close()
    assert (summary.ticks, summary.dropped, summary.complete, summary.error) == (COUNT, 0, True, "")
    given = client.channels["/tick"]
    row = message_class(Schema(given["schemaName"], base64.b64decode(given["schema"])))
    ticks = [row.FromString(data) for number, _, data in read if number == 0]
    rows = Log(tmp_path / "a.mcap").rows()
    assert [t.tick for t in ticks] == list(range(COUNT))
    np.testing.assert_array_equal([t.tau.leg_3 for t in ticks], rows["tau"][:, 3])
    frames = [data for number, _, data in read if number == 1]
    assert len(frames) == sum(len(SAMPLES[k % 50].received) + len(SAMPLES[k % 50].sent) for k in range(COUNT))


@pytest.mark.long
def test_an_occupied_port_is_refused_before_the_log_is_created(tmp_path, port):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", port))
        taken.listen()
        with pytest.raises(LogError, match=rf"recording.websocket: 127.0.0.1:{port}.*set another port"):
            Recording.start(tmp_path / "a.mcap", configuration="", live=Live(websocket=("127.0.0.1", port)))
    assert not list(tmp_path.iterdir())


def test_missing_websocket_package_is_reported_with_the_install_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    channels = Encoder(TICKS, epoch_ns=0, can_channels=["can0"], scene=None).channels
    with pytest.raises(LogError, match=r'pip install "hexapod-hil\[viewers\]"'):
        LiveSocket("127.0.0.1", 8765, channels)


@pytest.mark.parametrize(
    ("asks", "lockstep", "where"),
    [(True, False, ("127.0.0.1", 9123)), (True, True, None), (False, False, None)],
)
def test_the_websocket_listens_only_in_real_time_and_as_configured(
    tmp_path, monkeypatch, asks, lockstep, where
):
    text = load("virtual").text
    if asks:
        text = text.replace("  folder: runs\n", "  websocket: {port: 9123}\n")
    c = loads(text, "my.yaml")
    given: dict[str, Any] = {}
    monkeypatch.setattr(Recording, "start", lambda path, **words: given.update(words))
    record(c, build_cycle(c, 1000.0, 0.01), tmp_path / "a.mcap", "run", lockstep=lockstep)
    assert given["live"].websocket == where
