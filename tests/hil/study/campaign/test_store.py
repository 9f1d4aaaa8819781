"""Rows on the disk: complete after a crash at any step, of one campaign, for one process."""

import random
import signal
import subprocess
import sys
import time
from contextlib import closing

import pyarrow.parquet as pq
import pytest

from drivers.errors import LogError
from hil.study.arrow import Column
from hil.study.campaign.store import Store, stored_rows

COLUMNS = [
    Column("row", "int64", "", "number"),
    Column("mass_kg", "float64", "kg", "how heavy"),
    Column("fault", "text", "", "which"),
    Column("passed", "bool", "", "whether"),
]
MADE_OF = {"campaign": "a", "configuration": "b"}
OTHER = MADE_OF | {"configuration": "c", "file a.csv": "d"}
ROWS = [
    {"row": k, "mass_kg": None if k == 3 else k / 3.0, "fault": "none" if k % 2 else "jump", "passed": k != 2}
    for k in range(9)
]


def opened(folder, made_of=MADE_OF, **options):
    return closing(Store(folder, COLUMNS, made_of, **options))


def filled(folder, rows, made_of=MADE_OF):
    """Add rows in two sessions."""
    for part in (rows[:4], rows[4:]):
        with opened(folder, made_of) as store:
            for row in part:
                store.add(row)
    return folder


def table(folder):
    """Bytes of the table."""
    with opened(folder) as store:
        return store.finish(store.rows()).read_bytes()


def test_the_table_has_the_same_bytes_for_any_order_and_number_of_sessions(tmp_path):
    orders = {"one": ROWS, "back": ROWS[::-1], "mixed": [*random.Random(1).sample(ROWS, len(ROWS)), ROWS[2]]}
    assert len({table(filled(tmp_path / name, rows)) for name, rows in orders.items()}) == 1
    assert pq.read_table(tmp_path / "mixed" / "table.parquet").to_pylist() == ROWS


ADDS = """
import itertools, sys
from pathlib import Path
from tests.hil.study.campaign.test_store import opened
store = opened(Path(sys.argv[1])).thing
for k in itertools.count():
    store.add({"row": k, "mass_kg": 0.1, "fault": "x" * 1000, "passed": True})
    print(k, flush=True)
"""


def test_every_row_added_to_a_campaign_survives_kill_9(tmp_path):
    for instant in (0.0, 0.03, 0.1):
        folder = tmp_path / str(instant)
        with subprocess.Popen(
            [sys.executable, "-c", ADDS, folder], stdout=subprocess.PIPE, text=True
        ) as child:
            assert child.stdout is not None
            child.stdout.readline()
            time.sleep(instant)
            child.send_signal(signal.SIGKILL)
            added = 1 + len(child.stdout.read().splitlines())
        with opened(folder) as store:
            assert sorted(store.rows())[:added] == list(range(added))
            assert len(store.rows()) <= added + 1, "one row was added but not yet printed"
            store.add(ROWS[0])


def test_rows_of_another_campaign_are_refused_with_the_differing_parts(tmp_path):
    whole = table(filled(tmp_path, ROWS))
    changed = pytest.raises(
        LogError, match=r"these parts differ: configuration, file a\.csv\. .*`hil campaign --fresh`$"
    )
    with changed:
        opened(tmp_path, OTHER)
    with changed:
        stored_rows(tmp_path, OTHER)
    assert table(tmp_path) == whole
    with opened(tmp_path, OTHER, fresh=True) as store:
        assert store.rows() == {}
        assert not (tmp_path / "table.parquet").exists()
        store.add(ROWS[0])
    assert stored_rows(tmp_path, OTHER) == {0: ROWS[0]}


def test_second_process_is_refused_in_the_folder_of_a_running_campaign(tmp_path):
    with opened(tmp_path) as store:
        store.add(ROWS[0])
        with pytest.raises(LogError, match="another process runs this campaign; wait"):
            opened(tmp_path, fresh=True)
        store.add(ROWS[1])
    assert sorted(stored_rows(tmp_path, MADE_OF)) == [0, 1]


def test_rows_can_be_read_from_a_locked_or_read_only_folder(tmp_path):
    folder = tmp_path / "50 % of #2?"
    assert stored_rows(folder, MADE_OF) == {}
    with opened(folder) as running:
        running.add(ROWS[0])
        before = sorted(folder.iterdir())
        assert stored_rows(folder, MADE_OF) == {0: ROWS[0]}
        assert sorted(folder.iterdir()) == before
        running.add(ROWS[1])
    folder.chmod(0o500)
    assert sorted(stored_rows(folder, MADE_OF)) == [0, 1]
    folder.chmod(0o700)


def test_a_damaged_database_is_refused_with_advice(tmp_path):
    (filled(tmp_path, ROWS) / "campaign.sqlite").write_bytes(b"no database" * 100)
    for read in (opened, lambda folder: stored_rows(folder, MADE_OF)):
        with pytest.raises(LogError, match=r"campaign\.sqlite: .* remove it to run its rows again"):
            read(tmp_path)


def test_a_folder_with_other_files_is_refused_and_unchanged(tmp_path):
    (tmp_path / "thesis.txt").write_text("years")
    with pytest.raises(LogError, match="has no campaign of this version; give an empty"):
        opened(tmp_path, fresh=True)
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.txt"]
    with pytest.raises(LogError, match=r"thesis\.txt: cannot be used"):
        opened(tmp_path / "thesis.txt")
