"""Equations of the pages: accents on top, indices at the side, growing brackets, fractions as written."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs/_extensions"))
mathml = importlib.import_module("mathml").mathml
nodes = importlib.import_module("docutils.nodes")

NAMESPACE = "{http://www.w3.org/1998/Math/MathML}"
PAGES = sorted((ROOT / "docs").rglob("*.md"))


def tree(equation):
    return ET.fromstring(mathml(nodes.math(equation, equation), block=False))


def shape(element):
    """An equation as nested tuples of tags, with texts as leaves."""
    children = tuple(map(shape, element))
    tag = element.tag.removeprefix(NAMESPACE)
    return (tag, *children) if children else (element.text or "")


@pytest.mark.parametrize(
    ("equation", "expected"),
    [
        (r"\ddot q_d", ("msub", ("mover", "q", "¨"), "d")),
        (r"\dot q_{d,i}", ("msub", ("mover", "q", "˙"), ("mrow", "d", ",", "i"))),
        (r"\ddot q_d^2", ("msubsup", ("mover", "q", "¨"), "d", "2")),
        (r"\hat M_i", ("msub", ("mover", "M", "ˆ"), "i")),
        (r"\frac12", ("mfrac", "1", "2")),
        (r"\tfrac 3 4", ("mfrac", "3", "4")),
        (r"\max_i", ("munder", "max", "i")),
        (r"x_i^2", ("msubsup", "x", "i", "2")),
    ],
)
def test_rendered_formula_has_accents_on_top_and_indices_at_the_side(equation, expected):
    assert shape(tree(equation)) == ("math", expected)


@pytest.mark.parametrize(
    ("equation", "grows"),
    [
        (r"(\frac{a}{b} + c)^2", {"(": "true", ")": "true"}),
        (r"[\sum_i (a + b)]", {"[": "true", "]": "true", "(": "false", ")": "false"}),
        (r"\lvert \dfrac{a}{b} \rvert", {"|": "true"}),
        (r"(\ddot q_d - x_i)", {"(": "false", ")": "false"}),
        (r"\left(\frac{a}{b}\right)", {"(": "true", ")": "true"}),
    ],
)
def test_rendered_formula_has_brackets_that_grow_around_tall_content(equation, grows):
    found = {e.text: e.get("stretchy") for e in tree(equation).iter(NAMESPACE + "mo") if e.text in "()[]|"}
    assert found == grows


def test_fractions_without_braces_in_formulas_begin_with_a_digit():
    """A fraction without braces must begin with a digit.

    The translator then reads both arguments correctly.
    """
    short = re.compile(r"\\[td]?frac\s*(?![{\s]|\d\s*[\d{])(\S+)")
    assert not {page.name: found for page in PAGES if (found := short.findall(page.read_text()))}


@pytest.mark.long
def test_documentation_builds_without_warnings(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q"]
    folders = ["-d", str(tmp_path / "trees"), str(ROOT / "docs"), str(tmp_path / "html")]
    done = subprocess.run(
        [*command, "-D", "nb_execution_mode=off", *folders],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "html/_static/fonts/stix-two-math.woff2").read_bytes()[:4] == b"wOF2"
