"""The words of `--set`: which changes they are, and which are refused."""

from __future__ import annotations

import pytest

from drivers.errors import ConfigurationError
from hil.app.what_if.changes import read_changes


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["controller.wn_rad_s"], r"--set controller\.wn_rad_s: allowed: section\.key=value"),
        (["=3"], "allowed: section.key=value"),
        (["limits.x[0]=3"], "allowed: section.key=value"),
        (["limits.x=]"], "is no YAML value"),
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
