"""Refused runs: without drives, and as a second end on the same bus."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.signals import Mode
from hil.record.log import Log
from tests.realtime.rig import CHANNEL, Listener, Process, configuration

pytestmark = pytest.mark.realtime(patient=True)

Start = Callable[..., Process]
Listen = Callable[[Path], Listener]


def test_run_without_drives_ends_after_2_s_and_explains_how_to_start_them(
    tmp_path: Path, start: Start
) -> None:
    file = configuration(tmp_path)
    run = start("run", str(file))

    code, summary = run.wait(), run.summary
    assert code == 1
    assert not summary["success"]
    assert 1.9 < summary["duration_s"] < 2.5
    assert f"no drive answered on localcan channel {CHANNEL} within 2 s" in run.errors
    assert f"hil plant {file}" in run.errors
    assert "--plant" in run.errors
    assert "Traceback" not in run.errors
    log = Log.open(summary["log"])
    assert log.summary.closed == "clean"
    assert set(log.rows()["mode"]) == {Mode.WAITING}
    assert [event.level for event in log.events()] == ["error"]


@pytest.mark.long
def test_second_run_or_plant_on_a_bus_is_refused_without_disturbance(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    file = configuration(tmp_path, {"periods: 3": "periods: 30"})
    run = start("run", str(file), "--plant")
    listen(file).wait_for_motion(run, 0.2)
    family = run.find_family()
    before = set((tmp_path / "runs").iterdir())

    second_run = start("run", str(file), "--plant")
    second_plant = start("plant", str(file))

    for process, role, holder in (
        (second_run, "controller", family["daemon"]),
        (second_plant, "plant", family["plant"]),
    ):
        assert process.wait() == 2
        lines = process.messages
        assert len(lines) == 1
        assert lines[0].startswith(f"hil: bus localcan:{CHANNEL} already has a {role}, process {holder};")
    assert set((tmp_path / "runs").iterdir()) == before
    run.interrupt()
    assert run.wait() == 0
    assert run.summary["replay"]["exact"]
    assert run.summary["faults"] == []
