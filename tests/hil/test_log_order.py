"""In which order the messages of a log lie in its file."""

from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from drivers.tick_columns import ROW
from hil.record.decode import ITEM
from hil.record.entries import assemble
from hil.signals import Operator, Order
from tests.hil.samples import log_of, random_ticks


def test_the_messages_of_a_tick_lie_behind_its_row_and_before_the_next_one(tmp_path_factory):
    ticks = random_ticks(40, seed=7)
    topics: dict[int, str] = {}
    found: list[list[str]] = []
    with log_of(ticks, tmp_path_factory).open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                if topics[record.channel_id] == "/tick":
                    found.append([])
                found[-1].append(topics[record.channel_id])
    counts = [sum(topic == "/can" for topic in group) for group in found]
    assert counts == [len(tick.received) + len(tick.sent) for tick in ticks]
    assert len(set(counts)) > 1


def test_what_is_drawn_of_a_tick_lies_behind_its_frames_and_before_the_next_row(tmp_path_factory):
    ticks = random_ticks(100, seed=7)
    for tick in ticks:
        for name in ("p", "p_d", "R", "R_d"):
            tick.row[name] = 0.5
    topics: dict[int, str] = {}
    found: dict[int, list[str]] = defaultdict(list)
    order: list[int] = []
    with log_of(ticks, tmp_path_factory).open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                found[record.sequence].append(topics[record.channel_id])
                order.append(record.sequence)
    assert order == sorted(order)
    for k, tick in enumerate(ticks):
        views = ["/tf", "/tf"] if k % 33 == 0 else []
        commands = len(tick.operator) + len(tick.setpoints) + len(tick.orders)
        frames = len(tick.received) + len(tick.sent)
        assert found[k] == ["/tick", *["/can"] * frames, *["/operator"] * commands, *views]


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (1, 3, 0, 2)])
def test_commands_of_a_tick_are_given_by_their_number_in_it_wherever_another_writer_put_them(order):
    given = [
        (0, Operator.SPEED, (0.5,)), (1, Operator.SETPOINT, (0.0,) * 6), (2, Operator.START, ()),
        (3, Operator.SPEED, (1.0,)),
    ]  # fmt: skip
    operator = [(4, Operator.STOP, ()), (5, Operator.RESET, ())]
    rows = np.zeros(1, ROW)
    rows["tick"] = 7
    commands: Any = {7: [given[k] for k in order] + operator[:: 1 if order[0] < 2 else -1]}
    (tick,) = assemble(rows, np.zeros(0, ITEM), commands)
    assert tick.orders == (
        Order(Operator.SPEED, (0.5,)),
        Order(Operator.START),
        Order(Operator.SPEED, (1.0,)),
    )
    assert (tick.operator, len(tick.setpoints)) == ((Operator.STOP, Operator.RESET), 1)
