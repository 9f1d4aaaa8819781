"""The words of `--set`: which changes they are, which are refused, and how a change is named."""

from __future__ import annotations

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load
from hil.study.what_if.allowed import changes
from hil.study.what_if.changes import read_changes

VIRTUAL = load("virtual")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["controller.wn_rad_s"], r"--set controller\.wn_rad_s: allowed: section\.key=value"),
        (["=3"], "allowed: section.key=value"),
        (["limits.x[0]=3"], "allowed: section.key=value"),
        (["limits.x=]"], "is no YAML value"),
        (["limits={x: 1, x: 2}"], r"'\{x: 1, x: 2\}' is no YAML value"),
        (["limits.x=1\nvalue: 2"], "is no YAML value"),
        (["limits.x=1\ny: 2"], "is no YAML value"),
        (["limits.x=1", "limits.x=2"], r"limits\.x=2: the same key is set twice"),
        (["limits.x=1", "limits.x.y=2"], "the same key is set twice"),
        (["limits.x.y=1", "limits.x=2"], "the same key is set twice"),
        (["limits.x=1", "limits.x.y.z=2"], "the same key is set twice"),
    ],
)
def test_words_that_are_no_change_are_refused(words, message):
    with pytest.raises(ConfigurationError, match=message):
        read_changes(words)


def test_a_change_is_read_as_yaml_and_an_empty_one_takes_the_key_away():
    words = ["a.b=1e3", "a.c=[1, 2]", "a.d={e: x}", "f=", "a.g.h=true"]
    expected = {"a": {"b": 1000.0, "c": [1, 2], "d": {"e": "x"}, "g": {"h": True}}, "f": None}
    assert read_changes(words) == expected


@pytest.mark.parametrize(
    ("length", "shown"), [(59, "x" * 59), (60, "x" * 60), (61, "x" * 57 + "...")], ids=["59", "60", "61"]
)
def test_a_value_of_more_than_sixty_signs_is_cut_on_either_side(length, shown):
    here, there = (VIRTUAL.model_copy(update={"reference": each}) for each in ("x" * length, None))
    assert changes(there, here) == [f"reference: none -> {shown}"]
    assert changes(here, there) == [f"reference: {shown} -> none"]
    assert changes(here, here) == []
