"""The masters of the page about foreign controllers move the drives that `hil plant` serves."""

from __future__ import annotations

import asyncio
import os
import re
import runpy
import sys
import time
from importlib import metadata
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
import yaml

from drivers.signals import DriveState
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from plant_fmu.drives.drive import Snapshot
from plant_fmu.drives.nodes import Nodes
from tests import foreign_plant
from tests.realtime.rig import Process
from tests.serving import serving

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/guides/foreign-controllers.md").read_text(encoding="utf-8")
EDS = ROOT / "drivers/cia402/emulated_drive.eds"
CHANNEL = f"foreign-{os.getpid()}"
MOVED_m = 0.02


def text(family: str, folder: Path, fmu: Path | None = None) -> str:
    """Return configs/bench.yaml with the sections that the page has for a family, an FMU in place of the springs."""
    (block,) = (
        each for each in re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL) if f"protocol: {family}" in each
    )
    changes: dict[str, Any] = yaml.safe_load(block)
    changes["bus"]["channel"] = CHANNEL
    changes["recording"] = {"folder": f"{folder}/runs"}
    if fmu is not None:
        changes |= foreign_plant.sections(fmu)
    return with_changes((ROOT / "configs/bench.yaml").read_text(encoding="utf-8"), changes)


def configuration(family: str, folder: Path, fmu: Path | None = None) -> Configuration:
    return loads(text(family, folder, fmu), f"{family}.yaml", folder)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """An FMU of somebody else's making: Python behind FMI 2.0, without units."""
    pytest.importorskip("pythonfmu.builder")
    return foreign_plant.built(tmp_path_factory.mktemp("fmu"))


@pytest.fixture(autouse=True)
def patient_masters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let masters wait for an answer as long as a busy machine may need: the package gives up after 0.2 s."""
    monkeypatch.setattr("canopen.sdo.client.SdoClient.RESPONSE_TIMEOUT", 5.0)
    for wait in ("CHECK_TPDO", "SWITCH_STATE_SINGLE", "SWITCH_STATE_FINAL", "SWITCH_OP_MODE"):
        monkeypatch.setattr(f"canopen.profiles.p402.BaseNode402.TIMEOUT_{wait}", 5.0)


def run_example(monkeypatch: pytest.MonkeyPatch, name: str, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(ROOT / "docs/examples" / name), run_name="__main__")


def moved_mm(output: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?[0-9.]+", output[output.index("moved by") :])]


def at_rest(nodes: Nodes) -> Snapshot:
    """Wait until the brakes have closed."""
    end = time.monotonic() + 5.0
    while not (snapshot := nodes.snapshot()).brake.all():
        assert time.monotonic() < end, snapshot
        time.sleep(0.01)
    return snapshot


@pytest.mark.long
@pytest.mark.realtime(patient=True)
def test_a_canopen_master_moves_one_drive_and_parks_it(tmp_path, monkeypatch, capsys):
    assert metadata.version("canopen") == "2.4.1"
    with serving(configuration("cia402", tmp_path)) as nodes:
        before = nodes.snapshot().length
        run_example(monkeypatch, "canopen_master.py", str(EDS), CHANNEL)
        after = at_rest(nodes)
    (moved,) = moved_mm(capsys.readouterr().out)
    way = after.length - before
    assert 1e3 * way[4] == pytest.approx(moved, abs=2.0), "the true way is the one that the master reports"
    assert 0.7 * MOVED_m < way[4] < MOVED_m * 1.1
    assert np.abs(np.delete(way, 4)).max() < 1e-9, "the other five stood on their brakes"
    assert after.state.tolist() == [DriveState.BOOT] * 4 + [DriveState.OFF, DriveState.BOOT]
    assert after.rejected == 0


@pytest.mark.realtime(patient=True)
def test_the_moteus_package_moves_all_legs_and_stops_them(tmp_path, monkeypatch, capsys):
    assert metadata.version("moteus") == "1.1.1"
    with serving(configuration("moteus", tmp_path)) as nodes:
        before = nodes.snapshot().length
        run_example(monkeypatch, "moteus_master.py", CHANNEL)
        after = at_rest(nodes)
    moved = moved_mm(capsys.readouterr().out)
    way = after.length - before
    np.testing.assert_allclose(1e3 * way, moved, rtol=0, atol=2.0)
    assert (way > 0.7 * MOVED_m).all()
    assert (way < 1.1 * MOVED_m).all()
    assert after.state.tolist() == [DriveState.OFF] * 6
    assert after.rejected == 0


def read_by_canopen() -> float:
    """Return the length of leg 4 that the position of its drive is, m: 0.02 m a turn, 1.6 m at zero."""
    import canopen  # noqa: PLC0415 - an extra

    network = canopen.Network(bus=can.Bus(CHANNEL, "localcan", ignore_config=True))
    network.connect()
    network.sync.transmit()  # 0x6064 is that of the last SYNC
    counts = network.add_node(5, str(EDS)).sdo[0x6064].raw
    network.disconnect()
    return float(1.6 + 0.02 / 131072 * counts)


def read_by_moteus() -> list[float]:
    """Return the lengths of all legs, m."""
    import moteus  # type: ignore[import-untyped]  # noqa: PLC0415 - an extra

    async def read() -> list[float]:
        bus = moteus.PythonCan(interface="localcan", channel=CHANNEL, fd=True, ignore_config=True)
        heard = [await moteus.Controller(id=node, transport=bus).query() for node in range(1, 7)]
        bus.close()
        return [1.6 + 0.02 * each.values[moteus.Register.POSITION] for each in heard]

    return asyncio.run(read())


@pytest.mark.long  # a plant in Python is late on a slow machine, and the master gives up
@pytest.mark.realtime(patient=True)
def test_a_canopen_master_moves_a_leg_of_an_fmu_of_somebody_else_and_reads_its_length(
    tmp_path, monkeypatch, capsys, foreign
):
    with serving(configuration("cia402", tmp_path, foreign)) as nodes:
        before = nodes.snapshot().length
        run_example(monkeypatch, "canopen_master.py", str(EDS), CHANNEL)
        after = at_rest(nodes)
        read = read_by_canopen()
        now = nodes.snapshot().length
    assert moved_mm(capsys.readouterr().out)[0] == pytest.approx(1e3 * (after.length - before)[4], abs=2.0)
    assert 0.7 * MOVED_m < (now - before)[4] < 1.1 * MOVED_m
    assert np.abs(np.delete(now - before, 4)).max() < 1e-4, "an explicit step lets locked legs creep"
    assert read == pytest.approx(now[4], abs=0.02 / 131072), "a count"
    assert after.rejected == 0


@pytest.mark.long
@pytest.mark.realtime(patient=True)
def test_the_moteus_package_moves_an_fmu_of_somebody_else_and_reads_its_lengths(
    tmp_path, monkeypatch, capsys, foreign
):
    with serving(configuration("moteus", tmp_path, foreign)) as nodes:
        before = nodes.snapshot().length
        run_example(monkeypatch, "moteus_master.py", CHANNEL)
        after = at_rest(nodes)
        read = read_by_moteus()
        now = nodes.snapshot().length
    np.testing.assert_allclose(1e3 * (after.length - before), moved_mm(capsys.readouterr().out), atol=2.0)
    assert (now - before > 0.7 * MOVED_m).all()
    # the package asks for single numbers: half a step of one from 8 to 16 turns is 2^-21 of a turn
    np.testing.assert_allclose(read, now, rtol=0, atol=0.02 * 2**-21 + 1e-12)
    assert after.rejected == 0


@pytest.mark.long
@pytest.mark.realtime(patient=True)
@pytest.mark.parametrize(
    ("family", "example"), [("cia402", "canopen_master.py"), ("moteus", "moteus_master.py")]
)
@pytest.mark.parametrize("plant", ["springs", "foreign"])
def test_the_masters_move_the_drives_of_the_command_itself(
    tmp_path, monkeypatch, capsys, request, family, example, plant
):
    fmu = request.getfixturevalue("foreign") if plant == "foreign" else None
    file = tmp_path / "foreign.yaml"
    file.write_text(text(family, tmp_path, fmu), encoding="utf-8")
    served = Process(tmp_path, "plant", str(file))
    try:
        served.wait_for_child("hil.record")
        time.sleep(1.0)  # the drives boot
        run_example(monkeypatch, example, *([str(EDS)] if family == "cia402" else []), CHANNEL)
        served.interrupt()
        assert served.wait() == 0, served.errors
    finally:
        served.clean_up()
    assert min(moved_mm(capsys.readouterr().out)) > 14.0
    assert {*served.summary["final_states"]} <= {"OFF", "BOOT"}
    assert served.summary["rejected_frames"] == 0
