"""How a recorder parts the messages of a batch into chunks, and how it ends beside viewers that do not read."""

from __future__ import annotations

import os
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.record import recorder as module
from hil.record import recording as producer
from hil.record.encode import Messages
from hil.record.mcap_file import CHUNK_SIZE
from hil.record.recorder import Recorder


def chunks_of(lengths: list[list[int]]) -> list[list[tuple[int, int]]]:
    """Write messages of these lengths, tick by tick; return tick and number of those of each chunk.

    What the file is told of each message is compared with the message on the way.
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
        [[LARGE, 40, 40, 40]] * 40,
        [[40, LARGE]] * 100,
        [[LARGE, 8, 8]] * 8,
        [[LARGE // 3] * 3] * 33,
        [[16]] * 3 + [[LARGE] * 5] * 3 + [[16]],
    ],
    ids=["few", "row and frames", "many", "a little more than one", "equal", "unlike"],
)
def test_chunks_end_between_ticks_and_are_as_large_as_they_shall_be(lengths):
    found = chunks_of(lengths)
    sizes = [sum(sum(lengths[tick]) for tick in {tick for tick, _ in chunk}) for chunk in found]
    assert sum(sizes) == sum(map(sum, lengths)), "no tick is in two chunks"
    most = max(map(sum, lengths))
    assert max(sizes) <= CHUNK_SIZE + most
    assert len(found) <= np.ceil(sum(sizes) / CHUNK_SIZE), "and no more of them than that takes"


def test_a_tick_that_is_larger_than_a_chunk_is_one():
    large = [CHUNK_SIZE, CHUNK_SIZE, 40]
    found = chunks_of([[40, 40], large, [40], [40]])
    (chunk,) = [each for each in found if 1 in {tick for tick, _ in each}]
    assert sum(tick == 1 for tick, _ in chunk) == 3
    assert chunks_of([large]) == [[(0, 0), (0, 1), (0, 2)]], "also where it is alone"
    assert chunks_of([[40], [40], large]) == [[(0, 0), (1, 1)], [(2, 2), (2, 3), (2, 4)]], (
        "and where it is the last"
    )


# -- the end -------------------------------------------------------------------------------------------------


class LeftError(Exception):
    """Stands for the end of the process."""


@pytest.fixture
def ended(monkeypatch):
    """A function that runs a recorder with a socket to its end; it returns the code and what was answered."""

    def run(socket):
        answers: list[Any] = []
        left: list[int] = []

        def leave(code):
            left.append(code)
            raise LeftError

        recorder = SimpleNamespace(file=None, socket=socket)
        ring = SimpleNamespace(close_fd=lambda: None)
        setup = {"identity": {"topic": "/tick", "columns": "[]"}, "ring_ticks": 256, "path": "a.mcap"}
        nothing = SimpleNamespace(
            signal=lambda *_: None, pthread_sigmask=lambda *_: None, SIG_IGN=1, SIG_SETMASK=2,
            SIGINT=2, SIGTERM=15, SIGHUP=1,
        )  # fmt: skip
        for name, value in {
            "signal": nothing,
            "sys": SimpleNamespace(stdin=SimpleNamespace(buffer=None)),
            "receive": lambda pipe: setup,
            "Run": SimpleNamespace(of=lambda _: SimpleNamespace(topic="/tick", columns=())),
            "Ring": lambda *_: ring,
            "Recorder": lambda *_: recorder,
            "_Control": lambda *_: None,
            "_recorded": lambda *_: {"closed": "clean"},
            "answer": answers.append,
        }.items():
            monkeypatch.setattr(module, name, value)
        monkeypatch.setattr(os, "_exit", leave)
        try:
            code = module.main(["3", "1"])
        except LeftError:
            (code,) = left
        return code, bool(left), answers

    return run


@pytest.mark.parametrize("viewers", ["none", "that read", "that do not read"])
def test_a_recorder_ends_well_once_it_has_answered_and_waits_for_no_viewer(ended, viewers):
    socket = None if viewers == "none" else SimpleNamespace(close=lambda: viewers == "that read")
    code, at_once, answers = ended(socket)
    assert code == 0
    assert at_once is (viewers == "that do not read")
    assert answers == [{"ready": True}, {"closed": "clean"}]


@pytest.mark.parametrize("where", ["spawn", "send", "answer"])
@pytest.mark.parametrize("interrupt", [KeyboardInterrupt, SystemExit])
def test_an_interrupt_while_the_recorder_starts_goes_on_and_leaves_no_process(monkeypatch, interrupt, where):
    process: Any = SimpleNamespace(kill=lambda: None)
    reaped: list[Any] = []

    def interrupted(*_):
        raise interrupt

    for name, value in {
        "spawn": lambda _: process,
        "send": lambda *_: None,
        "finish": reaped.append,
    }.items():
        monkeypatch.setattr(producer, name, value)
    monkeypatch.setattr(producer, where, interrupted)
    ring: Any = None
    with pytest.raises(interrupt):
        producer._start(ring, {"path": "a.mcap"})
    assert reaped == ([] if where == "spawn" else [process])
