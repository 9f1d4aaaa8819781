"""Details of a what-if: faults listed once, time of the first differing frame, refused sensors."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.frame_array import NO_FRAMES, sent_array
from drivers.protocol import Frame
from drivers.sensing.settings import SensorSettings
from drivers.signals import Fault, Mode
from drivers.tick_columns import FIRST, ROW
from hil.app.configuration.configuration import load
from hil.loop import what_if as kernel
from hil.loop.replay import Block
from hil.loop.tick_row import Ticks
from hil.record.entries import Tick
from hil.study.what_if.inputs import refuse_other_inputs

FAULTS = {3: Fault.STALE, 9: Fault.STALE | Fault.SPEED, 13: Fault.NONE, 14: Fault.STALE}
"""Latched faults from a tick on: a second one next to the first, a reset, then the first one again."""
EXPECTED = [(3, "STALE"), (9, "SPEED"), (14, "STALE")]


def row_of(**columns):
    """A row with the given columns."""
    row: Any = np.zeros((), ROW)
    for name, value in columns.items():
        row[name] = value
    return row


def block_of(sides, frames=(), setpoints=()):
    """A block of ticks from (recorded, answered) rows, optionally with frames and set-points."""
    ticks = Ticks()
    answered = [sent_array(here) for _, here in frames] or [NO_FRAMES] * len(sides)
    ends = np.cumsum([len(each) for each in answered])
    ticks.frames[: ends[-1]] = np.concatenate(answered)
    ticks.ends[: len(sides)] = np.stack([ends - [len(each) for each in answered]] * 2 + [ends], axis=1)
    for k, (_, here) in enumerate(sides):
        ticks.row(k)[...] = here
    recorded = np.stack([there for there, _ in sides])
    sent = [there for there, _ in frames] or [()] * len(sides)
    poses = setpoints or [()] * len(sides)
    entries = [Tick(recorded[k], (), sent[k], (), poses[k]) for k in range(len(sides))]
    return Block(entries, recorded, ticks, slice(0, len(sides)))


def compared(sides, size):
    """The answer for rows of both sides, added in blocks of `size` ticks."""
    answer = kernel.Answer()
    both = kernel._Blocks(answer)
    for first in range(0, len(sides), size):
        both.add(block_of(sides[first : first + size]), lambda frame: (frame.id,))
    both.flush()
    return answer


@pytest.mark.parametrize("block", [1, 7])
def test_latched_fault_is_listed_once_for_any_block_size(block, monkeypatch):
    monkeypatch.setattr(kernel, "BLOCK", block)
    latched, sides = Fault.NONE, []
    for tick in range(20):
        latched = FAULTS.get(tick, latched)
        mode, t_ns = Mode.FAULT if latched else Mode.IDLE, 7_000_000 + 2_000_000 * tick
        row = row_of(tick=100 + tick, t_ns=t_ns, faults=latched, mode=mode)
        sides.append((row, row))
    answer = compared(sides, min(block, 3))
    assert [(each["tick"] - 100, each["fault"]) for each in answer.recorded_faults] == EXPECTED
    assert [each["time_s"] for each in answer.recorded_faults] == pytest.approx(
        [2e-3 * tick for tick, _ in EXPECTED], abs=1e-12
    )
    assert answer.last_mode == "FAULT"


VIRTUAL = load("virtual")
CYCLE: Any = SimpleNamespace(
    reset=lambda: None, mode=Mode.IDLE, mode_tick=0, reset_tick=None, faults=Fault.NONE, tick=FIRST, last=FIRST,
    parts=SimpleNamespace(protocol=SimpleNamespace(addressed=lambda frame: (frame.id,))),
)  # fmt: skip
"""A cycle without decisions; a frame is for the leg given by its identifier."""


def sensing(kind, **node):
    """A configuration with one sensor, or without any."""
    sensors = SensorSettings.model_validate({kind: node} if node else {})
    return VIRTUAL.model_copy(update={"sensors": sensors})


@pytest.mark.parametrize("kind", ["tracker", "imu", "wrench"])
def test_sensor_may_be_removed_but_not_added_or_moved(kind):
    there, without = sensing(kind, node_id=11, channel="a"), sensing(kind)
    rate_Hz = VIRTUAL.loop.rate_Hz
    refuse_other_inputs(there, there, rate_Hz)
    refuse_other_inputs(there, without, rate_Hz)
    with pytest.raises(ConfigurationError, match=f"sensors.{kind}.*the log has no such frames"):
        refuse_other_inputs(without, there, rate_Hz)
    for key, other in (
        ("node_id", {"node_id": 12, "channel": "a"}),
        ("channel", {"node_id": 11, "channel": "b"}),
    ):
        with pytest.raises(ConfigurationError, match=rf"sensors\.{kind}\.{key}: .*, as in the log"):
            refuse_other_inputs(there, sensing(kind, **other), rate_Hz)


def ticks_with(pairs, begun_ns=0):
    """A block of ticks 2 ms apart with (recorded, answered) frames."""
    rows = [row_of(tick=tick, t_ns=begun_ns + 2_000_000 * tick) for tick in range(len(pairs))]
    return block_of([(row, row) for row in rows], pairs)


A, B, C = (Frame(leg, bytes((leg,))) for leg in (1, 2, 3))


@pytest.mark.parametrize(
    ("there", "here", "recorded", "answered", "leg"),
    [
        ((A, B, C), (A, C, B), B, C, 3),
        ((A, B), (A, B, C), None, C, 3),
        ((A, B, C), (A, B), C, None, 3),
    ],
)
def test_first_differing_frame_is_reported_with_its_leg_and_time(
    there, here, recorded, answered, leg, monkeypatch
):
    block = ticks_with([((A,), (A,))] * 3 + [(there, here)], begun_ns=3 * 86_400 * 10**9)
    monkeypatch.setattr(kernel, "blocks", lambda *_: iter([block]))
    found = kernel.what_if(None, CYCLE).first_frames  # type: ignore[arg-type]
    assert found is not None
    assert (found.recorded, found.answered, found.legs) == (recorded, answered, (leg,))
    assert found.tick == 3
    assert found.time_s == pytest.approx(6e-3, abs=1e-12)
