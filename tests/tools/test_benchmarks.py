"""Figures and marks of the benchmark, and short runs of each part."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from tools.benchmarks.__main__ import PARTS, main
from tools.benchmarks.benchmark import Figure, Mark

NAN = float("nan")


@pytest.mark.parametrize(
    ("values", "mark", "met"),
    [
        ({"": 40.0}, Mark(40.0), True),
        ({"": 40.1}, Mark(40.0), False),
        ({"": 9.9}, Mark(10.0, at_most=False), False),
        ({"": 10.0}, Mark(10.0, at_most=False), True),
        ({"": NAN}, Mark(10.0), False),
        ({"": NAN}, Mark(10.0, at_most=False), False),
        ({"median": 30.0, "p99": 50.0}, Mark(40.0), False),
        ({}, Mark(40.0), None),
        ({"": 1.0}, None, None),
    ],
)
def test_benchmark_limit_is_met_only_if_every_measured_value_is_within_it(values, mark, met):
    assert Figure("x", values, "us", mark).met is met


REAL_TIME = {"realtime": [pytest.mark.realtime(patient=True)], "two_buses": [pytest.mark.realtime]}
"""Parts that run processes in real time."""


@pytest.mark.long
@pytest.mark.parametrize("part", [pytest.param(name, marks=REAL_TIME.get(name, [])) for name in PARTS])
def test_every_part_of_the_benchmark_can_run_for_2_s_and_reports_its_figures(part, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    words = ["--only", part, "--seconds", "2", "--json", "benchmark.json"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    summary = json.loads(Path("benchmark.json").read_text())
    assert set(summary["parts"]) == {part}
    assert summary["machine"]["kernel"] == os.uname().release
    assert f"{summary['marks_met']} of {summary['marks']} marks met" in result.stdout
    figures = {each["name"].strip(): each for each in summary["parts"][part]}
    assert summary["marks"] > 0 or part == "two_buses"
    assert all(each["values"] for each in figures.values() if "mark" in each), "nothing measured for a mark"
    if part in {"realtime", "two_buses"}:  # docs/guides/buses.md: SYNC 75.0 us, three feedbacks 193.8 us
        assert figures["wake-up to six feedbacks"]["values"]["median"] >= 268.8
        assert figures["rate"]["values"][""] <= {"realtime": 1000.0, "two_buses": 2000.0}[part]
    assert not list(Path("runs").iterdir()), "nothing stays behind"


def test_json_output_of_the_benchmark_does_not_overwrite_a_file_of_another_kind(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("notes.txt").write_text("keep me")
    result = CliRunner().invoke(main, ["--only", "tick", "--json", "notes.txt"])
    assert result.exit_code == 2
    assert result.stderr.startswith("benchmark: --json notes.txt: exists")
    assert Path("notes.txt").read_text() == "keep me"
