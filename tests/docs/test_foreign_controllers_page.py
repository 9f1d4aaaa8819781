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
from plant_fmu.drives.nodes import Nodes
from plant_fmu.drives.snapshot import Snapshot
from tests.drivers.cia402_sheet import sheet
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
        changes |= behind(fmu)
    return with_changes((ROOT / "configs/bench.yaml").read_text(encoding="utf-8"), changes)


def behind(fmu: Path) -> dict[str, Any]:
    """Return the sections of a robot without weight whose plant is the PythonFMU of docs/examples."""
    numbered = {key: [f"{key}{leg}" for leg in range(1, 7)] for key in ("force", "length", "rate", "brake")}
    circle = {"pair_half_angle_deg": 10.0}
    base = {"radius_m": 2.0, "pair_centres_deg": [0.0, 120.0, 240.0]}
    top = {"radius_m": 1.0, "pair_centres_deg": [60.0, 180.0, 300.0], "pairs_begin": "second_leg"}
    return {
        "monitor": {"friction_N": 0},
        "platform": {"base_joints_m": base | circle, "platform_joints_m": top | circle},
        "plant": {
            "model": {
                **dict.fromkeys(("mass_kg", "damping_N_s2_m2", "stiffness_N_m", "stiffness_N_m3")),
                **dict.fromkeys(("rest_length_m", "internal_step_us")),
                "type": "fmu",
                "path": str(fmu),
                "isolation": "child_process",
                "allow_execution_tool": True,
                **numbered,
                "assume_unit": {"force": "N", "length": "m", "rate": "m/s"},
                "step_us": 1250,
                "parameters": {
                    "mass": 1150.0,
                    "inertia_x": 570.0,
                    "inertia_y": 285.0,
                    "inertia_z": 285.0,
                    "base_radius": 2.0,
                    "platform_radius": 1.0,
                    "home_height": 1.0,
                    "gravity_z": 0.0,
                },
            },
            "drives": {"encoder_resolution_m": 0},
        },
    }


def configuration(family: str, folder: Path, fmu: Path | None = None) -> Configuration:
    return loads(text(family, folder, fmu), f"{family}.yaml", folder)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """An FMU of somebody else's making: Python behind FMI 2.0, without units."""
    builder = pytest.importorskip("pythonfmu.builder")
    folder = tmp_path_factory.mktemp("fmu")
    built = builder.FmuBuilder.build_FMU(ROOT / "docs/examples/pythonfmu_plant.py", dest=folder)
    return Path(built)


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


def test_the_data_sheet_is_that_of_the_emulated_drive():
    assert EDS.read_text(encoding="ascii") == sheet() + "\n"


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
