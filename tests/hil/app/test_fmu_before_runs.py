"""What a command that makes many runs refuses of an FMU of one's own before the first of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli import main
from tests.hil.app.test_check_fmu import configured


@pytest.mark.parametrize(
    "command",
    [
        ("faults", "--only", "plant_crash", "--jobs", "1"),
        ("compare", "--laws", "pd", "--duration", "0.01", "--jobs", "1", "--picture", "a.png"),
    ],
    ids=lambda command: command[0],
)
def test_an_fmu_that_cannot_be_hosted_is_refused_once_and_not_run_by_run(
    command: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = configured(tmp_path, "brake")
    file.write_text(file.read_text().replace("rate: [rate]", "rate: [speed]\n    isolation: in_process"))
    monkeypatch.chdir(tmp_path)
    name, *options = command
    result = CliRunner().invoke(main, [name, str(file), *options])
    assert result.exit_code == 2, result.output
    assert "no variable 'speed'" in result.output
    assert "could not be run" not in result.output
