"""The JSON of `hil check` says what the last check said, whatever refused the configuration."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from drivers.errors import BusError, ConfigurationError, HilError, ModelError, PlantError
from hil.cli import main


@pytest.mark.parametrize(
    "error",
    [
        PlantError("legs.fmu: the unit of 'force' is not stated"),
        ModelError("J is singular"),
        BusError("no such interface"),
        ConfigurationError("my.yaml:3:1: one", "my.yaml:4:1: two"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_what_refuses_a_configuration_takes_the_place_of_the_summary_of_an_earlier_good_check(
    error: HilError, monkeypatch, tmp_path
):
    file = tmp_path / "check.json"
    file.write_text(json.dumps({"success": True, "kind": "check", "warnings": []}))

    def refuse(*_: object) -> None:
        raise error

    monkeypatch.setattr("hil.app.check.command.inspect", refuse)
    result = CliRunner().invoke(main, ["check", "virtual", "--json", str(file)])
    assert result.exit_code == 2
    problems = str(error).splitlines()
    assert json.loads(file.read_text()) == {"success": False, "kind": "check", "problems": problems}
    assert all(each in result.stderr for each in problems)
