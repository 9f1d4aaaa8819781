"""The files that a log carries are written for its replay, and nothing is where it carries none."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from hil.app.compose import REFERENCE_CSV
from hil.app.configuration.configuration import load
from hil.app.recorded_files import attached
from hil.config.reference import SampledReference

VIRTUAL = load("virtual")
SAMPLED = VIRTUAL.model_copy(update={"reference": SampledReference(type="sampled", path="my.csv")})


def test_a_full_disk_of_temporary_files_is_in_the_way_of_no_configuration_that_names_no_file(monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryDirectory", full)
    with attached(VIRTUAL, {}) as found:
        assert found is VIRTUAL
    with pytest.raises(OSError, match="No space"), attached(SAMPLED, {REFERENCE_CSV: b""}):
        pass


def test_a_file_that_a_log_carries_is_there_while_it_is_needed_and_gone_afterwards():
    with attached(SAMPLED, {REFERENCE_CSV: b"t_s"}) as found:
        assert isinstance(found.reference, SampledReference)
        path = Path(found.reference.path)
        assert path.read_bytes() == b"t_s"
    assert not path.parent.exists()
