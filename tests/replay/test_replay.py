"""A log replays to the bit, and replay notices what does not."""

from __future__ import annotations

import pytest

from drivers.protocol import Received
from drivers.signals import Mode
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.loop.replay import replay
from hil.record.log import Log
from tests.broad import broad


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    summary = simulate(load("virtual"), log=path, duration_s=2.8)
    assert summary["success"]
    return path


class Edited:
    """A log with one tick changed on its way to the replay."""

    def __init__(self, path, tick, change):
        self.log, self.tick, self.change = Log.open(path), tick, change

    def ticks(self):
        for entry in self.log.ticks():
            yield self.change(entry) if entry.row["tick"] == self.tick else entry


def cycle():
    c = load("virtual")
    return build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)


def flip(entry, frame=2, byte=0):
    received = list(entry.received)
    t_ns, f = received[frame]
    data = bytearray(f.data)
    data[byte] ^= 1
    received[frame] = Received(t_ns, f._replace(data=bytes(data)))
    return entry._replace(received=tuple(received))


def test_every_tick_and_frame_comes_back(log):
    verdict, summary = replay_log(log)
    assert verdict.exact
    assert verdict.ticks == len(Log.open(log).rows()) > 2500
    assert summary["different_ticks"] == 0


@pytest.mark.parametrize(
    "mode", broad([Mode.TRACKING, Mode.IDLE, Mode.LOADING, Mode.APPROACH, Mode.PARKED], quick=2)
)
def test_one_flipped_bit_names_the_tick_and_the_column(log, mode):
    rows = Log.open(log).rows()
    tick = int(rows["tick"][rows["mode"] == mode][-1])
    verdict = replay(Edited(log, tick, flip), cycle())
    assert not verdict.exact
    assert {d.tick for d in verdict.first} == {tick}
    assert "frames_crc32" in [d.column for d in verdict.first]


def test_a_changed_computed_column_is_named(log):
    def change(entry):
        row = entry.row.copy()
        row["tau"][3] += 1e-9
        return entry._replace(row=row)

    verdict = replay(Edited(log, 1200, change), cycle())
    assert [(d.tick, d.column) for d in verdict.first] == [(1200, "tau")]
    assert verdict.different_ticks == 1
    assert verdict.wire_different_ticks == 0


def test_a_changed_sent_frame_is_named(log):
    def change(entry):
        return entry._replace(sent=(*entry.sent[:-1], entry.sent[-1]._replace(data=b"")))

    verdict = replay(Edited(log, 1200, change), cycle())
    assert [(d.tick, d.column) for d in verdict.first] == [(1200, "sent frames")]
    assert verdict.wire_different_ticks == 1


def test_a_missing_tick_is_a_gap_and_no_verdict_beyond_it(log):
    class Gap(Edited):
        def ticks(self):
            return (entry for entry in self.log.ticks() if entry.row["tick"] != self.tick)

    verdict = replay(Gap(log, 700, None), cycle())
    assert verdict.gaps == [(700, 1)]
    assert verdict.ticks == 700
    assert not verdict.exact
