"""What a campaign file may have instead of what it has: said in words of the place where it stands."""

from __future__ import annotations

import pytest

from drivers.errors import ConfigurationError
from hil.study.campaign.plan import read_plan
from tests.hil.study.campaign.campaigns import written

NAME = "text of the form [A-Za-z][A-Za-z0-9_]{0,49}"


def refused(folder, text):
    """Return the one problem of a campaign file, without the file's name."""
    path = written(folder, f"kind: campaign\n{text}\n")
    with pytest.raises(ConfigurationError) as error:
        read_plan(path)
    (problem,) = error.value.problems
    return problem.removeprefix(f"{path}:")


def sampled(words):
    """Return a section with one drawn axis."""
    return f"sample: {{method: sobol, count: 2, axes: {{a: {{key: x.y, {words}}}}}}}"


@pytest.mark.parametrize(
    ("text", "place", "kind"),
    [
        ("grid: {a: {key: x.y, values: []}}", "2:30: grid.a.values", "list"),
        ("grid: {a: {options: {}}}", "2:21: grid.a.options", "section"),
        ("grid: {a: {faults: {}}}", "2:20: grid.a.faults", "section"),
        (sampled("values: []"), "2:64: sample.axes.a.values", "list"),
        ("sample: {method: sobol, count: 2, axes: {}}", "2:41: sample.axes", "section"),
        ("grid: {}", "2:7: grid", "section"),
        ("list: {}", "2:7: list", "section"),
    ],
)
def test_where_there_is_nothing_at_least_one_entry_is_asked_for(tmp_path, text, place, kind):
    said = f"{place}: wrong number of entries, allowed: a {kind} of at least 1 entry, given: 0 entries"
    assert refused(tmp_path, text) == said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "normal: {mean: 3, std: 0, min: 0, max: 9}",
            "normal.std: out of range, allowed: a number greater than 0, given: 0",
        ),
        (
            "normal: {mean: 3, std: 1, min: 0, max: .inf}",
            "normal.max: not a finite number, allowed: a number, given: .inf",
        ),
        ("normal: {std: 1, min: 0, max: 9}", "normal.mean: missing, allowed: a number"),
        ("uniform: [0, .nan]", "uniform[1]: not a finite number, allowed: a number, given: .nan"),
        ("uniform: [-.inf, 0]", "uniform[0]: not a finite number, allowed: a number, given: -.inf"),
        ("uniform: [0]", "uniform: wrong number of entries, allowed: a list of 2 numbers, given: 1 entries"),
        ("integers: [0, 1.5]", "integers[1]: wrong type, allowed: a whole number, given: 1.5"),
        ("values: 3", "values: wrong type, allowed: a list of at least 1 entry or null, given: 3"),
    ],
)
def test_a_wrong_number_of_an_axis_is_told_which_numbers_are_allowed(tmp_path, words, message):
    assert refused(tmp_path, sampled(words)).split(": ", 1)[1] == f"sample.axes.a.{message}"


def test_a_strange_key_of_an_axis_is_told_the_keys_that_there_are(tmp_path):
    said = "2:22: grid.a.units: unknown key, allowed: key, values, options, faults"
    assert refused(tmp_path, "grid: {a: {key: x.y, units: [1]}}") == said


def test_a_name_of_brackets_is_told_so_where_its_axis_is_wrong_too(tmp_path):
    """Of a key itself the check of the file speaks as of `[key]`."""
    said = f'2:8: grid.[key]: wrong form, allowed: {NAME}, given: "[key]"'
    assert refused(tmp_path, 'grid: {"[key]": 3}') == said


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ('grid: {"a b-c/d": AXIS}', "2:8: grid.a b-c/d"),
        ('list: {"a b-c/d": AXIS}', "2:8: list.a b-c/d"),
        (
            'sample: {method: sobol, count: 2, axes: {"a b-c/d": AXIS}}',
            "2:42: sample.axes.a b-c/d",
        ),
    ],
)
def test_a_name_of_an_axis_is_told_of_which_characters_it_may_be(tmp_path, text, place):
    said = f'{place}: wrong form, allowed: {NAME}, given: "a b-c/d"'
    assert refused(tmp_path, text.replace("AXIS", "{key: x.y, values: [1]}")) == said


def test_a_limit_that_no_value_keeps_is_refused_before_anything_runs(tmp_path):
    text = "grid: {a: {key: seed, values: [1]}}\nlimits: {tracked_s: {min: 1, max: 0.1}}"
    said = "3:21: limits.tracked_s: min is above max, allowed: min <= max, given: 1.0, 0.1"
    assert refused(tmp_path, text) == said


def test_a_limit_may_be_one_value(tmp_path):
    """As where each run has to end in a fault."""
    text = "kind: campaign\ngrid: {a: {key: seed, values: [1]}}\nlimits: {faulted: {min: 1, max: 1}}\n"
    limit = read_plan(written(tmp_path, text)).subject.limits["faulted"]
    assert (limit.min, limit.max) == (1.0, 1.0)
