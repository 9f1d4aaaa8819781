"""The input of a tick and the columns of its record that hold it."""

import struct
from collections.abc import Sequence
from typing import Any

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.signals import BusState
from drivers.tick_columns import INPUT_COLUMNS, INPUT_ELEMENTS
from hil.signals import Operator, Order, SetPoint, TickInput

_INPUT = struct.Struct(f"<{INPUT_ELEMENTS}q")
"""The columns of TickInput stand first in the row, in the order of INPUT_COLUMNS."""
_FRAMES = TickInput._fields.index("frames")
_STATE, _ALIVE, _COMPUTE = map(INPUT_COLUMNS.index, ("bus_state", "recorder_alive", "compute_ns"))
"""Where TickInput has what no column holds or is no integer. latch_ns, the last column, is six."""
_STATES = {int(state): state for state in BusState}


def put_input(tick: Any, inp: TickInput) -> None:
    """Put an input into its columns of a tick's record."""
    _INPUT.pack_into(
        tick, 0, inp.tick,
        inp.t_ns, inp.lateness_ns, inp.skipped, inp.stretched_ns, inp.sync_skew_ns, inp.sends_failed,
        inp.bus_errors, inp.bus_off, inp.bus_overflow, inp.bus_state, inp.recorder_alive,
        inp.recorder_dropped, inp.compute_ns, *inp.latch_ns,
    )  # fmt: skip


def input_of(
    row: Any,
    frames: Rows,
    operator: Sequence[int] = (),
    setpoints: tuple[SetPoint, ...] = (),
    orders: tuple[Order, ...] = (),
) -> TickInput:
    """Return the input of a tick from its row, and from what no column holds.

    Raises LogError for a row that no cycle writes.
    """
    numbers = _INPUT.unpack_from(row)
    tick, alive, state = numbers[0], numbers[_ALIVE], _STATES.get(numbers[_STATE])
    if alive not in (0, 1):
        raise LogError(f"the row of tick {tick} is damaged: {alive} is not a valid recorder_alive")
    if state is None:
        raise LogError(f"the row of tick {tick} is damaged: {numbers[_STATE]} is not a valid BusState")
    try:
        words = tuple(map(Operator, operator))
    except ValueError as error:
        raise LogError(f"the row of tick {tick} is damaged: {error}") from None
    values: Sequence[Any] = (
        *numbers[:_FRAMES],
        frames,
        *numbers[_FRAMES:_STATE],
        state,
        alive == 1,
        *numbers[_ALIVE + 1 : _COMPUTE],
        words,
        numbers[_COMPUTE],
        numbers[_COMPUTE + 1 :],
        setpoints,
        orders,
    )
    return TickInput(*values)
