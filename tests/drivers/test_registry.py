"""Entry points: a package that cannot be imported, a name registered twice, and the name of a law."""

import os
import subprocess
import sys
from importlib.metadata import EntryPoint

import pytest

from drivers.errors import ConfigurationError
from drivers.registry import loaded, named, registered
from hil.control.law import LawSettings


def test_package_that_cannot_be_imported_is_refused_with_its_entry_point(monkeypatch):
    entry = EntryPoint("broken", "no_such_package:Law", "hil.laws")
    monkeypatch.setitem(registered("hil.laws"), "broken", entry)
    with pytest.raises(ConfigurationError, match=r"hil\.laws: broken = no_such_package:Law .*uninstall"):
        loaded("hil.laws", "broken")


def test_entry_point_name_registered_by_two_packages_is_refused_with_both_packages(tmp_path):
    for name in ("first", "second"):
        installed = tmp_path / f"{name}-1.dist-info"
        installed.mkdir()
        (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
        (installed / "entry_points.txt").write_text(f"[hil.protocols]\nmine = {name}:Mine\n")
    code = "from drivers.registry import registered; registered('hil.protocols')"
    here = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run([sys.executable, "-c", code], env=here, capture_output=True, text=True, check=False)
    assert "first:Mine" in done.stderr
    assert "second:Mine" in done.stderr


def test_settings_class_of_a_control_law_gets_the_name_of_its_entry_point():
    class Mine(LawSettings):
        gain: float

    made = named("mine", Mine, LawSettings, "law").model_validate({"law": "mine", "gain": 1.0})
    assert isinstance(made, Mine)
    assert type(made).model_json_schema()["properties"]["law"]["const"] == "mine"
    with pytest.raises(ValueError, match="law"):
        named("mine", Mine, LawSettings, "law").model_validate({"law": "other", "gain": 1.0})
    with pytest.raises(ConfigurationError, match=r"law mine: .* not a subclass"):
        named("mine", dict, LawSettings, "law")
