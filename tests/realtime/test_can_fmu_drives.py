"""`hil run --plant` with drives that come as a CAN FMU."""

import pytest

from hil.record.log import Log
from tests.network.can_nodes import build_drives
from tests.realtime.rig import configuration

pytestmark = pytest.mark.realtime(patient=True)
FMU = "{{path: [drives6.fmu], length: [length], rate: [rate], force: [force], brake: [brake], {more}}}"


def rig(folder, more=""):
    build_drives(folder, ANSWER_NS=20_000)
    line = "    encoder_resolution_m: 1e-6\n"
    return configuration(folder, {line: f"{line}    fmu: {FMU.format(more=more)}\n"}, short=True)


def test_run_with_a_can_fmu_as_drives_tracks_parks_and_replays_exactly(tmp_path, start):
    run = start("run", str(rig(tmp_path)), "--plant")
    code, summary = run.wait(240.0), run.summary
    assert code == 0, run.errors
    assert summary["final_mode"] == "PARKED"
    assert summary["replay"]["exact"]
    assert summary["plant"]["final_states"] == ["OFF"] * 6
    rows = Log.open(summary["plant"]["log"]).rows()
    assert rows["brake"][-1].all()
    assert not rows["brake"].all()


def test_crash_of_a_drive_fmu_ends_the_plant_and_not_the_daemon(tmp_path, start):
    run = start("run", str(rig(tmp_path, "parameters: {crash_ms: 1500}")), "--plant")
    code, summary = run.wait(240.0), run.summary
    assert code == 1
    assert "killed by SIGSEGV" in summary["trouble"]
    assert Log.open(summary["log"]).summary.closed == "clean"
