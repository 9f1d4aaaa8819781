"""How much is read of a file that a stranger may have made, and what is said of one that has more."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drivers.files import NotRegularError, open_regular, read_regular

MOST = 4_194_304
"""4 MiB."""


def sized(path: Path, size: int) -> Path:
    """Return a file of so many zeros, which takes no room on the disk."""
    with path.open("wb") as file:
        file.truncate(size)
    return path


def test_four_mebibytes_are_read_whole_and_a_byte_more_is_refused_with_the_limit(tmp_path):
    assert len(read_regular(sized(tmp_path / "a", MOST))) == MOST
    with pytest.raises(NotRegularError, match=f"more than the {MOST} bytes"):
        read_regular(sized(tmp_path / "b", MOST + 1))


@pytest.mark.parametrize("most", [0, 1, 1000])
def test_a_limit_of_its_own_takes_the_place_of_that_one(tmp_path, most):
    assert read_regular(sized(tmp_path / "a", most), most) == bytes(most)
    with pytest.raises(NotRegularError, match=f"more than the {most} bytes"):
        read_regular(sized(tmp_path / "b", most + 1), most)


def test_a_file_is_read_as_any_other_although_a_pipe_of_its_name_would_not_have_been_waited_for(tmp_path):
    with open_regular(sized(tmp_path / "a", 3)) as file:
        assert os.get_blocking(file.fileno())
        assert file.read() == bytes(3)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(NotRegularError, match="no regular file"):
        open_regular(tmp_path / "pipe")
