"""The files that a log carries are written for its replay, and nothing is where it carries none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.errors import LogError
from hil.app.compose import CONTROLLER_FILE, FEEDFORWARD_CSV, REFERENCE_CSV
from hil.app.configuration.configuration import load
from hil.app.recorded_files import with_attachments
from hil.config.feedforward import FeedforwardSettings
from hil.config.reference import SampledReference
from hil.control.state_space import StateSpaceSettings

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
def test_a_file_in_the_log_replaces_the_one_on_disk(tmp_path, monkeypatch, name):
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
def test_a_file_missing_from_the_log_is_reported_by_its_key(tmp_path, name):
    section, key, settings = NAMING[name]
    naming = VIRTUAL.model_copy(update={section: settings})
    files = {each: b"" for each in NAMING if each != name}
    with pytest.raises(LogError, match=rf"a file in {section}\.{key}, .* \(attachment {name}\)"):
        with_attachments(naming, files, tmp_path)
    assert list(tmp_path.iterdir()) == []
