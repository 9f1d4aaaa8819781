"""The bus code on the kernel's own CAN, if necessary inside a user-mode Linux kernel."""

from __future__ import annotations

import itertools
import json
import re
import statistics
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import cantools.database
import numpy as np
import pytest

from drivers.signals import BusState, DriveMode, Mode
from hil.record.log import Log
from tests.vcan import foreign_masters, uml
from tests.vcan.candump_log import read_log
from tests.vcan.daemon import configuration
from tests.vcan.socketcan_cases import CASES

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.vcan, pytest.mark.realtime(patient=True)]


def in_kernel_with_vcan(module: str, share: Path, limit_s: float, kernel: str = "any") -> uml.Completed:
    command = [sys.executable, "-m", f"tests.vcan.{module}", str(share)]
    try:
        return uml.run(command, limit_s=limit_s, share=share.parent, kernel=kernel)
    except uml.UnavailableError as error:
        pytest.skip(f"NOT TESTED over SocketCAN: {error}")


def compile_outside_the_guest(configuration: str, log: Path) -> None:
    """Fill the cache of compiled kernels for the guest, whose own writes are lost."""
    command = [sys.executable, "-m", "hil.cli", "sim", configuration, "--duration", "0.1", "--log", str(log)]
    subprocess.run(command, check=False, capture_output=True, timeout=240)


@pytest.fixture(autouse=True)
def _at_the_root(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_socketcan_bus_survives_failures_of_a_virtual_interface_made_by_the_kernel(tmp_path):
    # the modules of the running kernel are not ours to load
    result = tmp_path / "cases.json"
    done = in_kernel_with_vcan("socketcan_cases", result, limit_s=90.0, kernel="uml")
    assert done.exit_code == 0, done.stderr
    found = json.loads(result.read_text())
    assert list(found) == list(CASES)
    assert not [f"{name}: {trouble}" for name, (_, trouble) in found.items() if trouble]


def daemon(scenario: str, tmp_path: Path) -> tuple[dict[str, Any], dict[str, Any], Log]:
    """Results of a scenario of `daemon.py`, the summary of the run, and its log."""
    share = tmp_path / "share"
    share.mkdir()
    compile_outside_the_guest(str(configuration(share, "vcan0")), share / "warm.mcap")
    command = [sys.executable, "-m", "tests.vcan.daemon", scenario, str(share)]
    try:
        done = uml.run(command, limit_s=240.0, share=share, kernel="uml")
    except uml.UnavailableError as error:
        pytest.skip(f"NOT TESTED over SocketCAN: {error}")
    assert done.exit_code == 0, done.stdout[-3000:] + done.stderr[-3000:]
    found, summary = (json.loads((share / name).read_text()) for name in ("found.json", "run.json"))
    return found, summary, Log.open(share / "run.mcap")


def ticks_to_safe(rows: np.ndarray, cause: np.ndarray) -> list[int]:
    """Ticks until the drives are commanded off, for each tick in which a cause begins."""
    begins = np.flatnonzero(cause & ~np.concatenate([[False], cause[:-1]]))
    off = rows["command_mode"] == DriveMode.OFF
    return [int(rows["tick"][k + int(np.argmax(off[k:]))] - rows["tick"][k]) for k in begins]


@pytest.mark.long
def test_controller_reaches_a_safe_state_within_5_periods_of_a_bus_failure_and_recovers(tmp_path):
    found, summary, log = daemon("recovery", tmp_path)
    assert found == {
        "bus-off": ["BUS"],
        "down": ["BUS"],
        "deleted": ["BUS"],
        "second": ["SECOND_CONTROLLER"],
    }
    rows = log.rows()
    # bus-off, down, deleted
    powered = (rows["mode"] != Mode.WAITING) & (rows["bus_off"] == 1)
    took = ticks_to_safe(rows, powered)
    assert len(took) == 3
    assert max(took) <= 5
    assert summary["bus"]["bus_off"] == 1
    assert summary["final_mode"] == "PARKED"
    assert any("nothing was compared" in event.text for event in log.events())


@pytest.mark.long
def test_can_error_states_are_counted_and_bus_off_leads_to_a_safe_state_within_5_periods(tmp_path):
    found, summary, log = daemon("states", tmp_path)
    assert set(found["kept"]) == {"TRACKING"}
    assert found["faults"] == [["BUS"]] * 2
    rows = log.rows()
    took = ticks_to_safe(rows, rows["bus_state"] == BusState.OFF)
    assert len(took) == 2
    assert max(took) <= 5
    counted = {
        key: summary["bus"][key] for key in ("error_frames", "error_warning", "error_passive", "bus_off")
    }
    # twice: warning, passive, active, warning, passive, off
    assert counted == {"error_frames": 12, "error_warning": 4, "error_passive": 4, "bus_off": 2}
    assert any("1000000 bit/s, state ACTIVE, restart-ms 0" in event.text for event in log.events())


@pytest.mark.long
def test_one_percent_frame_loss_is_counted_without_a_fault(tmp_path):
    found, summary, log = daemon("loss", tmp_path)
    assert found["modes"] == ["TRACKING"]
    assert summary["faults"] == []
    near, far = (Counter({int(k): v for k, v in found["heard"][name].items()}) for name in ("hilA", "hilB"))
    lost, unsaid = far - near, near - far
    # frames sent at one end and not received at the other were dropped by the kernel
    assert lost.total() == pytest.approx(found["dropped"]["hilB"], abs=3)
    assert unsaid.total() == pytest.approx(found["dropped"]["hilA"], abs=3)
    assert lost.total() > 100
    assert unsaid.total() > 30
    feedback = range(0x181, 0x187)
    logged = Counter(r.frame.id for tick in log.ticks() for r in tick.received)
    missing = sum(near[each] - logged[each] for each in feedback)
    # the answers to the last SYNC are not read
    assert 0 <= missing <= 12
    aged = int(np.count_nonzero(log.rows()["age"] > 0))
    assert aged >= sum(lost[each] for each in feedback) + 6 * unsaid[0x80]


@pytest.mark.long
def test_adapter_command_finds_the_latency_and_loss_that_the_kernel_injects(tmp_path):
    """Timers of the user-mode kernel are late themselves: raw sockets see by how much."""
    share = tmp_path / "share"
    share.mkdir()
    done = in_kernel_with_vcan("adapter", share, limit_s=300.0, kernel="uml")
    assert done.exit_code == 0, done.stdout[-3000:] + done.stderr[-3000:]
    found = json.loads((share / "found.json").read_text())
    plain, short, long = (found[word]["summary"] for word in ("plain", "short", "long"))
    truth = {word: np.quantile(found[f"{word} truth"], (0.01, 0.5, 0.99)) for word in ("short", "long")}
    # a system call takes some 50 us there
    assert short["latency_us"] - plain["latency_us"] == pytest.approx(truth["short"][1], abs=60.0)
    assert long["latency_us"] - plain["latency_us"] == pytest.approx(truth["long"][1], rel=0.1)
    assert long["jitter_us"] == pytest.approx((truth["long"][2] - truth["long"][0]) / 2, rel=0.25)
    # the kernel counts those of the single frames, too: 1000 from one end
    assert 0 <= sum(found["short dropped"]) - short["lost"] <= 30
    assert short["lost"] / short["sent"] == pytest.approx(0.01, rel=0.15)
    assert short["time_stamps"] == ["software"]
    assert plain["lost"] == 0
    code, text = found["short check"]
    assert code == 0
    assert "loses" in text
    code, text = found["long check"]
    assert code == 2
    assert "too slow" in text
    assert found["busy"]["code"] == 2
    assert "0x701" in found["busy"]["output"]
    assert found["busy_sent"] == 0
    _, text = found["own"]
    assert "  sent          4500" in text
    assert "  lost          0" in text
    alone, both = found["serial"]["alone"], found["serial"]["both"]
    assert alone["code"] == 2
    assert "--receiver" in alone["output"]
    assert 0 < both["summary"]["lost"] <= found["serial"]["dropped"] <= both["summary"]["lost"] + 15


@pytest.mark.long
def test_canopen_and_moteus_masters_move_the_drives_on_vcan0(tmp_path):
    share = tmp_path / "share"
    share.mkdir()
    for family in foreign_masters.MASTERS:
        compile_outside_the_guest(
            str(foreign_masters.configuration(share, family)), share / f"warm-{family}.mcap"
        )
    done = in_kernel_with_vcan("foreign_masters", share, limit_s=200.0)
    assert done.exit_code == 0, done.stdout[-3000:] + done.stderr[-3000:]
    for family, legs in (("cia402", [4]), ("moteus", [0, 1, 2, 3, 4, 5])):
        summary = json.loads((share / f"{family}.json").read_text())
        assert summary["rejected_frames"] == 0
        assert all((summary["final_states"][leg] == "OFF") == (leg in legs) for leg in range(6))
        length = Log.open(share / f"{family}.mcap").rows()["length"]
        way = length[-1] - length[0]
        said = [float(word) for word in re.findall(r"-?[0-9.]+", (share / f"{family}.out").read_text())]
        np.testing.assert_allclose(1e3 * way[legs], said, rtol=0, atol=1.0)
        assert (way[legs] > 0.014).all()
        assert np.abs(np.delete(way, legs)).max(initial=0.0) < 1e-6


@pytest.mark.long
def test_hil_run_and_hil_plant_work_together_over_vcan0_at_50_Hz_for_10_s(tmp_path):
    share = tmp_path / "share"
    share.mkdir()
    compile_outside_the_guest("vcan50", share / "warm.mcap")
    done = in_kernel_with_vcan("bridge", share, limit_s=240.0)
    assert done.exit_code == 0, done.stdout[-3000:] + done.stderr[-3000:]
    database = cantools.database.can.Database()
    database.add_dbc_file(str(ROOT / "drivers/legs/legs.dbc"))
    names = {message.frame_id: message.name for message in database.messages}
    heard = read_log(share / "candump.log")
    assert {frame.identifier for frame in heard} <= names.keys()
    count = {
        kind: sum(names[frame.identifier].startswith(kind) for frame in heard) for kind in ("SYNC", "COMMAND")
    }
    senders = {
        names[frame.identifier][-1] for frame in heard if names[frame.identifier].startswith("FEEDBACK")
    }
    assert count["SYNC"] >= 450
    assert count["COMMAND"] >= 450
    assert senders == set("123456")
    sync = [frame.t for frame in heard if names[frame.identifier] == "SYNC"]
    spacing = statistics.median(b - a for a, b in itertools.pairwise(sync))
    assert spacing == pytest.approx(0.020, abs=0.001)
