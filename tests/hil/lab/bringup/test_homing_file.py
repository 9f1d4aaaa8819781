"""A bring-up beside drives that forget their turns: the homing file, and zeros less whole turns."""

from importlib import resources

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.homing.command import state_homing
from hil.app.homing.file import read_homing
from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.release import mark_moved, six_legs, state_lengths
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal, named


def forgetful(folder, radius_m: float = 0.004) -> Configuration:
    """Return the desktop with motors that forget their turns: multiples of 25 mm."""
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    homing = {"file": "legs.homing.yaml", "limit_m": 5e-3}
    drives = {
        "homing": homing,
        "transmission": {"pulley_radius_m": radius_m},
        "options": {"position_rad": 60.0, "velocity_rad_s": 200.0},
    }
    return loads(with_changes(text, {"drives": drives}), "forgetful", folder)


def test_whole_turns_that_were_forgotten_are_no_offset_and_the_rest_is(tmp_path):
    rehearsal = Rehearsal(forgetful(tmp_path), wired(Mistake("offset", 2)))
    forgotten = rehearsal.machine.forgotten_m
    assert forgotten is not None
    assert forgotten == pytest.approx([2 * 3.141592653589793 * 0.004] * 6)
    assert named(rehearsal.run(STEPS[:4])) == {("offset", (2,))}
    rehearsal.bench.nodes.snapshot()


@pytest.mark.long
def test_a_rehearsal_with_such_motors_ends_with_six_legs_that_move(tmp_path):
    rehearsal = Rehearsal(forgetful(tmp_path), Wiring())
    outcome = rehearsal.run()
    assert outcome.success, outcome.findings
    assert six_legs(rehearsal.c, rehearsal.bench).success


def test_the_homing_file_is_marked_as_moved_and_says_the_last_pose_at_the_end(tmp_path):
    c = forgetful(tmp_path)
    said: list[str] = []
    mark_moved(c, said.append)
    assert said == [], "there is no file yet"
    state_homing(c, at_home=True)
    path = tmp_path / "legs.homing.yaml"
    before = read_homing(c, path)
    mark_moved(c, said.append)
    marked = read_homing(c, path)
    assert (before.state, marked.state) == ("stated", "moved")
    assert marked.lengths_m == before.lengths_m
    assert "moved" in said[0]
    context = Rehearsal(c, Wiring()).context
    state_lengths(c, context, said.append)
    stated = read_homing(c, path)
    assert stated.state == "stated"
    assert stated.lengths_m == pytest.approx(context.machine.pose_lengths[1].tolist())


def test_a_file_of_another_robot_ends_the_bring_up_before_it_begins(tmp_path):
    state_homing(forgetful(tmp_path, 0.005), at_home=True)
    with pytest.raises(ConfigurationError, match="another robot"):
        mark_moved(forgetful(tmp_path), lambda _: None)
