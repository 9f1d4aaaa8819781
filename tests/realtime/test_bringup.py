"""A bring-up at a bus: `hil bringup` and the bench of `hil plant` are two processes on localcan."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest

import hil
from hil.app.configuration.changes import with_changes
from tests.hil.lab.bringup.families import FAMILIES
from tests.realtime.rig import CHANNEL, Process, configuration, gone

pytestmark = pytest.mark.long
SILENT_TICKS = 6 * (1 + 6)
"""At 400 Hz, half and one and a half times a watchdog of 10 ms, for each of six drives."""


@pytest.mark.realtime
def test_the_watchdogs_of_drives_that_damp_are_proven_live_and_their_answers_keep_their_window(
    tmp_path: Path, start: Callable[..., Process]
) -> None:
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    family = FAMILIES["moteus_zero_velocity"]
    bus = {**family["bus"], "channel": CHANNEL}
    file = tmp_path / "moteus.yaml"
    own = {"bus": bus, "recording": {"folder": str(tmp_path / "runs")}, "loop": {"on_stall": "fault"}}
    file.write_text(with_changes(text, {**family, **own}))
    plant = start("plant", str(file), "--bench", "--mistake", "encoder_frozen leg=3")
    plant.wait_for_child("hil.record")
    bringup = start("bringup", str(file), "--yes")
    assert bringup.wait(120.0) == 1, bringup.errors
    assert bringup.summary["passed"] == ["scan", "watchdog"]
    assert [line.split(":")[:2] for line in bringup.summary["findings"]] == [["encoder_frozen", " leg 3"]]
    frame = hil.Log(Path(bringup.summary["log"])).frame()
    ages = frame[[name for name in frame.columns if name.startswith("age.")]].to_numpy()
    late = (ages > 0).any(axis=1).sum() - SILENT_TICKS
    assert late < 0.02 * len(ages), f"{late} ticks of {len(ages)}"
    plant.interrupt()
    assert plant.wait() == 0, plant.errors


@pytest.mark.realtime(patient=True)
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


@pytest.mark.realtime(patient=True)
def test_a_good_machine_moves_at_the_end_although_its_bench_is_held_up_for_a_while(
    tmp_path: Path, start: Callable[..., Process]
) -> None:
    file = configuration(tmp_path, patient=False)
    plant = start("plant", str(file), "--bench")
    plant.wait_for_child("hil.record")
    bringup = start("bringup", str(file), "--yes")
    end = time.monotonic() + 120.0
    while not (runs := [log for log in tmp_path.rglob("*.mcap") if not _of_others(log.stem)]):
        assert time.monotonic() < end, "the six legs have not begun together"
        time.sleep(0.05)
    time.sleep(2.0)
    os.kill(plant.pid, signal.SIGSTOP)
    time.sleep(0.05)
    os.kill(plant.pid, signal.SIGCONT)
    assert bringup.wait(120.0) == 0, bringup.errors
    assert bringup.summary["passed"][-1] == "mounted"
    assert hil.Log(runs[0]).frame()["stretched_ns"].sum() > 30_000_000
    plant.interrupt()
    assert plant.wait() == 0, plant.errors


@pytest.mark.realtime(patient=True)
def test_the_steps_outlast_a_bench_and_a_bring_up_that_are_held_up_again_and_again(
    tmp_path: Path, start: Callable[..., Process]
) -> None:
    file = configuration(tmp_path, patient=False)
    plant = start("plant", str(file), "--bench", "--mistake", "force_sign leg=5")
    plant.wait_for_child("hil.record")
    bringup = start("bringup", str(file), "--yes")
    bringup.wait_for_child("hil.record")
    turn = stops = 0
    while not gone(bringup.pid):
        time.sleep(0.3)
        if not gone(bringup.pid):
            held = (plant, bringup)[turn := 1 - turn]
            os.kill(held.pid, signal.SIGSTOP)
            time.sleep(0.05)
            os.kill(held.pid, signal.SIGCONT)
            stops += 1
    assert bringup.wait() == 1, bringup.errors
    assert [line.split(":")[:2] for line in bringup.summary["findings"]] == [["force_sign", " leg 5"]]
    assert stops > 20
    assert bringup.summary["bench_time"]["stretches"] >= 0.6 * stops
    assert bringup.summary["bench_time"]["longest_ms"] > 40.0
    plant.interrupt()
    assert plant.wait() == 0, plant.errors


def _of_others(stem: str) -> bool:
    """Tell whether a log is the bench's, or of the steps before the ordinary controller's."""
    return "plant" in stem or "bringup" in stem
