"""What is reported of learning, and the masses that a rehearsal's law believes in."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.lab.learn.command import Knowledge, Outcome, learned
from hil.lab.learn.judgement import Floor
from hil.lab.learn.rehearsal import Rehearsal, with_scale
from hil.lab.learn.report import lines, series_summary, summary
from tests.hil.lab.learn.test_learned_from import run_of

OUT = Path("next.csv")
SHARES = {"learned": 0.5, "floor": 0.98, "contradicted": 2.0}
"""State -> error of the second run as a share of the first one's."""


@pytest.fixture(scope="module")
def outcomes() -> dict[str, Outcome]:
    return {state: learned([run_of(0), run_of(1, share)], Knowledge()) for state, share in SHARES.items()}


@pytest.mark.parametrize("state", SHARES)
def test_learning_is_a_success_but_where_a_run_contradicts_it_and_writes_only_where_it_goes_on(
    outcomes: dict[str, Outcome], state: str
) -> None:
    found = summary(outcomes[state], OUT)
    assert (found["state"], found["success"]) == (state, state != "contradicted")
    assert found["written"] == (str(OUT) if state == "learned" else None)
    assert (found["contradiction"] is None) == (state != "contradicted")


@pytest.mark.parametrize("state", SHARES)
@pytest.mark.parametrize("trouble", ["", "run 2: a fault"])
@pytest.mark.parametrize("interrupted", [False, True])
def test_a_series_is_a_success_where_no_run_contradicts_and_none_failed(
    outcomes: dict[str, Outcome], state: str, trouble: str, interrupted: bool
) -> None:
    outcome = outcomes[state]
    trouble = trouble or "interrupted" * interrupted
    made = Rehearsal(outcome.steps, outcome, 300.0, "a text", trouble, interrupted)
    found = series_summary(made, OUT)
    assert found["success"] is (state != "contradicted" and not trouble)
    assert found["state"] == ("interrupted" if interrupted else "failed" if trouble else state)
    assert found["trouble"] == (trouble or None)


@pytest.mark.parametrize(
    ("believed", "scale", "product"), [(1.0, 0.9, 0.9), (0.8, 1.1, 0.88), (1.2, 1.0, 1.2)]
)
def test_the_masses_that_a_law_believes_in_are_scaled_from_what_it_believes_already(
    believed: float, scale: float, product: float
) -> None:
    change = {"name": "virtual", "controller": {"model": {"inertia_scale": believed}}}
    c = load("virtual")
    c = loads(with_changes(c.text, change), "virtual", c.folder)
    before, after = c.controller.believed, with_scale(c, scale).controller.believed
    assert before is not None
    assert after is not None
    assert before.inertia_scale == believed
    assert after.inertia_scale == pytest.approx(product, rel=1e-12)


def test_a_law_without_masses_has_none_to_scale() -> None:
    c = load("virtual")
    pd = {"law": "pd", "kp_N_m": 1e6, "kv_N_s_m": 1e5}
    c = loads(with_changes(c.text, {"name": "virtual", "controller": pd}), "virtual", c.folder)
    with pytest.raises(ConfigurationError, match="--inertia-scale: law pd has no model"):
        with_scale(c, 0.9)


@pytest.mark.parametrize(
    ("parts", "share", "of_what"),
    [
        ((0.6, 0.6, 0.5, 0.0), "the largest part of it", "steps of the encoders"),
        ((0.48**0.5, 0.49**0.5, 0.03**0.5, 0.0), "the largest part of it", "noise of the leg rates"),
        ((0.0, 0.1, 0.7, 0.75), "most of it", "what is faster than the filter"),
        ((0.1, 0.2, 0.71, 0.67), "most of it", "what does not repeat"),
        ((0.1, 0.2, 0.7, 0.69), "the largest part of it", "what does not repeat"),
    ],
)
def test_a_cause_is_called_most_of_the_floor_where_it_has_more_than_half_of_the_squares(
    outcomes: dict[str, Outcome], parts: tuple[float, float, float, float], share: str, of_what: str
) -> None:
    floor = Floor(*(1e-6 * part for part in parts))
    said = [line for line in lines(outcomes["learned"]._replace(floor=floor), 300.0, None) if "Floor" in line]
    assert [f" mm rms, {share} {of_what}" in line for line in said] == [True]
