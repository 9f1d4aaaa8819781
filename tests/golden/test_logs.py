"""Frozen logs replay to the bit."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from hil.cli import main
from hil.record.log import Log
from hil.study.replay_suite import replay_case
from tests.golden.logs import FOLDER, LOGS, QUICK


def test_every_row_of_the_table_of_golden_logs_has_its_log_file():
    assert {path.stem for path in FOLDER.glob("*.mcap")} == set(LOGS)


@pytest.mark.parametrize("name", QUICK)
def test_stored_golden_log_replays_with_equal_bits(name):
    found = replay_case(FOLDER / f"{name}.mcap")
    assert found.verdict == "pass", found.text


@pytest.mark.long
def test_all_stored_golden_logs_pass_hil_replay_suite(tmp_path):
    report = tmp_path / "suite.json"
    result = CliRunner().invoke(
        main, ["replay", "--suite", str(FOLDER), "--jobs", "1", "--json", str(report)]
    )
    assert result.exit_code == 0, result.output
    summary = json.loads(report.read_text())
    assert (summary["passed"], summary["failed"], summary["skipped"]) == (len(LOGS), 0, 0)


def test_truncated_log_of_an_older_version_is_read_with_nan_in_columns_added_later(tmp_path):
    data, counts = (FOLDER / "ideal.mcap").read_bytes(), []
    for size in range(100_000, len(data), 10_000):
        (tmp_path / "cut.mcap").write_bytes(data[:size])
        log = Log(tmp_path / "cut.mcap")
        rows = log.rows()
        assert np.isnan(rows["probe_force"]).all()
        assert sum(len(block) for block in log.blocks()) == len(rows)
        counts.append(len(rows))
    assert counts == sorted(counts)
    assert counts[-1] > 100
