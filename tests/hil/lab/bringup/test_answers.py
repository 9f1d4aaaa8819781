"""What an operator may type: numbers, words, nonsense, nothing; and a state file that is damaged."""

import json
import os

import pytest

from drivers.errors import ConfigurationError, RunError
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.lab.bringup.command import run_bringup
from hil.lab.bringup.context import RefusedError, Request
from hil.lab.bringup.procedure import STEPS
from hil.lab.bringup.rehearsal import wiring_of
from hil.lab.bringup.steps import gauge
from hil.lab.bringup.store import Store, identity
from hil.lab.bringup.terminal import Terminal
from plant_fmu.rehearsal.wiring import MISTAKES, RANGES, Wiring
from tests.hil.lab.bringup.families import family
from tests.hil.lab.bringup.kit import Rehearsal

VIRTUAL = build_protocol(load("virtual"))
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
    return {"version": 5, "identity": {}, "facts": facts, **changes}


ENCODER = {"drive": 0, "tape_m": [0.55, 0.85], "scale": 1.0, "offset_m": 0.0, "bent_m": 0.0}
WAY = {"force_N": 1.0, "leg": 0, "way": 1}


def test_facts_of_a_step_are_a_state(tmp_path):
    path = tmp_path / "state.json"
    path.write_text(
        json.dumps(state_with({"encoder": {"0": ENCODER}, "force": {"0": {"plus": WAY, "minus": WAY}}}))
    )
    assert Store(path, {}).facts["encoder"]["0"] == ENCODER


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
        json.dumps(state_with({"opens": {"2": {"legs": [17], "hand_N": 1.0, "rate_share": 1.0}}})),
        json.dumps(state_with({"ids": {"0": {"drives": [-1], "changes_m": [0.0] * 6}}})),
        json.dumps(state_with({"encoder": {"0": ENCODER | {"drive": 99}}})),
        json.dumps(state_with({"force": {"0": {"plus": WAY | {"leg": 6}, "minus": WAY}}})),
        json.dumps(state_with({"force": {"0": {"plus": WAY, "minus": WAY | {"way": 2}}}})),
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


def test_what_a_bring_up_has_kept_is_read_again_and_a_fact_that_is_gone_is_measured(tmp_path):
    rehearsal = Rehearsal("virtual", Wiring())
    store = Store(tmp_path / "state.json", {})
    rehearsal.context.facts = store.facts
    rehearsal.run()
    store.save()
    assert Store(tmp_path / "state.json", {}).facts == store.facts
    assert set(store.facts) >= {"scan", "watchdog", "ids", "encoder", "held", "opens", "force", "gauge"}
    del store.facts["gauge"]["1"], store.facts["held"]["2"]
    again = Rehearsal("virtual", Wiring(), facts=store.facts)
    assert again.run().passed == tuple(step.name for step in STEPS)
    asked = [(request.act, request.leg) for request in again.hands.requests]
    assert [each for each in asked if each[0] in {"read_gauge", "read_held"}] == [
        ("read_held", 2),
        *[("read_gauge", 1)] * 4,
    ]
    store.facts["encoder"]["3"]["scale"] = 0.0
    assert gauge.judge(again.context) == [], "what no encoder counts has no lead"


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
        wiring_of([words], VIRTUAL)


@pytest.mark.parametrize(
    ("words", "wrong", "allowed"),
    [
        ("friction leg=2 value=-1", "value=-1", "0 to 1"),
        ("absent leg=1 value=3", "absent has no size", "no value="),
        ("ids_swapped leg=1 other=2 value=1", "ids_swapped has no size", "no value="),
        ("offset leg=2 leg=3", "'leg=3': leg is given twice", "once"),
        ("offset leg=1 value=100", "value=100", "-0.1 to 0.1"),
        ("encoder_scale leg=1 value=1e9", "value=1e+09", "0.01 to 100"),
        ("brake_weak leg=1 value=5", "value=5", "0 to 1"),
        ("force_sign leg=1 value=1", "value=1", "-4 to -0.25"),
        ("watchdog_short leg=1 value=0", "value=0", "0.01 to 1"),
        ("offset leg=1 value=nan", "'value=nan'", "a finite number"),
        ("offset leg", "'leg'", "a finite number"),
        ("offset leg=1 value=0", "nothing is wired wrongly", "changes something"),
        ("payload leg=1", "given: leg=1", "payload without legs"),
    ],
)
def test_a_mistake_of_a_size_that_cannot_be_is_refused_with_what_is_allowed(words, wrong, allowed):
    with pytest.raises(ConfigurationError) as caught:
        wiring_of([words], VIRTUAL)
    before, _, after = str(caught.value).partition("allowed: ")
    assert before.startswith(f"--mistake {words!r}: ")
    assert wrong in before.removeprefix(f"--mistake {words!r}: ")
    assert allowed in after


def test_mistakes_that_undo_each_other_are_none():
    with pytest.raises(ConfigurationError, match="nothing is wired wrongly"):
        wiring_of(["encoder_sign leg=2"] * 2, VIRTUAL)


@pytest.mark.parametrize("name", ["watchdog_missing", "watchdog_long", "watchdog_short"])
def test_drives_without_a_watchdog_cannot_have_a_wrong_one(name):
    with pytest.raises(ConfigurationError, match=r"these drives have no watchdog.*allowed: "):
        wiring_of([f"{name} leg=1"], build_protocol(family("cubemars")))
    assert wiring_of([f"{name} leg=1"], build_protocol(family("damiao"))) != Wiring()


def test_every_mistake_has_its_usual_size_within_its_range():
    sized = {name for name, (_, legs, size, _) in MISTAKES.items() if legs <= 1 and size is not None}
    assert set(RANGES) <= sized
    assert all(low <= (MISTAKES[name][2] or 0.0) <= high for name, (low, high) in RANGES.items())


def test_a_refused_mistake_is_said_before_anything_of_the_state_file(tmp_path):
    state = tmp_path / "state.json"
    said: list[str] = []
    Store(state, identity(load("virtual"), ("offset leg=1",))).save()
    with pytest.raises(ConfigurationError, match="--mistake"):
        run_bringup(
            "virtual", load("virtual"), mistakes=["offset leg=9"], state=state, yes=True, say=said.append
        )
    assert said == []


def test_a_bench_that_reads_what_cannot_be_ends_after_five_readings_and_says_why():
    rehearsal = Rehearsal("virtual", Wiring())
    rehearsal.hands.answer = lambda: -1.0  # type: ignore[method-assign]
    request = Request("read_push", 2, 0.0, "Read the gauge at leg 2", within=(0.0, 50.0))
    with pytest.raises(RefusedError, match=r"leg 2: 5 readings refused.*-1, allowed: 0 to 50"):
        rehearsal.context.ask(request)
    assert rehearsal.hands.requests == [request] * 5


def test_the_legs_of_a_mistake_are_those_that_are_named():
    assert wiring_of(["ids_rotated leg=1 other=2 third=4"], VIRTUAL).motor == (0, 2, 4, 3, 1, 5)
    assert wiring_of(["payload value=3", "upside_down"], VIRTUAL) == Wiring(payload=3.0, gravity=-1.0)
    brakes = wiring_of(["brake_of_another leg=1 other=4"], VIRTUAL).brake
    assert [sorted(legs) for legs in brakes] == [[0], [1, 4], [2], [3], [4], [5]]
