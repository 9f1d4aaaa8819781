"""When the controller of a simulation computes: with the last feedback, or when its window is over."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.can.arbitration import priority
from drivers.protocol import ALWAYS, Frame
from hil.app.sim.lockstep import Lockstep

BEGUN_NS, WINDOW_NS = 1_000_000, 500
FRAMES = {name: Frame(0x100 + n, b"", 0) for n, name in enumerate("abc")}
NS = 100
"""Of each frame on the wire."""


def exchanged(wanted: str, replies: dict[str, int], stale: str = "") -> tuple[list[str], list[str], int]:
    """Return which feedbacks were heard, which come later, and when it computes, ns from the tick's start.

    replies : when each is queued, ns from the tick's start; stale : what answers an earlier tick.
    """
    lockstep: Any = object.__new__(Lockstep)
    lockstep.__dict__.update(
        tick=7, window_ns=WINDOW_NS, free_ns=ALWAYS, timing=None, wanted={FRAMES[name].id for name in wanted},
        fresh=lambda answer, tick, t_ns: answer.frame.id not in {FRAMES[name].id for name in stale},
        awaited=lambda frame: frame.id, _queued=[], _number=0, _late=[], _commands=[], _bursts={},
        _shapes={(f.id, 0, 0): (priority(f.id, 0), NS) for f in FRAMES.values()},
        cycle=SimpleNamespace(parts=SimpleNamespace(protocol=SimpleNamespace(unasked_s=0.0))),
        nodes=SimpleNamespace(step=lambda *_: [(BEGUN_NS + at, FRAMES[name]) for name, at in replies.items()]),
    )  # fmt: skip
    lockstep._open = lambda *_: None
    answers, step_ns = lockstep._exchange(BEGUN_NS, ())
    names = {frame: name for name, frame in FRAMES.items()}
    heard, late = ([names[each.frame] for each in them] for them in (answers, lockstep._late))
    return heard, late, step_ns - BEGUN_NS


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
