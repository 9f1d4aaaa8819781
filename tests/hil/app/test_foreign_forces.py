"""A foreign command whose force no frame of the drives carries is refused before anything runs, with the range."""

from __future__ import annotations

from importlib import resources

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from tests.hil.lab.bringup.families import FAMILIES

KINDS = ["frames_forged_command", "bus_second_controller"]
MOST = {
    "legs_classic": "does not fit layout classic: .* N are allowed",
    "cia402_pdo": "does not fit 0x6071: six of up to .* N are allowed",
    "damiao": "up to .* N m are allowed",
    "odrive": "up to 10000 N m are allowed",
    "moteus_stopped": "up to 7 N m are allowed",
}


def desktop(family: str, kind: str, force_N: float) -> Configuration:
    text = resources.files("configs").joinpath("desktop.yaml").read_text(encoding="utf-8")
    faults = {"faults": [{"kind": kind, "force_N": force_N}]}
    return loads(with_changes(text, FAMILIES[family] | {"plant": faults}), family)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("family", sorted(MOST))
def test_a_force_that_no_frame_carries_is_refused_at_its_key(family, kind, sign):
    given = sign * 654321.0
    match = rf"plant\.faults\[0\]\.force_N: force command .* {MOST[family]}, given: {given:g}"
    with pytest.raises(ConfigurationError, match=match) as refused:
        desktop(family, kind, given)
    assert "limits.force_N" not in str(refused.value)
