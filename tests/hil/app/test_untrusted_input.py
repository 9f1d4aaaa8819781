"""Untrusted input: control characters, paths in a log, and random damage from a seed."""

import os
import re

import pytest

from drivers.errors import ConfigurationError, LogError
from hil.app.configuration.configuration import load, loads
from hil.app.files import printable
from hil.app.recorded_files import with_attachments
from hil.app.terminal import one_line, visible
from tools.fuzz import __main__ as case
from tools.fuzz.targets import TARGETS, stock

VIRTUAL = load("virtual").text


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


@pytest.mark.parametrize("name", ["../up", "a b", "a/b", "", "x" * 101, "\\e[31m", "a\\n"])
def test_name_that_is_unsafe_as_a_file_name_is_refused(name):
    text = VIRTUAL.replace("name: virtual\n", f'name: "{name}"\n', 1)
    with pytest.raises(
        ConfigurationError, match=re.escape("name: wrong form, allowed: text of the form [A-Za-z")
    ):
        loads(text)


def test_control_characters_are_escaped_on_the_terminal():
    assert visible("red \x1b[31m\r\x07 back \u202e \x9b\n") == "red \\x1b[31m\\r\\x07 back \\u202e \\x9b\n"
    assert visible("plain é ✓") == "plain é ✓"
    assert one_line("a\nb\u2028c") == "a\\nb\\u2028c"
    assert printable("a\x1b[2J\n.mcap") == "a\\x1b[2J\\n.mcap"


@pytest.fixture
def names_a_file():
    """The shipped configuration with a reference from a file, as in a log, without a search for the file."""

    def make(file):
        head, _, rest = VIRTUAL.partition("\nreference:")
        behind = rest[re.search(r"\n(?=[a-z])", rest[1:]).start() + 1 :]  # type: ignore[union-attr]
        return f'{head}\nreference:\n  type: sampled\n  path: "{file}"\n{behind}'

    return make


def test_replay_opens_no_file_path_given_in_a_log(names_a_file, pipe, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("the first line of another file\n")
    for file in (secret, pipe):
        c = loads(names_a_file(file), "log:config.yaml")
        with pytest.raises(LogError, match=r"reference\.path that the log does not carry") as found:
            with_attachments(c, {}, tmp_path)
        assert "first line" not in str(found.value)


QUICK = {"log": 25, "configuration": 12, "csv": 20, "controller": 8, "fmu": 6, "operator": 6}
"""Cases of each kind; `make fuzz` runs thousands."""


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return stock(tmp_path_factory.mktemp("stock"), duration_s=0.05)


@pytest.mark.parametrize("target", TARGETS)
def test_randomly_damaged_input_files_are_refused_without_a_crash(sound, target):
    results = [case.run(seed, sound, target) for seed in range(QUICK[target])]
    assert [r for r in results if r.problem not in {"", "hang"}] == []
    slow = [r for r in results if r.seconds > case.LONGEST_S]
    assert len(slow) < 3  # a first time may compile


@pytest.mark.long
@pytest.mark.parametrize("target", TARGETS)
def test_randomly_damaged_input_files_of_many_seeds_are_refused_without_a_crash(sound, target):
    results = [case.run(seed, sound, target) for seed in range(1000, 1000 + 20 * QUICK[target])]
    assert [r for r in results if r.problem] == []
