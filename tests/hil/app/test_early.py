"""What cannot be written is refused before kernels are loaded, let alone compiled."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from drivers.errors import LogError
from hil.app.early import recordings, refuse_folder, refuse_log_folder
from hil.app.picture_folder import choose_picture_folder

ROOT = Path(__file__).parents[3]


def test_a_folder_that_can_be_made_is_not_made_yet(tmp_path):
    refuse_folder(tmp_path / "a" / "b", "mend")
    assert not list(tmp_path.iterdir())


def test_a_file_and_a_link_to_nothing_are_named_with_what_to_do(tmp_path):
    (tmp_path / "runs").touch()
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    with pytest.raises(LogError, match=r"runs: is a file and no folder; mend$"):
        refuse_folder(tmp_path / "runs" / "more", "mend")
    with pytest.raises(LogError, match=r"gone: is a link to nothing; mend$"):
        refuse_folder(tmp_path / "gone", "mend")


def test_the_folder_of_the_configuration_counts_where_no_log_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").touch()
    with pytest.raises(LogError, match=r"^runs: is a file and no folder; .*recording\.folder$"):
        refuse_log_folder("virtual", None)
    refuse_log_folder("virtual", tmp_path / "a.mcap")


@pytest.mark.parametrize("section", ["", "recording: 3\n", "recording: {folder: 4}\n", ": ["])
def test_a_section_that_is_wrong_is_left_to_who_reads_it(section, tmp_path):
    (tmp_path / "my.yaml").write_text(section)
    assert recordings(str(tmp_path / "my.yaml")) in (None, Path("runs"))


def test_the_refusal_needs_no_compiler():
    program = "import sys, hil.app.early; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=False).returncode == 0


def test_matplotlib_gets_a_folder_of_ours_only_where_it_cannot_write_its_own(tmp_path, monkeypatch):
    for name in ("XDG_CONFIG_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.setattr("hil.app.picture_folder.CACHE_FOLDER", tmp_path)
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    monkeypatch.setenv("MPLCONFIGDIR", "")
    choose_picture_folder()
    assert not (tmp_path / "matplotlib").exists()
    (tmp_path / "XDG_CACHE_HOME").touch()
    choose_picture_folder()
    assert (tmp_path / "matplotlib").is_dir()
