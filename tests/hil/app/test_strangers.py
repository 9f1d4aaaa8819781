"""Files and texts of strangers: pipes and devices, control characters, files that a log names."""

import os
import re

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.errors import ConfigurationError, LogError
from drivers.files import MOST_BYTES, read_regular
from hil.app.compose import databases
from hil.app.configuration.configuration import load, loads, short_name
from hil.app.configuration.section_file import read_section
from hil.app.files import printable
from hil.app.recorded_files import with_attachments
from hil.app.run.command import _missing
from hil.app.sim.command import simulate
from hil.app.terminal import one_line, visible
from hil.cli import main
from hil.config.axis_model import AxisModel
from hil.config.reference import AxisLimits, TimeOptimalReference
from hil.config.values import Pose
from hil.lab.calibrate.command import read_pairs
from hil.record import Recording
from hil.record.log import Log
from hil.record.salvage import salvage
from hil.trajectory.sampled import read_poses
from hil.trajectory.time_optimal import plan, planned_trajectory
from tests.hil.samples import random_rows
from tools.fuzz import container

VIRTUAL = load("virtual").text


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


# -- what is no regular file ---------------------------------------------------------------------------------


@pytest.mark.parametrize("read", [load, read_pairs, lambda path: read_poses(path, 2)])
def test_a_pipe_is_refused_and_not_waited_for(pipe, read):
    with pytest.raises(ConfigurationError, match="not a regular file"):
        read(pipe)


def test_no_more_is_read_than_a_configuration_can_have(tmp_path):
    large = tmp_path / "large.yaml"
    large.write_bytes(b"#" * MOST_BYTES)
    assert len(read_regular(large)) == MOST_BYTES
    with large.open("ab") as file:
        file.write(b"#")
    with pytest.raises(ConfigurationError, match=f"more than the {MOST_BYTES} bytes"):
        load(large)


# -- names and texts -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["../up", "a b", "a/b", "", "x" * 101, "\\e[31m", "a\\n"])
def test_a_name_that_would_be_a_strange_file_name_is_refused(name):
    text = VIRTUAL.replace("name: virtual\n", f'name: "{name}"\n', 1)
    with pytest.raises(
        ConfigurationError, match=re.escape("name: wrong form, allowed: text of the form [A-Za-z")
    ):
        loads(text)


def test_a_configuration_without_a_name_has_a_plain_one_of_its_file():
    assert (
        loads(VIRTUAL.replace("name: virtual\n", "", 1), "here/my robot\x1b[1m.yaml").name == "my_robot__1m"
    )
    assert short_name("/") == "_"
    assert len(short_name("x" * 300)) == 100


def test_what_steers_a_terminal_is_shown_and_not_sent():
    assert visible("red \x1b[31m\r\x07 back \u202e \x9b\n") == "red \\x1b[31m\\r\\x07 back \\u202e \\x9b\n"
    assert visible("plain é ✓") == "plain é ✓"
    assert one_line("a\nb\u2028c") == "a\\nb\\u2028c"
    assert printable("a\x1b[2J\n.mcap") == "a\\x1b[2J\\n.mcap"


@pytest.mark.parametrize("length", [4000, 4001, 2_000_000])
def test_a_line_for_a_terminal_or_a_page_ends_and_says_how_much_more_there_was(length):
    more = f" ... and {length - 4000} signs more" if length > 4000 else ""
    assert one_line("x" * length) == "x" * 4000 + more


def test_a_message_about_a_hostile_file_is_one_line_without_control_characters(tmp_path):
    path = tmp_path / "a\x1b[2Jb\nc.mcap"
    path.write_bytes(b"no log")
    result = CliRunner().invoke(main, ["plot", str(path)])
    assert result.exit_code == 2
    assert result.stderr.endswith("a\\x1b[2Jb\\nc.mcap: not an MCAP file\n")
    assert result.stderr.count("\n") == 1


# -- what a log names ----------------------------------------------------------------------------------------


@pytest.fixture
def names_a_file():
    """The shipped configuration with a reference from a file, as a log has it: not looked for."""

    def make(file):
        head, _, rest = VIRTUAL.partition("\nreference:")
        behind = rest[re.search(r"\n(?=[a-z])", rest[1:]).start() + 1 :]  # type: ignore[union-attr]
        return f'{head}\nreference:\n  type: sampled\n  path: "{file}"\n{behind}'

    return make


def test_replay_opens_no_file_that_a_log_names(names_a_file, pipe, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("the first line of another file\n")
    for file in (secret, pipe):
        c = loads(names_a_file(file), "log:config.yaml")
        with pytest.raises(LogError, match=r"reference\.path, and the log does not carry it") as found:
            with_attachments(c, {}, tmp_path)
        assert "first line" not in str(found.value)


def test_a_log_of_a_run_that_names_a_pipe_is_refused_at_once(names_a_file, pipe, tmp_path):
    log = tmp_path / "a.mcap"
    metadata = {"kind": "run", "rate_Hz": 1000.0, "watchdog_s": 0.01}
    text = names_a_file(pipe)
    files = databases(load("virtual"))
    with Recording.start(
        log, configuration=text, attachments=files, metadata=metadata, lockstep=True
    ) as recording:
        for row in random_rows(3):
            recording.tick(row, (), ())
    result = CliRunner().invoke(main, ["replay", str(log)])
    assert result.exit_code == 2, result.output
    assert "the log does not carry it (attachment reference.csv)" in result.stderr


def test_a_plan_that_is_none_is_refused():
    limits = (
        "velocity_m_s",
        "velocity_deg_s",
        "acceleration_m_s2",
        "acceleration_deg_s2",
        "jerk_m_s3",
        "jerk_deg_s3",
    )
    points = [Pose(position_m=(0.0, y, 1.0), rotation_vector_deg=(0.0, 0.0, 0.0)) for y in (0.0, 0.1)]
    sound = plan(
        TimeOptimalReference(
            type="time_optimal", points=points, limits=AxisLimits(**dict.fromkeys(limits, 1.0))
        )
    )
    assert planned_trajectory(sound, 1).duration_s
    for bad in (b"", sound[:40], sound[:-8], sound.replace(b"<f8", b"|O8"), sound[:-8] + b"\xff" * 8):
        with pytest.raises(LogError, match="plan of the reference"):
            planned_trajectory(bad, 1)


# -- dropped ticks -------------------------------------------------------------------------------------------


def test_ticks_that_a_log_lacks_are_counted_without_skipped_periods():
    rows = random_rows(5)
    rows["tick"], rows["skipped"] = [0, 1, 5, 6, 9], [0, 0, 2, 0, 0]
    assert _missing(rows) == 1 + 2
    assert _missing(rows[:2]) == 0
    rows["tick"], rows["skipped"] = np.arange(5) + 3, [3, 0, 0, 0, 0]
    assert _missing(rows) == 0


# -- numbers -------------------------------------------------------------------------------------------------

LONG_NUMBERS = {
    "decimal": "-" + "9" * 400,
    "decimal of more digits than Python reads": "9" * 5000,
    "octal": "0o" + "7" * 5000,
    "hexadecimal": "0x" + "F" * 4000,
}


@pytest.mark.parametrize("number", LONG_NUMBERS.values(), ids=LONG_NUMBERS)
def test_a_whole_number_that_no_float_holds_is_refused_at_its_place_in_any_base(tmp_path, number):
    told = rf"number of {len(number)} digits: too long"
    text = VIRTUAL.replace("rate_Hz: 1000", f"rate_Hz: {number}", 1)
    assert number in text
    with pytest.raises(ConfigurationError, match=rf":\d+:\d+: loop\.rate_Hz: {told}"):
        loads(text)
    file = tmp_path / "axes.yaml"
    file.write_text(f"kind: {number}\n")
    with pytest.raises(ConfigurationError, match=rf"axes\.yaml:1:7: kind: {told}"):
        read_section(file, AxisModel)


@pytest.mark.parametrize("number", ["1" + "0" * 308, "0x" + "F" * 255, "0o" + "7" * 341])
def test_a_whole_number_that_a_float_holds_is_judged_by_its_limits(number):
    with pytest.raises(ConfigurationError, match=r"loop\.rate_Hz: .*allowed: .*given: "):
        loads(VIRTUAL.replace("rate_Hz: 1000", f"rate_Hz: {number}", 1))


def test_of_a_log_whose_chunks_are_all_unreadable_it_is_said_that_it_is_damaged_and_not_only_empty(tmp_path):
    path = tmp_path / "a.mcap"
    simulate(load("ideal"), log=path, duration_s=0.02, check_replay=False)
    records = container.split(path.read_bytes())
    strange = [(k, c.replace(b"zstd", b"gzip", int(k == container.CHUNK))) for k, c in records]
    path.write_bytes(container.whole(strange))
    for words in (["plot", str(path)], ["report", str(path)]):
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 2, result.output
        assert re.search(
            r"a\.mcap: has no tick: .*; the log is damaged; \d+ of \d+ bytes are lost", result.stderr
        )


def test_a_log_that_was_salvaged_is_not_said_to_be_mended_by_that(tmp_path):
    """The table of its columns names one twice, which salvage keeps as it is."""
    path, again = tmp_path / "a.mcap", tmp_path / "b.mcap"
    simulate(load("ideal"), log=path, duration_s=0.02, check_replay=False)
    whole = path.read_bytes()
    path.write_bytes(whole.replace(b'"name": "skipped"', b'"name": "tick"   '))
    with pytest.raises(LogError, match="'tick' occurs more than once; run `hil replay --salvage` on it"):
        Log(path)
    salvage(path, again)
    with pytest.raises(
        LogError, match="'tick' occurs more than once; it was salvaged before, and no more can"
    ):
        Log(again)
