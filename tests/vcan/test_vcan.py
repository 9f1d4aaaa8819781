"""The bridge over the kernel's own CAN, where needed inside a user-mode Linux kernel."""

from __future__ import annotations

import itertools
import json
import statistics
import subprocess
import sys
from pathlib import Path

import cantools.database
import pytest

from tests.vcan import uml
from tests.vcan.listen import read_log

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.vcan, pytest.mark.realtime(patient=True)]


def beside_vcan(module: str, share: Path, limit_s: float) -> uml.Completed:
    command = [sys.executable, "-m", f"tests.vcan.{module}", str(share)]
    try:
        return uml.run(command, limit_s=limit_s, share=share.parent)
    except uml.UnavailableError as error:
        pytest.skip(f"NOT TESTED over SocketCAN: {error}")


def compile_outside_the_guest(log: Path) -> None:
    """Fill the cache of compiled kernels, which the guest reads; what it writes is gone with it."""
    command = [sys.executable, "-m", "hil.cli", "sim", "vcan50", "--duration", "0.1", "--log", str(log)]
    subprocess.run(command, check=False, capture_output=True, timeout=240)


@pytest.fixture(autouse=True)
def _at_the_root(monkeypatch):
    monkeypatch.chdir(ROOT)


def test_python_can_and_candump_see_the_same_frames_on_vcan0(tmp_path):
    log = tmp_path / "candump.log"
    done = beside_vcan("roundtrip", log, limit_s=30.0)
    assert done.exit_code == 0, done.stderr
    classic, fd = "0102030405060708", bytes(range(32)).hex()
    assert json.loads(done.stdout) == [[0x123, False, classic], [0x110, True, fd]]
    assert [heard[1:] for heard in read_log(log)] == [
        (0x123, False, bytes.fromhex(classic)),
        (0x110, True, bytes.fromhex(fd)),
    ]


def test_the_command_of_the_guest_ends_at_its_time_limit(tmp_path):
    try:
        done = uml.run(["sleep", "60"], limit_s=1.0, share=tmp_path)
    except uml.UnavailableError as error:
        pytest.skip(f"NOT TESTED over SocketCAN: {error}")
    assert done.exit_code == 124


def test_run_and_plant_work_together_over_vcan0_at_50_Hz_for_10_s(tmp_path):
    share = tmp_path / "share"
    share.mkdir()
    compile_outside_the_guest(share / "warm.mcap")
    done = beside_vcan("bridge", share, limit_s=240.0)
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
