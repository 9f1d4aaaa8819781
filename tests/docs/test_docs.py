"""The documentation speaks of things that exist."""

from __future__ import annotations

import pkgutil
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
NAME = re.compile(r"`((?:hil|drivers|plant_fmu)(?:\.[A-Za-z_]\w*)+)`")
FILE = re.compile(
    r"`((?:configs|docs|drivers|hil|plant_fmu|tests|tools)/[\w./-]+\.\w+|Makefile|pyproject\.toml|requirements[\w-]*\.lock)`"
)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_name_in_a_page_exists(page):
    text = page.read_text()
    wrong = {}
    for name in NAME.findall(text):
        if not (ROOT / name).is_file():
            try:
                pkgutil.resolve_name(name)
            except (ImportError, AttributeError) as error:
                wrong[name] = str(error)
    wrong |= {path: "no such file" for path in FILE.findall(text) if not (ROOT / path).is_file()}
    assert not wrong


def test_the_theory_page_names_functions():
    assert len(NAME.findall((ROOT / "docs/theory/equations.md").read_text())) >= 12
