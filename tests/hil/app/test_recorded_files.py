"""Files of a configuration: found next to it; in a replay found in the log only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.errors import ConfigurationError, LogError
from drivers.sensing.settings import SensorSettings
from hil.app.compose import build_sensors, databases
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.app.recorded_files import (
    CONTROLLER_FILE,
    FEEDFORWARD_CSV,
    REFERENCE_CSV,
    with_attachments,
)
from hil.config.feedforward import FeedforwardSettings
from hil.config.reference import SampledReference
from hil.control.state_space import StateSpaceSettings
from tests.drivers.cia402_sheet import sheet

VIRTUAL = load("virtual")
SAMPLED = VIRTUAL.model_copy(update={"reference": SampledReference(type="sampled", path="my.csv")})
NAMING: Any = {
    REFERENCE_CSV: ("reference", "path", SAMPLED.reference),
    CONTROLLER_FILE: (
        *("controller", "controller_file"),
        StateSpaceSettings(law="state_space", controller_file="my.csv"),
    ),
    FEEDFORWARD_CSV: ("feedforward", "file", FeedforwardSettings(file="my.csv", limit_N=1000.0)),
}


@pytest.mark.parametrize("name", NAMING)
def test_replay_uses_the_file_in_the_log_and_not_the_one_on_disk(tmp_path, monkeypatch, name):
    section, key, settings = NAMING[name]
    naming = VIRTUAL.model_copy(update={section: settings})
    monkeypatch.chdir(tmp_path)
    Path("files").mkdir()
    found = with_attachments(naming, {each: each.encode() for each in NAMING}, Path("files"))
    path = tmp_path / "files" / name
    assert getattr(found, section) == settings.model_copy(update={key: str(path)})
    assert getattr(naming, section) == settings
    assert path.read_bytes() == name.encode()
    assert [each.name for each in Path("files").iterdir()] == [name]


@pytest.mark.parametrize("name", NAMING)
def test_file_missing_from_the_log_is_reported_with_its_configuration_key(tmp_path, name):
    section, key, settings = NAMING[name]
    naming = VIRTUAL.model_copy(update={section: settings})
    files = {each: b"" for each in NAMING if each != name}
    with pytest.raises(LogError, match=rf"a file in {section}\.{key} .* \(attachment {name}\)"):
        with_attachments(naming, files, tmp_path)
    assert list(tmp_path.iterdir()) == []


def inclined(file: str) -> Any:
    """A configuration with an inclinometer by a DBC file."""
    signals = {"roll": "SlopeLong", "pitch": "SlopeLateral"}
    device = {"device": {"protocol": "dbc", "file": file, "signals": signals}}
    return VIRTUAL.model_copy(update={"sensors": SensorSettings.model_validate({"inclination": device})})


def test_sensor_dbc_is_stored_in_the_log_and_replay_reads_only_that_copy(tmp_path):
    example = Path(__file__).parents[3] / "docs/examples/sensors/cia410.dbc"
    c, gone = inclined(str(example)), inclined("/gone.dbc")
    files = dict(databases(c))
    assert files["sensors.inclination.dbc"] == example.read_bytes()
    found, expected = build_sensors(with_attachments(gone, files, tmp_path)), build_sensors(c)
    assert found is not None
    assert expected is not None
    assert [each.device for each in found.sensors.values()] == [
        each.device for each in expected.sensors.values()
    ]
    assert found.tables.rows.tobytes() == expected.tables.rows.tobytes()
    with pytest.raises(LogError, match=r"a file in sensors\.inclination\.device\.file"):
        with_attachments(gone, {}, tmp_path)


def test_dbc_of_the_drives_goes_into_the_log_and_replay_reads_only_that(monkeypatch):
    example = Path(__file__).parents[3] / "docs/examples/drives/rmd.yaml"
    monkeypatch.chdir(example.parent)  # a copy in the working directory is not read either
    c = load(example)
    files = dict(databases(c))
    assert files["drives.dbc"] == example.with_name("rmd.dbc").read_bytes()
    other = {"drives.dbc": files["drives.dbc"].replace(b"Request: 8", b"Inquiry: 8")}
    assert loads(c.text, "log", files=files).drives == c.drives
    assert "Inquiry" in str(loads(c.text, "log", files=other).drives.options["dbc"])
    with pytest.raises(ConfigurationError, match=r"drives\.options\.dbc: no such file: rmd\.dbc"):
        databases(loads(c.text, "log"))


def text(name: str) -> str:
    return with_changes(load("virtual-cia402").text, {"drives": {"options": {"eds": name}}})


@pytest.mark.parametrize("where", ["here", "beside"])
def test_drive_eds_is_found_in_the_working_directory_or_next_to_the_configuration(
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
    with pytest.raises(ConfigurationError, match=r"drives\.options\.eds: .*0x605E:0 .* is missing"):
        loads(text("drive.eds"), "a.yaml", beside)


def test_configuration_from_a_log_opens_no_drive_eds_file(tmp_path: Path) -> None:
    """The content of an invalid sheet would appear in the refusal."""
    secret = tmp_path / "secret"
    secret.write_text("the key\n")
    for name in (str(secret), str(tmp_path / "nowhere")):
        assert loads(text(name), "log.mcap:config.yaml").drives.options["eds"] == name
