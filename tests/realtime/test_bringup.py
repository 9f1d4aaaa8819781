"""A bring-up at a bus: `hil bringup` and the bench of `hil plant` are two processes on localcan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.realtime.rig import Process, configuration

pytestmark = [pytest.mark.realtime(patient=True), pytest.mark.long]


def test_exchanged_drives_are_named_over_the_bus_and_asked_for_again_when_mended(
    tmp_path: Path, start: Callable[..., Process]
) -> None:
    file = configuration(tmp_path)
    plant = start("plant", str(file), "--bench", "--mistake", "ids_swapped leg=1 other=4")
    plant.wait_for_child("hil.record")
    bringup = start("bringup", str(file), "--yes")
    assert bringup.wait(120.0) == 1, bringup.errors
    summary = bringup.summary
    assert [line.split(":")[:2] for line in summary["findings"]] == [["ids", " legs 1, 4"]]
    assert summary["passed"][:4] == ["scan", "watchdog", "ids", "encoder"]
    assert "NOT RELEASED" in Path(summary["found"]).read_text()
    plant.interrupt()
    assert plant.wait() == 0, plant.errors
    assert plant.summary["final_states"] == ["OFF"] * 6

    plant = start("plant", str(file), "--bench", "--mistake", "brake_stuck_open leg=2")
    plant.wait_for_child("hil.record")
    again = start("bringup", str(file), "--yes")
    assert again.wait(120.0) == 1, again.errors
    assert "watchdog" in again.summary["passed"]
    assert not again.summary["success"]
    plant.interrupt()
    assert plant.wait() == 0, plant.errors
