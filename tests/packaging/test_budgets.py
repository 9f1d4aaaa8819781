"""Lines and syntax nodes of each room: a room that grows takes out as much, or a decision record says why not."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = {".py", ".c", ".h", ".js", ".css", ".html"}
BUDGETS = {
    "drivers": (9_350, 67_000),
    "plant_fmu": (8_290, 58_000),
    "hil/loop hil/operate": (7_050, 54_300),
    "hil/safety hil/estimation": (3_100, 25_300),
    "hil/robot hil/control hil/trajectory hil/mathematics": (6_090, 44_000),
    "hil/record": (4_880, 37_300),
    "hil/config hil/app/configuration": (4_110, 25_800),
    "hil/design hil/proof": (6_430, 58_600),
    "hil/lab": (7_840, 65_800),
    "hil/study": (7_900, 64_400),
    "hil/app": (10_800, 75_900),
    "hil/cli": (2_350, 11_800),
    "hil/contracts": (1_550, 13_000),
    "tools": (2_660, 21_400),
    "configs": (210, 1_900),
    "tests": (74_340, 667_600),
}
"""Folders -> lines and nodes at most; `hil/app` without its configuration."""


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
def test_a_room_keeps_its_budget_of_lines_and_nodes(room):
    lines, nodes = counted(room)
    most_lines, most_nodes = BUDGETS[room]
    assert lines <= most_lines, f"{room}: {lines} lines"
    assert nodes <= most_nodes, f"{room}: {nodes} nodes"
    assert lines > 0.9 * most_lines, f"{room}: {lines} lines, lower its budget"
