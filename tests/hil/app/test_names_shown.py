"""Names that a user gave are shown as they are: no markup of a terminal, no mathematics of a picture."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.table import Table

from hil.app.output import print_table
from hil.lab.identify.axes import draw
from hil.study.campaign.rates import Rate
from hil.study.campaign.show import cells
from hil.study.compare import plot, table
from hil.study.compare.measure import Outcome

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


def test_a_table_of_any_words_is_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    words = Table("[title]", box=None)
    for name in NAMES[:8]:
        words.add_row(name)
    print_table(words)
    found = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert [line for line in found if line in NAMES] == NAMES[:8]
    words.add_row(cells(Rate("x [old]\x1b[1m", 4, 3, 0.1, 0.9))[0])
    print_table(words)
    assert "x [old]\\x1b[1m" in capsys.readouterr().out


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are saved, drawn without a renderer's cost."""
    figures: list[Figure] = []

    def save(figure: Figure, path: Path, **_: object) -> None:
        figure.draw_without_rendering()
        figures.append(figure)
        path.write_bytes(b"")

    monkeypatch.setattr(Figure, "savefig", save)
    return figures


def test_a_picture_of_laws_of_any_name_names_each_as_it_is(tmp_path: Path, drawn: list[Figure]) -> None:
    t = np.linspace(0.0, 1.0, 5)
    traces = {"t": t, "error_mm": t, "force_N": t}
    laws = {name: Outcome(name, "own", None, None, {}, traces) for name in NAMES}
    paths = {
        name: {"ideal": Outcome(name, "ideal", None, None, {"peak_leg_error_mm": 1.0}, {})} for name in NAMES
    }
    plot.draw(laws, paths, tmp_path / "a.png", "$a_$ \udce9")
    (figure,) = drawn
    (legend,) = figure.legends
    shown = [*NAMES[:8], "\\x1b[31mpd", "a\\nb"]
    assert [text.get_text() for text in legend.get_texts()] == shown
    assert [label.get_text() for label in figure.axes[3].get_xticklabels()] == shown
    assert figure.get_suptitle() == "$a_$ \ufffd"


def test_the_picture_of_axes_is_named_after_its_log_whatever_its_name(
    tmp_path: Path, drawn: list[Figure]
) -> None:
    f = np.array([1.0, 2.0, 4.0])
    axis = SimpleNamespace(
        frequency_Hz=f, magnitude=f, magnitude_std=f, phase_deg=f, phase_std_deg=f, coherence=f
    )
    model: Any = SimpleNamespace(
        axes="joint",
        rate_Hz=1000.0,
        nominal=SimpleNamespace(transport_ms=1.0, lag_ms=1.0, gain=[1.0] * 6),
        measured=[axis] * 6,
        uncertainty=SimpleNamespace(frequency_Hz=f, bound=f),
    )
    draw(model, tmp_path / "a.png", "$\\frac$ \udce9")
    (figure,) = drawn
    assert figure.get_suptitle() == "$\\frac$ \ufffd"
