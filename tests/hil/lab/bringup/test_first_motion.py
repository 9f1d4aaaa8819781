"""Last step of a bring-up: six legs moved by the ordinary controller at reduced limits."""

from __future__ import annotations

from functools import cache

import pytest
from click.testing import CliRunner

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import loads
from hil.cli import main
from hil.lab.bringup.rehearsal import six_legs
from hil.lab.bringup.written_configuration import found_text
from tests.broad import broad
from tests.hil.lab.bringup.rehearsals import Rehearsal

LIGHT = (
    "--mounting hanging --base-radius 0.2 --platform-radius 0.12 --length-min 0.3 --stroke 0.12 --mass 5 "
    "--leg-mass 0.5 --drive-force 200 --drive-speed 0.3 --drives cubemars --model AK80-9 --travel 0.126 --yes"
)
"""5 kg, with drives whose friction is a fifth of the weight on a leg."""


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    """A function for the configuration of a light robot, by the Coulomb friction of its legs in N."""
    path = tmp_path_factory.mktemp("light") / "light.yaml"
    done = CliRunner().invoke(main, ["new", str(path), *LIGHT.split()])
    assert done.exit_code == 0, done.output

    @cache
    def robot(friction_N):
        changes = {"plant": {"model": {"coulomb_friction_N": friction_N}}}
        return loads(with_changes(path.read_text(encoding="utf-8"), changes), "light.yaml")

    return robot


@pytest.mark.parametrize("friction_N", broad([2.0, 0.5, 6.0], quick=1))
def test_sticking_legs_break_away_within_the_speed_limit(friction_N, light):
    """Six simultaneous pushes of 7 N once drove this platform beyond the reduced speed limit."""
    c = light(friction_N)
    rehearsal = Rehearsal(c)
    found = loads(found_text(c, rehearsal.context, ()), "found.yaml")
    assert found.limits.speed_m_s == pytest.approx(0.25 * c.limits.speed_m_s)
    assert found.limits.following_error_m == pytest.approx(0.002), "the lower bound applies: a fifth is less"
    ending = six_legs(found, rehearsal.bench)
    assert ending.success, ending.trouble
