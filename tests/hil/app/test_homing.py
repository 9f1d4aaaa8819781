"""Homing file across a power-off: written by one run, checked by the next."""

import os
import re
from importlib import resources
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import yaml

from drivers.can.runtime_folder import RoleLock
from drivers.errors import ConfigurationError
from drivers.transmission import Transmission
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.fault_words import with_faults
from hil.app.homing.command import state_homing
from hil.app.homing.file import read_homing
from hil.app.homing.keeper import Keeper
from hil.app.homing.last_pose import start_lengths
from hil.app.sim.command import simulate
from hil.loop.cycle import Cycle
from hil.mathematics.rotations import rotation_vector
from hil.record.log import Log

STEP_M = 0.1 * 2.0 * np.pi * 0.02
"""Length that a drive forgets: encoder in front of a gear of 10 : 1, pinion of 20 mm radius."""
RESOLUTION_M = 25.0 / 65535 * 0.02
"""Resolution of the position field of Damiao."""
HOMING = "  homing: {file: real.yaml, limit_m: 0.0005, forgotten_turns: 0.1}\n"
START = "  initial_position_m: [0, 0, 0.292]\n"


def configuration(folder: Path, start: str = START, homing: str = HOMING, mass: int = 10) -> Configuration:
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    text = text.replace("offset_m: 0.325 ", "offset_m: 0.3 ")  # two turns from home
    text = text.replace("  watchdog_ms: 10 ", homing + "  watchdog_ms: 10 ")
    text = text.replace("mass_kg: 10 ", f"mass_kg: {mass} ")
    text = text.replace("plant:\n", f"plant:\n  homing_file: bench.yaml\n{start}")
    return loads(text, "desktop", folder)


def state(c: Configuration) -> None:
    state_homing(c, emulated=True, lengths_m=start_lengths(c).tolist())


@pytest.fixture(scope="module")
def parked(tmp_path_factory):
    """A first run: its folder, its summary, and the true pose at its end."""
    folder = tmp_path_factory.mktemp("homing")
    c = configuration(folder)
    state(c)
    summary = simulate(c, log=folder / "first.mcap", duration_s=1.6, plant_log=True, check_replay=False)
    return folder, summary, Log.open(Path(summary["plant_log"])).rows()[-1]


def begins_where(truth, by_m: float = 0.0) -> str:
    p, turn = truth["p"] + [0, 0, by_m], np.rad2deg(rotation_vector(truth["R"]))
    return f"  initial_position_m: {p.tolist()}\n  initial_rotation_vector_deg: {turn.tolist()}\n"


def test_run_that_parks_writes_its_leg_lengths_to_the_homing_file(parked):
    folder, summary, truth = parked
    assert summary["success"], summary["trouble"]
    c = configuration(folder)
    file = read_homing(c, folder / "bench.yaml")
    assert file.state == "parked"
    np.testing.assert_allclose(file.lengths_m, truth["length"], atol=RESOLUTION_M)
    assert np.abs(truth["length"] - start_lengths(c)).max() > 0.003, "the run parked where it had begun"
    raw = np.array(file.turns)
    gear = c.drives.transmission
    assert gear is not None
    step = (np.array(file.lengths_m) - Transmission(gear).length(raw)) / STEP_M
    np.testing.assert_allclose(step, np.round(step), atol=1e-9)
    assert step.any(), "the file must hold the turns that the drives report, without those added"
    assert not (folder / "real.yaml").exists(), "a simulation must not write the homing file of real drives"


def test_pose_after_a_power_off_equals_the_pose_before(parked, tmp_path):
    folder, _, truth = parked
    c = configuration(folder, begins_where(truth))
    before = (folder / "bench.yaml").read_text()
    summary = simulate(c, log=tmp_path / "second.mcap", duration_s=0.1)
    (folder / "bench.yaml").write_text(before)
    rows = Log.open(tmp_path / "second.mcap").rows()
    assert summary["success"], summary["trouble"]
    first = rows[np.flatnonzero((rows["age"] == 0).all(axis=1))[0]]
    np.testing.assert_allclose(first["q"], truth["length"], atol=RESOLUTION_M)
    assert any(float(turns) for turns in summary["homing"]["turns_added"].split(", "))
    assert summary["replay"]["exact"]


def test_platform_moved_by_hand_since_parking_is_refused_in_run_and_replay(parked, tmp_path):
    folder, _, truth = parked
    c = configuration(folder, begins_where(truth, 0.002))
    before = (folder / "bench.yaml").read_text()
    summary = simulate(c, log=tmp_path / "moved.mcap", duration_s=8.0)
    assert not summary["success"]
    lengths = start_lengths(c)
    (found,) = re.findall(r"leg 4 is (\S+) m long", summary["trouble"])
    assert float(found) == pytest.approx(lengths[4], abs=2 * RESOLUTION_M)
    assert (
        f"and was {read_homing(c, folder / 'bench.yaml').lengths_m[4]:.6f} m (parked " in summary["trouble"]
    )
    assert "allowed: 0.5 mm (drives.homing)" in summary["trouble"]
    rows = Log.open(tmp_path / "moved.mcap").rows()
    assert not rows["command_mode"].any(), "no drive was powered"
    assert len(rows) < 2.5 * 400, "the run must end within 1 s"
    assert summary["replay"]["exact"], "the replay takes the homing file from the log"
    assert yaml.safe_load((folder / "bench.yaml").read_text()) == yaml.safe_load(before), "file changed"


@pytest.mark.parametrize(
    ("fault", "commands", "state"),
    [((), [(1.2, "estop")], "parked"), (("encoder_lost leg=1 mode=TRACKING at=0.8",), [], "moved")],
)
def test_homing_file_gets_the_leg_lengths_after_a_fault_only_if_known(tmp_path, fault, commands, state):
    c = with_faults(configuration(tmp_path, "  initial_position_m: [0, 0, 0.284]\n"), fault)
    state_homing(c, emulated=True, lengths_m=start_lengths(c).tolist())
    summary = simulate(
        c, log=tmp_path / "a.mcap", duration_s=2.0, commands=commands, plant_log=True, check_replay=False
    )
    assert not summary["success"]
    assert state == "moved" or "all six drives confirmed it" in summary["trouble"]
    file = read_homing(c, tmp_path / "bench.yaml")
    assert file.state == state
    truth = Log.open(Path(summary["plant_log"])).rows()[-1]["length"]
    gap = np.abs(truth - file.lengths_m).max()
    assert (gap < 2 * RESOLUTION_M) == (state == "parked")


# -- the file ----------------------------------------------------------------------------------------------


def limits(c: Configuration) -> list[float]:
    pose = Keeper(c, emulated=True).last_pose
    assert pose is not None
    return [float(limit) for limit in pose.limit_m]


def refusal(c: Configuration) -> str:
    with pytest.raises(ConfigurationError) as refused:
        Keeper(c, emulated=True)
    return str(refused.value)


def test_missing_homing_file_is_refused_with_the_command_that_makes_one(tmp_path):
    said = refusal(configuration(tmp_path))
    assert "bench.yaml: no such file" in said
    assert "`hil homing desktop --emulated` --at-home" in said


def test_truncated_homing_file_is_refused_wherever_it_ends(tmp_path):
    c = configuration(tmp_path)
    state(c)
    file = tmp_path / "bench.yaml"
    text = file.read_text()
    body = text.index("\n") + 1
    for end in range(0, text.index("turns:"), 23):
        file.write_text(text[:end])
        assert ("not a complete homing file" in refusal(c)) or end < body, end


def test_homing_file_of_another_robot_is_refused(tmp_path):
    state(configuration(tmp_path))
    said = refusal(configuration(tmp_path, mass=11))
    assert "for another robot, configuration 'desktop'" in said


def test_homing_file_left_by_a_killed_run_is_refused(tmp_path):
    c = configuration(tmp_path)
    state(c)
    keeper = Keeper(c, emulated=True)
    keeper.begin(cast("Cycle", None))  # the run dies before its cycle is asked
    assert "did not end at rest" in refusal(c)
    with pytest.raises(ConfigurationError, match="did not end at rest"):
        state_homing(c, emulated=True, legs_m={2: 0.35})
    state_homing(c, emulated=True, at_home=True)
    assert Keeper(c, emulated=True).last_pose is not None


# -- the command -------------------------------------------------------------------------------------------


def test_hil_homing_with_one_leg_length_keeps_the_lengths_of_the_other_legs(tmp_path):
    c = configuration(tmp_path)
    state(c)
    state_homing(c, emulated=True, legs_m={2: 0.35})
    there = read_homing(c, tmp_path / "bench.yaml")
    expected = start_lengths(c)
    expected[2] = 0.35
    assert there.lengths_m == expected.tolist()
    assert there.state == "stated"
    assert there.turns is None


def test_leg_length_stated_by_the_operator_may_be_wrong_by_a_quarter_turn(tmp_path):
    c = configuration(tmp_path)
    state(c)
    assert limits(c) == pytest.approx([STEP_M / 4] * 6)
    file = tmp_path / "bench.yaml"
    file.write_text(file.read_text().replace("state: stated", "state: parked"))
    assert limits(c) == [0.0005] * 6


def test_homing_file_is_not_written_while_a_run_uses_the_bus(tmp_path):
    c = configuration(tmp_path)
    state(c)
    before = (tmp_path / "bench.yaml").read_text()
    held = RoleLock(c.bus.interface, c.bus.channel, "controller")
    try:
        with pytest.raises(
            ConfigurationError, match=f"while a run may move .* process {os.getpid()}; stop it"
        ):
            state_homing(c, emulated=True, legs_m={2: 0.31})
        assert (tmp_path / "bench.yaml").read_text() == before
        assert state_homing(c, emulated=True)["success"], "it is shown"
    finally:
        held.close()
    state_homing(c, emulated=True, legs_m={2: 0.31})
    assert (tmp_path / "bench.yaml").read_text() != before


def test_hil_homing_refuses_a_length_outside_the_stroke_and_writes_no_file(tmp_path):
    c = configuration(tmp_path)
    with pytest.raises(
        ConfigurationError, match=r"leg 3: 0\.45 m: outside the stroke, allowed: 0\.25 to 0\.4 m"
    ):
        state_homing(c, emulated=True, at_home=True, legs_m={3: 0.45})
    assert not list(tmp_path.iterdir())


# -- the configuration, and the drives' end -----------------------------------------------------------------
