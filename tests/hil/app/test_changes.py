"""Some values of a configuration's text changed."""

from __future__ import annotations

import pytest

from hil.app.configuration.changes import with_changes
from hil.app.configuration.yaml_positions import parse


@pytest.mark.parametrize(("section", "key"), [("controller", "law"), ("reference", "type")])
def test_another_law_or_type_takes_the_keys_of_the_one_before_with_it(section, key):
    text = f"{section}: {{{key}: first, own: 1}}\n"
    other = {section: {key: "second", "its": 2}}
    assert parse(with_changes(text, other)).value == other
    same = {section: {key: "first", "its": 2}}
    assert parse(with_changes(text, same)).value == {section: {key: "first", "own": 1, "its": 2}}
