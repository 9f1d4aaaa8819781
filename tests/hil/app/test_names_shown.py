"""Names that a user gave are shown as they are: no markup of a terminal, no mathematics of a picture."""

from __future__ import annotations

from typing import Any

import pytest

from hil.study.compare import table

NAMES = [
    "pd [old]",
    "pd [new]",
    "pd [/]",
    "[red]pd",
    "$a_$",
    "$\\frac$",
    "_hidden",
    "a:smile:b",
    "\x1b[31mpd",
    "a\nb",
]


def summary(row: dict[str, Any]) -> dict[str, Any]:
    laws = dict.fromkeys(NAMES, row)
    return {
        "duration_s": 1.0,
        "step": {"axis": "z_m", "size": 0.001},
        "laws": laws,
        "paths": {name: {"ideal": row, "drives": row} for name in NAMES},
        "claims": [
            {"section": "2", "claim": "less [a]", "holds": True, "figures": "1 [b]"},
            {"section": "3", "claim": "more", "holds": False, "figures": "2"},
        ],
        "disturbance": None,
    }


def test_laws_of_any_name_have_each_its_row_in_each_table(capsys: pytest.CaptureFixture[str]) -> None:
    row = {"fault": "FOLLOWING", "fault_s": 0.25, "peak_leg_error_mm": 0.3, "steady_leg_error_mm": 0.1}
    table.show(summary(row), 200)
    said = capsys.readouterr().out
    for name in NAMES[:8]:
        assert said.count(name) >= 2, name
    assert said.count("\\x1b[31mpd") >= 2
    assert "\x1b" not in said
    assert "less [a]" in said
    assert "1 [b]" in said
    assert "yes" in said
    assert "[green]" not in said
