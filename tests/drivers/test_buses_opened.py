"""Several buses are opened as one: with the role on each, on one clock, and all of them or none."""

from __future__ import annotations

import os
from typing import Any

import pytest

from drivers.can.bus import Bus
from drivers.can.localcan.participant import Participant
from drivers.can.runtime_folder import RoleLock, runtime_folder
from drivers.config import BusSettings
from drivers.errors import BusError, RunError
from drivers.frame_array import sent_array
from drivers.protocol import BUS, Frame

pytestmark = pytest.mark.usefixtures("runtime")
CHANNELS = ("a", "b", "c")


def three(**wrong: Any) -> BusSettings:
    """Return three channels of two legs each; `wrong`: options of one of them."""
    channels = [
        {"channel": name, "legs": [2 * k, 2 * k + 1], "options": wrong.get(name, {})}
        for k, name in enumerate(CHANNELS)
    ]
    return BusSettings.model_validate({"channels": channels})


def one(channel: str) -> BusSettings:
    return BusSettings(interface="localcan", channel=channel)


@pytest.mark.parametrize("role", ["controller", "plant"])
def test_a_role_is_taken_on_every_bus_and_given_back_on_every_bus(role):
    with Bus.open(three(), role):
        for channel in CHANNELS:
            with pytest.raises(RunError, match=rf"localcan:{channel} already has a {role}.*{os.getpid()}"):
                Bus.open(one(channel), role).close()
        Bus.open(one("d"), role).close()
    for channel in CHANNELS:
        Bus.open(one(channel), role).close()


@pytest.mark.parametrize("taken", CHANNELS)
def test_a_role_that_another_has_on_one_bus_leaves_all_of_them_free(taken):
    with (
        Bus.open(one(taken), "plant"),
        pytest.raises(RunError, match=f"localcan:{taken} already has a plant"),
    ):
        Bus.open(three(), "plant").close()
    Bus.open(three(), "plant").close()


@pytest.mark.parametrize("bad", CHANNELS)
def test_where_one_bus_does_not_open_nobody_stays_on_the_others(bad):
    with pytest.raises(BusError, match="colour") as refused:
        Bus.open(three(**{bad: {"colour": "red"}}), "controller").close()
    assert refused.tb is not None, "what was open then lives on with it"
    assert list(runtime_folder().glob("*.wire*")) == []
    for channel in CHANNELS:
        RoleLock("localcan", channel, "controller").close()


@pytest.mark.parametrize("holder", range(3))
def test_all_channels_of_one_bus_go_by_one_clock(holder):
    with Bus.open(three(), "controller") as bus:
        links: Any = bus._links
        assert [link.clock for link in links] == [bus.clock] * 3
        assert all(isinstance(link, Participant) for link in links)
        # 1 ns to wake up, 1 ns to work: from now on bench time stands still on all of them
        links[holder].clock.begin(1, 1)
        links[holder].clock.holds = True
        links[holder].clock.working()
        stood = bus.clock.now()
        for k in range(3):
            assert bus.send(sent_array([Frame(1, b"", BUS * k)])) == 0
            assert abs(links[k].sent_ns()[0] - stood) < 1_000_000
