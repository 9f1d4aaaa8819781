"""Input of the operator at the terminal, and the text form of mistakes."""

import io
import os

import pytest

from drivers.errors import ConfigurationError
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.lab.bringup.context import RefusedError, Request
from hil.lab.bringup.rehearsal import wiring_of
from hil.lab.bringup.terminal import Terminal
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.lab.bringup.families import family

VIRTUAL = build_protocol(load("virtual"))
MEASURE = Request("measure", 1, 0.0, "Measure leg 1", within=(0.0, 1.0))
PUSH = Request("push", 1, 0.0, "Push leg 1")
DOWN = Request("take_down", text="Take the platform off", word="down")


@pytest.fixture
def typing():
    """A terminal, the list of its output, and the pipe to type into."""
    reading, writing = os.pipe()
    said: list[str] = []
    with os.fdopen(reading) as source, os.fdopen(writing, "wb", buffering=0) as pipe:
        yield Terminal(said.append, source), said, pipe


@pytest.mark.parametrize(
    ("request_", "refused", "typed", "answer"),
    [
        (MEASURE, (b"", b"1.2.3", b"1,234.5", b"nan", b"inf", b"0.3 m", b"\xff\xfe"), b"0,326", 0.326),
        (PUSH, (b"0.3",), b"", 0.0),
        (DOWN, (b"", b"yes", b"0"), b"Down", 0.0),
    ],
    ids=["a number", "Enter", "a word"],
)
def test_question_is_repeated_until_the_answer_is_valid(typing, request_, refused, typed, answer):
    terminal, said, pipe = typing
    terminal.ask(request_)
    assert terminal.answer() is None
    for wrong in refused:
        before = len(said)
        pipe.write(wrong + b"\n")
        assert terminal.answer() is None
        assert len(said) > before
    pipe.write(typed + b"\n")
    assert terminal.answer() == answer


def test_line_typed_ahead_at_the_terminal_answers_the_next_question(typing):
    """A buffered reader would take all lines at once: the second answer would then wait for a third line."""
    terminal, _, pipe = typing
    pipe.write(b"0.3\n0.4\n\n")
    for expected in (0.3, 0.4):
        terminal.ask(MEASURE)
        assert terminal.answer() == expected
    terminal.ask(PUSH)
    assert terminal.answer() == 0.0


@pytest.mark.parametrize("how", ["closed", "no"])
def test_no_or_end_of_input_ends_the_bring_up_during_a_question(typing, how):
    terminal, _, pipe = typing
    terminal.ask(MEASURE)
    if how == "closed":
        pipe.close()
    else:
        pipe.write(b"no\n")
    with pytest.raises(RefusedError, match="ended by the operator"):
        terminal.answer()


def test_consent_is_requested_until_enter_or_no_is_typed(typing):
    terminal, _, pipe = typing
    pipe.write(b"what?\n\nno\n")
    assert terminal.consent("step", "does", "Ctrl-C")
    with pytest.raises(RefusedError):
        terminal.consent("step", "does", "Ctrl-C")
    with pytest.raises(RefusedError):
        Terminal(lambda _: None, io.StringIO("")).consent("step", "does", "Ctrl-C")


REFUSED = [
    *("", "nonsense leg=1", "encoder_sign", "encoder_sign leg=1.5", "encoder_sign leg=1 other=2"),
    *(
        "ids_swapped leg=1",
        "ids_swapped leg=1 other=1",
        "offset leg=6",
        "offset leg=2 leg=3",
        "payload leg=1",
    ),
    *("friction leg=2 value=-1", "offset leg=1 value=nan", "offset leg=1 value=100", "offset leg=1 value=0"),
    *("payload mounting value=2", "offset leg=1 value=0 mounting"),
]


@pytest.mark.parametrize("words", REFUSED)
def test_invalid_option_mistake_is_refused_with_the_allowed_mistakes(words):
    with pytest.raises(ConfigurationError, match=r"--mistake.*allowed"):
        wiring_of([words], VIRTUAL)


def test_simulated_watchdog_mistakes_are_refused_for_drives_without_a_watchdog():
    with pytest.raises(ConfigurationError, match="no watchdog"):
        wiring_of(["watchdog_long leg=1"], build_protocol(family("cubemars")))
    assert wiring_of(["watchdog_long leg=1"], build_protocol(family("damiao"))) != Wiring()


def test_simulated_mistake_changes_the_wiring_of_the_given_legs_only():
    assert wiring_of(["ids_rotated leg=1 other=2 third=4"], VIRTUAL).motor == (0, 2, 4, 3, 1, 5)
    assert wiring_of(["payload value=3", "upside_down"], VIRTUAL) == Wiring(payload=3.0, gravity=-1.0)
    brakes = wiring_of(["brake_of_another leg=1 other=4"], VIRTUAL).brake
    assert [sorted(legs) for legs in brakes] == [[0], [1, 4], [2], [3], [4], [5]]
