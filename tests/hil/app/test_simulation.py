"""`hil.sim`: a run from Python with a changed configuration, its log, its summary, the plant's truth."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

import hil
from drivers.errors import ConfigurationError, LogError
from drivers.signals import Fault, Mode
from drivers.tick_columns import ROW
from hil.app import simulation
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.configuration.yaml_positions import parse
from hil.app.replay import replay_log
from hil.app.sim import command
from hil.app.sim.command import run_identity
from hil.app.sim.commands import LATEST_S
from hil.cli import main
from hil.cli.shared import DURATION
from hil.loop.run_end import Ending
from hil.record.log import Log
from plant_fmu.faults.kinds import EncoderJump
from plant_fmu.faults.plan import FaultPlan


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sim")
    return hil.sim(
        "virtual", duration_s=2.0, log=folder / "a.mcap", controller={"wn_rad_s": 25}, check_replay=False
    )


def test_a_run_has_its_log_and_its_summary(run):
    assert run.success
    assert run.summary["final_mode"] == "PARKED"
    assert str(run.log.path) == run.summary["log"]
    assert run.log.summary.ticks == run.summary["ticks"]
    assert run.log.figures()["tracking"] == run.summary["tracking"]


def test_the_log_carries_the_changed_configuration_and_replays(run):
    there, shipped = loads(run.log.configuration), load("virtual")
    assert there.controller.model_dump() == shipped.controller.model_dump() | {"wn_rad_s": 25.0}
    assert there.platform == shipped.platform
    assert there.name == "virtual"
    assert replay_log(run.log.path)[0].exact


def test_the_truth_of_each_tick_is_what_its_encoders_read(run):
    """The drives answer with the length at the SYNC, in steps of 1 um; the plant's grid is 50 us off at most."""
    labels = [f"leg_{leg}" for leg in range(6)]
    frame = run.log.frame("q", "age", "plant.length", "plant.rate", "mode")
    moving = frame[(frame["mode"] == "TRACKING") & (frame["age.leg_0"] == 0)]
    assert len(moving) > 300
    read, true, rate = (
        moving[[f"{name}.{leg}" for leg in labels]].to_numpy() for name in ("q", "plant.length", "plant.rate")
    )
    assert (np.abs(read - true) <= 0.6e-6 + 50e-6 * np.abs(rate)).all()
    assert np.abs(true[1:] - read[:-1]).max() > 5e-4  # a tick beside the right one would be seen


@pytest.mark.long
def test_a_log_of_twenty_one_seconds_is_a_table_within_a_second(tmp_path):
    """Processor time, the best of three: other tests run beside."""
    run = hil.sim("virtual", log=tmp_path / "a.mcap", plant_log=False, check_replay=False)
    assert run.summary["duration_s"] > 21
    took = []
    for _ in range(3):
        begun = time.process_time()
        frame = hil.Log(tmp_path / "a.mcap").frame()
        took.append(time.process_time() - begun)
    assert min(took) < 1.0
    assert frame.shape == (run.summary["ticks"], ROW.itemsize // 8)
    assert set(frame.attrs["units"]) == set(frame.columns)


def test_the_command_records_the_plant_where_it_is_asked_to(tmp_path):
    words = ["sim", "virtual", "--duration", "0.3", "--plant-log", "--log", str(tmp_path / "a.mcap")]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    log = hil.Log(tmp_path / "a.mcap")
    assert log.plant.summary.ticks == log.summary.ticks
    assert log.plant.summary.closed == "clean"


def test_neither_log_is_written_over(run):
    with pytest.raises(LogError, match="exists and is not overwritten"):
        hil.sim("virtual", duration_s=0.4, log=run.log.path)


def test_faults_and_what_is_no_configuration_are_answered_as_by_the_command(tmp_path):
    with pytest.raises(ConfigurationError, match=r"controller\.wn_rad_s"):
        hil.sim("virtual", controller={"wn_rad_s": -1})
    with pytest.raises(ConfigurationError, match="contoller: unknown"):
        hil.sim("virtual", contoller={"wn_rad_s": 20})
    with pytest.raises(ConfigurationError, match="shipped configurations are"):
        hil.sim("vitrual")
    lost = hil.sim(
        "virtual", duration_s=1.5, log=tmp_path / "a.mcap", faults=["drive_silence leg=2 at=0.9"],
        check_replay=False, plant_log=False,
    )  # fmt: skip
    assert not lost.success
    assert lost.summary["faults"]
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


# -- changes -------------------------------------------------------------------------------------------------

TEXT = """
name: "12:30"
controller: {law: pd, kp: 1e3, gains: [1, 2.5e-7]}
loop: {rate_Hz: 1000, note: "no"}
plant: {model: {type: stewart, friction: 0}, log: true}
"""


def changed(**changes):
    """What YAML 1.2 reads: PyYAML agrees where text that could be something else is quoted."""
    return yaml.safe_load(with_changes(TEXT, changes))


def test_a_change_touches_its_key_alone():
    before = yaml.safe_load(TEXT) | {"controller": {"law": "pd", "kp": 1000.0, "gains": [1, 2.5e-7]}}
    after = changed(loop={"rate_Hz": 500})
    assert after.pop("loop") == {"rate_Hz": 500, "note": "no"}
    before.pop("loop")
    assert after == before


def test_another_law_or_type_takes_nothing_over():
    assert changed(controller={"law": "pid", "ki": 2})["controller"] == {"law": "pid", "ki": 2}
    assert changed(plant={"model": {"type": "bench"}})["plant"] == {"model": {"type": "bench"}, "log": True}
    assert changed(controller={"law": "pd", "kp": 2})["controller"] == {
        "law": "pd",
        "kp": 2,
        "gains": [1, 2.5e-7],
    }


def test_none_takes_a_key_away():
    assert "plant" not in changed(plant=None)
    assert changed(plant={"log": None})["plant"] == {"model": {"type": "stewart", "friction": 0}}


def test_arrays_numbers_and_paths_of_the_usual_libraries_are_taken():
    after = changed(
        reference={"points": np.eye(2), "n": np.int64(3), "x": np.float64(0.5), "f": Path("a/b.csv")}
    )
    assert after["reference"] == {"points": [[1.0, 0.0], [0.0, 1.0]], "n": 3, "x": 0.5, "f": "a/b.csv"}


def test_what_yaml_cannot_hold_is_refused_with_its_place():
    with pytest.raises(ConfigurationError, match=r"^loop\.a\[1\]: .* cannot stand in a configuration"):
        changed(loop={"a": [1, object()]})


@pytest.mark.parametrize(
    "text", ["1e3", "no", "12:30", "0x10", "", "null", "- a", "ä: b", "true", "1_000", ".inf"]
)
def test_text_stays_text(text):
    value = parse(with_changes(TEXT, {"description": text})).value
    assert value is not None
    assert value["description"] == text
    assert value["name"] == "12:30"


@pytest.mark.parametrize("name", ["virtual", "ideal", "lab", "bench", "socketcan", "vcan50"])
def test_a_shipped_configuration_stays_what_it_is_without_a_change(name):
    shipped = load(name)
    again = loads(with_changes(shipped.text, {}), shipped.source, shipped.folder)
    assert again.model_dump() == shipped.model_dump()


@pytest.mark.parametrize("duration_s", [0, -1.0, float("nan"), float("inf"), 1e306])
def test_a_duration_that_is_none_is_refused_before_a_log_is_there(tmp_path, duration_s):
    with pytest.raises(ConfigurationError, match=r"^duration_s .*allowed: seconds > 0, up to 1e"):
        hil.sim("virtual", duration_s=duration_s, log=tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


def test_one_fault_may_stand_as_a_text(tmp_path):
    fault = "encoder_jump leg=3 at=0.9 by=5e-3"
    run = hil.sim("virtual", duration_s=1.0, log=tmp_path / "a.mcap", plant_log=False, faults=fault)
    assert run.summary["faults"] == ["ENCODER"]


def test_one_run_has_one_identity_and_none_of_another(run, tmp_path):
    """All that a simulation follows from is in it, and no clock: its log is the same again."""
    c = loads(run.log.configuration)
    first = run_identity(c, 2.0, None, None, ())
    assert run.log.metadata["hil"]["run"] == run.log.plant.metadata["hil"]["run"] == first
    poses = [tmp_path / name for name in ("a.csv", "b.csv")]
    for n, path in enumerate(poses):
        path.write_text(f"0 0 0 {n}\n")
    others = [
        run_identity(load("virtual"), 2.0, None, None, ()),
        run_identity(c, 3.0, None, None, ()),
        run_identity(c, 2.0, FaultPlan([EncoderJump(leg=0, at_s=2.0, by_m=5e-3)]), None, ()),
        run_identity(c, 2.0, FaultPlan(seed=1), None, ()),
        *(run_identity(c, 2.0, None, None, ((t, "hold"),)) for t in (0.01, 0.011)),
        *(run_identity(c, 2.0, None, path, ()) for path in poses),
    ]
    assert len({first, *others}) == 9
    assert run_identity(c, 2.0, FaultPlan([EncoderJump(leg=0, at_s=2.0, by_m=5e-3)]), None, ()) == others[2]


def test_a_log_that_was_closed_and_cannot_be_read_again_ends_in_a_summary_that_says_so(tmp_path, monkeypatch):
    def unreadable(path):
        raise LogError(f"{path}: damaged at byte 4711")

    ended = Ending(Mode.PARKED, Fault.NONE, "", 0)
    monkeypatch.setattr(command, "_run_to_end", lambda *_: ended)
    monkeypatch.setattr(Log, "open", unreadable)
    summary = command.simulate(load("virtual"), log=tmp_path / "a.mcap", duration_s=0.1)
    assert not summary["success"]
    assert summary["trouble"] == f"{tmp_path}/a.mcap: damaged at byte 4711"
    assert "replay" not in summary


def test_the_command_line_and_the_package_allow_runs_of_one_length():
    assert DURATION.max == LATEST_S


@pytest.mark.parametrize("changes", [{}, {"loop": {"priority": 7}}], ids=["as it is", "changed"])
def test_files_of_a_configuration_are_looked_for_beside_it_also_where_it_was_changed(
    tmp_path, monkeypatch, changes
):
    asked: list[Any] = []

    def simulate(configuration, **_):
        asked.append(configuration)
        raise LogError("no further")

    monkeypatch.setattr(simulation, "simulate", simulate)
    monkeypatch.setattr(simulation, "refuse_unreachable", lambda _: None)
    (tmp_path / "mine.yaml").write_text(load("virtual").text)
    with pytest.raises(LogError, match="no further"):
        hil.sim(tmp_path / "mine.yaml", **changes)
    assert [each.folder for each in asked] == [tmp_path]
    assert [each.loop.priority for each in asked] == [7 if changes else 80]
