"""The log of what another controller would have answered: its times are those of the log that it answers."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.record import Recording
from hil.record.log import Log
from hil.study.what_if.recorded import record

UPTIME_NS = 3 * 86_400 * 1_000_000_000
"""The machine has been up for days when a run in real time begins: its clock counts from there."""
PERIOD_NS = 1_000_000
CYCLE: Any = SimpleNamespace(
    parts=SimpleNamespace(rate_Hz=1000.0, setup=SimpleNamespace(watchdog_s=0.01)),
)


@pytest.mark.parametrize(("ticks", "begun_ns"), [(20, UPTIME_NS), (0, 0)])
def test_the_notice_stands_at_the_first_tick_and_not_where_the_clock_began(tmp_path, ticks, begun_ns):
    rows = np.zeros(ticks, ROW)
    rows["tick"] = np.arange(ticks)
    rows["t_ns"] = begun_ns + np.arange(ticks) * PERIOD_NS
    rows["R"] = np.eye(3).reshape(rows["R"].shape[1:])
    source, out = tmp_path / "run.mcap", tmp_path / "answer.mcap"
    with Recording.start(source, configuration="", metadata={"kind": "sim"}) as recording:
        for row in rows:
            recording.tick(row, (), ())
    with record(load("virtual"), CYCLE, out, Log(source)) as recording:
        for row in rows:
            recording.tick(row, (), ())
    answer = Log.open(out)
    assert [event.t_ns for event in answer.events()] == [begun_ns]
    assert answer.summary.duration_s == pytest.approx(max(ticks - 1, 0) * 1e-9 * PERIOD_NS)
    assert len(answer.rows()) == ticks
    said = answer.metadata["hil"]
    assert said["mode"] == "lockstep", "it waits for its recorder"
    assert (said["kind"], said["what_if_of"], said["what_if_of_kind"]) == ("what-if", "run.mcap", "sim")
    assert (said["rate_Hz"], said["watchdog_s"], said["protocol"]) == ("1000.0", "0.01", "legs")


def test_no_recorder_is_started_for_a_log_whose_first_row_cannot_be_read(tmp_path, monkeypatch):
    class Damaged:
        path, metadata, can_channels = tmp_path / "run.mcap", {}, ()

        @property
        def origin_ns(self):
            raise LogError("its first row is damaged")

    monkeypatch.setattr(Recording, "start", lambda *_, **__: pytest.fail("a recorder was started"))
    damaged: Any = Damaged()
    with pytest.raises(LogError, match="its first row is damaged"):
        record(load("virtual"), CYCLE, tmp_path / "answer.mcap", damaged)
