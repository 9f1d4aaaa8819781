"""The masters in the guide on foreign controllers move the drives of `hil plant`."""

from __future__ import annotations

import asyncio
import os
import re
import runpy
import sys
import time
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
from tests.plant_thread import serving

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/guides/foreign-controllers.md").read_text(encoding="utf-8")
EDS = ROOT / "drivers/cia402/emulated_drive.eds"
CHANNEL = f"foreign-{os.getpid()}"
MOVED_m = 0.02


def configuration(family: str, folder: Path, fmu: Path | None) -> Configuration:
    """configs/bench.yaml with the guide's sections for a family, optionally an FMU in place of the springs."""
    blocks = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (block,) = (each for each in blocks if f"protocol: {family}" in each)
    changes: dict[str, Any] = yaml.safe_load(block)
    changes["bus"]["channel"] = CHANNEL
    changes["recording"] = {"folder": f"{folder}/runs"}
    if fmu is not None:
        changes |= foreign_plant.sections(fmu)
    text = with_changes((ROOT / "configs/bench.yaml").read_text(encoding="utf-8"), changes)
    return loads(text, f"{family}.yaml", folder)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """A third-party FMU: Python behind FMI 2.0, without units."""
    pytest.importorskip("pythonfmu.builder")
    return foreign_plant.built(tmp_path_factory.mktemp("fmu"))


@pytest.fixture(autouse=True)
def patient_masters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Raise the masters' timeouts of 0.2 s to what a busy machine may need."""
    monkeypatch.setattr("canopen.sdo.client.SdoClient.RESPONSE_TIMEOUT", 5.0)
    for wait in ("CHECK_TPDO", "SWITCH_STATE_SINGLE", "SWITCH_STATE_FINAL", "SWITCH_OP_MODE"):
        monkeypatch.setattr(f"canopen.profiles.p402.BaseNode402.TIMEOUT_{wait}", 5.0)


def run_example(monkeypatch: pytest.MonkeyPatch, name: str, *arguments: str) -> None:
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    runpy.run_path(str(ROOT / "docs/examples" / name), run_name="__main__")


def moved_mm(output: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?[0-9.]+", output[output.index("moved by") :])]


def at_rest(nodes: Nodes) -> Snapshot:
    """State of the drives after the brakes have closed."""
    end = time.monotonic() + 5.0
    while not (snapshot := nodes.snapshot()).brake.all():
        assert time.monotonic() < end, snapshot
        time.sleep(0.01)
    return snapshot


def read_by_canopen() -> float:
    """Length of leg 4 from its drive's position, m: 0.02 m per turn, 1.6 m at zero."""
    import canopen  # noqa: PLC0415 - an extra

    network = canopen.Network(bus=can.Bus(CHANNEL, "localcan", ignore_config=True))
    network.connect()
    network.sync.transmit()  # 0x6064 is that of the last SYNC
    counts = network.add_node(5, str(EDS)).sdo[0x6064].raw
    network.disconnect()
    return float(1.6 + 0.02 / 131072 * counts)


def read_by_moteus() -> list[float]:
    """Lengths of all legs, m."""
    import moteus  # type: ignore[import-untyped]  # noqa: PLC0415 - an extra

    async def read() -> list[float]:
        bus = moteus.PythonCan(interface="localcan", channel=CHANNEL, fd=True, ignore_config=True)
        heard = [await moteus.Controller(id=node, transport=bus).query() for node in range(1, 7)]
        bus.close()
        return [1.6 + 0.02 * each.values[moteus.Register.POSITION] for each in heard]

    return asyncio.run(read())


MASTERS: dict[str, Any] = {
    "cia402": (["canopen_master.py", str(EDS), CHANNEL], [4], read_by_canopen, 0.02 / 131072),
    # the package asks for single numbers: half a step of one from 8 to 16 turns is 2^-21 of a turn
    "moteus": (["moteus_master.py", CHANNEL], [0, 1, 2, 3, 4, 5], read_by_moteus, 0.02 * 2**-21 + 1e-12),
}
"""Family -> program, legs that it moves, reader of their lengths, its resolution in m."""
CASES = [
    ("moteus", "springs"),
    pytest.param("cia402", "springs", marks=pytest.mark.long),
    pytest.param("moteus", "foreign", marks=pytest.mark.long),  # a plant in Python may be late
    pytest.param("cia402", "foreign", marks=pytest.mark.long),
]


@pytest.mark.realtime(patient=True)
@pytest.mark.parametrize(("family", "plant"), CASES)
def test_example_master_of_the_guide_on_foreign_controllers_moves_legs_and_reads_lengths(
    tmp_path, monkeypatch, capsys, request, family, plant
):
    program, legs, read, resolution_m = MASTERS[family]
    fmu = request.getfixturevalue("foreign") if plant == "foreign" else None
    with serving(configuration(family, tmp_path, fmu)) as nodes:
        before = nodes.snapshot().length
        run_example(monkeypatch, *program)
        after = at_rest(nodes)
        measured = read()
        now = nodes.snapshot().length
    way = after.length - before
    np.testing.assert_allclose(1e3 * way[legs], moved_mm(capsys.readouterr().out), rtol=0, atol=2.0)
    assert (0.7 * MOVED_m < way[legs]).all()
    assert (way[legs] < 1.1 * MOVED_m).all()
    creep_m = 1e-9 if plant == "springs" else 1e-4  # an explicit step lets locked legs creep
    assert np.abs(np.delete(way, legs)).max(initial=0.0) < creep_m
    quantum_m = 1e-6 if plant == "springs" else 0.0  # of the emulated encoders
    np.testing.assert_allclose(measured, now[legs], rtol=0, atol=resolution_m + 0.5 * quantum_m)
    if plant == "springs":
        states = [DriveState.OFF if leg in legs else DriveState.BOOT for leg in range(6)]
        assert after.state.tolist() == states
    assert after.rejected == 0
