"""Modules, files and tests named in the documentation exist, and its examples are right."""

from __future__ import annotations

import ast
import doctest
import pkgutil
import re
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
NAME = re.compile(r"`((?:hil|drivers|plant_fmu)(?:\.[A-Za-z_]\w*)+)`")
TEST = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")
EXAMPLE = re.compile(r"```pycon\n(.*?)```", re.DOTALL)
FILE = re.compile(
    r"`((?:configs|docs|drivers|hil|plant_fmu|tests|tools)/[\w./-]+\.\w+|Makefile|pyproject\.toml|requirements[\w-]*\.lock)`"
)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_module_and_file_mentioned_in_the_documentation_exists(page):
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_test_mentioned_in_the_documentation_exists(page):
    named = TEST.findall(page.read_text())
    missing = [(file, name) for file, name in named if name not in functions(ROOT / file)]
    assert not missing


def functions(file):
    if not file.is_file():
        return set()
    return {node.name for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if EXAMPLE.search(page.read_text())],
    ids=lambda page: page.relative_to(ROOT).as_posix(),
)
def test_python_examples_of_the_documentation_give_the_shown_output(page):
    """All examples of one page in order, in one namespace."""
    text = "\n".join(EXAMPLE.findall(page.read_text()))
    examples = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)
    assert examples.examples
    heard: list[str] = []
    with np.printoptions():
        doctest.DocTestRunner().run(examples, out=heard.append)
    assert not heard, "".join(heard)


def test_architecture_page_lists_every_package_of_the_source_tree():
    tree = (ROOT / "docs/guides/architecture.md").read_text().split("```")[1]
    rooms = {line.split()[0] for line in tree.splitlines() if line.strip()}
    there = {
        f"{path.parent.name}/"
        for name in ("drivers", "hil", "plant_fmu")
        for path in (ROOT / name).glob("*/__init__.py")
    }
    assert rooms == there | {"drivers/", "hil/", "plant_fmu/", "configs/", "tests/", "docs/", "tools/"}
