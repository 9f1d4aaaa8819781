"""The examples in the guide on logs run in their order, and its commands succeed."""

import json
import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

import hil
from hil.cli import main

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/guides/analysis.md").read_text()
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def test_every_example_of_the_guide_on_log_analysis_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    ran = {"python": 0, "sh": 0}
    for kind, code in BLOCK.findall(PAGE):
        ran[kind] += 1
        if kind == "python":
            exec(compile(code, "docs/guides/analysis.md", "exec"), names)
            continue
        for line in code.splitlines():
            program, *words = shlex.split(line)
            assert program == "hil"
            done = CliRunner().invoke(main, words)
            assert done.exit_code == 0, (line, done.output)
    assert ran == {"python": 9, "sh": 1}
    frame = names["frame"]
    assert isinstance(frame, hil.LoggedFrame)
    assert "FEEDBACK" in capsys.readouterr().out.upper()
    again = names["again"]
    assert again.attrs["units"]["tau.leg_3"] == "N"  # type: ignore[attr-defined]


@pytest.mark.long
def test_cells_of_the_tracking_notebook_run_in_their_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    cells = json.loads((ROOT / "docs/examples/tracking.ipynb").read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    names: dict[str, object] = {}
    for number, cell in enumerate(code):
        exec(compile(cell, f"docs/examples/tracking.ipynb, cell {number}", "exec"), names)
    assert len(code) == 5
    peaks = names["peaks"]
    assert isinstance(peaks, dict)
    assert peaks[25] < peaks[15], "the stiffer law follows more closely"


def test_api_page_lists_exactly_the_public_names_of_the_log_api():
    text = (ROOT / "docs/api/index.md").read_text()
    assert sorted(re.findall(r"^\.\. auto\w+:: hil\.(\w+)", text, re.MULTILINE)) == sorted(hil.__all__)
