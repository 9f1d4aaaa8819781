"""What is promised of drives that hear nothing more is what they do."""

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.protocol import DriveSetup
from drivers.signals import Reaction
from hil.loop.report import KEPT, not_confirmed, not_told


@pytest.mark.parametrize("says", [not_told, lambda parts: not_confirmed(parts, "")])
def test_a_watchdog_is_promised_where_drives_have_one_and_nowhere_else(says: Any) -> None:
    setup = DriveSetup(0.0125, Reaction.BRAKE, 1000.0)
    with_one, without = (
        says(SimpleNamespace(protocol=SimpleNamespace(traits=SimpleNamespace(has_watchdog=has)), setup=setup))
        for has in (True, False)
    )
    assert "acts 12.5 ms after the last command it heard" in with_one
    assert KEPT not in with_one
    assert KEPT in without
    assert "acts" not in without


@pytest.mark.parametrize("says", [not_told, not_confirmed])
def test_what_a_watchdog_does_is_said_where_it_is_known(says: Any) -> None:
    parts = SimpleNamespace(
        protocol=SimpleNamespace(traits=SimpleNamespace(has_watchdog=True)),
        setup=DriveSetup(0.0125, Reaction.BRAKE, 1000.0),
    )
    assert says(parts, "brake").endswith("after the last command it heard, with reaction `brake`")
    assert says(parts, "").endswith("after the last command it heard")
    begins = "the drives could not be told" if says is not_told else "the watchdog of one that hears nothing"
    assert says(parts, "").startswith(begins)
