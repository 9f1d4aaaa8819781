"""The guide on references has a valid example of every kind."""

import re
from pathlib import Path
from typing import Any

import pytest

from hil.app.check.command import inspect
from hil.app.configuration.configuration import load, loads
from hil.trajectory.build import BUILDERS

ROOT = Path(__file__).resolve().parents[2]
PATH = """t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg
0,0,0,1,0,0,0
1,0.02,0,1,0,0,1
2,0,0.02,1.01,1,0,0
3,0,0,1,0,0,0
"""
PAGE = (ROOT / "docs/guides/references.md").read_text()
EXAMPLES = re.findall(r"```yaml\n(reference:\n.*?)```", PAGE, re.DOTALL)
KNOWN: Any = BUILDERS
KINDS = [match[1] for match in (re.search(r"  type: (\w+)", example) for example in EXAMPLES) if match]


def test_every_kind_of_reference_has_one_example_and_a_table_row_in_the_guide():
    types: set[str] = {kind.model_fields["type"].annotation.__args__[0] for kind in KNOWN}
    assert sorted(KINDS) == sorted(types)
    assert set(re.findall(r"^\| `(\w+)` \| [a-z]", PAGE.partition("## Hold")[0], re.MULTILINE)) == types


@pytest.mark.parametrize("example", EXAMPLES, ids=KINDS)
def test_every_example_of_the_guide_on_references_loads_and_passes_hil_check(example, tmp_path):
    (tmp_path / "path.csv").write_text(PATH)
    virtual = load("virtual").text
    first, last = virtual.index("\nreference:") + 1, virtual.index("\nlimits:") + 1
    report = inspect(loads(virtual[:first] + example + "\n" + virtual[last:], "my.yaml", tmp_path))
    assert any(title.startswith("reference ") for title in report.sections)
    of_the_rest = (
        "SCHED_FIFO",
        "that are needed",
        "hil schema",
    )  # this machine; limits made for a livelier path
    assert [w for w in report.warnings if not any(word in w for word in of_the_rest)] == []
