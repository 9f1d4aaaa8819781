"""Equations of the pages: accents on top, indices at the side, brackets that grow, fractions as written."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from tests.browser import Browser, needs_chromium

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs/_extensions"))
mathml = importlib.import_module("mathml").mathml
nodes = importlib.import_module("docutils.nodes")

NAMESPACE = "{http://www.w3.org/1998/Math/MathML}"
PAGES = sorted((ROOT / "docs").rglob("*.md"))


def tree(equation):
    return ET.fromstring(mathml(nodes.math(equation, equation), block=False))


def shape(element):
    """An equation as nested tuples of tags, leaves as their texts."""
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
def test_accents_are_on_top_and_indices_at_the_side(equation, expected):
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
def test_brackets_grow_with_what_is_tall_between_them(equation, grows):
    found = {e.text: e.get("stretchy") for e in tree(equation).iter(NAMESPACE + "mo") if e.text in "()[]|"}
    assert found == grows


def test_fractions_of_the_pages_are_read_as_written():
    """A fraction without braces begins with a digit: then two are mended, and one before braces is read rightly."""
    short = re.compile(r"\\[td]?frac\s*(?![{\s]|\d\s*[\d{])(\S+)")
    assert not {page.name: found for page in PAGES if (found := short.findall(page.read_text()))}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("docs")
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q"]
    done = subprocess.run(
        [*command, "-D", "nb_execution_mode=off", "-d", str(folder / "trees"), str(ROOT / "docs"), str(folder / "html")],
        cwd=ROOT, capture_output=True, text=True, timeout=240, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder / "html"


@pytest.mark.long
@needs_chromium
def test_a_page_shows_equations_with_its_own_font_and_loads_nothing_else(built, tmp_path):
    with Browser() as browser:
        browser.open(built / "theory/inverse_dynamics.html")
        assert browser.value(
            "document.fonts.ready.then(() => document.fonts.check('16px \"STIX Two Math\"'))"
        )
        place = (
            "((e) => { const r = e.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; })"
            "([...document.querySelectorAll('msub')].find((m) => m.children[0].tagName === 'mover')"
            ".children[%s])"
        )
        letter, index = browser.value(place % "0].children[0"), browser.value(place % "1")
        accent = browser.value(place % "0].children[1")
        assert index[0] >= letter[2] - 1.0, "the index begins where the letter ends"
        assert accent[1] < letter[3]
        assert letter[0] - 4.0 <= (accent[0] + accent[2]) / 2 <= letter[2] + 4.0, "the accent is above it"
        bracket = "[...document.querySelectorAll('mo')].map((m) => m.getBoundingClientRect().height)"
        browser.open(built / "theory/monitor.html")
        browser.value("document.fonts.ready.then(() => 0)")
        heights = browser.value(bracket.replace("('mo')", "('mo[form=prefix]')"))
        assert max(heights) > 1.5 * min(heights), "a bracket around a fraction is taller"
        assert browser.errors == []
        assert all(url.startswith(built.as_uri()) for url in browser.requests if not url.startswith("data:"))


@pytest.mark.long
@needs_chromium
@pytest.mark.parametrize("word", ["watchdog", "lyapunov_share"])
def test_the_search_finds_a_word_that_is_part_of_a_name(built, tmp_path, word):
    named = {
        page.relative_to(ROOT / "docs").with_suffix(".html").as_posix()
        for page in PAGES
        if re.search(
            rf"(?<![^\W_]){word}(?![^\W_])", re.sub(r"!\[[^]]*\]", "", page.read_text())
        )  # in words, not pictures
        and "_static" not in page.parts
    }
    with Browser() as browser:
        browser.open(built / "search.html", f"?q={word}")
        found = browser.value(
            "new Promise((done) => { const look = () => { const hits = [...document.querySelectorAll("
            "'#search-results li a')].map((a) => a.href); const end = document.querySelector('#search-results p');"
            " if (end && /finished/.test(end.textContent)) done(hits); else setTimeout(look, 100); };"
            " setTimeout(look, 500); })"
        )
        pages = {url.partition("#")[0].partition("?")[0].removeprefix(built.as_uri() + "/") for url in found}
        assert named <= pages, named - pages
        assert browser.errors == []
