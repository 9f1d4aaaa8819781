"""A log replays to the bit, and replay detects a change of any column, input or frame."""

from __future__ import annotations

import math
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.frame_array import received_frames
from drivers.protocol import Frame, Received
from drivers.signals import LEGS, BusState, Mode
from drivers.tick_columns import COLUMNS, COMPUTED_COLUMNS, INPUT_COLUMNS, ROW
from hil.app.readable import readable
from hil.app.replay import replay_log
from hil.loop.replay import Comparison, Difference, recorded_input, replay
from hil.record.entries import Tick
from hil.record.log import Log
from hil.record.salvage import salvage
from hil.signals import Operator
from hil.study.what_if.command import what_if_log
from tests.hil.rewrite import mcap_summary
from tests.loop.bench import changed, new_cycle
from tests.replay.short_run import SOON, moved

AT = 50
"""The changed tick."""


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return moved(tmp_path_factory.mktemp("replay") / "run.mcap")


@pytest.fixture(scope="module")
def entries(log):
    return list(Log.open(log).ticks())


@cache
def cycle() -> Any:
    """A controller that each replay resets."""
    return new_cycle(changed("virtual", **SOON))


def verdict_on(entries: list[Tick]) -> Comparison:
    class Entries:
        def ticks(self) -> Any:
            return iter(entries)

    return replay(Entries(), cycle())


def with_row(entries: list[Tick], at: int, **columns: Any) -> list[Tick]:
    """The ticks with some columns of one tick changed."""
    row: Any = entries[at].row.copy()
    for name, value in columns.items():
        row[name] = value
    return [*entries[:at], entries[at]._replace(row=row), *entries[at + 1 :]]


def compared(entries: list[Tick], **columns: Any) -> Comparison:
    return verdict_on(with_row(entries, AT, **columns)[: AT + 10])


def test_replay_gives_every_recorded_tick_and_frame(log, entries):
    verdict, summary = replay_log(log)
    assert verdict.exact
    assert verdict.ticks == len(entries) > 500
    assert verdict.frames == sum(len(entry.sent) for entry in entries)
    assert summary["different_ticks"] == 0
    assert (compared(entries).largest, compared(entries).story) == (0.0, None)


@pytest.mark.parametrize("mode", [Mode.TRACKING, Mode.IDLE, Mode.LOADING, Mode.APPROACH, Mode.PARKED])
def test_flipped_bit_of_a_frame_is_reported_with_tick_and_column(entries, mode):
    at = next(k for k, entry in enumerate(entries) if entry.row["mode"] == mode)
    received = list(entries[at].received)
    t_ns, frame = received[2]
    received[2] = Received(t_ns, frame._replace(data=bytes([frame.data[0] ^ 1, *frame.data[1:]])))
    changed = entries[at]._replace(received=tuple(received))
    verdict = verdict_on([*entries[:at], changed, *entries[at + 1 : at + 20]])
    assert not verdict.exact
    assert {d.tick for d in verdict.first} == {at}
    assert "frames_crc32" in [d.column for d in verdict.first]


@pytest.mark.parametrize("name", COMPUTED_COLUMNS)
def test_every_computed_column_is_compared_up_to_its_last_element(entries, name):
    column, row = COLUMNS[name], entries[1].row
    changed = np.array(row[name])
    changed.reshape(-1)[-1] = changed.reshape(-1)[-1] + 1 if np.isfinite(changed.reshape(-1)[-1]) else 1.0
    verdict = verdict_on(with_row(entries[:2], 1, **{name: changed}))
    assert [(each.tick, each.column) for each in verdict.first] == [(1, name)]
    assert (verdict.different_ticks, verdict.wire_different_ticks) == (1, 0)
    endless = verdict.largest >= sys.float_info.max
    assert endless == (column.type is not float or not np.isfinite(row[name]).all())
    assert verdict.largest > 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_recorded_nan_or_infinity_is_an_infinite_difference(entries, value):
    lengths = np.where(np.arange(6) == 5, value, entries[AT].row["q"])
    verdict = compared(entries, q=lengths)
    assert verdict.largest == math.inf
    assert f"q[5]: recorded {value!r}, replayed " in str(verdict.first[0])


def test_difference_is_relative_but_absolute_below_a_value_of_one(entries):
    lengths = entries[AT].row["q"].copy()
    own = float(lengths[3])
    for recorded, unit in ((1e6, 1e6), (own + 0.5, own + 0.5), (0.75, 1.0), (0.0, 1.0), (-1.25, 1.25)):
        lengths[3] = recorded
        found = compared(entries, q=lengths)
        assert found.largest == pytest.approx(abs(recorded - own) / unit, rel=1e-9)
        assert f"tick {AT}: q[3]: recorded {recorded!r}, replayed {own!r}" in str(found.first[0])
    far = Difference(7, "tau", np.array([1.7e308]), np.array([-1.7e308]))
    assert "difference -inf" in str(far)


def test_largest_difference_is_over_all_ticks_and_inf_for_integers(entries):
    far = with_row(entries[:100], 20, q=entries[20].row["q"] + 9.0)
    verdict = verdict_on(with_row(far, 60, q=entries[60].row["q"] + 0.1))
    assert verdict.different_ticks == 2
    assert verdict.largest == pytest.approx(9.0 / (9.0 + entries[20].row["q"].min()), rel=1e-3)
    found = compared(entries, q=entries[AT].row["q"] * 2, mode=99)
    assert found.largest == math.inf
    assert {each.column for each in found.first} == {"q", "mode"}


def test_changed_or_missing_sent_frames_are_wire_differences(entries):
    for sent in ((), (*entries[AT].sent[:-1], entries[AT].sent[-1]._replace(data=b""))):
        verdict = verdict_on([*entries[:AT], entries[AT]._replace(sent=sent), *entries[AT + 1 : 100]])
        assert [(each.tick, each.column) for each in verdict.first] == [(AT, "sent frames")]
        assert (verdict.different_ticks, verdict.wire_different_ticks, verdict.largest) == (1, 1, 0.0)
        assert not verdict.equivalent
        assert "sent frames: recorded (" in str(verdict.first[0])


@pytest.mark.parametrize(
    ("found", "exact", "equivalent"),
    [
        ({}, True, True),
        ({"ticks": 0}, False, False),
        ({"gaps": [(700, 3)]}, False, False),
        ({"different_ticks": 1, "largest": 1e-9}, False, True),
        ({"different_ticks": 1, "largest": 1.001e-9}, False, False),
        ({"different_ticks": 1, "wire_different_ticks": 1}, False, False),
    ],
)
def test_exact_means_equal_bits_and_equivalent_within_a_billionth(found, exact, equivalent):
    comparison = Comparison(**{"ticks": 1000, **found})
    assert (comparison.exact, comparison.equivalent) == (exact, equivalent)


@pytest.mark.parametrize(
    ("largest", "there", "here"), [(None, True, True), (1e-10, True, False), (1e-8, False, False)]
)
def test_replay_on_another_processor_may_differ_by_a_billionth(
    log, entries, monkeypatch, largest, there, here
):
    found = {} if largest is None else {"different_ticks": 1, "largest": largest}
    monkeypatch.setattr("hil.app.replay.replay", lambda *_: Comparison(ticks=len(entries), **found))
    assert replay_log(log)[1]["agrees"] is here
    monkeypatch.setattr("hil.app.replay.environment", lambda: {"cpu": "another one"})
    fields = replay_log(log)[1]
    assert (fields["agrees"], fields["replayed_on"]) == (there, "another one")


def test_replay_result_explains_each_fault_latched_in_the_log(entries):
    begun = next(k for k, entry in enumerate(entries) if entry.row["mode"] == Mode.LOADING)
    verdict = verdict_on(with_row(entries[: begun + 50], begun + 5, bus_off=1))
    assert verdict.story is not None
    assert [finding.fault for finding in verdict.story.findings] == ["BUS"]


# -- gaps ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("skipped", "missing"), [(0, 2), (1, 1), (2, 0)])
def test_gap_is_missing_ticks_beyond_those_skipped_by_the_loop(entries, skipped, missing):
    verdict = verdict_on([*entries[:40], *with_row(entries[42:], 0, skipped=skipped)])
    assert verdict.gaps == ([(40, missing)] if missing else [])
    assert verdict.ticks == (40 if missing else len(entries) - 2)
    if not missing:
        assert verdict.end == int(entries[-1].row["tick"]) + 1, "by tick number, despite skipped ticks"
        assert verdict_on(with_row(entries[2:], 0, skipped=2)).gaps == [], "no gap before the first tick"


@pytest.mark.parametrize(("at", "skipped"), [(0, 1), (42, 1), (42, 43), (42, -1)])
def test_impossible_number_of_skipped_ticks_is_a_damaged_row(entries, at, skipped):
    with pytest.raises(LogError, match=f"the row of tick {at} is damaged"):
        verdict_on(with_row(entries, at, skipped=skipped))


def test_replay_of_an_unclosed_log_warns_that_it_may_end_early(log, tmp_path):
    cut, whole = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 4 // 5])
    salvage(cut, whole)
    assert "it may end before the run did" in replay_log(whole)[1]["remark"]
    assert "remark" not in replay_log(log)[1]


def test_salvaged_log_reports_the_lost_bytes_to_every_reader(log, tmp_path):
    """The damage is at the end, so no gap shows it and the rest replays exactly."""
    data = bytearray(log.read_bytes())
    chunk = mcap_summary(log).chunk_indexes[-1]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0x40
    bad, whole = tmp_path / "bad.mcap", tmp_path / "whole.mcap"
    bad.write_bytes(data)
    report = salvage(bad, whole)
    assert report.ticks_lost > 0
    comparison, found = replay_log(whole)
    assert (comparison.exact, found["gaps"]) == (True, [])
    assert f"{report.bytes_lost} bytes of the original are lost" in found["remark"]
    assert found["remark"] in what_if_log(whole)["remarks"]
    assert readable(whole, ("tick",)).remark == found["remark"]


# -- inputs ----------------------------------------------------------------------------------------------------


def recorded(frames=(), operator=(), setpoints=(), orders=(), **columns):
    """A tick with a different number in each input."""
    rows = np.zeros(1, ROW)
    for number, name in enumerate(INPUT_COLUMNS):
        rows[name] = 1000 * number + np.arange(LEGS if name == "latch_ns" else 1)
    rows["tick"], rows["bus_state"], rows["recorder_alive"] = 17, BusState.PASSIVE, 1
    for name, value in columns.items():
        rows[name] = value
    row: Any = rows[0]
    return Tick(row, frames, (), operator, setpoints, orders)


def test_replay_restores_every_recorded_input_to_its_own_field():
    frames = (Received(7, Frame(0x181, b"\x01")), Received(9, Frame(0x182, b"\x02")))
    setpoints: Any = ("a pose", "another")
    orders: Any = ("an order",)
    given = recorded(frames, (int(Operator.STOP), int(Operator.RESET)), setpoints, orders)
    found = recorded_input(given)._asdict()
    for number, name in enumerate(INPUT_COLUMNS):
        if name in {"tick", "bus_state", "recorder_alive"}:
            continue
        whole = 1000 * number
        assert found[name] == (tuple(range(whole, whole + LEGS)) if name == "latch_ns" else whole), name
    assert (found["tick"], found["bus_state"]) == (17, BusState.PASSIVE)
    assert received_frames(found["frames"]) == frames
    assert found["operator"] == (Operator.STOP, Operator.RESET)
    assert (found["setpoints"], found["orders"]) == (setpoints, orders)
    for alive in (True, False):
        assert recorded_input(recorded(recorder_alive=alive)).recorder_alive is alive
    for state in BusState:
        assert recorded_input(recorded(bus_state=state)).bus_state is state


NOTICED = {
    "t_ns": 5 * 10**8, "lateness_ns": 5 * 10**7, "stretched_ns": 10**10, "sync_skew_ns": 9 * 10**8, "sends_failed": 5,
    "bus_errors": 500, "bus_off": 1, "bus_overflow": 5, "recorder_alive": 0, "recorder_dropped": 5, "latch_ns": 2 * 10**6,
}  # fmt: skip
"""Inputs that decisions depend on, with changed values; bus state and times are for readers only."""


@pytest.mark.parametrize("name", NOTICED)
def test_replay_differs_by_the_next_tick_after_any_input_is_changed(entries, name):
    assert set(INPUT_COLUMNS) - set(NOTICED) == {"tick", "skipped", "bus_state", "compute_ns"}
    verdict = compared(entries, **{name: NOTICED[name]})
    assert not verdict.exact
    assert AT <= min(each.tick for each in verdict.first) <= AT + 1


@pytest.mark.parametrize(
    ("column", "values"),
    [
        ("bus_state", (1 << 40, -1, 5)),
        ("operator", ((99,), (1, 0))),
        ("recorder_alive", (2, -1, 256, 1 << 40)),
    ],
)
def test_invalid_state_command_or_recorder_value_is_a_damaged_row(column, values):
    """A replay would only find another row, without a differing column."""
    for value in values:
        with pytest.raises(LogError, match=r"^the row of tick 17 is damaged: .* is not a valid"):
            recorded_input(recorded(**{column: value}))
