"""Frames that the plant's process sends after a stall: the newest feedback of each kind, and all other frames."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.frame_array import sent_frames, timed_array
from drivers.protocol import BUS, Frame
from hil.app.plant import latest

T, LATER, LATEST = 1_000_000, 2_000_000, 3_000_000
OWN: Any = SimpleNamespace(
    traits=SimpleNamespace(feedback_ids={0x101, 0x102, 0x103}), awaited=lambda frame: frame.id
)
SHARED: Any = SimpleNamespace(
    traits=SimpleNamespace(feedback_ids={1, 2, 3}), awaited=lambda frame: frame.data[0]
)
A1, A2, A3, A4 = (Frame(0x101, bytes((n,))) for n in range(4))
B1, B2, B3 = (Frame(0x102, bytes((n,))) for n in range(3))
C, STATUS, ELSEWHERE = Frame(0x103, b"1"), Frame(0x1A0, b"s"), Frame(0x101, b"2", BUS)
OLD, NEW = ([Frame(0, bytes((node, n))) for node in (1, 2, 3)] for n in (1, 2))
OTHERS = [Frame(0x7E0, bytes((n,))) for n in range(3)]


@pytest.mark.parametrize(
    ("protocol", "queued", "now_ns", "sent"),
    [
        (
            OWN,
            [(T, A1), (T, B1), (T, STATUS), (LATER, A2), (LATER, B2), (LATEST, B3)],
            LATEST,
            [A2, B3, STATUS],
        ),
        (OWN, [(T, C), (LATER, A1)], LATER, [C, A1]),
        (OWN, [], LATER, []),
        (SHARED, [*((T, f) for f in OLD), (LATER, NEW[1]), (LATER, NEW[2])], LATER, [OLD[0], *NEW[1:]]),
        (OWN, [(T, A1), (T, ELSEWHERE)], LATER, [A1, ELSEWHERE]),
        (OWN, [(T, A1), (T, A2)], LATER, [A1, A2]),
        (OWN, [(T, A1), (T, A2), (LATER, A3), (LATER, A4)], LATER, [A3, A4]),
        (OWN, [(T, OTHERS[0]), (T, OTHERS[1]), (LATEST, OTHERS[2])], LATEST, OTHERS),
        (OWN, [(T, A1), (LATER, B1), (LATEST, A2)], LATER, [A1, B1]),
    ],
    ids=[
        "newest of each",
        "one of each",
        "nothing",
        "drives that share an identifier",
        "drives of two buses",
        "two nodes at one instant",
        "two nodes twice",
        "no feedback",
        "what is not yet to be on the bus",
    ],
)
def test_plant_process_sends_only_the_newest_feedback_of_each_drive_after_a_stall(
    protocol: Any, queued: list[tuple[int, Frame]], now_ns: int, sent: list[Frame]
) -> None:
    assert [*sent_frames(latest(timed_array(queued), now_ns, protocol))] == sent
