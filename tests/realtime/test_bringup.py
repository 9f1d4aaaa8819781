"""A bring-up on a bus: `hil bringup` and the bench of `hil plant` are two processes on localcan."""

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
Start = Callable[..., Process]


def begun(start: Start, file: Path, mistake: str = "") -> tuple[Process, Process]:
    """Start a bench, optionally with a wiring mistake, and a bring-up on it."""
    plant = start("plant", str(file), "--bench", *(["--mistake", mistake] if mistake else []))
    plant.wait_for_child("hil.record")
    return plant, start("bringup", str(file), "--yes")


def ended(plant: Process, bringup: Process, code: int) -> list[list[str]]:
    """Wait for both to end; return kind and legs of the findings."""
    assert bringup.wait(120.0) == code, bringup.errors
    plant.interrupt()
    assert plant.wait() == 0, plant.errors
    return [line.split(":")[:2] for line in bringup.summary["findings"]]


def hold_up(process: Process) -> None:
    os.kill(process.pid, signal.SIGSTOP)
    time.sleep(0.05)
    os.kill(process.pid, signal.SIGCONT)


@pytest.mark.realtime
def test_bringup_proves_watchdogs_of_damping_drives_with_timely_answers(tmp_path: Path, start: Start) -> None:
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    family = FAMILIES["moteus_zero_velocity"]
    bus = {**family["bus"], "channel": CHANNEL}
    file = tmp_path / "moteus.yaml"
    own = {"bus": bus, "recording": {"folder": str(tmp_path / "runs")}, "loop": {"on_stall": "fault"}}
    file.write_text(with_changes(text, {**family, **own}))
    plant, bringup = begun(start, file, "encoder_frozen leg=3")
    assert ended(plant, bringup, 1) == [["encoder_frozen", " leg 3"]]
    assert bringup.summary["passed"] == ["scan", "watchdog"]
    frame = hil.Log(Path(bringup.summary["log"])).frame()
    ages = frame[[name for name in frame.columns if name.startswith("age.")]].to_numpy()
    late = (ages > 0).any(axis=1).sum() - SILENT_TICKS
    assert late < 0.02 * len(ages), f"{late} ticks of {len(ages)}"


@pytest.mark.realtime(patient=True)
def test_bringup_detects_exchanged_drives_and_retests_them_after_the_fix(
    tmp_path: Path, start: Start
) -> None:
    file = configuration(tmp_path)
    plant, bringup = begun(start, file, "ids_swapped leg=1 other=4")
    assert ended(plant, bringup, 1) == [["ids", " legs 1, 4"]]
    assert bringup.summary["passed"][:4] == ["scan", "watchdog", "ids", "encoder"]
    assert "NOT RELEASED" in Path(bringup.summary["found"]).read_text()
    assert plant.summary["final_states"] == ["OFF"] * 6

    plant, again = begun(start, file, "brake_stuck_open leg=2")
    ended(plant, again, 1)
    assert "watchdog" in again.summary["passed"]
    assert not again.summary["success"]


@pytest.mark.realtime(patient=True)
def test_bringup_ends_with_motion_although_the_plant_process_stalls(tmp_path: Path, start: Start) -> None:
    plant, bringup = begun(start, configuration(tmp_path, patient=False))
    end = time.monotonic() + 120.0
    while not (runs := [log for log in tmp_path.rglob("*.mcap") if not _of_others(log.stem)]):
        assert time.monotonic() < end, "the first motion has not begun"
        time.sleep(0.05)
    time.sleep(2.0)
    hold_up(plant)
    ended(plant, bringup, 0)
    assert bringup.summary["passed"][-1] == "hoisted"
    assert hil.Log(runs[0]).frame()["stretched_ns"].sum() > 30_000_000


@pytest.mark.realtime(patient=True)
def test_bringup_succeeds_although_plant_and_bringup_processes_stall(tmp_path: Path, start: Start) -> None:
    plant, bringup = begun(start, configuration(tmp_path, patient=False), "force_sign leg=5")
    bringup.wait_for_child("hil.record")
    turn = stops = 0
    while not gone(bringup.pid):
        time.sleep(0.3)
        if not gone(bringup.pid):
            hold_up((plant, bringup)[turn := 1 - turn])
            stops += 1
    assert ended(plant, bringup, 1) == [["force_sign", " leg 5"]]
    assert stops > 20
    assert bringup.summary["bench_time"]["stretches"] >= 0.6 * stops
    assert bringup.summary["bench_time"]["longest_ms"] > 40.0


def _of_others(stem: str) -> bool:
    return "plant" in stem or "bringup" in stem
