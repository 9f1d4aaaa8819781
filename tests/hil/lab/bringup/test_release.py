"""End of a bring-up: six legs move after all steps passed and the operator agreed; text of its files."""

from __future__ import annotations

import contextlib
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import ConfigurationError, RunError
from drivers.signals import Fault
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.homing.command import state_homing
from hil.app.homing.file import read_homing
from hil.lab.bringup import command
from hil.lab.bringup.command import mark_moved, run_bringup, state_lengths
from hil.lab.bringup.connection import served_bench
from hil.lab.bringup.context import Finding, RefusedError
from hil.lab.bringup.procedure import STEPS, Outcome
from hil.lab.bringup.rehearsal import six_legs
from hil.lab.bringup.store import Store
from hil.lab.bringup.terminal import Terminal
from hil.record.recording import LogSummary
from tests.hil.lab.bringup.rehearsals import Rehearsal, named

FULL = "No space left on device"


class Recorder:
    """A recording in memory that may fail at one of its events."""

    def __init__(self, path, fails_at):
        self.path, self.fails_at, self.events, self.trouble = path, fails_at, [], ""

    def event(self, _t_ns, _level, text):
        self.events.append(text)
        if len(self.events) == self.fails_at:
            self.trouble = FULL

    def close(self):
        return LogSummary(self.path, 10, 0, 0, 3, 0, 0.0, not self.trouble, self.trouble, bool(self.trouble))


_FACTS: dict[str, Any] = {
    "held": {"moved": False, "hand_N": 700.0},
    "opens": {"legs": [0], "hand_N": 30.0, "rate_share": 1.0},
    "platform": True,
}


@pytest.fixture
def ended(tmp_path, monkeypatch):
    """Run a rehearsal with given results of its steps and first motion; return summary and texts."""
    monkeypatch.chdir(tmp_path)

    def end(six_legs, *, yes=True, fails_at=0, name="virtual", facts=None, findings=()):
        said: list[str] = []

        def steps(context):
            for step in ("held", "opens", "platform"):
                context.keep(step, "hung" if step == "platform" else 0, _FACTS[step])
            context.facts.update(facts or {})
            for _ in range(3):
                context.operator.tell("a step")
            return Outcome(("scan",), findings)

        @contextlib.contextmanager
        def log(_c, path, _clock):
            yield Recorder(path, fails_at)

        monkeypatch.setattr(command, "bring_up", steps)
        monkeypatch.setattr(command, "six_legs", six_legs)
        monkeypatch.setattr(command, "_log", log)
        summary = command.run_bringup(name, load(name), mistakes=[], yes=yes, say=said.append)
        return summary, said

    return end


FOUND = "virtual.rehearsal.yaml"


def ran(*, success=True, faults=Fault(0)):  # noqa: B008
    return lambda *_: SimpleNamespace(success=success, trouble="", faults=faults)


def test_configuration_is_released_after_six_legs_have_moved_together(ended, tmp_path):
    summary, _ = ended(ran())
    assert summary["success"]
    text = (tmp_path / FOUND).read_text()
    assert "NOT RELEASED" not in text
    assert "REHEARSAL" in text.split("\nname:")[0]
    assert (tmp_path / summary["checklist"]).read_text().startswith("REHEARSAL")


def test_configuration_lists_corrected_findings_apart_from_those_still_to_be_fixed(ended, tmp_path):
    encoder = {"drive": 3, "tape_m": [0.25, 0.4], "scale": 0.98, "offset_m": 0.0, "bent_m": 0.0}
    findings = (
        Finding("wrong_lead", (3,), "too long", "Shorten it."),
        Finding("brake_stuck_open", (1,), "it gives way", "Look at brake."),
    )
    _, said = ended(ran(), name="desktop", facts={"encoder": {"3": encoder}}, findings=findings)
    head = (tmp_path / "desktop.rehearsal.yaml").read_text().split("\nname:")[0].splitlines()
    released, corrected = (
        k for k, line in enumerate(head) if line.startswith(("# NOT", "# This file already corrects"))
    )
    assert [line.split(":")[0] for line in head[released + 1 : corrected]] == ["#   brake_stuck_open"]
    assert [line.split(":")[0] for line in head[corrected + 1 :]] == ["#   wrong_lead"]
    (line,) = [text for text in said if text.startswith("next: ")]
    assert "desktop.rehearsal.yaml --rehearse" in line


def test_failed_brake_in_the_first_motion_prevents_release_and_discards_all_measurements(ended, tmp_path):
    summary, _ = ended(ran(success=False, faults=Fault.BRAKE))
    assert not summary["success"]
    assert "# NOT RELEASED: the step `together` has not passed" in (tmp_path / FOUND).read_text()
    kept = Store(tmp_path / "virtual.rehearsal.state.json", {}).facts
    assert kept == {"platform": {"hung": True}}


def raising(error):
    def answer(*_):
        raise error

    return answer


@pytest.mark.parametrize("error", [RefusedError("ended"), KeyboardInterrupt()], ids=["no", "Ctrl-C"])
def test_without_consent_no_leg_moves_and_no_configuration_is_released(ended, tmp_path, monkeypatch, error):
    monkeypatch.setattr(Terminal, "consent", raising(error))
    summary, _ = ended(lambda *_: pytest.fail("six legs have moved"), yes=False)
    assert not summary.get("success")
    assert "[ ] together" in (tmp_path / summary["checklist"]).read_text()
    assert "NOT RELEASED" in (tmp_path / FOUND).read_text()


def test_configuration_is_not_released_if_the_program_dies_during_the_first_motion(ended, tmp_path):
    with pytest.raises(SystemExit):
        ended(raising(SystemExit()))
    assert "# NOT RELEASED: the step `together`" in (tmp_path / FOUND).read_text()


@pytest.mark.parametrize("fails_at", [2, 4], ids=["in the steps", "at the end"])
def test_incomplete_log_is_a_failure_and_prevents_the_first_motion(ended, tmp_path, fails_at):
    summary, _ = ended(
        ran() if fails_at == 4 else lambda *_: pytest.fail("they have moved"), fails_at=fails_at
    )
    assert (summary["success"], FULL in summary["trouble"]) == (False, True)
    assert ("NOT RELEASED" in (tmp_path / FOUND).read_text()) == (fails_at == 2)


@pytest.mark.parametrize("served", [True, False])
@pytest.mark.parametrize("agrees", [True, False])
def test_homing_file_of_a_real_machine_is_written_only_after_consent(monkeypatch, agrees, served):
    done: list[str] = []
    monkeypatch.setattr(Terminal, "consent", (lambda *_: True) if agrees else raising(RefusedError("ended")))
    monkeypatch.setattr(command, "state_lengths", lambda *_: done.append("stated"))

    def run(*_, on_bench, **__):
        done.append("on a bench" if on_bench else "ran")
        return {"success": False, "trouble": "x", "faults": ["BRAKE"]}

    monkeypatch.setattr(command, "run_daemon", run)
    said = command._Journal(lambda _: None, Recorder("x", 0))  # type: ignore[arg-type]
    agree = Terminal(said).consent
    together = command._release(load("virtual"), None, None, said, agree, served=served)  # type: ignore[arg-type]
    assert done == (["on a bench"] if served else ["stated", "ran"]) * agrees
    assert together.brake_failed is agrees


def forgetful(folder, radius_m=0.004) -> Configuration:
    """The desktop hexapod with motors that forget their turns: multiples of 25 mm."""
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    homing = {"file": "legs.homing.yaml", "limit_m": 5e-3}
    drives = {
        "homing": homing,
        "transmission": {"pulley_radius_m": radius_m},
        "options": {"position_rad": 60.0, "velocity_rad_s": 200.0},
    }
    return loads(with_changes(text, {"drives": drives}), "forgetful", folder)


def test_length_offset_other_than_whole_turns_is_found_on_motors_that_forget_turns(tmp_path):
    rehearsal = Rehearsal(forgetful(tmp_path), "offset leg=2")
    forgotten = rehearsal.machine.forgotten_m
    assert forgotten is not None
    assert forgotten == pytest.approx([2 * 3.141592653589793 * 0.004] * 6)
    assert named(rehearsal.run(STEPS[:4])) == {("offset", (2,))}


@pytest.mark.long
def test_first_motion_succeeds_after_a_rehearsal_with_motors_that_forget_turns(tmp_path):
    rehearsal = Rehearsal(forgetful(tmp_path))
    outcome = rehearsal.run()
    assert outcome.success, outcome.findings
    assert six_legs(rehearsal.c, rehearsal.bench).success


def test_homing_file_is_marked_as_moved_and_gets_the_last_pose_at_the_end(tmp_path):
    c = forgetful(tmp_path)
    said: list[str] = []
    mark_moved(c, said.append)
    assert said == [], "nothing is reported while no homing file exists"
    state_homing(c, at_home=True)
    path = tmp_path / "legs.homing.yaml"
    before = read_homing(c, path)
    mark_moved(c, said.append)
    marked = read_homing(c, path)
    assert (before.state, marked.state) == ("stated", "moved")
    assert marked.lengths_m == before.lengths_m
    context = Rehearsal(c).context
    state_lengths(c, context, said.append)
    stated = read_homing(c, path)
    assert stated.state == "stated"
    assert stated.lengths_m == pytest.approx(context.machine.pose_lengths[1].tolist())


@pytest.fixture
def stated(tmp_path: Path, folder: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A machine with a homing file that states its leg lengths."""
    monkeypatch.chdir(tmp_path)
    text = forgetful(tmp_path).text.replace("folder: runs", f"folder: {tmp_path}/runs")
    c = loads(text, "forgetful", tmp_path)
    state_homing(c, at_home=True)
    return c


@pytest.fixture
def begun(stated: Configuration, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """State in the homing file at the start of the steps of each bring-up."""
    said: list[str] = []

    def proceed(*_: Any, **__: Any) -> Any:
        said.append(homing(stated))
        return Outcome((), (), stopped="ended"), "ended"

    @contextlib.contextmanager
    def log(_c: Configuration, path: Path, _clock: Any) -> Any:
        yield Recorder(path, 0)

    monkeypatch.setattr(command, "_proceed", proceed)
    monkeypatch.setattr(command, "_log", log)
    return said


def homing(c: Configuration) -> str:
    return read_homing(c, c.folder / "legs.homing.yaml").state


def test_option_yes_to_all_steps_is_refused_at_a_real_machine(
    stated: Configuration, begun: list[str]
) -> None:
    before = sorted(stated.folder.iterdir())
    with pytest.raises(RunError, match="for a bench only: leave it out at a machine"):
        run_bringup("forgetful", stated, yes=True, say=lambda _: None)
    assert begun == []
    assert homing(stated) == "stated"
    assert sorted(stated.folder.iterdir()) == before


def test_homing_file_is_marked_before_the_first_leg_is_moved_by_hand(
    stated: Configuration, begun: list[str]
) -> None:
    for _ in range(2):
        run_bringup("forgetful", stated, say=lambda _: None)
        assert homing(stated) == "moved", "the file stays marked as moved until lengths are stated again"
        state_homing(stated, at_home=True)
    assert begun == ["moved"] * 2


def test_homing_file_of_another_robot_prevents_the_bring_up(stated: Configuration, begun: list[str]) -> None:
    state_homing(forgetful(stated.folder, 0.005), at_home=True)
    with pytest.raises(ConfigurationError, match="another robot"):
        run_bringup("forgetful", stated, say=lambda _: None)
    assert begun == []


@pytest.mark.parametrize("served", [False, True])
def test_rehearsal_does_not_change_the_homing_file_of_the_machine(
    stated: Configuration, begun: list[str], served: bool
) -> None:
    with served_bench(stated, []) if served else contextlib.nullcontext():
        run_bringup("forgetful", stated, mistakes=None if served else [], yes=True, say=lambda _: None)
    assert begun == ["stated"]
    assert homing(stated) == "stated"


@pytest.mark.long
@pytest.mark.parametrize("name", ["virtual", "desktop"])
def test_rehearsal_ends_with_moving_legs_and_valid_files(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    summary = run_bringup(name, load(name), mistakes=[], yes=True, say=said.append)
    assert summary["success"]
    found = load(summary["found"])
    assert found.drives.node_ids == load(name).drives.node_ids
    checked = (tmp_path / summary["checklist"]).read_text()
    assert checked.count("[x]") == len(STEPS) + 1
    again = run_bringup(name, load(name), mistakes=[], yes=True, say=said.append)
    assert again["success"]
    assert said.count("  passed before") == len(STEPS) - 1
