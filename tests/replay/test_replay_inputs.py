"""A replayed tick is given each of its recorded inputs, as the type that the loop gave."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.frame_array import received_frames
from drivers.protocol import Frame, Received
from drivers.signals import LEGS, BusState
from drivers.tick_columns import INPUT_COLUMNS, ROW
from hil.loop.replay import recorded_input
from hil.record.entries import Tick
from hil.signals import Operator


def recorded(frames=(), operator=(), setpoints=(), orders=(), **columns):
    rows = np.zeros(1, ROW)
    for number, name in enumerate(INPUT_COLUMNS):
        rows[name] = 1000 * number + np.arange(LEGS if name == "latch_ns" else 1)
    rows["bus_state"], rows["recorder_alive"] = BusState.PASSIVE, 1
    for name, value in columns.items():
        rows[name] = value
    row: Any = rows[0]
    return Tick(row, frames, (), operator, setpoints, orders)


def test_each_number_of_a_recorded_input_comes_back_in_its_place():
    found = recorded_input(recorded())._asdict()
    for number, name in enumerate(INPUT_COLUMNS):
        if name in {"bus_state", "recorder_alive"}:
            continue
        whole = 1000 * number
        assert found[name] == (tuple(range(whole, whole + LEGS)) if name == "latch_ns" else whole), name
    assert found["bus_state"] is BusState.PASSIVE


@pytest.mark.parametrize("alive", [True, False])
def test_whether_the_recorder_lived_comes_back_as_yes_or_no(alive):
    assert recorded_input(recorded(recorder_alive=alive)).recorder_alive is alive


def test_frames_commands_set_points_and_orders_come_back_as_they_were_recorded():
    frames = (Received(7, Frame(0x181, b"\x01")), Received(9, Frame(0x182, b"\x02")))
    setpoints: Any = ("a pose", "another")
    orders: Any = ("an order",)
    found = recorded_input(recorded(frames, (int(Operator.STOP), int(Operator.RESET)), setpoints, orders))
    assert (received_frames(found.frames), found.operator) == (frames, (Operator.STOP, Operator.RESET))
    assert (found.setpoints, found.orders) == (setpoints, orders)
