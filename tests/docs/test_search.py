"""Search of the built pages, by Sphinx's own script in Chromium: the wanted page is among the first hits."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from urllib.parse import quote

import pytest

from tests.browser import Browser, needs_chromium

ROOT = Path(__file__).resolve().parents[2]
HITS = 3
WANTED = {
    "mode diagram": "from-start-to-stop",
    "ball screw": "gains",
    "friction": "gains",
    "own law": "own-laws",
    "own drive": "own-drives",
    "cite": "development",
    "contribute": "development",
    "pull the cable": "from-start-to-stop",
    "gains": "gains",
    "units": "configuration",
    "tracker": "sensors",
}
_FOUND = """
new Promise((done) => {
  const look = () => {
    const found = [...document.querySelectorAll("ul.search > li > a")].map((a) => a.getAttribute("href"));
    const over = (document.querySelector(".search-summary") || {}).innerText;
    over || found.length > 5 ? done(found) : setTimeout(look, 50);
  };
  look();
})
"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "-q", "-D", "nb_execution_mode=off"]
    built = subprocess.run(
        [*command, "docs", str(folder)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stderr
    return folder


@pytest.mark.long
@needs_chromium
@pytest.mark.parametrize("query", WANTED)
def test_search_lists_the_page_about_a_word_among_its_first_hits(query, pages):
    with Browser() as browser:
        browser.open(pages / "search.html", f"?q={quote(query)}")
        hits = browser.value(_FOUND)[:HITS]
    assert any(f"guides/{WANTED[query]}.html" in hit for hit in hits), hits
