"""A row that no cycle has written ends a replay in a sentence."""

from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import ROW
from hil.loop.replay import recorded_input
from hil.record.entries import Tick


def tick(bus_state: int, operator: tuple[int, ...], alive: int = 1) -> Tick:
    rows = np.zeros(1, ROW)
    rows["tick"], rows["bus_state"], rows["recorder_alive"] = 17, bus_state, alive
    row: Any = rows[0]
    return Tick(row, (), (), operator)


@pytest.mark.parametrize(
    ("bus_state", "operator"), [(1 << 40, ()), (-1, ()), (5, ()), (1, (99,)), (1, (1, 0))]
)
def test_a_state_or_a_command_that_there_is_none_of_is_damage_with_its_tick(
    bus_state: int, operator: tuple[int, ...]
) -> None:
    with pytest.raises(LogError, match=r"^the row of tick 17 is damaged: .* is not a valid"):
        recorded_input(tick(bus_state, operator))


@pytest.mark.parametrize("alive", [2, -1, 256, 1 << 40])
def test_a_recorder_that_is_neither_alive_nor_gone_is_damage_with_its_tick(alive: int) -> None:
    """A replay would find another row, and no column of its own that differs."""
    with pytest.raises(
        LogError, match=rf"^the row of tick 17 is damaged: {alive} is not a valid recorder_alive"
    ):
        recorded_input(tick(1, (), alive))


def test_a_recorder_that_is_alive_or_gone_comes_back() -> None:
    assert [recorded_input(tick(1, (), alive)).recorder_alive for alive in (0, 1)] == [False, True]


def test_each_state_and_command_that_there_is_comes_back() -> None:
    found = [recorded_input(tick(state, (1, 2))) for state in range(5)]
    assert [int(each.bus_state) for each in found] == list(range(5))
    assert [int(each) for each in found[0].operator] == [1, 2]
