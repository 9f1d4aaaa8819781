"""`hil.sim`: a run from Python with changes, its log, its summary and the true state of the plant."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import hil
from drivers.errors import ConfigurationError
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.replay import replay_log
from hil.app.sim.build import build_lockstep
from hil.app.sim.command import run_identity
from plant_fmu.faults.kinds import EncoderJump
from plant_fmu.faults.plan import FaultPlan


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sim")
    return hil.sim(
        "virtual", duration_s=2.0, log=folder / "a.mcap", controller={"wn_rad_s": 25}, check_replay=False
    )


def test_sim_in_python_returns_its_log_and_its_summary(run):
    assert run.success
    assert run.summary["final_mode"] == "PARKED"
    assert str(run.log.path) == run.summary["log"]
    assert run.log.summary.ticks == run.summary["ticks"]
    assert run.log.figures()["tracking"] == run.summary["tracking"]


def test_log_carries_the_changed_configuration_and_replays(run):
    there, shipped = loads(run.log.configuration), load("virtual")
    assert there.controller.model_dump() == shipped.controller.model_dump() | {"wn_rad_s": 25.0}
    assert there.platform == shipped.platform
    assert there.name == "virtual"
    assert replay_log(run.log.path)[0].exact


def test_true_lengths_of_each_tick_agree_with_its_encoders(run):
    """The drives sample the length at the SYNC, quantised to 1 um; the plant's grid is at most 50 us off."""
    labels = [f"leg_{leg}" for leg in range(6)]
    frame = run.log.frame("q", "age", "plant.length", "plant.rate", "mode")
    moving = frame[(frame["mode"] == "TRACKING") & (frame["age.leg_0"] == 0)]
    assert len(moving) > 300
    read, true, rate = (
        moving[[f"{name}.{leg}" for leg in labels]].to_numpy() for name in ("q", "plant.length", "plant.rate")
    )
    assert (np.abs(read - true) <= 0.6e-6 + 50e-6 * np.abs(rate)).all()
    assert np.abs(true[1:] - read[:-1]).max() > 5e-4  # a tick beside the right one would be seen


def test_sim_in_python_refuses_mistakes_and_reports_faults_like_the_command(tmp_path):
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


CHANGES: dict[str, tuple[Any, Any]] = {
    "loop": ({"rate_Hz": 500}, {"rate_Hz": 500, "note": "no"}),
    "controller": ({"law": "pid", "ki": 2}, {"law": "pid", "ki": 2}),
    "plant": ({"model": {"type": "bench"}, "log": None}, {"model": {"type": "bench"}}),
    "name": ("other", "other"),
}
"""Section, a change, and the result; another `law` or `type` replaces the whole section."""


@pytest.mark.parametrize("section", CHANGES)
def test_changed_configuration_text_differs_in_the_changed_key_only(section):
    """Compared through PyYAML, which agrees with YAML 1.2 if ambiguous text is quoted."""
    change, there = CHANGES[section]
    before = yaml.safe_load(TEXT) | {"controller": {"law": "pd", "kp": 1000.0, "gains": [1, 2.5e-7]}}
    assert yaml.safe_load(with_changes(TEXT, {section: change})) == before | {section: there}
    assert section not in yaml.safe_load(with_changes(TEXT, {section: None}))


@pytest.mark.parametrize("duration_s", [0, -1.0, float("nan"), float("inf"), 1e306])
def test_invalid_duration_is_refused_before_a_log_is_created(tmp_path, duration_s):
    with pytest.raises(ConfigurationError, match=r"^duration_s .*allowed: seconds > 0, up to 1e"):
        hil.sim("virtual", duration_s=duration_s, log=tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


def test_run_identity_depends_on_all_inputs_of_a_simulation_only(run, tmp_path):
    """It covers all inputs of a simulation and no clock, so a repeated run gives the same log."""
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


@pytest.mark.parametrize(
    "operator", [{"start": "asked"}, {"deadman_s": 0.2}, {"stays": True}], ids=lambda each: next(iter(each))
)
def test_lockstep_simulation_that_would_wait_for_an_operator_is_refused(operator):
    """Simulated time has no operator."""
    c = loads(with_changes(load("virtual").text, {"operator": operator}), "mine.yaml", Path())
    cycle = build_cycle(c, c.loop.rate_Hz, 0.01)
    nodes, plant = build_nodes(c)
    try:
        with pytest.raises(ConfigurationError, match=r"mine\.yaml: operator: nobody gives commands here"):
            build_lockstep(c, cycle, nodes)
        assert build_lockstep(c, cycle, nodes, attended=True).tick == -1
    finally:
        plant.close()
