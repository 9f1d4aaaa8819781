"""How the loop starts a recorder: what it tells it first, and what it makes of the answer."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record import recording as module
from hil.record.recording import Live, Recording, Scene
from hil.record.ring import Ring
from hil.record.row import TICKS, Table, describe

SMALL = Table("/small", tuple(Column("output", n, int, "", "", (), ()) for n in ("tick", "t_ns")))


@pytest.fixture
def started(monkeypatch, tmp_path):
    """A function that starts a recording with these options; it returns the set-up, the files and the recording."""
    found: list[Any] = []

    def begin(ring, setup):
        found.append((ring, setup))
        return "process"

    monkeypatch.setattr(module, "_start", begin)
    monkeypatch.setattr(module, "environment", lambda: {"version": "1"})
    monkeypatch.setattr(module, "scheduling", lambda: {"scheduler": "other 0"})
    monkeypatch.setattr(time, "time_ns", lambda: 5_000)
    monkeypatch.chdir(tmp_path)

    def start(**options):
        recording = Recording.start("logs/a.mcap", configuration="ä: 1\n", **options)
        ring, setup = found.pop()
        process: Any = recording._process
        assert (recording._ring, process) == (ring, "process")
        recording._ring.close_fd()
        return setup, recording

    return start


def test_a_simulation_has_an_epoch_of_its_own_and_says_how_its_process_is_scheduled(started, tmp_path):
    setup, recording = started(lockstep=True)
    epoch = 946_684_800_000_000_000
    assert setup == {
        "path": str(tmp_path / "logs" / "a.mcap"), "ring_ticks": 8192, "created_ns": epoch, "scene": None,
        "live": Live(), "mirror": None, "attachments": [("config.yaml", "ä: 1\n".encode())],
        "environment": {"version": "1", "scheduler": "other 0"},
        "identity": {
            "topic": "/tick", "columns": describe(TICKS.columns), "epoch_ns": str(epoch), "can_channel": "can0",
            "mode": "lockstep",
        },
    }  # fmt: skip
    assert recording.path == tmp_path / "logs" / "a.mcap"
    assert (recording._lockstep, recording._ring.capacity) == (True, 8192)
    assert (recording.ticks, recording.dropped) == (0, 0)


def test_a_run_in_real_time_has_the_epoch_of_its_clock_and_all_that_it_is_told(started, tmp_path):
    corners = [[1.0, k, 0.0] for k in range(6)]
    setup, recording = started(
        table=SMALL, attachments=[("b", b"12"), ("c", b"")], ring_ticks=64, can_channel=("front", "rear"),
        metadata={"kind": "run", "seed": 7, "name": "\udc80"}, scene=Scene(corners, corners, 5),
        live=Live(status=True, reference_s=2.5, websocket=("::1", 8765)), clock=SimpleNamespace(now=lambda: 1_200),
        mirror=(tmp_path / "m", {"name": "x"}),
    )  # fmt: skip
    assert setup == {
        "path": str(tmp_path / "logs" / "a.mcap"), "ring_ticks": 64, "created_ns": 5_000,
        "scene": Scene(corners, corners, 5),
        "live": Live(status=True, reference_s=2.5, websocket=("::1", 8765)),
        "mirror": (tmp_path / "m", {"name": "x", "columns": describe(SMALL.columns)}),
        "attachments": [("config.yaml", "ä: 1\n".encode()), ("b", b"12"), ("c", b"")],
        "environment": {"version": "1"},
        "identity": {
            "kind": "run", "seed": "7", "name": "?", "topic": "/small", "columns": describe(SMALL.columns),
            "epoch_ns": "3800", "can_channel": "front", "can_channels": '["front", "rear"]', "mode": "realtime",
        },
    }  # fmt: skip
    assert (recording._lockstep, recording._ring.rows.dtype) == (False, SMALL.dtype)


def test_a_scene_is_drawn_at_every_33rd_tick_where_nothing_else_is_said(started):
    setup, _ = started(scene=Scene([[1.0, 0.0, 0.0]], [[2.0, 0.0, 0.0]]), ring_ticks=16)
    assert setup["scene"] == ([[1.0, 0.0, 0.0]], [[2.0, 0.0, 0.0]], 33)


def test_a_single_bus_in_a_list_is_called_by_its_name_alone(started):
    identity = started(can_channel=["front"], ring_ticks=16)[0]["identity"]
    assert (identity["can_channel"], "can_channels" in identity) == ("front", False)


def test_a_table_that_cannot_be_recorded_is_refused_before_anything_starts(started):
    with pytest.raises(ValueError, match="the row needs a scalar integer column t_ns"):
        started(table=Table("/small", SMALL.columns[:1]))


def test_without_shared_memory_the_message_says_what_to_lower_and_to_raise(started, monkeypatch):
    def refuse(*_):
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr(Ring, "create", refuse)
    with pytest.raises(
        LogError, match=r"a.mcap: no shared memory for its recorder: Cannot allocate memory; lower "
    ):
        started()


@pytest.mark.parametrize("broken", [False, True])
@pytest.mark.parametrize(
    ("reply", "says"),
    [
        ({"ready": True}, ""),
        ({"error": "exists"}, "^exists$"),
        ({}, "^b/a.mcap: the recorder process did not start$"),
    ],
)
def test_a_recorder_that_is_not_ready_is_ended_and_its_reason_given(monkeypatch, broken, reply, says):
    process = SimpleNamespace(killed=0)
    did: list[tuple[Any, ...]] = []
    process.kill = lambda: setattr(process, "killed", process.killed + 1)

    def send(of, setup):
        assert setup.pop("packer"), "so that it has not to be imported there"
        did.append(("set up", setup))
        if broken:
            raise BrokenPipeError

    def answer(of, timeout_s):
        did.append(("answer", timeout_s))
        return reply

    monkeypatch.setattr(module, "spawn", lambda ring: process)
    monkeypatch.setattr(module, "send", send)
    monkeypatch.setattr(module, "answer", answer)
    monkeypatch.setattr(module, "finish", lambda of: did.append(("finish", of.killed)))
    ring: Any = None
    expected: list[tuple[Any, ...]] = [
        ("set up", {"path": "b/a.mcap"}),
        ("answer", 1.0 if broken else 20.0),
    ]
    if says:
        with pytest.raises(LogError, match=says):
            module._start(ring, {"path": "b/a.mcap"})
        expected.append(("finish", 1))
    else:
        assert module._start(ring, {"path": "b/a.mcap"}) is process  # type: ignore[comparison-overlap]
    assert did == expected
