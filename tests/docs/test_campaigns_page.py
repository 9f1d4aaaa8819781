"""The first campaign in the guide on campaigns runs with the stated result."""

import re
from pathlib import Path

import pyarrow.parquet as pq
from click.testing import CliRunner

from hil.cli import main
from hil.study.campaign.figures import METRICS

PAGE = (Path(__file__).parents[2] / "docs/guides/campaigns.md").read_text()


def test_first_example_of_the_guide_on_campaigns_runs(tmp_path, monkeypatch):
    example = re.search(r"Write `first.yaml`:\n\n```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert example is not None
    monkeypatch.chdir(tmp_path)
    Path("first.yaml").write_text(example[1])
    result = CliRunner().invoke(main, ["campaign", "first.yaml", "--out", "first", "--jobs", "1"])
    assert result.exit_code in (0, 1), result.output
    rows = pq.read_table("first/table.parquet").to_pylist()
    assert [row["law"] for row in rows] == ["own", "soft"] * 2
    assert len({row["friction_N"] for row in rows}) == 2
    assert (result.exit_code == 0) == all(row["passed"] for row in rows)
    assert Path("first/report.html").is_file()


def test_guide_on_campaigns_lists_every_metric():
    section = PAGE.partition("## What is measured")[2].partition("\n## ")[0]
    assert set(re.findall(r"`([a-zA-Z_]+)`", section)) >= set(METRICS)
