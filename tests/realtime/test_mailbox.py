"""What the plant's process sends after a stall: the newest of each identifier, in the order of the first."""

from __future__ import annotations

from drivers.protocol import Frame
from hil.app.plant import latest


def by_identifier(_frame: Frame) -> int:
    return -1


def test_answers_that_are_out_of_date_are_not_sent() -> None:
    old = [Frame(0x101, b"1"), Frame(0x102, b"1"), Frame(0x1A0, b"s")]
    new = [Frame(0x101, b"2"), Frame(0x102, b"2")]
    assert latest(old + new, by_identifier) == [Frame(0x101, b"2"), Frame(0x102, b"2"), Frame(0x1A0, b"s")]


def test_one_answer_each_goes_out_as_it_is() -> None:
    frames = [Frame(0x103, b"1"), Frame(0x101, b"1")]
    assert latest(frames, by_identifier) == frames


def test_drives_that_answer_on_one_identifier_all_answer() -> None:
    old = [Frame(0x000, bytes((node, 1))) for node in (1, 2, 3)]
    new = [Frame(0x000, bytes((node, 2))) for node in (2, 3)]
    assert latest(old + new, lambda frame: frame.data[0]) == [old[0], *new]
