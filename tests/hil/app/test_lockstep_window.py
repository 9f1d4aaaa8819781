"""When the controller of a simulation computes: with the last feedback, or when its window is over."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.arrays import array_at
from drivers.frame_array import FRAME, NO_FRAMES, timed_array
from drivers.protocol import Frame
from hil.app.sim.wire_kernels import DONE, answer, begin
from hil.app.sim.wires import Wires
from tests.drivers.stub_protocol import InPython

BEGUN_NS, WINDOW_NS = 1_000_000, 500
FRAMES = {name: Frame(0x100 + n, b"", 0) for n, name in enumerate("abc")}
NS = 100
"""Of each frame on the wire."""


def exchanged(wanted: str, replies: dict[str, int], stale: str = "") -> tuple[list[str], list[str], int]:
    """Return which feedbacks were heard, which come later, and when it computes, ns from the tick's start.

    replies : when each is queued, ns from the tick's start; stale : what answers an earlier tick.
    """
    ids = {name: frame.id for name, frame in FRAMES.items()}
    waited = [ids[name] for name in wanted]

    def place(_context: int, at: int, _tick: int, _since_ns: int) -> int:
        number = int(array_at(at, 1, FRAME)["id"][0])
        return 0 if number in {ids[name] for name in stale} else 1 + [*waited, number].index(number)

    family: Any = SimpleNamespace(
        fresh_by=InPython(place, 4), addressed_by=SimpleNamespace(address=0), context=0, wanted=tuple(waited)
    )
    wires = Wires([None], family)
    wires.times_ns[:] = NS
    sent = timed_array([(BEGUN_NS + at, FRAMES[name]) for name, at in replies.items()])
    deadline_ns = BEGUN_NS + WINDOW_NS
    assert begin(wires.record, NO_FRAMES, BEGUN_NS, deadline_ns) == DONE
    assert answer(wires.record, sent, 7, BEGUN_NS, deadline_ns) == DONE
    heard, late = np.split(wires.late[: wires.record["late"]], [int(wires.record["taken"])])
    names = {number: name for name, number in ids.items()}
    answers, rest = ([names[number] for number in each["id"].tolist()] for each in (heard, late))
    return answers, rest, int(wires.record["step_ns"]) - BEGUN_NS


@pytest.mark.parametrize(
    ("replies", "heard", "late", "at_ns"),
    [
        ({"a": 0, "b": 10, "c": 20}, ["a", "b", "c"], [], 300),
        ({"a": 0, "b": 10, "c": 400}, ["a", "b", "c"], [], 500),
        ({"a": 0, "b": 10, "c": 401}, ["a", "b"], ["c"], 500),
        ({"a": 0, "b": 350, "c": 360}, ["a", "b"], ["c"], 500),
        ({"a": 0, "b": 480, "c": 490}, ["a"], ["b"], 500),
        ({"a": 0, "b": 10}, ["a", "b"], [], 500),
        ({}, [], [], 500),
    ],
)
def test_it_computes_with_its_last_feedback_and_no_later_than_its_window_ends(
    replies: dict[str, int], heard: list[str], late: list[str], at_ns: int
) -> None:
    assert exchanged("abc", replies) == (heard, late, at_ns)


def test_what_answers_an_earlier_tick_is_heard_and_waited_for_all_the_same() -> None:
    assert exchanged("ab", {"a": 0, "b": 150}, stale="a") == (["a", "b"], [], 500)
    assert exchanged("ab", {"a": 0, "b": 150}) == (["a", "b"], [], 250)


def test_what_comes_behind_the_last_feedback_is_of_the_next_tick() -> None:
    assert exchanged("ab", {"a": 0, "b": 10, "c": 20}) == (["a", "b"], ["c"], 200)
