"""Rows on the disk: whole after a crash between any two steps, of one campaign, of one process."""

import errno
import json
import random
from typing import Any

import pytest

from drivers.errors import LogError
from hil.study.campaign import parquet
from hil.study.campaign import store as store_of
from hil.study.campaign.parquet import Column, read
from hil.study.campaign.store import Store, stored_rows

COLUMNS = [
    Column("row", "int64", "", "number"),
    Column("mass_kg", "float64", "kg", "how heavy"),
    Column("fault", "text", "", "which"),
    Column("passed", "bool", "", "whether"),
]
MADE_OF = {"campaign": "a", "configuration": "b"}
ROWS = [
    {"row": k, "mass_kg": None if k == 3 else k / 3.0, "fault": "none" if k % 2 else "jump", "passed": k != 2}
    for k in range(9)
]


def opened(folder, made_of=MADE_OF, **options):
    return Store(folder, COLUMNS, made_of, **options)


def crash(store):
    """End as a killed process does: its lock falls, and nothing is written any more."""
    store._lock.close()


def table(folder, parts):
    """Return the bytes of the table that comes of rows in these parts."""
    with opened(folder) as store:
        for part in parts:
            for row in part:
                store.add(row)
            store.flush()
        return store.finish(store.rows()).read_bytes()


def test_the_table_has_the_same_bytes_whatever_the_order_and_the_parts(tmp_path):
    mixed = random.Random(1).sample(ROWS, len(ROWS))
    tables = {
        table(tmp_path / "one", [ROWS]),
        table(tmp_path / "single", [[row] for row in reversed(ROWS)]),
        table(tmp_path / "mixed", [mixed[:4], mixed[4:], mixed[2:5]]),
    }
    assert len(tables) == 1
    assert read(tmp_path / "mixed" / "table.parquet") == ROWS
    assert not list((tmp_path / "mixed" / "parts").glob("*.parquet"))


def test_after_a_crash_the_parts_are_there_and_what_was_half_written_is_gone(tmp_path):
    first = opened(tmp_path)
    for row in ROWS[:4]:
        first.add(row)
    first.flush()
    first.add(ROWS[5])  # on no disk yet
    half = tmp_path / "parts" / "tmpab_c0123.parquet"
    half.write_bytes(b"PAR1")
    half_manifest = tmp_path / "tmpabcdefg1.json"
    half_manifest.write_bytes(b"{")
    (tmp_path / "tmp.json").write_text("of the user")
    crash(first)
    with opened(tmp_path) as second:
        assert second.rows() == {k: ROWS[k] for k in range(4)}
        assert not half.exists()
        assert not half_manifest.exists()
        assert (tmp_path / "tmp.json").exists()
        second.add(ROWS[5])
    with opened(tmp_path) as third:
        assert sorted(third.rows()) == [0, 1, 2, 3, 5]


def test_after_a_crash_between_the_table_and_the_removal_of_the_parts_nothing_is_lost(tmp_path):
    table(tmp_path, [ROWS])
    whole = (tmp_path / "table.parquet").read_bytes()
    late = opened(tmp_path)
    late.add(ROWS[0])
    late.flush()
    crash(late)
    with opened(tmp_path) as store:
        assert store.finish(store.rows()).read_bytes() == whole
    assert not list((tmp_path / "parts").glob("*.parquet"))


def test_rows_are_written_while_a_campaign_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(store_of, "_ROWS", 3)
    store = opened(tmp_path)
    for row in ROWS[:7]:
        store.add(row)
    crash(store)
    with opened(tmp_path) as again:
        assert sorted(again.rows()) == list(range(6))


class Timers:
    """In the place of a timer: starts are noted, and time is over when the test says so."""

    def __init__(self, monkeypatch):
        self.running: list[Any] = []
        timers = self

        class Timer:
            def __init__(self, seconds, function):
                assert seconds == 2.0
                self.function = function

            def start(self):
                timers.running.append(self)

            def cancel(self):
                if self in timers.running:
                    timers.running.remove(self)

        monkeypatch.setattr(store_of, "Timer", Timer)

    def over(self):
        (timer,) = self.running
        self.running.clear()
        timer.function()


def test_rows_are_written_two_seconds_after_the_first_of_them_whether_or_not_another_comes(
    tmp_path, monkeypatch
):
    timers = Timers(monkeypatch)
    store = opened(tmp_path)
    for row in ROWS[:3]:
        store.add(row)
    timers.over()
    assert sorted(store.rows()) == [0, 1, 2]
    store.add(ROWS[3])
    timers.over()
    store.add(ROWS[4])
    crash(store)
    with opened(tmp_path) as again:
        assert sorted(again.rows()) == [0, 1, 2, 3]


def test_what_is_written_anyway_needs_no_timer(tmp_path, monkeypatch):
    timers = Timers(monkeypatch)
    with opened(tmp_path) as store:
        store.add(ROWS[0])
        store.flush()
        assert not timers.running
        store.add(ROWS[1])
    assert not timers.running
    with opened(tmp_path) as again:
        assert sorted(again.rows()) == [0, 1]


def test_a_disk_that_is_full_in_the_meantime_is_said_with_the_next_row_and_costs_none(tmp_path, monkeypatch):
    timers = Timers(monkeypatch)
    store = opened(tmp_path)
    store.add(ROWS[0])
    write = parquet.write

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(parquet, "write", full)
    timers.over()
    with pytest.raises(LogError, match="No space left on device"):
        store.add(ROWS[1])
    monkeypatch.setattr(parquet, "write", write)
    store.flush()
    assert sorted(store.rows()) == [0, 1]
    crash(store)


def test_rows_of_another_campaign_are_refused_with_what_has_changed_and_how_to_go_on(tmp_path):
    table(tmp_path, [ROWS])
    with pytest.raises(LogError, match=r"changed since: configuration, file a\.csv; allowed: .*--fresh"):
        opened(tmp_path, MADE_OF | {"configuration": "c", "file a.csv": "d"})
    assert read(tmp_path / "table.parquet") == ROWS
    with opened(tmp_path, MADE_OF | {"configuration": "c"}, fresh=True) as store:
        assert store.rows() == {}
    assert json.loads((tmp_path / "campaign.json").read_text())["made_of"]["configuration"] == "c"


def test_the_manifest_is_on_the_disk_before_any_row_and_one_that_is_damaged_costs_no_row(
    tmp_path, monkeypatch
):
    synced = []
    monkeypatch.setattr(store_of, "_sync", lambda path: synced.append(path.suffix))
    with opened(tmp_path) as store:
        assert synced == [".json", ""]
        store.add(ROWS[0])
    for damaged in ("", "[]", '{"made_of": 7}', "[" * 100_000):
        (tmp_path / "campaign.json").write_text(damaged)
        with pytest.raises(LogError, match=r"campaign\.json: is no manifest .* remove it"):
            opened(tmp_path)
    (tmp_path / "campaign.json").unlink()
    with opened(tmp_path) as store:
        assert sorted(store.rows()) == [0]


def test_two_processes_do_not_share_a_folder(tmp_path):
    with opened(tmp_path), pytest.raises(LogError, match="another process works on this campaign; wait"):
        opened(tmp_path, fresh=True)


def test_a_damaged_part_is_named_with_what_to_do(tmp_path):
    with opened(tmp_path) as store:
        store.add(ROWS[0])
    part = tmp_path / "parts" / "part-000000.parquet"
    part.write_bytes(part.read_bytes()[:-9])
    with opened(tmp_path) as store, pytest.raises(LogError, match=r"part-000000\.parquet: .* remove it"):
        store.rows()


def test_a_damaged_part_that_was_removed_costs_its_own_rows_alone(tmp_path):
    with opened(tmp_path) as store:
        for row in ROWS[:3]:
            store.add(row)
            store.flush()
    (tmp_path / "parts" / "part-000001.parquet").unlink()
    with opened(tmp_path) as again:
        again.add(ROWS[5])
        again.flush()
        assert sorted(again.rows()) == [0, 2, 5]


def test_rows_that_say_they_are_of_another_campaign_are_refused_wherever_they_come_from(tmp_path):
    """Whoever lost or exchanged the manifest, or copied a part here, mixes nothing."""
    for folder, made_of in (("one", MADE_OF), ("two", MADE_OF | {"configuration": "c"})):
        with opened(tmp_path / folder, made_of) as store:
            store.add(ROWS[0])
    (tmp_path / "one" / "campaign.json").unlink()
    refused = pytest.raises(
        LogError, match=r"part-000000\.parquet: its rows are of another campaign .* remove"
    )
    with opened(tmp_path / "one", MADE_OF | {"configuration": "c"}) as store, refused:
        store.rows()
    with pytest.raises(
        LogError, match=r"of another campaign, changed since: configuration; .* `hil campaign --fresh`$"
    ):
        stored_rows(tmp_path / "two", MADE_OF)
    assert list(stored_rows(tmp_path / "two", MADE_OF | {"configuration": "c"})) == [0]


def test_rows_are_read_while_another_process_has_the_folder_and_where_nothing_may_be_written(tmp_path):
    assert stored_rows(tmp_path, MADE_OF) == {}
    with opened(tmp_path) as running:
        running.add(ROWS[0])
        running.flush()
        running.add(ROWS[1])
        before = sorted(tmp_path.rglob("*"))
        assert stored_rows(tmp_path, MADE_OF) == {0: ROWS[0]}
        assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_called_parts_makes_no_campaign_and_a_crash_right_after_it_was_made_does_no_harm(tmp_path):
    (tmp_path / "robot" / "parts").mkdir(parents=True)
    drawing = tmp_path / "robot" / "tmp_bolts.parquet"
    drawing.write_bytes(b"of somebody else")
    with pytest.raises(LogError, match="holds no results of a campaign"):
        opened(tmp_path / "robot", fresh=True)
    assert drawing.exists()
    (tmp_path / "begun" / "parts").mkdir(parents=True)
    with opened(tmp_path / "begun") as store:
        assert store.rows() == {}


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("years")
    with pytest.raises(LogError, match="holds no results of a campaign; name an empty or new folder"):
        opened(tmp_path, fresh=True)
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.txt"]
    with pytest.raises(LogError, match="is a file; name a folder"):
        opened(tmp_path / "thesis.txt")
