"""The law of the page on laws runs, replays and passes the contract suite."""

import re

import pytest

from tests.docs.page_package import CONTRACT, SUCCESS, Package


@pytest.fixture
def package(tmp_path):
    return Package("law", "soft", "own-laws.md", tmp_path)


def test_the_law_of_the_page_runs_and_replays(package):
    package.run(package.blocks["simulation"] + SUCCESS)


def test_the_law_of_the_page_has_at_most_thirty_lines(package):
    assert len(package.files["law.py"].read_text().splitlines()) <= 30


def test_the_law_of_the_page_passes_the_contract_suite(package):
    assert re.search(r"^\d passed", package.run(CONTRACT), re.MULTILINE)
