"""What was measured holds for the hardware that the configuration names, and for no other."""

from typing import Any

import pytest

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.lab.bringup.store import Store, identity

OTHERS: dict[str, tuple[str, dict[str, Any], str]] = {
    "watchdog": ("desktop", {"drives": {"watchdog_ms": 12}}, "drives"),
    "rated_force": ("desktop", {"drives": {"force_limit_N": 200}}, "drives"),
    "radius": ("desktop", {"drives": {"transmission": {"pulley_radius_m": 0.021}}}, "drives"),
    "one_sign": ("desktop", {"drives": {"transmission": {"sign": [1, -1, 1, -1, 1, 1]}}}, "drives"),
    "range": ("desktop", {"drives": {"options": {"position_rad": 12.6}}}, "drives"),
    "heartbeat": ("virtual", {"drives": {"heartbeat_ms": 50}}, "drives"),
    "numbers": ("virtual", {"drives": {"node_ids": [1, 2, 3, 4, 6, 5]}}, "node numbers"),
    "shorter": ("virtual", {"platform": {"length_min_m": 0.76}}, "stroke"),
    "longer": ("virtual", {"platform": {"length_max_m": 2.19}}, "stroke"),
    "bus": ("virtual", {"bus": {"channel": "hil9"}}, "bus"),
}


@pytest.mark.parametrize("case", OTHERS)
def test_with_other_hardware_in_the_configuration_everything_is_proven_again(case, tmp_path):
    name, changes, changed = OTHERS[case]
    c, path = load(name), tmp_path / "s.json"
    store = Store(path, identity(c, ()))
    store.facts["watchdog"] = {"0": {"powered": True, "until_s": 0.012, "since_s": 0.01}}
    store.facts["platform"] = {"hung": True}
    store.save()
    assert Store(path, identity(c, ())).facts == store.facts
    other = loads(with_changes(c.text, changes), "other.yaml", c.folder)
    again = Store(path, identity(other, ()))
    assert (again.changed, again.facts) == (changed, {"platform": {"hung": True}})
