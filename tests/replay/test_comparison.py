"""What a replay says of a log that differs: how far, with which story, in how long a time."""

from __future__ import annotations

import json
import math
import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import LogError
from drivers.signals import Mode
from drivers.tick_columns import COLUMNS, COMPUTED_COLUMNS
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.app.readable import readable
from hil.app.replay import replay_log, summary
from hil.app.sim.command import simulate
from hil.cli import main
from hil.loop.replay import Comparison, Difference, replay
from hil.loop.story.narrator import Narrator
from hil.record.log import Log
from hil.record.salvage import salvage
from hil.signals import Operator
from hil.study.what_if.command import what_if_log
from tests.hil.rewrite import mcap_summary, rewrite_log


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    simulate(load("virtual"), log=path, duration_s=0.1, check_replay=False)
    return path


@pytest.fixture(scope="module")
def entries(log):
    return list(Log.open(log).ticks())


class Edited:
    """Recorded ticks of which some columns of one are others."""

    def __init__(self, entries, at, **columns):
        row = entries[at].row.copy()
        for name, value in columns.items():
            row[name] = value
        self.entries = [*entries[:at], entries[at]._replace(row=row), *entries[at + 1 :]]

    def ticks(self):
        return iter(self.entries)


class Entries(Edited):
    """Recorded ticks as they are."""

    def __init__(self, entries):
        self.entries = entries


@cache
def virtual():
    """Return a cycle that each replay resets."""
    c = load("virtual")
    return build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)


def compared(entries, at, **columns):
    return replay(Edited(entries, at, **columns), virtual())


def verdict_on(entries):
    return replay(Entries(entries), virtual())


@pytest.mark.parametrize(
    ("found", "exact", "equivalent"),
    [
        ({}, True, True),
        ({"ticks": 1}, True, True),
        ({"ticks": 0}, False, False),
        ({"gaps": [(700, 3)]}, False, False),
        ({"different_ticks": 1, "largest": 1e-9}, False, True),
        ({"different_ticks": 1, "largest": 1.001e-9}, False, False),
        ({"different_ticks": 1, "largest": math.inf}, False, False),
        ({"different_ticks": 1, "wire_different_ticks": 1}, False, False),
    ],
)
def test_exact_is_every_bit_and_equivalent_the_same_frames_with_columns_within_a_billionth(
    found, exact, equivalent
):
    comparison = Comparison(**{"ticks": 1000, **found})
    assert (comparison.exact, comparison.equivalent) == (exact, equivalent)


@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize(
    ("found", "there", "here"),
    [
        ({}, True, True),
        ({"different_ticks": 1, "largest": 1e-10}, True, False),
        ({"different_ticks": 1, "largest": 1e-8}, False, False),
    ],
)
def test_a_replay_agrees_to_the_bit_and_on_another_processor_within_a_billionth(
    log, monkeypatch, elsewhere, found, there, here
):
    ticks = Log.open(log).summary.ticks
    monkeypatch.setattr("hil.app.replay.replay", lambda *_: Comparison(ticks=ticks, **found))
    if elsewhere:
        monkeypatch.setattr("hil.app.replay.environment", lambda: {"cpu": "another one"})
    fields = replay_log(log)[1]
    assert fields["agrees"] == (there if elsewhere else here)
    cpu = Log.open(log).metadata["environment"]["cpu"]
    named = (fields.get("recorded_on"), fields.get("replayed_on"))
    assert named == ((cpu, "another one") if elsewhere else (None, None))


@pytest.mark.parametrize("name", COMPUTED_COLUMNS)
def test_every_computed_column_is_compared_in_its_last_element(entries, name):
    column, row = COLUMNS[name], entries[1].row
    changed = np.array(row[name])
    changed.reshape(-1)[-1] = 1.0 if np.isnan(changed.reshape(-1)[-1]) else changed.reshape(-1)[-1] + 1
    verdict = compared(entries[:2], 1, **{name: changed})
    assert [(each.tick, each.column) for each in verdict.first] == [(1, name)]
    assert (verdict.largest == math.inf) == (column.type is not float or np.isnan(row[name]).any())
    assert verdict.largest > 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_was_recorded_as_none_is_no_small_difference(entries, value):
    lengths = entries[50].row["q"].copy()
    lengths[5] = value
    verdict = compared(entries, 50, q=lengths)
    assert verdict.largest == math.inf
    assert f"q[5]: recorded {value!r}, replayed 1." in str(verdict.first[0])


def test_a_difference_beyond_all_numbers_is_told():
    far = Difference(7, "tau", np.array([1.7e308]), np.array([-1.7e308]))
    assert str(far) == "tick 7: tau: recorded 1.7e+308, replayed -1.7e+308 (difference -inf)"


def test_the_largest_difference_is_that_of_all_ticks(entries):
    far, near = (
        Edited(entries, at, q=entries[at].row["q"] + by).entries[at] for at, by in ((20, 9.0), (50, 0.1))
    )
    verdict = verdict_on([*entries[:20], far, *entries[21:50], near, *entries[51:]])
    assert verdict.different_ticks == 2
    assert verdict.largest == pytest.approx(9.0 / 10.59245, rel=1e-3), "9 m of the recorded 10.6"


@pytest.mark.parametrize(("skipped", "missing"), [(0, 2), (1, 1)])
def test_a_gap_is_what_is_missing_beyond_the_ticks_that_the_loop_skipped(entries, skipped, missing):
    row = entries[42].row.copy()
    row["skipped"] = skipped
    verdict = verdict_on([*entries[:40], entries[42]._replace(row=row), *entries[43:]])
    assert verdict.gaps == [(40, missing)]
    assert verdict.ticks == 40


def test_ticks_that_the_loop_skipped_are_no_gap(entries):
    row = entries[42].row.copy()
    row["skipped"] = 2
    verdict = verdict_on([*entries[:40], entries[42]._replace(row=row), *entries[43:]])
    assert verdict.gaps == []
    assert verdict.ticks == len(entries) - 2
    last = int(entries[-1].row["tick"])
    assert verdict.end == last + 1, "by its number, whatever was skipped before"
    first = entries[2].row.copy()
    first["skipped"] = 2
    verdict = verdict_on([entries[2]._replace(row=first), *entries[3:]])
    assert verdict.gaps == [], "nor are those before the first"
    assert verdict.ticks == len(entries) - 2


@pytest.mark.parametrize(("at", "skipped"), [(0, 1), (42, 1), (42, 43), (42, -1)])
def test_ticks_that_cannot_have_been_skipped_are_damage_of_their_row(entries, at, skipped):
    row = entries[at].row.copy()
    row["skipped"] = skipped
    told = f"the row of tick {at} is damaged: {skipped} ticks cannot have been skipped before it"
    with pytest.raises(LogError, match=told):
        verdict_on([*entries[:at], entries[at]._replace(row=row), *entries[at + 1 :]])


def test_a_difference_is_relative_to_the_recorded_value_and_below_one_absolute(entries):
    lengths = entries[50].row["q"].copy()
    assert (abs(lengths) < 2.0).all()
    for far in (1e6, -1e6):
        lengths[3] = far
        assert compared(entries, 50, q=lengths).largest == pytest.approx(1.0, rel=1e-4)
    own = float(entries[50].row["q"][3])
    for recorded, unit in ((own + 0.5, own + 0.5), (1.25, 1.25), (0.75, 1.0), (0.0, 1.0), (-1.25, 1.25)):
        lengths[3] = recorded
        difference = abs(recorded - own) / unit
        assert compared(entries, 50, q=lengths).largest == pytest.approx(difference, rel=1e-9)


def test_the_largest_of_all_differences_is_kept_and_an_integer_has_no_small_one(entries):
    assert compared(entries, 50).largest == 0.0
    assert compared(entries, 50, q=entries[50].row["q"] * 2, mode=99).largest == math.inf


def test_a_replay_has_the_story_of_the_faults_that_its_cycle_latched(entries):
    assert compared(entries, 50).story is None
    begun = next(k for k, entry in enumerate(entries) if entry.row["mode"] == Mode.LOADING)
    verdict = compared(entries, begun + 5, bus_off=1)
    assert verdict.story is not None
    assert [finding.fault for finding in verdict.story.findings] == ["BUS"]


def test_a_replay_tells_the_story_what_the_operator_said_in_each_tick(entries, monkeypatch):
    told: list[tuple[int, tuple[Operator, ...]]] = []
    there = Narrator.look

    def look(narrator, operator=()):
        told.append((len(told), tuple(operator)))
        there(narrator, operator)

    monkeypatch.setattr(Narrator, "look", look)
    said = {3: (Operator.ESTOP,), 4: (), 5: (Operator.RESET, Operator.STOP)}
    verdict_on([entry._replace(operator=said.get(k, ())) for k, entry in enumerate(entries[:8])])
    assert told == [(k, said.get(k, ())) for k in range(8)]


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("by", [0.5, -0.25])
def test_a_difference_names_the_element_with_the_recorded_and_the_replayed_value(entries, leg, by):
    lengths = np.array(entries[50].row["q"])
    own = lengths[leg].item()
    lengths[leg] += by
    (found,) = compared(entries, 50, q=lengths).first
    assert (found.recorded.tolist(), found.replayed[leg].item()) == (lengths.tolist(), own)
    assert str(found) == (
        f"tick 50: q[{leg}]: recorded {own + by!r}, replayed {own!r} (difference {-by:.3g})"
    )


def test_a_difference_of_a_scalar_has_no_element_and_one_of_whole_numbers_no_distance(entries):
    own = int(entries[50].row["mode"])
    (found,) = compared(entries, 50, mode=99).first
    assert str(found) == f"tick 50: mode: recorded 99, replayed {own}"
    number = entries[50].row["condition"].item()
    (found,) = compared(entries, 50, condition=number + 1.0).first
    assert str(found).startswith(f"tick 50: condition: recorded {number + 1.0!r}, replayed {number!r} (diff")


def test_a_replay_is_as_fast_as_the_logged_time_over_its_own(log, entries, monkeypatch):
    clock = SimpleNamespace(perf_counter=iter((1000.0, 1000.5)).__next__)
    monkeypatch.setattr("hil.app.replay.time", clock)
    found = replay_log(log)[1]
    assert found["wall_s"] == 0.5
    assert found["times_real_time"] == pytest.approx(1e-3 * len(entries) / 0.5), "ticks are 1 ms apart"


def test_the_summary_gives_the_speed_and_where_how_many_ticks_are_missing():
    fields = summary(Comparison(ticks=6000, gaps=[(700, 3)]), 2.0, 6.0)
    assert fields["times_real_time"] == 3.0
    assert fields["gaps"] == ["3 ticks missing from tick 700"]
    assert summary(Comparison(), 0.0, 6.0)["times_real_time"] == 0.0


def test_sent_frames_are_counted_over_all_ticks(entries):
    verdict = verdict_on(entries[:60])
    assert verdict.frames == sum(len(entry.sent) for entry in entries[:60]) > 60


def test_a_tick_that_differs_in_frames_and_columns_is_told_in_both(entries):
    edited = Edited(entries[:60], 50, q=entries[50].row["q"] + 0.5, mode=99)
    edited.entries[50] = edited.entries[50]._replace(sent=())
    verdict = replay(edited, virtual())
    assert [each.column for each in verdict.first] == [
        *(name for name in COMPUTED_COLUMNS if name in {"q", "mode"}), "sent frames",
    ]  # fmt: skip
    assert (verdict.different_ticks, verdict.wire_different_ticks, verdict.largest) == (1, 1, math.inf)


def test_a_tick_whose_sent_frames_are_gone_is_a_difference_that_can_be_printed(entries):
    edited = [*entries]
    edited[50] = edited[50]._replace(sent=())
    verdict = replay(Edited(edited, 60), virtual())
    (difference,) = verdict.first
    assert str(difference).startswith("tick 50: sent frames: recorded (), replayed (Frame(")
    assert (verdict.different_ticks, verdict.wire_different_ticks, verdict.largest) == (1, 1, 0.0)
    assert not verdict.equivalent


def test_a_log_that_its_run_did_not_close_may_end_too_early_and_says_so(log, tmp_path):
    cut, whole = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 4 // 5])
    salvage(cut, whole)
    assert "(salvaged): it may end before the run did" in replay_log(whole)[1]["remark"]
    assert "remark" not in replay_log(log)[1]


def test_a_salvaged_log_whose_last_chunk_was_damaged_says_what_is_lost_wherever_it_is_read(log, tmp_path):
    """Nothing after it shows a gap: what replays is exact."""
    data = bytearray(log.read_bytes())
    chunk = mcap_summary(log).chunk_indexes[-1]
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0x40
    bad, whole = tmp_path / "bad.mcap", tmp_path / "whole.mcap"
    bad.write_bytes(data)
    report = salvage(bad, whole)
    assert report.ticks_lost > 0
    comparison, found = replay_log(whole)
    assert (comparison.exact, found["gaps"]) == (True, [])
    assert f"salvaged, {report.bytes_lost} bytes of the original are lost" in found["remark"]
    assert found["remark"] in what_if_log(whole)["remarks"]
    with readable(whole, ("tick",)) as there:
        assert there.remark == found["remark"]


def without_frame(sequence):
    return lambda topic, data, number: None if (topic, number) == ("/can", sequence) else data


def test_the_command_shows_the_largest_difference_where_there_is_one_alone(log, tmp_path):
    exact = CliRunner().invoke(main, ["replay", str(log)])
    assert exact.exit_code == 0, exact.output
    assert "largest" not in exact.stdout
    changed = tmp_path / "changed.mcap"
    rewrite_log(log, changed, without_frame(40))
    result = CliRunner().invoke(main, ["replay", str(changed), "--json", str(tmp_path / "verdict.json")])
    assert result.exit_code == 1, result.output
    assert re.search(r"largest[ _]relative[ _]difference", result.stdout)
    assert json.loads((tmp_path / "verdict.json").read_text())["success"] is False


def test_a_salvaged_log_says_what_was_lost_before_it_is_replayed(log, tmp_path):
    data = bytearray(log.read_bytes())
    chunks = mcap_summary(log).chunk_indexes
    data[chunks[-1].chunk_start_offset + chunks[-1].chunk_length // 2] ^= 0x40
    (tmp_path / "damaged.mcap").write_bytes(data)
    command = ["replay", str(tmp_path / "damaged.mcap"), "--salvage", str(tmp_path / "whole.mcap")]
    result = CliRunner().invoke(main, command)
    first, remark, *_ = result.stderr.splitlines()
    assert first.startswith("salvaged ")
    assert remark.startswith("  ")
    assert "damaged" in remark


def test_progress_is_drawn_over_itself_on_a_terminal_and_not_at_all_elsewhere(log, monkeypatch):
    assert "\r" not in CliRunner().invoke(main, ["replay", str(log)]).stderr

    def replay_log(path, progress):
        progress(1000)
        progress(2000)
        return Comparison(ticks=2000), {**summary(Comparison(ticks=2000), 1.0, 2.0), "agrees": True}

    monkeypatch.setattr("hil.app.replay.replay_log", replay_log)
    monkeypatch.setattr("click.testing._NamedTextIOWrapper.isatty", lambda self: True)
    said = CliRunner().invoke(main, ["replay", str(log)], color=True).stderr
    assert said == "\r1000 ticks\r2000 ticks\r\x1b[K"


def test_progress_is_told_every_thousand_ticks(tmp_path):
    simulate(load("virtual"), log=tmp_path / "run.mcap", duration_s=1.7, check_replay=False)
    entries = list(Log.open(tmp_path / "run.mcap").ticks())
    for count, said in ((999, []), (1000, [1000]), (1001, [1000]), (2000, [1000, 2000])):
        told: list[int] = []
        assert replay(Entries(entries[:count]), virtual(), told.append).ticks == count
        assert told == said
