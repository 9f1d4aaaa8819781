"""What is to be known of the figures of a what-if, and what of a tick its own log gets."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.frame_array import NO_FRAMES
from drivers.protocol import Frame
from drivers.signals import Mode
from hil.app.configuration.configuration import Configuration, load
from hil.config.reference import HoldReference, LiveReference
from hil.loop.what_if import Answer, OtherFrames
from hil.signals import Operator
from hil.study.what_if import command
from hil.study.what_if.picture import Forces

VIRTUAL = load("virtual")
ENVIRONMENT = {"version": "0.2.0", "git": "7dfb941", "cpu": "x86 of one maker"}
LIMITS: dict[str, Any] = {"velocity_m_s": 0.3, "acceleration_m_s2": 1, "jerk_m_s3": 10}
LIMITS |= {"velocity_deg_s": 20, "acceleration_deg_s2": 60, "jerk_deg_s3": 600}


@pytest.fixture
def remarks(monkeypatch):
    """A function that returns what is remarked of an answer; nothing, of one like its log, made here."""
    monkeypatch.setattr(command, "environment", lambda: dict(ENVIRONMENT))

    def remarked(
        answer=None, there=ENVIRONMENT, here: Configuration = VIRTUAL, closed="clean", mode=Mode.PARKED
    ):
        metadata = {"summary": {"closed": closed}, "environment": dict(there)}
        log: Any = SimpleNamespace(metadata=metadata, cut="")
        cycle: Any = SimpleNamespace(mode=mode)
        answer = answer or Answer()
        answer.last_mode = "PARKED"
        return command._remarks(log, here, answer, cycle)

    return remarked


def test_nothing_is_remarked_of_a_log_of_this_build_that_ends_as_it_did(remarks):
    assert remarks() == []


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (["version"], "version"),
        (["git"], "state of the sources"),
        (["cpu"], "CPU"),
        (["version", "cpu"], "version, CPU"),
        (["version", "git", "cpu"], "version, state of the sources, CPU"),
    ],
)
@pytest.mark.parametrize("lacking", [False, True])
def test_a_log_of_another_build_or_processor_is_said_to_be_so(remarks, other, named, lacking):
    there = {key: value for key, value in ENVIRONMENT.items() if key not in other}
    (found,) = remarks(there=there if lacking else there | dict.fromkeys(other, "another"))
    assert found.startswith(f"the log was made with another {named}: `hil replay` without --what-if says")


def test_set_points_that_no_other_reference_takes_are_counted(remarks):
    answer = Answer(setpoints=2)
    hold = VIRTUAL.model_copy(update={"reference": HoldReference(type="hold")})
    assert remarks(answer, here=hold) == [
        "the 2 set-points of the log are not followed: reference.type hold takes none"
    ]
    live = LiveReference.model_validate({"type": "live", "limits": LIMITS})
    assert remarks(answer, here=VIRTUAL.model_copy(update={"reference": live})) == []
    assert remarks(Answer(), here=hold) == []


@pytest.mark.parametrize(
    ("ticks", "said"),
    [([], False), ([49], False), ([50], False), ([51], True), ([49, 51], True), ([51, 49], True)],
)
def test_a_fault_past_the_first_other_frames_may_come_of_the_open_loop(remarks, ticks, said):
    faults = [{"tick": tick} for tick in ticks]
    frames = OtherFrames(50, 0.05, None, Frame(1, b""), (0,))
    found = remarks(Answer(first_frames=frames, answered_faults=faults))
    assert [each.partition(" may")[0] for each in found] == ["a fault after tick 50"] * said
    assert remarks(Answer(answered_faults=faults)) == [], "without other frames no loop is open"


def test_an_end_in_another_mode_and_what_a_log_lacks_are_said(remarks):
    assert remarks(mode=Mode.FAULT) == [
        "at the end of the log it is in FAULT, the recorded one in PARKED",
    ]
    (found,) = remarks(closed="no")
    assert found.startswith("the log was not closed by its run (no)")


def test_no_remark_hides_another(remarks):
    answer = Answer(setpoints=2, answered_faults=[{"tick": 51}])
    answer.first_frames = OtherFrames(50, 0.05, None, Frame(1, b""), (0,))
    hold = VIRTUAL.model_copy(update={"reference": HoldReference(type="hold")})
    found = remarks(answer, {**ENVIRONMENT, "cpu": "another"}, hold, closed="no", mode=Mode.FAULT)
    begins = ["the log was not closed", "the log was made with another CPU", "the 2 set-points"]
    begins += ["a fault after tick 50", "at the end of the log it is in FAULT"]
    assert [each[: len(begin)] for each, begin in zip(found, begins, strict=True)] == begins


@pytest.mark.parametrize("given", [((), (), ()), ((Operator.STOP,), (), ())])
def test_the_log_of_an_answer_gets_the_inputs_of_each_tick_with_what_is_answered(given, monkeypatch):
    called: list[Any] = []
    entry: Any = SimpleNamespace(operator=given[0], setpoints=given[1], orders=given[2])
    recorded = (["row"], "frames", "ends")
    block: Any = SimpleNamespace(ticks=SimpleNamespace(recorded=lambda _: recorded), span=0, entries=[entry])

    def what_if(log, cycle, *, observe, keep, progress):
        called.append((log, cycle, keep, progress))
        if observe is not None:
            observe(block)
        return Answer(ticks=1)

    monkeypatch.setattr(command, "what_if", what_if)
    ticks: list[Any] = []

    def take(*what):
        ticks.append(what)

    recording: Any = SimpleNamespace(tick_of_items=take, ticks_of_items=take)
    forces = Forces()
    these: tuple[Any, Any] = ("log", "cycle")
    assert command._answer(*these, recording, forces, print).ticks == 1
    assert ticks == [("row", "frames", NO_FRAMES, *given) if any(given) else recorded]
    assert command._answer(*these, None, None, None).ticks == 1
    assert called == [(*these, forces.keep, print), (*these, None, None)]
    assert len(ticks) == 1
