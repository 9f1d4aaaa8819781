"""How many rows a campaign may have: refused by their number, before any is made."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.errors import ConfigurationError
from hil.study.campaign import plan
from hil.study.campaign.plan import read_plan
from tests.hil.study.campaign.campaigns import written


def text_of(sample: int, listed: int, grid: list[int]) -> str:
    """Return a campaign with so many samples, rows of the list, and values of each axis of the grid."""
    text = "kind: campaign\nduration_s: 0.05\n"
    if sample:
        text += (
            f"sample: {{method: sobol, count: {sample}, axes: {{f: {{key: plant.x, uniform: [0, 1]}}}}}}\n"
        )
    if listed:
        text += f"list: {{l: {{key: plant.y, values: {list(range(listed))}}}}}\n"
    if grid:
        axes = (f"g{n}: {{key: plant.z{n}, values: {list(range(count))}}}" for n, count in enumerate(grid))
        text += f"grid: {{{', '.join(axes)}}}\n"
    return text


@pytest.mark.parametrize(
    ("counts", "rows", "place"),
    [
        ((0, 0, [10] * 9), "1000000000", ":3:1: grid"),
        ((0, 0, [10] * 30), "1" + 30 * "0", ":3:1: grid"),
        ((0, 11, [10] * 6), "11000000", ":4:1: grid"),
        ((1001, 0, [10] * 4), "10010000", ":4:1: grid"),
        ((10_000_000, 2, []), "20000000", ":4:1: list"),
        ((101, 10, [10] * 4), "10100000", ":5:1: grid"),
    ],
    ids=str,
)
def test_more_rows_than_a_campaign_has_are_refused_before_any_is_made(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, counts: Any, rows: str, place: str
) -> None:
    def made(*_: Any) -> Any:
        raise AssertionError("rows were made")

    monkeypatch.setattr(plan, "draw", made)
    monkeypatch.setattr(plan, "product", made)
    with pytest.raises(ConfigurationError) as error:
        read_plan(written(tmp_path, text_of(*counts)))
    (problem,) = error.value.problems
    assert f"{place}: {rows} rows, allowed: up to 10000000" in problem


@pytest.mark.parametrize("counts", [(1000, 10, [10, 10, 10]), (0, 0, [10] * 7), (10_000_000, 0, [])], ids=str)
def test_as_many_rows_as_are_allowed_are_made(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, counts: Any
) -> None:
    class MadeError(Exception):
        pass

    def made(*_: Any) -> Any:
        raise MadeError

    monkeypatch.setattr(plan, "_subject", made)
    with pytest.raises(MadeError):
        read_plan(written(tmp_path, text_of(*counts)))
