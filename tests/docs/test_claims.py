"""Figures of README and docs: each quoted text stands on its page, and each run of docs/claims.yaml gives it."""

from __future__ import annotations

import pytest

from tools.claims import BENCH, holds, judged, table

RUNS, CLAIMS = table()


@pytest.mark.parametrize("claim", CLAIMS, ids=lambda claim: f"{claim.page}: {claim.quote}")
def test_every_figure_listed_in_claims_yaml_is_quoted_on_its_page(claim):
    assert claim.stands()


def test_every_run_in_claims_yaml_measures_at_least_one_quoted_figure():
    assert {claim.run for claim in CLAIMS} == set(RUNS)


@pytest.mark.parametrize(
    ("quoted", "measured", "within", "verdict"),
    [
        ("0.83", 0.8325, 0.0, True),
        ("0.83", 0.8249, 0.0, False),
        ("0.90", 0.8325, 0.0, False),
        ("246", 246.44, 0.0, True),
        ("246", 246.51, 0.0, False),
        ("40900", 40887.7, 0.01, True),
    ],
)
def test_quoted_figure_is_the_rounded_measured_one_or_within_tolerance(quoted, measured, within, verdict):
    assert holds(quoted, measured, within) is verdict


@pytest.mark.long
@pytest.mark.parametrize("run", [run for run in RUNS if run != BENCH])
def test_figures_quoted_in_the_documentation_equal_the_measured_ones(run):
    found = list(judged([claim for claim in CLAIMS if claim.run == run], RUNS[run].result()))
    assert not [(claim.page, claim.quote, measured) for claim, _, measured, fine in found if not fine]
