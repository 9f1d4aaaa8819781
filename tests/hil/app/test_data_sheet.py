"""The data sheet of a CiA 402 drive is looked at with its configuration, and never by who reads a log."""

from pathlib import Path

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from tests.drivers.cia402_sheet import sheet


def text(name: str) -> str:
    return with_changes(load("virtual-cia402").text, {"drives": {"options": {"eds": name}}})


@pytest.mark.parametrize("where", ["here", "beside"])
def test_a_data_sheet_is_found_here_or_next_to_the_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    here, beside = tmp_path / "here", tmp_path / "beside"
    for folder in (here, beside):
        folder.mkdir()
    monkeypatch.chdir(here)
    file = tmp_path / where / "drive.eds"
    file.write_text(sheet(), encoding="ascii")
    loads(text("drive.eds"), "a.yaml", beside)
    file.write_text(sheet(0x605E), encoding="ascii")
    with pytest.raises(ConfigurationError, match=r"drives\.options\.eds: by .*0x605E:0 .* is not there"):
        loads(text("drive.eds"), "a.yaml", beside)


def test_the_configuration_of_a_log_opens_no_data_sheet(tmp_path: Path) -> None:
    """One that is no sheet would be quoted in the refusal."""
    secret = tmp_path / "secret"
    secret.write_text("the key\n")
    for name in (str(secret), str(tmp_path / "nowhere")):
        assert loads(text(name), "log.mcap:config.yaml").drives.options["eds"] == name
