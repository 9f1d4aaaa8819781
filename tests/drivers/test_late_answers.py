"""Answers without a counter that come later than their tick: whose they are, and when a node is doubled."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.frame_array import received_array
from drivers.protocol import Received
from drivers.signals import LEGS
from hil.contracts.ends import PERIOD_NS, Ends, at_tick
from tests.drivers.test_mit import run_protocols

LEG = 2


class Late:
    """A controller that hears, a tick, as many answers of one leg as it is told, each of another length."""

    def __init__(self, make: Any) -> None:
        self.ends = Ends(make())
        self.ends.until_set_up()
        self.ends.step()
        awaited = self.ends.protocol.awaited
        self.others = [each for each in self.ends.received if awaited(each.frame) not in {-1, LEG}]
        self.answer = next(each for each in self.ends.received if awaited(each.frame) == LEG)
        self.last, self.dialogue, self.said = self.ends.measurement, self.ends.dialogue, 0

    def hears(self, count: int) -> Any:
        """Return the next tick's measurement."""
        m = at_tick(int(self.last["tick"]) + 1)
        begun = int(m["tick"]) * PERIOD_NS
        frames = [Received(begun + 1, each.frame) for each in (*self.others, *self.answers(count))]
        self.dialogue = self.ends.protocol.decode(self.dialogue, received_array(frames), self.last, m, begun)
        self.last = m
        return m

    def answers(self, count: int) -> list[Received]:
        """Return answers of the leg that differ from each other and from all before."""
        found = []
        for _ in range(count):
            self.said += 1
            data = self.answer.frame.data
            changed = data[0], data[1] ^ self.said, *data[2:]
            found.append(self.answer._replace(frame=self.answer.frame._replace(data=bytes(changed))))
        return found


@pytest.mark.parametrize("ticks", [1, 2, 5])
@pytest.mark.parametrize(("make", "_fault"), run_protocols())
def test_answers_that_stay_late_and_catch_up_are_of_one_node_and_the_newest_counts(make, _fault, ticks):
    late = Late(make)
    heard = [late.hears(count) for count in (0, *[1] * ticks, 2)]
    newest = Late(make)
    newest.said = late.said - 1
    assert [m["doubled"] for m in heard] == [0] * (ticks + 2)
    assert heard[-1]["length"][LEG] == newest.hears(1)["length"][LEG]
    assert heard[-1]["length"][LEG] != heard[-2]["length"][LEG]
    assert heard[-1]["age"].tolist() == [0] * LEGS


@pytest.mark.parametrize(("make", "_fault"), run_protocols())
def test_answers_of_several_ticks_come_at_once_and_no_more_than_were_asked_for(make, _fault):
    late = Late(make)
    assert [late.hears(count)["doubled"] for count in (0, 0, 0, 4, 1)] == [0] * 5
    late = Late(make)
    assert [late.hears(count)["doubled"] for count in (0, 0, 0, 5)] == [0, 0, 0, 1 << LEG]


@pytest.mark.parametrize(("make", "_fault"), run_protocols())
def test_a_second_node_is_named_once_it_has_said_what_answers_were_missing(make, _fault):
    late = Late(make)
    missing = [late.hears(0)["doubled"] for _ in range(3)]
    heard = [late.hears(2)["doubled"] for _ in range(5)]
    assert missing + heard == [0] * 6 + [1 << LEG] * 2
