"""What an operator may type: numbers, words, nonsense, nothing; and a state file that is damaged."""

import json
import os

import pytest

from drivers.errors import ConfigurationError, RunError
from hil.app.bringup.store import Store, identity
from hil.app.bringup.terminal import Terminal
from hil.app.bringup.words import wiring_of
from hil.app.configuration.configuration import load
from hil.bringup.context import RefusedError, Request
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.bringup.kit import Rehearsal

MEASURE = Request("measure", 1, 0.0, "Measure leg 1")
PUSH = Request("push", 1, 0.0, "Push leg 1")
DOWN = Request("take_down", text="Take the platform off", word="down")


@pytest.fixture
def typing():
    """A terminal, what it has said, and a function that types."""
    reading, writing = os.pipe()
    said: list[str] = []
    with os.fdopen(reading) as source, os.fdopen(writing, "wb", buffering=0) as pipe:
        yield Terminal(said.append, source), said, pipe


def test_a_comma_is_a_decimal_point_and_what_was_read_is_said(typing):
    terminal, said, pipe = typing
    terminal.ask(MEASURE)
    pipe.write(b"0,326\n")
    assert terminal.answer() == 0.326
    assert said[-1].strip() == "read as 0.326"


@pytest.mark.parametrize(
    "typed", [b"\n", b"1.2.3\n", b"1,234.5\n", b"nan\n", b"inf\n", b"0.3 m\n", b"\xff\xfe\n"]
)
def test_what_is_no_number_is_asked_again_and_is_no_answer(typing, typed):
    terminal, said, pipe = typing
    terminal.ask(MEASURE)
    pipe.write(typed)
    assert terminal.answer() is None
    assert "is no number" in said[-1]
    pipe.write(b"0.3\n")
    assert terminal.answer() == 0.3


def test_a_number_is_not_taken_for_the_enter_of_an_act(typing):
    terminal, said, pipe = typing
    terminal.ask(PUSH)
    pipe.write(b"0.3\n")
    assert terminal.answer() is None
    assert "Enter when it is done" in said[-1]
    pipe.write(b"\n")
    assert terminal.answer() == 0.0


@pytest.mark.parametrize("typed", [b"\n", b"yes\n", b"0\n"])
def test_a_promise_needs_its_word(typing, typed):
    terminal, said, pipe = typing
    terminal.ask(DOWN)
    pipe.write(typed)
    assert terminal.answer() is None
    assert "type `down`" in said[-1]
    pipe.write(b"Down\n")
    assert terminal.answer() == 0.0


def test_what_was_typed_ahead_waits_its_turn(typing):
    """A buffered reader takes all lines at once: the second answer then waits for a third one."""
    terminal, _, pipe = typing
    pipe.write(b"0.3\n0.4\n\n")
    for expected in (0.3, 0.4):
        terminal.ask(MEASURE)
        assert terminal.answer() == expected
    terminal.ask(PUSH)
    assert terminal.answer() == 0.0


def test_the_end_of_the_input_ends_in_the_middle_of_a_question(typing):
    terminal, _, pipe = typing
    terminal.ask(MEASURE)
    pipe.close()
    with pytest.raises(RefusedError, match="ended by the operator"):
        terminal.answer()


def test_consent_is_asked_until_it_is_enter_or_no(typing):
    terminal, said, pipe = typing
    pipe.write(b"what?\n\nno\n")
    assert terminal.consent("step", "does", "Ctrl-C")
    assert "is no answer" in said[-1]
    with pytest.raises(RefusedError):
        terminal.consent("step", "does", "Ctrl-C")


def state_with(facts: object, **changes: object) -> dict[str, object]:
    return {"version": 3, "identity": {}, "facts": facts, **changes}


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "\x00",
        "[]",
        "[" * 100_000,
        '"text"',
        json.dumps(state_with([])),
        json.dumps(state_with({}, identity=[1])),
        json.dumps(state_with({"encoder": []})),
        json.dumps(state_with({"encoder": {"0": {"drive": 0}}})),
        json.dumps(state_with({"held": {"6": {"moved": True}}})),
        json.dumps(state_with({"held": {"0": {"moved": "no"}}})),
        json.dumps(state_with({"ids": {"0": {"drives": [True], "changes_m": [0.0] * 6}}})),
        json.dumps(state_with({"mounted": {"0": {"q_m": [0.3] * 5}}})),
        json.dumps(state_with({"mounted": {"0": {"q_m": [0.3] * 5 + [float("nan")]}}})),
        json.dumps(state_with({"nonsense": {}})),
    ],
    ids=lambda text: text[:40] or "empty",
)
def test_a_damaged_state_is_one_line_and_stays_as_it_is(tmp_path, text):
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(RunError) as caught:
        Store(path, {})
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "--state" in str(caught.value)
    assert path.read_text() == text


def test_what_a_bring_up_has_kept_is_read_again(tmp_path):
    rehearsal = Rehearsal("virtual", Wiring())
    store = Store(tmp_path / "state.json", {})
    rehearsal.context.facts = store.facts
    rehearsal.run()
    store.save()
    assert Store(tmp_path / "state.json", {}).facts == store.facts
    assert set(store.facts) >= {"scan", "watchdog", "ids", "encoder", "held", "opens", "force", "gauge"}


def test_a_new_beginning_still_knows_that_the_platform_hangs(tmp_path):
    c = load("virtual")
    path = tmp_path / "state.json"
    store = Store(path, identity(c, ()))
    store.facts |= {"platform": {"hung": True}, "held": {"0": {"moved": False, "hand_N": 700.0}}}
    store.save()
    assert Store(path, identity(c, ()), again=True).facts == {"platform": {"hung": True}}
    assert Store(path, identity(c, ("other",))).facts == {"platform": {"hung": True}}


@pytest.mark.parametrize(
    "words",
    [
        "",
        "encoder_sign",
        "encoder_sign other=2",
        "encoder_sign leg=1.5",
        "encoder_sign leg=1 other=2",
        "ids_swapped leg=1",
        "ids_rotated leg=1 other=2",
        "same_id leg=1",
        "brake_of_another leg=3",
        "encoder_sign leg=nan",
    ],
)
def test_a_mistake_names_its_legs_or_is_refused(words):
    with pytest.raises(ConfigurationError, match="--mistake"):
        wiring_of([words])


def test_the_legs_of_a_mistake_are_those_that_are_named():
    assert wiring_of(["ids_rotated leg=1 other=2 third=4"]).motor == (0, 2, 4, 3, 1, 5)
    brakes = wiring_of(["brake_of_another leg=1 other=4"]).brake
    assert [sorted(legs) for legs in brakes] == [[0], [1, 4], [2], [3], [4], [5]]
