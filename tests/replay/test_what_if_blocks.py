"""Of a what-if: a latched fault is listed once however long it stays, and other sensors are refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from drivers.config import SensorSettings
from drivers.errors import ConfigurationError
from drivers.signals import Fault, Mode
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import load
from hil.app.what_if.allowed import refuse_other_inputs
from hil.loop import what_if as kernel

FAULTS = {3: Fault.STALE, 9: Fault.STALE | Fault.SPEED, 13: Fault.NONE, 14: Fault.STALE}
"""What is latched from a tick on: a second one beside the first, then a reset, then the first one again."""
EXPECTED = [(3, "STALE"), (9, "SPEED"), (14, "STALE")]


@pytest.mark.parametrize("block", [1, 2, 3, 4, 5, 7, 9, 14, 20, 1024])
def test_a_fault_that_stays_latched_is_listed_once_wherever_a_block_ends(block, monkeypatch):
    monkeypatch.setattr(kernel, "BLOCK", block)
    answer = kernel.Answer()
    blocks, latched = kernel._Blocks(answer, None), Fault.NONE
    for tick in range(20):
        latched = FAULTS.get(tick, latched)
        row = np.zeros((), ROW)
        row["tick"], row["t_ns"], row["faults"] = 100 + tick, 7_000_000 + 2_000_000 * tick, latched
        row["mode"] = Mode.FAULT if latched else Mode.IDLE
        inp = SimpleNamespace(t_ns=int(row["t_ns"]))
        blocks.add(SimpleNamespace(entry=SimpleNamespace(row=row, sent=()), inp=inp, row=row, sent=()))  # type: ignore[arg-type]
    blocks.flush()
    assert [(each.tick - 100, each.fault) for each in answer.recorded_faults] == EXPECTED
    assert [each.time_s for each in answer.recorded_faults] == pytest.approx(
        [2e-3 * tick for tick, _ in EXPECTED]
    )
    assert answer.last_mode == "FAULT"


VIRTUAL = load("virtual")
KINDS = ["tracker", "imu", "wrench"]


def sensing(kind, **node):
    """Return a configuration with one sensor, or without any."""
    sensors = SensorSettings.model_validate({kind: node} if node else {})
    return VIRTUAL.model_copy(update={"sensors": sensors})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("key", "other"),
    [("node_id", {"node_id": 12, "channel": "a"}), ("channel", {"node_id": 11, "channel": "b"})],
)
def test_a_sensor_whose_recorded_frames_would_not_be_heard_is_refused(kind, key, other):
    there = sensing(kind, node_id=11, channel="a")
    refuse_other_inputs(there, there, VIRTUAL.loop.rate_Hz)
    for log, given in ((there, sensing(kind, **other)), (sensing(kind, **other), there)):
        with pytest.raises(ConfigurationError) as refused:
            refuse_other_inputs(log, given, VIRTUAL.loop.rate_Hz)
        recorded, wanted = (getattr(getattr(c.sensors, kind), key) for c in (log, given))
        assert f"sensors.{kind}.{key}: {wanted}, allowed: {recorded}, as in the log" in str(refused.value)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sensor_may_be_left_out_and_may_not_be_added(kind):
    there, without = sensing(kind, node_id=11), sensing(kind)
    refuse_other_inputs(there, without, VIRTUAL.loop.rate_Hz)
    with pytest.raises(ConfigurationError, match=f"sensors.{kind}: .*the log has no frame of one"):
        refuse_other_inputs(without, there, VIRTUAL.loop.rate_Hz)


@pytest.mark.parametrize("counts", [[2], [0, 2, 1, 0, 3, 0], [1] * 5, [0, 0]])
def test_all_set_points_of_a_log_are_counted_whichever_ticks_they_came_in(counts, monkeypatch):
    steps = []
    for tick, count in enumerate(counts):
        row = np.zeros((), ROW)
        inp = SimpleNamespace(tick=tick, t_ns=0, operator=(), setpoints=("a pose",) * count)
        steps.append(SimpleNamespace(entry=SimpleNamespace(row=row, sent=()), inp=inp, row=row, sent=()))
    monkeypatch.setattr(kernel, "stepped", lambda *_: iter(steps))
    idle = SimpleNamespace(
        reset=lambda: None, mode=Mode.IDLE, mode_tick=0, reset_tick=None, faults=Fault.NONE, tick=None
    )
    answer = kernel.what_if(None, idle)  # type: ignore[arg-type]
    assert (answer.ticks, answer.setpoints) == (len(counts), sum(counts))
