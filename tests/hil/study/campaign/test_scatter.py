"""Plots of a campaign's page: dots and quantiles of the figures over the swept values."""

from __future__ import annotations

import re

import pytest

from hil.study.campaign import scatter
from hil.study.campaign.figures import METRICS


def rows():
    """101 rows with an error of 0, 1, .. 100 mm over a friction of 0, 2, .. 200 N; the last ten fail."""
    empty = dict.fromkeys(METRICS)
    return [
        empty | {"peak_leg_error_mm": k, "faulted": 0, "friction_N": 2.0 * k, "law": "pd", "passed": k <= 90}
        for k in range(101)
    ]


def paths(html, kind):
    return re.findall(rf'<path class="{kind}" d="([^"]*)"', html)


def test_campaign_page_has_the_quantiles_of_each_figure_that_varies():
    table = next(iter(scatter.plots(["friction_N"], rows())))
    assert re.findall(r"<td[^>]*>([^<]*)</td>", table) == ["0", "10", "50", "90", "100"]
    assert "faulted" not in table, "equal in all rows"


def test_campaign_page_draws_a_dot_a_row_and_quantiles_of_each_value():
    html = "".join(scatter.plots(["friction_N", "law"], rows()))
    assert [path.count("M") for path in paths(html, "pass")] == [91, 91]
    assert [path.count("M") for path in paths(html, "fail")] == [10, 10]
    bottom, top = 124 - 0.05 * 120, 124 - 0.95 * 120
    over_friction, over_law = (re.findall(r"M[-\d.]+ ([\d.]+)H", path) for path in paths(html, "quantile"))
    levels = [bottom + (top - bottom) * share for share in (0.1, 0.5, 0.9)]
    assert [float(y) for y in over_law] == pytest.approx(sorted(levels), abs=0.06)
    assert len(over_friction) == 12, "many values: the quantiles of each quarter"


def test_campaign_page_escapes_the_names_of_swept_values():
    given = [row | {"law": f"<b>{k % 2}"} for k, row in enumerate(rows())]
    html = "".join(scatter.plots(["law"], given))
    assert "<b>" not in html
    assert "&lt;b&gt;1" in html
