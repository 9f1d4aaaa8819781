"""Defects during motion: a law that raises an unexpected exception, and a plant that hangs."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.signals import LEGS, DriveFault
from hil.record.log import Log
from tests.plant_fmu.test_fmu_child import STEP_LINE, altered
from tests.realtime.rig import START_S, Process, configuration

pytestmark = pytest.mark.realtime(patient=True)


@pytest.mark.long
def test_exception_in_the_control_law_causes_a_lasting_fault_and_the_drives_hold_the_platform(
    tmp_path: Path, start: Callable[..., Process]
) -> None:
    file = configuration(tmp_path)
    run = start("run", str(file), "--plant", entry="tests.realtime.failing_law")

    end = time.monotonic() + START_S
    while "The drives hold the platform" not in run.errors and time.monotonic() < end:
        time.sleep(0.05)
    release = start("run", str(file), "--release")

    code, summary = run.wait(), run.summary
    assert (code, release.wait()) == (1, 0)
    assert "LAW (the law raised ZeroDivisionError: a law with a defect (" in summary["trouble"]
    assert "failing_law.py, line " in summary["trouble"]
    assert "Traceback" not in run.errors
    log = Log.open(summary["log"])
    assert log.summary.closed == "clean"
    assert summary["replay"]["exact"]

    rows = Log.open(summary["plant"]["log"]).rows()
    assert summary["plant"]["final_states"] == ["OFF"] * LEGS, "commanded, not the watchdog"
    assert (rows["drive_fault"] == DriveFault.NONE).all()
    assert np.abs(rows["rate"]).max() > 0.3
    assert (rows["brake"][-1] == 1).all()


HUNG = """  model:
    type: fmu
    path: {path}
    force: [force]
    length: [length]
    rate: [rate]
    brake: [brake]
    step_us: 100
    # """


@pytest.mark.long
def test_hanging_plant_is_reported_before_its_consequences(
    tmp_path: Path, start: Callable[..., Process]
) -> None:
    path = altered(tmp_path, f"if (time > 3.0) for (;;) usleep(1000); {STEP_LINE}")
    stewart = "  model:\n    type: stewart  "
    file = configuration(tmp_path, {"    internal_step_us: 100\n": "", stewart: HUNG.format(path=path)})
    text = file.read_text()
    for key in ("fmi_version", "isolation", "force_bandwidth_Hz", "viscous_friction", "coulomb_friction"):
        text = "".join(line for line in text.splitlines(True) if not line.strip().startswith(key))
    file.write_text(text)
    run = start("run", str(file), "--plant")

    code, summary = run.wait(), run.summary
    assert code == 1
    words = "the FMU did not step within 5 s; its process was stopped"
    assert summary["trouble"].startswith(f"{path}: {words}; the controller: latched fault ")
    assert "STALE (" in summary["trouble"]  # the reference goes on, so FOLLOWING may occur, too
    assert summary["story"]["plant"] == f"{path}: {words}"
    assert "fix the plant" in run.errors
    assert words in Log.open(summary["log"]).events()[-1].text
