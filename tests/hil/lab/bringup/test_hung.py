"""The platform hangs on the legs, or is off them: what is known of it at every moment, and is no longer."""

from __future__ import annotations

import json
from typing import Any

import pytest

from hil.lab.bringup.procedure import STEPS
from plant_fmu.rehearsal.wiring import Wiring
from tests.hil.lab.bringup.kit import Rehearsal

MOUNTED = STEPS[-1:]


def saved(rehearsal: Rehearsal) -> list[str]:
    """Return all that a bring-up writes into its state file from now on."""
    written: list[str] = []
    rehearsal.context.save = lambda: written.append(json.dumps(rehearsal.context.facts))
    return written


def asked(rehearsal: Rehearsal, act: str) -> list[float]:
    return [request.value for request in rehearsal.hands.requests if request.act == act]


@pytest.mark.parametrize("stop_at", [3, 4], ids=["first pose", "second pose"])
def test_who_is_ended_while_the_platform_is_being_hung_has_written_that_it_may_hang(stop_at: int) -> None:
    rehearsal = Rehearsal("virtual", Wiring(), stop_at=stop_at)
    written = saved(rehearsal)
    with pytest.raises(KeyboardInterrupt):
        rehearsal.run(MOUNTED)
    assert rehearsal.hands.requests[-1].act == "hang"
    facts = json.loads(written[-1])
    assert facts["platform"] == {"hung": True}
    again = Rehearsal("virtual", Wiring(), facts=facts)
    again.bench.hung = True
    with again.context.opened(2):
        assert not again.bench.hung
    assert (len(asked(again, "take_down")), again.watched.opened_while_hung) == (1, 0)


def test_a_platform_that_is_not_to_be_hung_is_not_said_to_hang() -> None:
    rehearsal = Rehearsal("virtual", Wiring(), stop_at=2)
    with pytest.raises(KeyboardInterrupt):
        rehearsal.run(MOUNTED)
    assert "platform" not in rehearsal.context.facts


def test_each_time_the_platform_was_taken_down_it_is_hung_and_read_anew_at_each_pose() -> None:
    facts: dict[str, dict[str, Any]] = {}
    hung: list[list[float]] = []
    for _ in range(3):
        rehearsal = Rehearsal("virtual", Wiring(), facts=facts)
        written = saved(rehearsal)
        for _ in range(2):
            rehearsal.context.take_down()
        assert len(asked(rehearsal, "take_down")) == len(written) == len(hung[:1]), "once, where it hangs"
        assert not {"platform", "mounted"} & {name for each in written for name in json.loads(each)}
        assert not {"platform", "mounted"} & facts.keys()
        assert rehearsal.run(MOUNTED).success
        hung.append(asked(rehearsal, "hang"))
        assert set(facts["mounted"]) == {"0", "1"}
    assert hung == [[0.0, 1.0]] * 3
