"""What the plant's process sends after a stall: of each feedback the newest, and all that is no feedback."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.frame_array import sent_frames, timed_array
from drivers.protocol import BUS, Frame
from hil.app.plant import latest as latest_rows


def latest(queued: list[tuple[int, Frame]], now_ns: int, protocol: Any) -> list[Frame]:
    """Return what goes out, as frames."""
    return [*sent_frames(latest_rows(timed_array(queued), now_ns, protocol))]


T, LATER, LATEST = 1_000_000, 2_000_000, 3_000_000
PROTOCOL: Any = SimpleNamespace(
    traits=SimpleNamespace(feedback_ids={0x101, 0x102, 0x103}), awaited=lambda frame: frame.id
)
SHARED: Any = SimpleNamespace(
    traits=SimpleNamespace(feedback_ids={1, 2, 3}), awaited=lambda frame: frame.data[0]
)


def test_answers_that_are_out_of_date_are_not_sent() -> None:
    old = [(T, Frame(0x101, b"1")), (T, Frame(0x102, b"1")), (T, Frame(0x1A0, b"s"))]
    new = [(LATER, Frame(0x101, b"2")), (LATER, Frame(0x102, b"2")), (LATEST, Frame(0x102, b"3"))]
    kept = [Frame(0x101, b"2"), Frame(0x102, b"3"), Frame(0x1A0, b"s")]
    assert latest(old + new, LATEST, PROTOCOL) == kept


def test_one_answer_each_goes_out_as_it_is() -> None:
    frames = [Frame(0x103, b"1"), Frame(0x101, b"1")]
    assert latest([(T, frames[0]), (LATER, frames[1])], LATER, PROTOCOL) == frames
    assert latest([], LATER, PROTOCOL) == []


def test_drives_that_answer_on_one_identifier_all_answer() -> None:
    old = [Frame(0x000, bytes((node, 1))) for node in (1, 2, 3)]
    new = [Frame(0x000, bytes((node, 2))) for node in (2, 3)]
    queued = [*((T, frame) for frame in old), *((LATER, frame) for frame in new)]
    assert latest(queued, LATER, SHARED) == [old[0], *new]


def test_drives_of_two_buses_with_one_identifier_both_answer() -> None:
    one, two = Frame(0x101, b"1"), Frame(0x101, b"2", BUS)
    assert latest([(T, one), (LATER, two)], LATER, PROTOCOL) == [one, two]


@pytest.mark.parametrize("instants", [(T, T), (T, LATER)])
def test_two_answers_of_one_instant_are_two_nodes_and_both_go_out(instants: tuple[int, ...]) -> None:
    """The same where an older answer of both is out of date."""
    first = [(instants[0], Frame(0x101, bytes((node, 1)))) for node in (1, 2)]
    last = [(instants[1], Frame(0x101, bytes((node, 2)))) for node in (1, 2)]
    queued = first + last if instants[0] != instants[1] else last
    assert latest(queued, LATER, PROTOCOL) == [frame for _, frame in last]


def test_what_is_no_feedback_goes_out_each_time_it_was_sent() -> None:
    """Answers to several requests, frames of a node that should not be there."""
    queued = [(t_ns, Frame(0x0, bytes((n,)))) for n, t_ns in enumerate((T, T, LATER, LATEST))]
    assert latest(queued, LATEST, PROTOCOL) == [frame for _, frame in queued]


def test_what_is_not_yet_to_be_on_the_bus_makes_nothing_out_of_date() -> None:
    queued = [(T, Frame(0x101, b"1")), (LATER, Frame(0x102, b"1")), (LATEST, Frame(0x101, b"2"))]
    assert latest(queued, LATER, PROTOCOL) == [Frame(0x101, b"1"), Frame(0x102, b"1")]
