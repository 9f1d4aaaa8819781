"""The end of a bring-up: what its files say once six legs are to move, and what a full disk leaves."""

import contextlib
import errno
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.errors import RunError
from drivers.signals import Fault
from hil.app.configuration.configuration import load
from hil.app.files import write_whole
from hil.lab.bringup import command
from hil.lab.bringup.context import Finding, RefusedError
from hil.lab.bringup.procedure import Outcome
from hil.lab.bringup.store import Store
from hil.lab.bringup.terminal import Terminal
from hil.record.recording import LogSummary

FULL = "No space left on device"


class Recorder:
    """A recording in memory, which may fail at some event."""

    def __init__(self, path, fails_at):
        self.path, self.fails_at, self.events, self.trouble = path, fails_at, [], ""

    def event(self, _t_ns, _level, text):
        self.events.append(text)
        if len(self.events) == self.fails_at:
            self.trouble = FULL

    def close(self):
        return LogSummary(self.path, 10, 0, 0, 3, 0, 0.0, not self.trouble, self.trouble, bool(self.trouble))


@pytest.fixture
def ended(tmp_path, monkeypatch):
    """A function that does a rehearsal whose steps have all passed, with another end; summary, texts, state."""
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


_FACTS: dict[str, Any] = {
    "held": {"moved": False, "hand_N": 700.0},
    "opens": {"legs": [0], "hand_N": 30.0, "rate_share": 1.0},
    "platform": True,
}
NO_FAULT = Fault(0)
FOUND = "virtual.rehearsal.yaml"


def ran(*, success=True, faults=NO_FAULT):
    return lambda *_: SimpleNamespace(success=success, trouble="", faults=faults)


def test_the_found_file_is_released_once_six_legs_have_moved(ended, tmp_path):
    summary, said = ended(ran())
    assert summary["success"]
    assert not any("the log ends" in text for text in said)
    assert "NOT RELEASED" not in (tmp_path / FOUND).read_text()


def test_what_a_rehearsal_has_written_says_that_no_machine_was_measured(ended, tmp_path):
    summary, _ = ended(ran())
    assert "REHEARSAL" in (tmp_path / FOUND).read_text().split("\nname:")[0]
    assert (tmp_path / summary["checklist"]).read_text().startswith("REHEARSAL")


def test_a_configuration_that_would_be_refused_is_not_written_and_why_is_said(ended, tmp_path):
    """A lead five times as long takes five times the torque: more than these drives have."""
    encoder = {"drive": 3, "tape_m": [0.25, 0.4], "scale": 0.2, "offset_m": 0.0, "bent_m": 0.0}
    findings = (Finding("wrong_lead", (3,), "too long", "Shorten it."),)
    summary, said = ended(ran(), name="desktop", facts={"encoder": {"3": encoder}}, findings=findings)
    assert "found" not in summary
    assert not (tmp_path / "desktop.rehearsal.yaml").exists()
    (why,) = [text for text in said if text.startswith("no configuration is written")]
    assert "drives.force_limit_N: " in why
    assert why in (tmp_path / summary["checklist"]).read_text()


def test_what_the_written_file_makes_up_for_stands_apart_from_what_is_to_be_mended(ended, tmp_path):
    encoder = {"drive": 3, "tape_m": [0.25, 0.4], "scale": 0.98, "offset_m": 0.0, "bent_m": 0.0}
    findings = (
        Finding("wrong_lead", (3,), "too long", "Shorten it."),
        Finding("brake_stuck_open", (1,), "it gives way", "Look at brake."),
    )
    _, said = ended(ran(), name="desktop", facts={"encoder": {"3": encoder}}, findings=findings)
    head = (tmp_path / "desktop.rehearsal.yaml").read_text().split("\nname:")[0].splitlines()
    at = head.index("# NOT RELEASED: mend what follows, and give this file to `hil bringup` again.")
    assert head[at + 1 :] == [
        "#   brake_stuck_open: leg 1: it gives way. Look at brake.",
        "# This file makes up for what follows: do not mend it at the machine, too.",
        "#   wrong_lead: leg 3: too long",
    ]
    (line,) = [text for text in said if text.startswith("next: ")]
    assert line == (
        "next: hil bringup desktop.rehearsal.yaml --rehearse, once what was found at the machine is mended; "
        "that file makes up for wrong_lead: do not mend it at the machine, too"
    )


def test_where_the_file_makes_up_for_all_it_is_given_again_at_once(ended, tmp_path):
    findings = (Finding("stroke", (0, 1, 2, 3, 4, 5), "all end early", "Write it."),)
    tapes = {
        str(k): {"drive": k, "tape_m": [1.2, 2.0], "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0}
        for k in range(6)
    }
    _, said = ended(ran(), facts={"encoder": tapes}, findings=findings)
    assert "# NOT RELEASED: give this file to `hil bringup` again." in (tmp_path / FOUND).read_text()
    (line,) = [text for text in said if text.startswith("next: ")]
    assert line.startswith(f"next: hil bringup {FOUND} --rehearse; that file makes up for stroke")


@pytest.mark.parametrize("leg", range(6))
def test_what_was_measured_at_a_leg_with_a_finding_is_not_in_the_state_and_the_rest_is(ended, tmp_path, leg):
    encoder = {"tape_m": [0.75, 2.2], "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0}
    facts = {"encoder": {str(k): {"drive": k, **encoder} for k in range(6)}}
    facts |= {step: {str(k): _FACTS[step] | {"legs": [k]} for k in range(6)} for step in ("held", "opens")}
    summary, _ = ended(ran(), facts=facts, findings=(Finding("encoder_sign", (leg,), "falls", "Mend it."),))
    assert not summary["success"]
    kept = Store(tmp_path / "virtual.rehearsal.state.json", {}).facts
    assert {step: sorted(map(int, kept[step])) for step in facts} == {
        step: [k for k in range(6) if k != leg] for step in facts
    }


def test_a_brake_that_failed_under_the_platform_is_tested_again_and_nothing_is_released(ended, tmp_path):
    summary, _ = ended(ran(success=False, faults=Fault.BRAKE))
    assert not summary["success"]
    assert "# NOT RELEASED: the step together has not passed" in (tmp_path / FOUND).read_text()
    kept = Store(tmp_path / "virtual.rehearsal.state.json", {}).facts
    assert kept == {"platform": {"hung": True}}


def test_nothing_is_released_where_six_legs_were_refused(ended, tmp_path, monkeypatch):
    monkeypatch.setattr(Terminal, "consent", _refuse)
    summary, _ = ended(ran(), yes=False)
    assert not summary["success"]
    assert "# NOT RELEASED: the step together" in (tmp_path / FOUND).read_text()


def test_ctrl_c_before_six_legs_leaves_a_checklist_and_releases_nothing(ended, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Terminal, "consent", interrupted)
    summary, _ = ended(lambda *_: pytest.fail("six legs have moved"), yes=False)
    assert "[ ] together: interrupted before" in (tmp_path / summary["checklist"]).read_text()
    assert "NOT RELEASED" in (tmp_path / FOUND).read_text()


def _refuse(*_):
    raise RefusedError("ended by the operator")


def test_nothing_is_released_where_the_program_died_meanwhile(ended, tmp_path):
    def dies(*_):
        raise SystemExit

    with pytest.raises(SystemExit):
        ended(dies)
    assert "# NOT RELEASED: the step together" in (tmp_path / FOUND).read_text()


def test_a_log_that_was_cut_is_said_once_and_six_legs_do_not_move(ended, tmp_path):
    summary, said = ended(lambda *_: pytest.fail("six legs have moved"), fails_at=2)
    assert not summary["success"]
    assert summary["trouble"] == f"{FULL}: 3 ticks are not in the log"
    assert sum("the log ends here" in text for text in said) == 1
    assert "NOT RELEASED" in (tmp_path / FOUND).read_text()


def test_a_log_that_was_cut_at_the_end_is_no_success(ended):
    summary, _ = ended(ran(), fails_at=4)
    assert (summary["success"], FULL in summary["trouble"]) == (False, True)


@pytest.mark.parametrize(
    "findings", [(), (Finding("absent", (3,), "drive 3 is silent", "Look at its cable."),)]
)
def test_a_disk_that_is_full_once_all_is_done_takes_no_result_with_it(ended, monkeypatch, findings):
    """The file of what was found cannot be written again; with findings not at all. The checklist can."""
    written: list[str] = []

    def write(path, text):
        written.append(path.name)
        if path.name == FOUND and written.count(FOUND) == 2 - bool(findings):
            raise OSError(errno.ENOSPC, FULL, str(path))
        write_whole(path, text)

    monkeypatch.setattr(command, "write_whole", write)
    summary, _ = ended(ran(), findings=findings)
    assert not summary["success"]
    assert [FULL in why and FOUND in why for why in summary["unwritten"]] == [True]
    assert written[-1] != FOUND


@pytest.mark.parametrize("served", [True, False])
@pytest.mark.parametrize("agrees", [True, False])
def test_the_homing_file_is_written_when_the_operator_has_agreed(monkeypatch, agrees, served):
    done: list[str] = []
    monkeypatch.setattr(Terminal, "consent", lambda *_: agrees or _refuse())
    monkeypatch.setattr(command, "state_lengths", lambda *_: done.append("stated"))

    def run(*_, on_bench, **__):
        done.append("on a bench" if on_bench else "ran")
        stood = {"stretches": 2, "longest_ms": 7.5}
        return {"success": False, "trouble": "x", "faults": ["BRAKE"], "bench_time": stood}

    monkeypatch.setattr(command, "run_daemon", run)
    said = command._Said(lambda _: None, Recorder("x", 0))  # type: ignore[arg-type]
    agree = Terminal(said).consent
    together = command._release(load("virtual"), None, None, said, agree, served=served)  # type: ignore[arg-type]
    assert done == (["on a bench"] if served else ["stated", "ran"]) * agrees
    assert together.brake_failed is agrees
    assert any("bench time stood still 2 times, 7.5 ms at most" in line for line in together.lines) is agrees


def test_a_state_that_cannot_be_written_is_one_line_with_its_path(tmp_path):
    store = Store(tmp_path / "gone" / "s.json", {})
    with pytest.raises(RunError, match=r"gone/s\.json: the state cannot be written \(.+\)\. It keeps"):
        store.save()
