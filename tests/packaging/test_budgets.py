"""Line and syntax node budgets of each package: growth is compensated, or a decision record gives the reason."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = {".py", ".c", ".h", ".js", ".css", ".html"}
BUDGETS = {
    "drivers": (11_740, 88_950),
    "plant_fmu": (10_670, 73_800),
    "hil/loop hil/operate": (6_775, 52_275),
    "hil/safety hil/estimation": (3_440, 28_950),
    "hil/robot hil/control hil/trajectory hil/mathematics": (5_760, 43_275),
    "hil/record": (4_760, 37_775),
    "hil/config hil/app/configuration": (4_000, 26_300),
    "hil/design hil/proof": (5_890, 54_425),
    "hil/lab": (8_295, 71_275),
    "hil/study": (8_485, 71_350),
    "hil/app": (12_650, 92_425),
    "hil/cli": (2_555, 12_800),
    "hil/contracts": (1_720, 14_925),
    "tools": (2_325, 19_175),
    "configs": (205, 1_875),
    "tests": (77_650, 688_600),
}
"""Folders -> largest numbers of lines and nodes; `hil/app` without its configuration."""


def files(folders: str) -> list[Path]:
    found = [p for folder in folders.split() for p in (ROOT / folder).rglob("*") if p.suffix in SOURCES]
    apart = ROOT / "hil/app/configuration"
    return [p for p in found if folders != "hil/app" or apart not in p.parents]


def counted(folders: str) -> tuple[int, int]:
    lines = nodes = 0
    for path in files(folders):
        text = path.read_text(encoding="utf-8")
        lines += text.count("\n")
        nodes += sum(1 for _ in ast.walk(ast.parse(text))) if path.suffix == ".py" else 0
    return lines, nodes


@pytest.mark.parametrize("room", BUDGETS)
def test_each_package_stays_within_its_budget_of_source_lines_and_syntax_nodes(room):
    lines, nodes = counted(room)
    most_lines, most_nodes = BUDGETS[room]
    assert lines <= most_lines, f"{room}: {lines} lines"
    assert nodes <= most_nodes, f"{room}: {nodes} nodes"
    assert lines > 0.9 * most_lines, f"{room}: {lines} lines, lower its budget"
