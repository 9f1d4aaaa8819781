"""CAN FMUs as drives in `hil sim`: `legs_drive.c`, written by hand from the DBC, against the emulated drives."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from drivers.errors import ConfigurationError, HilError, PlantError
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import loads
from hil.app.sim.command import run_identity, simulate
from hil.cli.check import command
from hil.record.log import Log
from plant_fmu.faults.kinds import EncoderJump, WrenchStep
from plant_fmu.faults.plan import FaultPlan
from plant_fmu.network.drives import FmuNodes
from tests.network.can_nodes import build_drives

ROOT = Path(__file__).parents[2]
NAMES = {"length": ["length"], "rate": ["rate"], "force": ["force"], "brake": ["brake"]}
ALL = {"path": ["drives6.fmu"], **NAMES}
EACH = {"path": ["drives1.fmu"] * 6, **NAMES, "parameters": {"leg": [0, 1, 2, 3, 4, 5]}}


def configuration(folder, fmu, **sections):
    c = yaml.safe_load((ROOT / "configs/virtual.yaml").read_text()) | sections
    c["plant"]["drives"] |= {} if fmu is None else {"fmu": fmu}
    c["reference"]["periods"] = 1
    return loads(yaml.safe_dump(c), "test", folder)


def run(folder, name, fmu, **settings):
    """Summary and log of a simulation."""
    summary = simulate(configuration(folder, fmu), log=folder / f"{name}.mcap", **settings)
    return summary, Log.open(folder / f"{name}.mcap")


def sent(log):
    return [frame for tick in log.ticks() for frame in tick.sent]


def test_can_fmu_drives_move_the_robot_as_emulated_ones_to_the_bit(tmp_path, monkeypatch):
    # Emulated drives have their say once a tick only; so have these, for equal times on the bus.
    monkeypatch.setattr(FmuNodes, "unasked", False)
    build_drives(tmp_path)
    (_, emulated), (_, hosted) = (
        run(tmp_path, name, fmu, duration_s=2.2, check_replay=False)
        for name, fmu in (("emulated", None), ("hosted", ALL))
    )
    a, b = emulated.rows(), hosted.rows()
    for column in ("q", "dq", "tau", "mode", "drive_state"):
        np.testing.assert_array_equal(a[column], b[column], column)
    assert sent(emulated) == sent(hosted)
    assert np.abs(a["dq"]).max() > 0.1


@pytest.mark.parametrize("fmu", [ALL, EACH], ids=["one for all", "one a leg"])
def test_sim_with_can_fmu_drives_parks_replays_exactly_and_repeats(tmp_path, fmu):
    build_drives(tmp_path, drives=6 if fmu is ALL else 1, ANSWER_NS=30_000)
    summary, log = run(tmp_path, "first", fmu, duration_s=0.1)
    assert (summary["success"], summary["final_mode"]) == (True, "PARKED")
    assert summary["replay"]["exact"]
    assert "plant_warnings" not in summary
    _, again = run(tmp_path, "again", fmu, duration_s=0.1, check_replay=False)
    np.testing.assert_array_equal(log.rows()["q"], again.rows()["q"])
    # SYNC has 75 bits, at 1 Mbit/s; the drives answer 30 us later; a feedback takes 64.6 us.
    tick = list(log.ticks())[305]  # no heartbeat
    ends = [each.t_ns - tick.row["t_ns"] for each in tick.received if 641 <= each.frame.id <= 646]
    assert ends == [75_000 + 30_000 + 64_600 * n for n in range(1, 7)]


def test_payload_fault_moves_the_forces_of_can_fmu_drives(tmp_path):
    build_drives(tmp_path)
    plan = FaultPlan([WrenchStep(at_s=0.75, force_N=(0.0, 0.0, -3000.0))])
    _, log = run(tmp_path, "loaded", ALL, duration_s=0.9, check_replay=False, faults=plan)
    _, free = run(tmp_path, "free", ALL, duration_s=0.9, check_replay=False)
    difference = np.abs(log.rows()["q"] - free.rows()["q"]).max(axis=1)
    assert difference[:750].max() == 0.0
    assert difference[750:800].max() > 1e-6


@pytest.mark.parametrize(
    ("fmu", "sections", "word"),
    [
        (ALL | {"path": ["drives6.fmu"] * 2}, {}, "one file or six"),
        (ALL | {"force": ["a", "b"]}, {}, "force"),
        (EACH | {"force": ["a"] * 6}, {}, "force"),
        (ALL | {"force": ["length"]}, {}, "causality"),
        (ALL | {"force": ["thrust"]}, {}, "thrust"),
        (ALL | {"force": ["brake"]}, {}, "Float64"),
        (ALL | {"parameters": {"leg": "x"}}, {}, "'x'"),
        (ALL | {"path": ["none.fmu"]}, {}, "none.fmu"),
        (ALL, {"sensors": {"imu": {"rate_Hz": 500}}}, "sensors"),
    ],
)
def test_drives_that_do_not_fit_are_refused_with_the_reason(tmp_path, fmu, sections, word):
    build_drives(tmp_path)
    with pytest.raises(HilError, match=word):
        build_nodes(configuration(tmp_path, fmu, **sections))


def test_drives_with_another_bit_rate_than_the_bus_are_refused(tmp_path):
    build_drives(tmp_path, FD_RATE=2_000_000)
    with pytest.raises(PlantError, match=r"2000000 .* 5000000"):
        build_nodes(configuration(tmp_path, ALL))


def test_fault_of_an_emulated_drive_is_refused(tmp_path):
    build_drives(tmp_path)
    plan = FaultPlan([EncoderJump(at_s=1.0, leg=0, by_m=1e-3)])
    with pytest.raises(ConfigurationError, match="encoder_jump"):
        build_nodes(configuration(tmp_path, ALL), plan)


def test_hil_check_reports_a_drive_fmu_that_cannot_be_hosted(tmp_path):
    c = configuration(tmp_path, ALL)
    (tmp_path / "own.yaml").write_text(c.text)
    done = CliRunner().invoke(command, [str(tmp_path / "own.yaml")])
    assert done.exit_code != 0
    assert "drives6.fmu" in done.output + str(done.exception)


def test_identity_of_a_run_depends_on_the_content_of_the_drive_fmus(tmp_path):
    c, given = configuration(tmp_path, ALL), (None, None, None, ())
    build_drives(tmp_path)
    first = run_identity(c, *given)
    assert run_identity(c, *given) == first
    build_drives(tmp_path, ANSWER_NS=1)
    assert run_identity(c, *given) != first
